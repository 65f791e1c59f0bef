"""What a command meets before it runs: the streams, the working folder, and errors of the operating system."""

from __future__ import annotations

import errno
import io
import os
import sys
import tempfile

from ..errors import DescriptionError

FULL = (errno.ENOSPC, errno.EDQUOT)


def prepare_streams() -> None:
    """Let the standard streams take every character.

    Where the encoding lacks one (``PYTHONIOENCODING=ascii``, an old terminal) its number is shown, such as ``\\xfc``.
    Without this a single unit or file name would end the command.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def keep_to_one_thread() -> None:
    """Let numpy's BLAS start no threads: no command gains by them, and a process that has some is not safe to fork.

    Starting them costs a sixth of the processor time of a short run. Who sets the variable decides otherwise.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def check_working_folder() -> None:
    """Raise DescriptionError if the working folder is gone."""
    try:
        os.getcwd()
    except OSError as error:
        raise DescriptionError(
            f"the working folder cannot be used ({error.strerror}): it was deleted, or may not be entered. "
            "Change to another folder."
        ) from None


def explain(error: OSError) -> str:
    """One sentence for an error of the operating system that nothing nearer to its cause has explained."""
    text = error.strerror or str(error)
    where = f"{error.filename}: " if error.filename else ""
    if error.errno in FULL and not where:
        return f"{text}. Temporary files go to {_temporary()}; the variable TMPDIR names another folder."
    return f"{where}{text}."


def _temporary() -> str:
    try:
        return tempfile.gettempdir()
    except OSError:
        return "a folder that cannot be written"
