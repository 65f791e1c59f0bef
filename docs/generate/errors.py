"""The page of errors: wrong inputs of ``errors.toml`` are run, and shown with the message that they give."""

from __future__ import annotations

import contextlib
import inspect
import io
import os
import shlex
import tempfile
import tomllib
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

import cosim
from cosim.commands.cli import main

from .markup import fenced, language_of, literal, markdown

ROOT = Path(__file__).resolve().parents[2]
LINKED = ("build", "docs")
"""Folders of the source tree that an input may name."""


@dataclass(frozen=True)
class Wrong:
    """A wrong input, as ``errors.toml`` describes it."""

    stage: str
    title: str
    files: Mapping[str, str] = field(default_factory=dict[str, str])
    prepare: str = ""
    run: str = ""
    python: str = ""
    code: int = 2
    text: str = ""


def wrong_inputs() -> list[Wrong]:
    """All wrong inputs, in the order of the page."""
    content = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    return [Wrong(**entry) for entry in content["errors"]]


def write(folder: Path) -> None:
    """Write ``reference/errors.md``: its beginning stands there, the errors follow."""
    page = folder / "reference" / "errors.md"
    lines = [page.read_text(encoding="utf-8")]
    stage = ""
    for wrong in wrong_inputs():
        if wrong.stage != stage:
            stage = wrong.stage
            lines += [f"## {stage}", ""]
        lines.append(_entry(wrong))
    lines += ["## Exceptions", "", *_exceptions()]
    page.write_text("\n".join(lines), encoding="utf-8")


def exceptions() -> dict[str, type[BaseException]]:
    """All exceptions of the package, by the name under which users import them."""
    package = Path(cosim.__file__).parent
    for path in sorted(package.rglob("*.py")):
        if "Error" in path.read_text(encoding="utf-8") and not path.stem.startswith("__"):
            import_module(".".join(("cosim", *path.relative_to(package).with_suffix("").parts)))
    names = {getattr(cosim, name): f"cosim.{name}" for name in cosim.__all__}
    found = dict.fromkeys((*_subclasses(cosim.CosimError), cosim.Interrupted))
    public = (kind for kind in found if not kind.__name__.startswith("_"))
    return dict(sorted((names.get(kind, f"{kind.__module__}.{kind.__qualname__}"), kind) for kind in public))


def _subclasses(kind: type[BaseException]) -> Iterator[type[BaseException]]:
    yield kind
    for inner in kind.__subclasses__():
        if inner.__module__.startswith("cosim."):
            yield from _subclasses(inner)


def _exceptions() -> list[str]:
    """The entries of a list of definitions: each exception, its base and its docstring."""
    lines: list[str] = []
    for name, kind in exceptions().items():
        base = f" (a {literal(kind.__base__.__name__)})" if kind.__base__ is not None else ""
        paragraphs = [markdown(text) for text in (inspect.getdoc(kind) or "").split("\n\n")]
        lines += [f"{literal(name)}{base}", ": " + "\n\n  ".join(paragraphs), ""]
    return lines


def _entry(wrong: Wrong) -> str:
    code, said = told(wrong)
    assert code == wrong.code, f"{wrong.title}: exit code {code}, not {wrong.code}\n{said}"
    lines = [f"### {wrong.title}", ""]
    if wrong.prepare:
        lines += [fenced(wrong.prepare.strip(), "python")]
    for name, text in wrong.files.items():
        lines += [f"{literal(name)}:", "", fenced(text.strip(), language_of(name))]
    if wrong.run:
        lines += [fenced(f"$ {wrong.run}\n{said}", "console", wrapped=True)]
    else:
        lines += [fenced(wrong.python.strip(), "python"), fenced(said, wrapped=True)]
    return "\n".join([*lines, wrong.text, ""])


def told(wrong: Wrong) -> tuple[int, str]:
    """The exit code of a wrong input and what it prints as error, in a folder of its own."""
    with _folder() as place:
        for name, text in wrong.files.items():
            Path(name).write_text(text.lstrip(), encoding="utf-8")
        if wrong.prepare:
            exec(wrong.prepare, {})
        code, said = _run(wrong.run) if wrong.run else _exec(wrong.python)
        for path in (f"{place}{os.sep}", str(place), f"{ROOT}{os.sep}"):
            said = said.replace(path, "")
    return code, said.strip()


@contextlib.contextmanager
def _folder() -> Iterator[Path]:
    """A new working folder, with links to folders of the source tree."""
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        place = Path.cwd()
        for linked in LINKED:
            (place / linked).symlink_to(ROOT / linked)
        yield place


def _run(command: str) -> tuple[int, str]:
    """The exit code of a command, and what it prints on standard error."""
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        try:
            code = main(shlex.split(command)[1:])
        except SystemExit as end:
            code = int(end.code or 0)
    return code, errors.getvalue() or output.getvalue()


def _exec(code: str) -> tuple[int, str]:
    """What a script raises, as Python shows it at the end of a traceback; the exit code is that of a command."""
    try:
        exec(code, {})
    except Exception as error:
        kind = getattr(error, "problems", None)
        return (2 if kind is not None else 1), traceback.format_exception_only(error)[-1]
    return 0, ""
