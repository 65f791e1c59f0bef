"""Operating system signals that ask a run to end. They set a flag during a run, and raise at any other time."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Generator
from types import FrameType

ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)  # Windows has no SIGHUP.


class Ended(KeyboardInterrupt):
    """A signal asked this process to end; ``number`` is the number of the signal."""

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(f"ended by {signal.Signals(number).name}")


def end(number: int, frame: FrameType | None) -> None:
    """Signal handler that raises Ended. Because it is an exception, temporary folders are removed."""
    raise Ended(number)


class Presses:
    """The signals that arrived: ``number`` is the number of the first signal, ``count`` counts all of them."""

    def __init__(self) -> None:
        self.number = 0
        self.count = 0

    def __call__(self) -> bool:
        return self.count > 0


@contextlib.contextmanager
def ending_by_exception() -> Generator[None]:
    """Let SIGTERM and SIGHUP raise Ended, as Ctrl-C raises KeyboardInterrupt.

    Signals that are ignored, or that have another handler, are left alone.
    """
    with _handled([number for number in ENDING if signal.getsignal(number) is signal.SIG_DFL], end):
        yield


@contextlib.contextmanager
def counted(*, most: int) -> Generator[Presses]:
    """Count signals instead of raising, so that no instance is stopped in the middle of a step.

    More than ``most`` signals raise Ended. This acts only in the main thread, and only on signals that would end the
    process otherwise.
    """
    presses = Presses()

    def handle(number: int, frame: FrameType | None) -> None:
        presses.count += 1
        presses.number = presses.number or number
        if presses.count > most:
            end(number, frame)

    deadly = (signal.SIG_DFL, signal.default_int_handler, end)
    with _handled([number for number in ENDING if signal.getsignal(number) in deadly], handle):
        yield presses


@contextlib.contextmanager
def held_back() -> Generator[None]:
    """Hold signals back in this thread until the end of the block, and in processes that it starts until ``released``.

    A process that is interrupted while it starts would show the traceback of an import. Windows cannot hold back.
    """
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def released() -> None:
    """Let signals end this process without a word, those that were held back, too. During a run they end the run."""
    for number in ENDING:
        signal.signal(number, signal.SIG_DFL)
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)


@contextlib.contextmanager
def _handled(numbers: list[signal.Signals], handler: signal._HANDLER) -> Generator[None]:  # pyright: ignore[reportPrivateUsage]
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
