"""Every example of every command runs, and the page of a command says what its help says."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

import pytest

from cosim.commands.cli import main, make_parser
from cosim.commands.parser import Parser, broken
from docs.generate.commands import leaves, page, page_name, write

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = {parser.prog: parser for parser in [make_parser(), *(parser for parser, _ in leaves(make_parser()))]}
EXAMPLES = [example for parser in COMMANDS.values() for example in parser.examples]


def plain(text: str) -> str:
    """The words of a text, without line breaks, list points, and marks of Markdown."""
    return " ".join(re.sub(r"[`\\*]", "", text).split())


def test_every_command_has_an_example_of_its_own() -> None:
    for name, parser in COMMANDS.items():
        assert parser.examples, name
        assert all(f"{example} ".startswith(f"{name} ") for example in parser.examples)


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_example_runs(example: str, native: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The paths of an example start at the folder of the source tree. What it writes stays in the folder of the test.
    for name in ("docs", "fmus"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    program, *arguments = shlex.split(broken(example).replace("\\\n", ""))
    assert program == "cosim"
    assert main(arguments) == 0


@pytest.mark.parametrize("name", COMMANDS)
def test_help_ends_with_the_examples_and_the_exit_codes(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as end:
        main([*name.split()[1:], "--help"])
    assert end.value.code == 0
    words = plain(capsys.readouterr().out)
    for example in COMMANDS[name].examples:
        assert plain(broken(example)) in words
    for code, meaning in COMMANDS[name].exit_codes.items():
        assert f"{code} {meaning}" in words


@pytest.mark.parametrize("parser", [parser for parser, _ in leaves(make_parser())], ids=page_name)
def test_the_page_says_what_the_help_says(parser: Parser) -> None:
    words = plain(page(parser))
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        assert action.help, f"{parser.prog} {action.dest} has no help"
        text = action.help.replace("%%", "%")
        assert plain(text) in words, action.dest
        assert all(name in words for name in action.option_strings)
        if action.default not in (None, False) and action.default != []:
            assert "default:" in text, f"{parser.prog} {action.dest} does not say its default {action.default!r}"
    assert all(plain(broken(example)) in words for example in parser.examples)


def test_each_command_has_a_page(tmp_path: Path) -> None:
    write(tmp_path)
    written = {path.stem for path in (tmp_path / "reference" / "commands").iterdir()}
    assert written == {"index", *(page_name(parser) for parser, _ in leaves(make_parser()))}


def test_a_long_command_is_broken_before_options_only() -> None:
    long = "cosim run " + "a" * 80 + " --plot b.png --output " + "c" * 60
    assert broken(long) == f"cosim run {'a' * 80} \\\n    --plot b.png \\\n    --output {'c' * 60}"
    assert broken("cosim list") == "cosim list"
