"""Pages that are made from the code: nothing on them is written a second time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from docs import equations

from . import api, commands, components, contract, errors, explanations, formats

GENERATORS: list[Callable[[Path], None]] = [
    commands.write,
    formats.write,
    api.write,
    components.write,
    equations.write,
    errors.write,
    contract.write,
    explanations.write,
]
"""Each writes its pages into the copy of docs that Sphinx reads."""
