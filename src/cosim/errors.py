"""The one tree of exceptions, and the wording they share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches


class CosimError(Exception):
    """Base of every error this package raises on purpose."""


class DescriptionError(CosimError):
    """Files, names or values given by the user are wrong; nothing has run. Exit code 2.

    ``problems`` holds every problem found, one sentence each.
    """

    def __init__(self, problems: str | Sequence[str]) -> None:
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        super().__init__("\n".join(self.problems))


class TraceError(CosimError):
    """The equations of a component cannot be traced to C; raised when FMUs are built."""


class SimulationError(CosimError):
    """An FMI call failed during a run. Exit code 1; results computed before are kept."""


class FileError(CosimError):
    """A file or folder cannot be written. Exit code 1; a file that was there before is as it was."""


def suggest(name: str, known: Iterable[str]) -> str:
    """`` Did you mean 'x'?`` for the known name nearest to ``name``, else all of a short list, else ``""``."""
    names = sorted(known)
    near = get_close_matches(name, names, n=1, cutoff=0.6)
    if near:
        return f" Did you mean '{near[0]}'?"
    if 0 < len(names) <= 12:
        return " Known: " + ", ".join(names) + "."
    return ""
