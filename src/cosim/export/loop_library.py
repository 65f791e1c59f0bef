"""The compiled inner loop of the master: from ``loop.c`` to a library beside it, for each platform asked for."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from ..files import write_file
from .compile import TARGETS, compile_binary

FOLDER = Path(__file__).parents[1] / "master"
"""Where the master looks for its loop."""
SOURCE = FOLDER / "loop.c"


def library_names(platforms: Sequence[str]) -> dict[str, str]:
    """Platform -> name of its library, which holds the digest of ``loop.c``: the master loads no other version."""
    digest = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:12]
    return {name: f"loop-{digest}-{name}{TARGETS[name][1]}" for name in platforms}


def compile_loop(platforms: Sequence[str], folder: Path, cache: Path) -> list[Path]:
    """Put the libraries for ``platforms`` into ``folder`` and remove those of other versions; returns what was written.

    Raises BuildError for C that does not compile.
    """
    wanted = library_names(platforms)
    written: list[Path] = []
    for name, file in wanted.items():
        content = compile_binary({SOURCE.name: SOURCE.read_bytes()}, name, cache, (SOURCE.name,))
        path = folder / file
        if not path.is_file() or path.read_bytes() != content:
            # replaced in one go: a running master may have the old one loaded
            write_file(path, content)
            written.append(path)
    current = library_names(tuple(TARGETS)).values()
    for old in folder.glob("loop-*-*"):
        if old.name not in current:
            old.unlink()
    return written
