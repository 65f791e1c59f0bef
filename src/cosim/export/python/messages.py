"""Log messages of a Python FMU. Their texts are those of the contract, as in the C runtime."""

from __future__ import annotations

from typing import NamedTuple

from .. import contract
from ..contract import DISCARD, ERROR, WARNING

CATEGORIES = dict(zip((WARNING, DISCARD, ERROR), contract.CATEGORIES, strict=False))
PHASES = dict(zip((1 << k for k in range(len(contract.PHASES))), contract.PHASES.values(), strict=True))


class LogEntry(NamedTuple):
    """A log message as PythonFMU takes it."""

    status: int
    category: str
    msg: str


class Refusal(Exception):
    """Ends a call with a status and a message of the contract."""

    def __init__(self, status: int, name: str, *arguments: object) -> None:
        self.status, self.text = status, contract.message(name, *arguments)
        super().__init__(self.text)
