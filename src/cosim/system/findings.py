"""The findings while a system is read: problems stop the reading, notes do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from ..errors import suggest
from .values import fraction, show_value


class Findings:
    """Problems and notes about a system, collected so that all of them are reported at once."""

    def __init__(self, name: str, problems: Sequence[str] = ()) -> None:
        self.name = name
        self.problems = list(problems)
        self.notes: list[str] = []

    def problem(self, where: str, text: str) -> None:
        """Add a problem at ``where``, a path of keys."""
        self.problems.append(f"{self.name}: {where}: {text}")

    def note(self, where: str, text: str) -> None:
        """Add a note: something is legal but may surprise."""
        self.notes.append(f"{where}: {text}")

    def known_keys(self, where: str, table: Mapping[str, Any], known: Sequence[str]) -> None:
        """Add a problem for each key of a table that is not in ``known``."""
        for key in table:
            if key not in known:
                path = f"{where}.{key}" if where else key
                self.problem(path, f"unknown key.{suggest(key, known)}")

    def table(self, document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        """The table under ``key``; empty if there is none. Adds a problem if the value is not a table."""
        value = document.get(key, {})
        if isinstance(value, Mapping):
            return cast("Mapping[str, Any]", value)
        self.problem(key, f"must be a table: write [{key}].")
        return {}

    def count(self, where: str, value: object) -> int:
        """``value`` as a whole number of at least 1. For another value, adds a problem and returns 1."""
        number = fraction(value) if not isinstance(value, str) else None
        if number is None or number.denominator != 1 or number < 1:
            self.problem(where, f"{show_value(value)} is not a count. Give a whole number of at least 1.")
            return 1
        return int(number)
