"""Writes files whole or not at all. Makes temporary folders that do not outlive their process for long."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Generator
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from .errors import DescriptionError, FileError

PART = ".part"
"""Ending of the name of an unfinished file."""

FULL = (errno.ENOSPC, errno.EDQUOT)
"""Numbers of the errors that say that the disk is full."""

_REASONS = {
    errno.ENOSPC: "no space is left on the disk",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file would be larger than allowed",
    errno.EACCES: "no permission",
    errno.EPERM: "no permission",
    errno.EROFS: "the file system is read-only",
    errno.ENAMETOOLONG: "the name is too long",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.EISDIR: "it is a folder",
    errno.ENOENT: "there is no such file or folder",
    errno.EMFILE: "too many files are open",
}


def reason(error: OSError) -> str:
    """The reason why an operation on a file failed, as text."""
    return _REASONS.get(error.errno or 0) or error.strerror or str(error)


def cannot_write(path: Path, error: OSError) -> FileError:
    """The FileError for ``path``, which could not be written. An older file there must be unchanged."""
    unchanged = " The file that was there before is unchanged." if _exists(path) else ""
    return FileError(f"{path}: cannot be written: {reason(error)}.{unchanged}")


class Replacement:
    """A new file that is written beside ``path``. ``commit`` puts it in the place of ``path`` in one operation.

    Until then, an older file at ``path`` is unchanged. As a context manager it commits at the end, or removes the new
    file after an exception. Raises FileError if the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            # If ``path`` is a link, the file that it points to is replaced, not the link.
            self._target = path.resolve()
            self._target.parent.mkdir(parents=True, exist_ok=True)
            self._part = _part(self._target)
            self.file: BinaryIO = open(self._part, "xb")  # noqa: SIM115 (closed by commit and discard)
        except OSError as error:
            raise cannot_write(path, error) from None

    def commit(self) -> None:
        """Write the file completely to the disk, then give it its name. Raises FileError."""
        try:
            self.file.flush()
            os.fsync(self.file.fileno())
            self.file.close()
            with contextlib.suppress(FileNotFoundError):
                shutil.copymode(self._target, self._part)
            os.replace(self._part, self._target)
        except OSError as error:
            self.discard()
            raise cannot_write(self.path, error) from None
        except BaseException:
            self.discard()
            raise
        _sync_folder(self._target.parent)

    def discard(self) -> None:
        """Remove the new file."""
        with contextlib.suppress(OSError):
            self.file.close()
        with contextlib.suppress(OSError):
            self._part.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.commit()
            return
        self.discard()
        if isinstance(error, OSError):
            raise cannot_write(self.path, error) from None


def write_file(path: Path, content: bytes | str) -> Path:
    """Write a file, whole or not at all; text is written as UTF-8. Raises FileError."""
    with Replacement(path) as new:
        new.file.write(content.encode() if isinstance(content, str) else content)
    return path


def check_no_folder(path: Path) -> None:
    """Raise DescriptionError if ``path`` is a folder."""
    if os.path.isdir(path):
        raise DescriptionError(f"{path} is a folder. Name a file.")


def check_writable(path: Path) -> None:
    """Raise DescriptionError if the file ``path`` cannot be written now.

    Missing folders count as writable if they can be made. Nothing is left behind by this check.
    """
    check_no_folder(path)
    made: list[Path] = []
    try:
        target = path.resolve()
        folder = target.parent
        for place in (target, next(place for place in (folder, *folder.parents) if _exists(place))):
            if _exists(place) and not stat.S_IMODE(place.stat().st_mode) & 0o222:
                raise PermissionError(errno.EACCES, "write-protected", str(place))
        for place in reversed([place for place in (folder, *folder.parents) if not _exists(place)]):
            place.mkdir()
            made.append(place)
        part = _part(target)
        open(part, "xb").close()
        part.unlink()
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be written: {reason(error)}. Name another file.") from None
    finally:
        for place in reversed(made):
            with contextlib.suppress(OSError):
                place.rmdir()


def _part(target: Path) -> Path:
    """A new path beside ``target``, with at most 40 characters of its name."""
    name = target.name
    # Usual file systems accept names up to 255 bytes. A longer name is not shortened, so that it fails here.
    kept = name if len(os.fsencode(name)) > 255 else name[:40]
    return target.with_name(f"{kept}.{secrets.token_hex(4)}{PART}")


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        return False


def _sync_folder(folder: Path) -> None:
    """Write the names in a folder to the disk, if the system supports this. The content of files is there already."""
    with contextlib.suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


# ---- temporary folders ----

_PREFIX = "cosim-"


@contextlib.contextmanager
def temporary_folder() -> Generator[Path]:
    """A temporary folder that is removed at the end of the ``with`` block.

    Raises FileError if it cannot be made, or if the disk is full when the block writes into it.

    The name of the folder identifies this process. If the process is killed, a later process removes the folder.
    """
    _remove_abandoned()
    place = os.environ.get("TMPDIR") or "the temporary folder"
    if any("\ud800" <= character <= "\udfff" for character in tempfile.gettempdir()):
        # FMPy and lxml cannot open files there
        raise FileError(f"{place}: the name of this folder for temporary files is not UTF-8. Set TMPDIR.")
    try:
        folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{_identity(os.getpid())}-"))
    except OSError as error:
        raise FileError(f"{place}: cannot make a temporary folder there: {reason(error)}. Set TMPDIR.") from None
    try:
        yield folder
    except OSError as error:
        if error.errno not in FULL:
            raise
        raise FileError(f"{folder}: {reason(error)}. The variable TMPDIR names another place.") from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def forbidden_library(text: str) -> str:
    """A sentence for the dynamic linker's ``text`` on a library in a temporary folder without programs; else ``""``."""
    if "failed to map segment" not in text:
        return ""
    return " No program may run from the folder for temporary files (noexec): the variable TMPDIR names another place."


def temporary_variables(folder: Path) -> dict[str, str]:
    """The variables of the environment that make ``folder`` the place for temporary files of another process.

    What that process leaves behind when it is killed is then removed with ``folder``.
    """
    return dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))


@cache
def _remove_abandoned() -> None:
    """Remove the folders of processes that ended without removing them. Done once in a process."""
    with contextlib.suppress(OSError), os.scandir(tempfile.gettempdir()) as entries:
        for entry in entries:
            parts = entry.name.removeprefix(_PREFIX).split("-")
            if entry.name.startswith(_PREFIX) and len(parts) == 4 and parts[0].isdecimal():
                owner = "-".join(parts[:3])
                if parts[2] == _namespace() and owner != _identity(int(parts[0])):
                    shutil.rmtree(entry.path, ignore_errors=True)


def _identity(process: int) -> str:
    """Number, start time and namespace of a process as text; ``""`` if there is no such process.

    Process numbers are used again, so the start time is needed. Containers have their own numbers, so the namespace is
    needed.
    """
    if not _alive(process):
        return ""
    started = "0"
    with contextlib.suppress(OSError):
        # The start time is field 22. Field 2 is the name in brackets, which may contain any characters.
        started = Path(f"/proc/{process}/stat").read_text(errors="replace").rpartition(")")[2].split()[19]
    return f"{process}-{started}-{_namespace()}"


@cache
def _namespace() -> str:
    try:
        return os.readlink("/proc/self/ns/pid").partition("[")[2].rstrip("]")
    except OSError:
        return "0"


def _alive(process: int) -> bool:
    if sys.platform == "win32":
        import ctypes

        # On Windows, os.kill would end the process. 0x1000 is PROCESS_QUERY_LIMITED_INFORMATION.
        handle = ctypes.windll.kernel32.OpenProcess(0x1000, False, process)
        if handle:
            ctypes.windll.kernel32.CloseHandle(handle)
        return bool(handle)
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
