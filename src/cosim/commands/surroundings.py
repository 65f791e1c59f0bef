"""The environment of a command: standard streams, threads, working folder, and errors of the operating system."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import tempfile

from ..errors import DescriptionError
from ..files import FULL


def prepare_streams() -> None:
    """Let the standard streams take every character; what is written to a closed stream (``>&-``) is lost.

    If the encoding lacks a character (``PYTHONIOENCODING=ascii``, an old terminal), its number is shown, such as
    ``\\xfc``. Otherwise, a single unit or file name with such a character would end the command.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (open to the end of the process)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def keep_to_one_thread() -> None:
    """Keep the BLAS of NumPy from starting threads.

    No command is faster with these threads, and a process with threads is not safe to fork. Starting them takes a sixth
    of the processor time of a short run. A user who sets OPENBLAS_NUM_THREADS overrides this.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def replace_missing_home() -> None:
    """Give Matplotlib the temporary folder for its settings if the user has no home folder.

    Matplotlib before 3.11 cannot be imported otherwise. A variable MPLCONFIGDIR that is set stays.
    """
    if os.path.expanduser("~") == "~":
        with contextlib.suppress(OSError):
            os.environ.setdefault("MPLCONFIGDIR", tempfile.gettempdir())


def check_working_folder() -> None:
    """Raise DescriptionError if the working folder does not exist any more or may not be entered."""
    try:
        os.getcwd()
    except OSError as error:
        raise DescriptionError(
            f"the working folder cannot be used ({error.strerror}): it was deleted, or may not be entered. "
            "Change to another folder."
        ) from None


def explain(error: OSError) -> str:
    """One sentence for an error of the operating system that no other code has explained."""
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
