"""The exceptions of this package, which have a common base class, and the hint "Did you mean"."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches

MOST_SHOWN = 200
"""Largest number of characters of a value in a message."""
MOST_LISTED = 12
"""Largest number of known names that a message lists: about two lines."""
MOST_PROBLEMS = 5
"""Largest number of problems of one kind that a message lists."""
MOST_MEANT = 3
"""Names that may be meant by a word; with more the word says too little."""


class CosimError(Exception):
    """Base class of all errors that this package raises on purpose."""


class DescriptionError(CosimError):
    """Files, names or values given by the user are wrong. Nothing has run. Exit code 2.

    ``problems`` holds all problems, one text for each.
    """

    def __init__(self, problems: str | Sequence[str]) -> None:
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        super().__init__("\n".join(self.problems))


class TraceError(CosimError):
    """The equations of a component cannot be traced to C; raised when FMUs are built."""


class SimulationError(CosimError):
    """An FMU could not be loaded, or a run failed. Exit code 1. Results computed before are kept."""


class FileError(CosimError):
    """A file or folder cannot be written. Exit code 1. An older file of the same name is unchanged."""


def clipped(text: str) -> str:
    """``text`` for a message; of a long text only the beginning."""
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]} ..."


def listed(names: Sequence[str], most: int) -> str:
    """The first ``most`` of the names for a message, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def shortened(problems: Sequence[str], what: str = "problems") -> list[str]:
    """The first problems of one kind, and a line such as "and 4 more problems like these."."""
    more = len(problems) - MOST_PROBLEMS
    return [*problems[:MOST_PROBLEMS], *([f"and {more} more {what} like these."] if more > 0 else [])]


def suggest(name: str, known: Iterable[str], meanings: Mapping[str, str] | None = None) -> str:
    """The hint `` Did you mean 'x'?`` with the known name nearest to ``name``.

    With ``meanings``, a name whose meaning has all words of ``name`` is near, too: ``mass`` for ``m``, "Moving mass of
    table". Without a near name, lists all known names if there are at most 12; else returns "".
    """
    names = sorted(known)
    near = get_close_matches(name, names, n=1, cutoff=0.6)
    if near:
        return f" Did you mean '{near[0]}'?"
    words = re.findall("[a-z]{3,}", name.lower())
    if words and meanings is not None:
        meant = [f"'{each}' ({text})" for each, text in meanings.items() if all(word in text.lower() for word in words)]
        if 0 < len(meant) <= MOST_MEANT:
            return f" Did you mean {' or '.join(meant)}?"
    if 0 < len(names) <= MOST_LISTED:
        return " Known: " + ", ".join(names) + "."
    return ""
