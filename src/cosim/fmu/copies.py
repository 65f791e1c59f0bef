"""Copies FMUs into a folder of the user, for other tools."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..errors import DescriptionError, suggest
from ..files import write_file
from .places import fmus_in


def copy_fmus(source: Path, folder: Path, names: Sequence[str] = (), *, force: bool = False) -> list[Path]:
    """Copy the FMUs ``names`` from ``source`` into ``folder``, all of them without names. Returns the files written.

    An existing file with the same content is left alone. A file with other content is replaced only with ``force``.
    Raises DescriptionError with all unknown names and all files in the way, before anything is copied. Raises FileError
    for a folder that cannot be written to.
    """
    known = fmus_in(source)
    problems = [f"no FMU '{name}' in {source}.{suggest(name, known)}" for name in names if name not in known]
    if not known:
        problems.append(f"{source}: there is no FMU. Build the FMUs, or name another folder with --fmus.")
    if folder.exists() and not folder.is_dir():
        problems.append(f"{folder}: is not a folder. Give another one.")
    contents = {folder / known[name].name: known[name].read_bytes() for name in (names or known) if name in known}
    changed: dict[Path, bytes] = {}
    for path, content in contents.items():
        if path.is_dir():
            problems.append(f"{path}: is a folder. Give another folder to copy to.")
        elif not path.is_file():
            changed[path] = content
        elif path.read_bytes() != content:
            changed[path] = content
            if not force:
                problems.append(f"{path}: is another FMU. Give --force to replace it, or another folder.")
    if problems:
        raise DescriptionError(problems)
    for path, content in changed.items():
        write_file(path, content)
    return list(changed)
