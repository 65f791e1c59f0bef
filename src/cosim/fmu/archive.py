"""Zip archives: checks and unpacks archives from unknown sources, and writes this project's own archives."""

from __future__ import annotations

import contextlib
import io
import shutil
import stat
import zipfile
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath

from ..errors import CosimError, DescriptionError, shortened
from ..files import Replacement

MAX_MEMBERS = 20_000
"""Largest number of files in an FMU. An FMU with a Python environment inside has some thousand."""

MAX_MEMBER_BYTES = 512 * 2**20
"""Largest size in bytes of a file in an FMU, unpacked. It leaves room for large tables and libraries."""

MAX_TOTAL_BYTES = 2**30
"""Largest size in bytes of all files of an FMU, unpacked: a small archive can unpack to any size."""

Choice = Callable[[str], bool]
"""A function of a member's name that selects members."""


@contextlib.contextmanager
def opened(path: Path, content: bytes | None = None) -> Generator[zipfile.ZipFile]:
    """The archive at ``path``, to be read in a ``with`` block; ``content`` is its content if it was read before.

    Raises DescriptionError if the archive is damaged, whenever this shows in the block, and OSError.
    """
    try:
        with zipfile.ZipFile(path if content is None else io.BytesIO(content)) as archive:
            archive.filename = str(path)
            yield archive
    except (CosimError, OSError):
        raise
    except Exception as error:  # zipfile raises exceptions of many classes for a damaged archive
        raise DescriptionError(
            f"{path.name}: not a readable zip archive ({error}). Build or download it again."
        ) from None


def checked_members(archive: zipfile.ZipFile, single: Choice = lambda name: True) -> list[zipfile.ZipInfo]:
    """The members of an archive, after a check that none can write outside the folder or fill the disk.

    Names in the archive become plain (``_plain``). Raises DescriptionError for a member that could, and for
    a file whose name is that of a folder. Also raises it if two members have the same name but different content, and
    ``single`` selects this name.
    """
    members = archive.infolist()
    source = Path(str(archive.filename)).name
    problems: list[str] = []
    seen: set[str] = set()
    for member in members:
        member.filename = _plain(member.orig_filename)
    folders = {str(parent) for member in members for parent in PurePosixPath(member.filename).parents}
    for member in members:
        name = member.filename
        path = PurePosixPath(name)
        said = f"{source}: archive member {member.orig_filename!r}"
        if ":" in name or "\0" in name:
            problems.append(f"{said} has a colon or null in its name. Refused.")
        elif path.is_absolute() or ".." in path.parts:
            problems.append(f"{said} points outside the archive. Refused.")
        elif stat.S_ISLNK(member.external_attr >> 16):
            problems.append(f"{said} is a symbolic link. Refused.")
        elif name in seen and single(name) and _differ(name, members):
            problems.append(f"{said} is there twice, with different content. Refused.")
        elif name in folders:
            problems.append(f"{said} is a file, but other members lie in a folder of this name. Refused.")
        if member.flag_bits & 1:
            problems.append(f"{said} is encrypted. Refused.")
        if member.file_size > MAX_MEMBER_BYTES:
            problems.append(
                f"{said} would unpack to {member.file_size / 2**20:.0f} MiB; "
                f"at most {MAX_MEMBER_BYTES // 2**20} MiB are allowed."
            )
        seen.add(name)
    archive.NameToInfo.update({member.filename: member for member in members})
    total = sum(member.file_size for member in members)
    if total > MAX_TOTAL_BYTES:
        problems.append(
            f"{source}: would unpack to {total / 2**20:.0f} MiB; at most {MAX_TOTAL_BYTES // 2**20} MiB are allowed."
        )
    if len(members) > MAX_MEMBERS:
        problems.append(f"{source}: {len(members)} archive members; at most {MAX_MEMBERS} are allowed.")
    if problems:
        raise DescriptionError(shortened(problems))
    return members


def _plain(name: str) -> str:
    """A member's name with slashes only (some Windows programs write backslashes) and without empty parts and dots."""
    slashed = name.replace("\\", "/")
    parts = [part for part in slashed.split("/") if part not in ("", ".")]
    root, end = "/" * slashed.startswith("/"), "/" * slashed.endswith("/")
    return f"{root}{'/'.join(parts)}{end}" if parts else "./"


def repeated(members: Sequence[zipfile.ZipInfo]) -> list[str]:
    """The names that two or more files of different content share. The last file of a name is unpacked."""
    counts = Counter(member.filename for member in members if not member.is_dir())
    return [name for name, count in counts.items() if count > 1 and _differ(name, members)]


def _differ(name: str, members: Iterable[zipfile.ZipInfo]) -> bool:
    return len({(member.CRC, member.file_size) for member in members if member.filename == name}) > 1


def unpack(
    archive: zipfile.ZipFile, folder: Path, needed: Choice = lambda name: True, single: Choice = lambda name: True
) -> None:
    """Write the members that ``needed`` selects into ``folder``.

    Raises DescriptionError if a member is refused (see ``checked_members``), or if the folder cannot take the files,
    for example because the disk is full.
    """
    for member in checked_members(archive, single):
        if not needed(member.filename):
            continue
        target = folder.joinpath(*PurePosixPath(member.filename).parts)
        try:
            if member.is_dir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(member) as source, target.open("wb") as file:
                shutil.copyfileobj(source, file)
        except OSError as error:
            raise DescriptionError(
                f"{Path(str(archive.filename)).name}: cannot be unpacked into {folder}: {error.strerror or error}. "
                "The variable TMPDIR names another folder for temporary files."
            ) from None


def write_zip(target: Path, files: Mapping[str, bytes | Path], first: str, deflated: Collection[str] = ()) -> None:
    """Write an archive whose bytes depend only on the names and contents of its members.

    The member ``first`` comes first; the others are sorted by name. All have the same date. A Path stands for the
    content of that file. Members are stored, or deflated if their name is in ``deflated``.
    Raises FileError; an older ``target`` is then left unchanged.
    """
    with Replacement(target) as new, zipfile.ZipFile(new.file, "w") as archive:
        for name in sorted(files, key=lambda name: (name != first, name)):
            content = files[name]
            entry = zipfile.ZipInfo(name, (2026, 1, 1, 0, 0, 0))
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED if name in deflated else zipfile.ZIP_STORED
            archive.writestr(entry, content.read_bytes() if isinstance(content, Path) else content)
