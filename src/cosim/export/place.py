"""Places in source files for error messages, as in ``my.py, line 12``."""

from __future__ import annotations

import ast
import inspect
import sysconfig
import textwrap
import traceback
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

_NOT_OURS = tuple(
    str(Path(folder).resolve())
    for folder in (Path(__file__).parents[1], sysconfig.get_path("stdlib"), sysconfig.get_path("purelib"))
)
"""Folders of Python and of this package: no line in them was written by the component's author."""


def place(file: str, line: int | None) -> str:
    """``my.py, line 12``; the name alone where no line is known."""
    return Path(file).name if line is None else f"{Path(file).name}, line {line}"


def of_author(file: str) -> bool:
    """Whether the component's author wrote a file: it is not of this package, not of Python, and not installed."""
    return not file.startswith("<") and not str(Path(file).resolve()).startswith(_NOT_OURS)


def of_error(trail: TracebackType | None, within: str = "") -> str:
    """The last line of the author in a traceback; the last one in the file ``within`` if the traceback has one."""
    frames = [frame for frame in traceback.extract_tb(trail) if of_author(frame.filename)]
    frames = [frame for frame in frames if frame.filename == within] or frames
    return place(frames[-1].filename, frames[-1].lineno) if frames else ""


def of_caller(frame: FrameType | None) -> str:
    """The line of the author that is nearest in the call stack."""
    while frame is not None and not of_author(frame.f_code.co_filename):
        frame = frame.f_back
    return place(frame.f_code.co_filename, frame.f_lineno) if frame is not None else ""


def of_method(owner: type[Any], name: str) -> str:
    """The first line of a method."""
    code = getattr(inspect.unwrap(getattr(owner, name)), "__code__", None)
    return of_class(owner) if code is None else place(code.co_filename, code.co_firstlineno)


def of_class(owner: type[Any]) -> str:
    """The first line of a class; its file where the text cannot be read."""
    try:
        return place(inspect.getsourcefile(owner) or "", inspect.getsourcelines(owner)[1])
    except (OSError, TypeError):
        return owner.__module__


def of_declaration(owner: type[Any], attribute: str) -> str:
    """The line that declares ``attribute``, in the class or the base class that has it."""
    for base in owner.__mro__:
        if attribute not in vars(base).get("__annotations__", {}):
            continue
        try:
            lines, first = inspect.getsourcelines(base)
            tree = ast.parse(textwrap.dedent("".join(lines)))
        except (OSError, TypeError, SyntaxError):
            return of_class(base)
        for node in ast.walk(tree):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == attribute:
                return place(inspect.getsourcefile(base) or "", first + node.lineno - 1)
    return of_class(owner)
