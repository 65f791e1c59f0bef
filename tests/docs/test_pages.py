"""Every command and script on a page is run by somebody: by the site's build, by a test, or it says that it is not."""

from __future__ import annotations

import re

from conftest import ROOT
from markdown_it import MarkdownIt

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
RUNNABLE = {"sh", "console", "python", "bash"}
MARKS = {"run", "run-importers"}
"""tests/importers/page.py follows blocks with these marks."""
ELSEWHERE = {
    r"pip install \"?motion_cosim-.*": "tests/export/test_wheel.py",
    r"cosim run shams2010/fsmc_5sin --plot run.png": "tests/export/test_wheel.py",
    r"cosim fmus copy my_fmus": "tests/commands/test_copy_fmus.py",
    r"make (demo|test|docs|lint|lowest)( .*)?": ".ci/run",
    r"source .venv/bin/activate": ".ci/venv",
}
"""Lines of a terminal, and the file that runs such lines."""
NOT_RUN = {
    r"make (wheel|release)( .*)?": "minutes of compiling for five platforms; run before a release",
    r"make bench|python benchmarks/\w+.py": "minutes, and what they measure depends on the machine",
}
"""Lines that nothing runs, and why."""
TESTED = {"docs/results.md": "tests/result/test_results_page.py"}
"""Pages whose Python is run as a whole, and the test that does it."""


def blocks(text: str) -> list[tuple[str, str, str]]:
    """Section, info string and content of each code block."""
    found: list[tuple[str, str, str]] = []
    section = ""
    tokens = MarkdownIt().parse(text)
    for token, after in zip(tokens, [*tokens[1:], None], strict=True):
        if token.type == "heading_open" and after is not None:
            section = after.content
        elif token.type == "fence":
            found.append((section, token.info.strip(), token.content))
    return found


def unsaid(section: str, text: str) -> bool:
    """Whether a section fails to say that its code is not run here."""
    return "not run here" not in text.rsplit(f"\n## {section}\n", 1)[-1].split("\n## ", 1)[0]


def test_every_command_and_script_is_run_by_somebody() -> None:
    counted, wrong = 0, []
    for page in PAGES:
        name, text = page.relative_to(ROOT).as_posix(), page.read_text(encoding="utf-8")
        for section, info, content in blocks(text):
            language, _, mark = info.partition(" ")
            lines = [line.split("  #")[0].strip() for line in content.splitlines() if line.strip()]
            if language not in RUNNABLE or mark in MARKS or name in TESTED:
                counted += language in RUNNABLE
            elif language == "sh" and all(
                any(re.fullmatch(rule, line) for rule in (*ELSEWHERE, *NOT_RUN)) for line in lines
            ):
                counted += len(lines)
            elif unsaid(section, text):
                wrong.append(f"{name}, {section}: {lines[0]}")
    assert wrong == []
    assert counted > 20


def test_what_runs_lines_elsewhere_is_there() -> None:
    assert [file for file in {*ELSEWHERE.values(), *TESTED.values()} if not (ROOT / file).is_file()] == []


def test_no_page_hides_commands_in_a_block_without_language() -> None:
    hidden = [
        f"{page.name}, {section}: {line}"
        for page in PAGES
        for section, info, content in blocks(page.read_text(encoding="utf-8"))
        if not info
        for line in content.splitlines()
        if re.match(r"(\$ )?(cosim|python|make|pip) ", line)
    ]
    assert hidden == []
