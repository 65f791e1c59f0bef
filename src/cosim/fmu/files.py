"""Files written in one go: nobody ever sees half of one, and an older file stays until the new one is whole."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(target: Path) -> Generator[Path]:
    """A file to write in place of ``target``, in its folder, which is made; it becomes ``target`` at the end.

    If anything is raised, it is removed and ``target`` left alone.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield partial
        partial.replace(target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def write_file(target: Path, content: bytes) -> None:
    """Write ``content`` in one go. Raises OSError."""
    with replacing(target) as partial:
        partial.write_bytes(content)
