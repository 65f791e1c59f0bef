"""Fenced blocks that run while the site is built: {run} for commands, {file} for what they read.

    ```{run}
    :picture: run.png
    :alt: What the picture shows
    cosim run shams2010/fsmc_5sin --plot run.png
    ```

All blocks of a page run in one folder, one after the other; a line that ends in a backslash goes on in the next one.
A command that does not end with the exit code of the option ``exit`` (0) is a warning, which fails the build. Times and
folders of this machine are taken out of what is shown.

    ```{file} stage.toml
    description = "My stage"
    ```

writes the file into the folder of the page and shows it; ``{file} script.py`` with the option ``run`` starts it, too.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
import textwrap
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from docs.generate.markup import language_of

ROOT = Path(__file__).resolve().parents[1]
COMPUTING_TIME = re.compile(
    r"^(.* times real time| *Elapsed .* s) *\n|(?<=runs of a record) in \S+ s|(?<= passed) in \S+s$", re.MULTILINE
)
TIME_COLUMN = "Time / s"
FOLDER = re.compile(r"(?<!\S)/\S+/(?=\S)")
"""The folders of an absolute path, up to the name of the file."""
WIDTH, TOO_LONG = 80, 100
"""Lines of output with more characters are sentences, not tables: they are broken as a terminal breaks them."""
LINKS = ("build", "docs", "fmus", "studies")
"""What lies in the folder of a page as in a checkout."""


def cleaned(text: str) -> str:
    """A program's output that is the same each time: no computing times, no folders of this machine, long
    sentences broken, no blanks at the ends of lines."""
    text = text.replace(str(ROOT), "/checkout")  # its folders may have blanks in their names
    text = FOLDER.sub("", COMPUTING_TIME.sub("", _without_time_column(text)))
    lines: list[str] = []
    for line in text.splitlines():
        lines += textwrap.wrap(line, WIDTH) if len(line) > TOO_LONG else [line]
    return "\n".join(line.rstrip() for line in lines).strip("\n")


def _without_time_column(text: str) -> str:
    """The text without the columns of computing times in its tables. A table ends at an empty line."""
    lines: list[str] = []
    column: slice | None = None
    for line in text.splitlines():
        if TIME_COLUMN in line:
            end = line.index(TIME_COLUMN) + len(TIME_COLUMN)
            column = slice(end - len(TIME_COLUMN), end + 3)  # with the gap to the next column
        elif not line.strip():
            column = None
        lines.append(line if column is None else line[: column.start] + line[column.stop :])
    return "\n".join(lines)


class Block(SphinxDirective):
    """A block with something that runs."""

    has_content = True

    def output(self, line: str, folder: Path, expected: int) -> str:
        """What a command prints; another exit code than the expected one fails the build."""
        ended = subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True, check=False)
        output = cleaned(ended.stdout + ended.stderr)
        if ended.returncode != expected:
            raise self.severe(f"{line}\nended with {ended.returncode}, not {expected}:\n{output}")
        self.env.app.commands_run += 1  # pyright: ignore[reportAttributeAccessIssue]
        return output


class Run(Block):
    """A block of commands."""

    option_spec = {  # noqa: RUF012 - docutils has it so
        "exit": directives.nonnegative_int,
        "picture": directives.unchanged,
        "alt": directives.unchanged,
    }

    def run(self) -> list[nodes.Node]:
        folder, shown = page_folder(self.env.app, self.env.docname), []
        for command in "\n".join(self.content).replace("\\\n", "\\\0").splitlines():
            line = command.replace("\\\0", "\\\n")
            shown.append(f"$ {line}")
            if self.config.run_commands:
                shown.append(self.output(line, folder, self.options.get("exit", 0)))
        block = nodes.literal_block("\n".join(shown), "\n".join(shown), language="console")
        picture = [self.picture(folder)] if "picture" in self.options and self.config.run_commands else []
        return [block, *picture]

    def picture(self, folder: Path) -> nodes.image:
        """A picture that the commands wrote, beside the pages."""
        if "alt" not in self.options:
            raise self.severe("a picture needs the option alt, which says what it shows")
        file = folder / self.options["picture"]
        name = f"{hashlib.sha256(file.read_bytes()).hexdigest()[:12]}-{file.name}"
        kept = Path(self.env.srcdir) / "run-pictures"
        kept.mkdir(exist_ok=True)
        shutil.copyfile(file, kept / name)
        uri = f"/run-pictures/{name}"
        return nodes.image(uri=uri, alt=self.options["alt"])


class File(Block):
    """A block that is written to a file and perhaps started."""

    required_arguments = 1
    option_spec = {"run": directives.flag}  # noqa: RUF012 - docutils has it so

    def run(self) -> list[nodes.Node]:
        name, text = self.arguments[0], "\n".join(self.content) + "\n"
        folder = page_folder(self.env.app, self.env.docname)
        (folder / name).write_text(text, encoding="utf-8")
        content = nodes.literal_block(text, text, language=language_of(name))
        shown: list[nodes.Node] = [named(name, [content], self.state.document)]
        if "run" in self.options and self.config.run_commands:
            output = self.output(f"python {name}", folder, 0)
            shown += [nodes.literal_block(output, output, language="text")] if output else []
        return shown


def named(name: str, content: list[nodes.Node], document: nodes.document) -> nodes.container:
    """A file on a page: its name above its content."""
    wrapper = nodes.container("", nodes.caption("", "", nodes.literal("", name)), *content)
    wrapper["literal_block"] = True
    wrapper["classes"].append("literal-block-wrapper")
    document.set_id(wrapper)
    return wrapper


def page_folder(app: Sphinx, page: str) -> Path:
    """The folder in which the commands of a page run."""
    folder = Path(app.outdir).parent / "run" / page
    if not folder.exists():
        folder.mkdir(parents=True)
        for name in LINKS:
            (folder / name).symlink_to(ROOT / name, target_is_directory=True)
    return folder


def count(app: Sphinx, error: Exception | None) -> None:
    """How many commands ran, for whoever reads the build."""
    if error is None and app.config.run_commands:
        print(f"{app.commands_run} commands on pages ran")  # noqa: T201  # pyright: ignore[reportAttributeAccessIssue]


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.commands_run = 0  # pyright: ignore[reportAttributeAccessIssue]
    app.add_config_value("run_commands", True, "env", bool)
    app.add_directive("run", Run)
    app.add_directive("file", File)
    app.connect("build-finished", count)
    return {"version": "1", "parallel_read_safe": False}
