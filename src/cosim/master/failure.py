"""How a process of FMUs ended that must go on: it crashed, an FMU ended it, or it took too long.

All commands use the same words, from the board on which the process has shown its calls.
"""

from __future__ import annotations

import signal

from .board import Board
from .instance import CallError


class ProcessError(CallError):
    """The process of the FMUs crashed, was ended by an FMU, or took too long.

    ``instance`` and ``function`` name the present or last call. ``status`` is "Crash", "Exit" or "Timeout". ``result``
    holds all complete rows; it is None if the rows were in the process.
    """

    def __init__(self, text: str, instance: str, function: str, *, time: float, status: str) -> None:
        super().__init__(instance, function, time=time, status=status, message="")
        self.args = (text,)

    def of(self, run: str) -> ProcessError:
        """The same error, whose text begins with the name of the ``run``."""
        self.args = (f"{run}: {self}",)
        return self


class CallClock:
    """Measures how long the present call of an FMU takes, as seen from the watching process."""

    def __init__(self, board: Board, now: float) -> None:
        self._board = board
        self._mark: tuple[int, ...] = ()
        self.since = now

    def seconds(self, now: float) -> float:
        """Time of the present call in s, at ``now`` in s; 0 between two calls."""
        mark = self._board.mark()
        if mark != self._mark:
            self._mark, self.since = mark, now
        return now - self.since if self._board.calling else 0.0


def process_error(board: Board, code: int | None, *, limit: str = "") -> ProcessError:
    """The error for a process that ended with the exit ``code``, or that was killed because of a ``limit``.

    ``code`` is negative for a signal, and None if the process goes on but does not answer. ``limit`` says what took too
    long.
    """
    if limit:
        status, what = "Timeout", f"had not come back {limit}, and was ended"
    elif code is None:
        status, what = "Crash", "closed or damaged the connection to this process"
    elif code < 0:
        status, what = "Crash", f"crashed: {signal_text(-code)}"
    elif code >= 0xC0000000:
        # On Windows, the exit code of a crashed process is the number of the exception.
        status, what = "Crash", f"crashed with exception 0x{code:08X}"
    else:
        status, what = "Exit", f"ended its process with exit code {code}, which an FMU must not do"
    (instance, function), time, why = board.called(), board.time(), ""
    if not function:
        where = "before the first call of an FMU, the process"
    elif board.calling:
        where = f"{instance}: {function} at {time:.9g} s"
    else:
        where = f"{instance}: after {function} at {time:.9g} s, between two calls, the process"
        why = (
            ""
            if limit or code is None
            else " An FMU has left a thread running, or has damaged memory in an earlier call."
        )
    return ProcessError(f"{where} {what}.{why}", instance, function, time=time, status=status)


def limit_text(seconds: float, of: str) -> str:
    """What took too long, for ``process_error``: a limit in s ``of`` a run or another part of the work."""
    return f"when {seconds:g} s had passed, the limit for {of}"


def signal_text(number: int) -> str:
    """The name and the meaning of a signal that ended a process, as text."""
    try:
        name = signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
    meanings = {
        "SIGSEGV": "it used memory that is not its own",
        "SIGBUS": "it used memory that is not there",
        "SIGABRT": "it gave up, after an error it found itself",
        "SIGFPE": "a calculation is not defined, such as a division of integers by zero",
        "SIGILL": "an instruction that this processor does not have",
        "SIGKILL": "ended from outside; perhaps the memory was used up",
    }
    return f"{name}, {meanings[name]}" if name in meanings else name
