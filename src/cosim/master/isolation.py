"""A run whose FMUs are in another process. Even if they crash this process, the run is reported and its rows are kept.

The other process is forked if this is safe, otherwise it is a new Python process. This module is the watching side: it
reads the progress from shared memory, collects messages, kills a process that hangs, and reports what happened.
"""

from __future__ import annotations

import contextlib
import queue
import sys
import threading
import time as clock_time
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import CosimError, FileError
from ..files import temporary_folder
from ..result.result import Message, Result
from ..system.system import System
from . import loop
from .board import DRAINED, FINISHED, STEPPING, STOP, Board
from .child import Assignment, Ending, sent
from .failure import CallClock, process_error
from .instance import MAX_TEXT, RunError, log_message
from .interrupts import Presses, counted
from .process import FmuProcess, fork_process, may_fork, shared_memory, start_process
from .run import Interrupted, Progress, check_memory, make_result, row_times

POLL_SECONDS = 0.05
"""Time between two looks of the watching process. A message or the end of the run wakes it at once."""

GRACE_SECONDS = 0.4
"""Time that a call may go on after Ctrl-C before the process is killed, so that the command ends within a second."""

JOIN_SECONDS = 0.5
"""Longest time to read the rest of the pipes of a process that has ended."""

WINDOW_BYTES = 2**24
"""Size of each of the two windows of rows, if the rows are not all kept in memory."""

PRINTED_LINES = 1000
"""Largest number of lines printed by FMUs that are kept."""


class RecordError(RunError):
    """The record of a run could not be written during the run. ``result`` holds the rows kept in memory."""


class RecordSink(Protocol):
    """Takes rows during the run."""

    def write(self, times: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
        """Take the next rows, one for each of ``times`` in s. Raises FileError; this ends the run."""
        ...


def simulate_isolated(
    system: System,
    *,
    progress: Progress | None = None,
    debug: bool = False,
    keep_going: bool = False,
    timeout: float | None = None,
    sink: RecordSink | None = None,
    most_bytes: int | None = None,
    fork: bool | None = None,
) -> Result:
    """Run ``system`` once in another process.

    An FMI call that takes longer than ``timeout`` seconds ends the run. If all rows with their times need more than
    ``most_bytes``, the result holds only every n-th row, as if ``decimation`` were larger; ``sink`` gets all rows
    during the run. ``fork``: whether to fork (default: if this is safe).
    Raises the errors of ``simulate``, ProcessError, and RecordError if ``sink`` fails.
    """
    rows = system.steps // system.decimation + 1
    columns = len(system.record)
    # Two spare rows, see Board.room.
    capacity, windows = rows + 2, 1
    size = 8 * rows * (1 + columns)
    if most_bytes is not None and size > most_bytes:
        capacity, windows = max(2, WINDOW_BYTES // max(8 * columns, 1)), 2
    else:
        check_memory(system, rows)
    fork = may_fork() if fork is None else fork
    with temporary_folder() as folder:
        job = Assignment(folder, debug, keep_going, columns, capacity, windows)
        every = 1 if windows == 1 or most_bytes is None else -(-size // most_bytes)
        with shared_memory(folder, Board.size(columns, capacity, windows), shared_file=not fork) as (memory, file):
            board = Board(memoryview(memory), columns, capacity, windows)
            # Load the loop before the fork, so that the child has it.
            loop.compiled()
            process = fork_process(system, job, memory) if fork else start_process(system, job, file)
            watch = _Watch(system, process, board, timeout=timeout, progress=progress, sink=sink, every=every)
            return watch.run()


class _Watch:
    """Watches one run to its end."""

    def __init__(
        self,
        system: System,
        process: FmuProcess,
        board: Board,
        *,
        timeout: float | None,
        progress: Progress | None,
        sink: RecordSink | None,
        every: int,
    ) -> None:
        self.system = system
        self.process = process
        self.board = board
        self.timeout = timeout
        self.progress = progress
        self.sink = sink
        self.every = every
        self.started = clock_time.perf_counter()
        self.came: queue.SimpleQueue[Message | Ending | None] = queue.SimpleQueue()
        self.messages: list[Message] = []
        self.dropped = 0
        self.outcome: Ending | None = None
        self.timed_out = False
        self.failed: FileError | None = None
        self.taken = 0
        """Number of rows taken from windows."""
        self.kept: list[NDArray[np.float64]] = []
        self.calls = CallClock(board, self.started)

    def run(self) -> Result:
        readers = [
            (threading.Thread(target=read, args=(file,), daemon=True), file)
            for read, file in ((self.read_channel, self.process.channel), (self.read_printed, self.process.printed))
        ]
        try:
            with counted(most=2) as presses:
                for reader, _ in readers:
                    reader.start()
                self.wait(presses)
        finally:
            self.process.kill()
            for reader, file in readers:
                reader.join(JOIN_SECONDS)
                # A process that an FMU has started may have left the group and still hold the pipe. Then the reader
                # does not end; it is a daemon thread.
                if not reader.is_alive():
                    file.close()
        while not self.came.empty():
            self.take(self.came.get())
        return self.result(presses)

    def wait(self, presses: Presses) -> None:
        """Wait until the process has ended, or until it must be killed."""
        pressed = 0.0
        while not self.process.ended():
            # A closed pipe usually means that the process ends. But an FMU may close it, too.
            with contextlib.suppress(queue.Empty):
                self.take(self.came.get(timeout=POLL_SECONDS))
            now = clock_time.perf_counter()
            if self.drain():
                self.calls.since = now
            if self.progress is not None:
                self.progress(min(1.0, int(self.board.state[loop.POINT]) / self.system.steps))
            if presses.count > 0:
                self.board.flags[STOP] = 1
                pressed = pressed or now
            killed = presses.count > 1 or (pressed and now - pressed > GRACE_SECONDS) or self.failed is not None
            if killed or self.overdue(now):
                return

    def take(self, item: Message | Ending | None) -> None:
        if isinstance(item, Message):
            self.messages.append(item)
            log_message(item)
        elif isinstance(item, Ending):
            self.outcome = item
        elif item is None:
            # The pipe has ended. The process will probably end within milliseconds.
            for _ in range(20):
                if self.process.ended():
                    return
                clock_time.sleep(1e-3)

    def overdue(self, now: float) -> bool:
        """Whether the present call has taken longer than the timeout."""
        spent = self.calls.seconds(now)
        self.timed_out = self.timeout is not None and spent > self.timeout
        return self.timed_out

    # Rows

    def drain(self) -> bool:
        """Take all windows that were handed over. Returns whether there were any."""
        full = self.board.full()
        for rows in full:
            self.keep(rows)
            self.board.flags[DRAINED] += 1
        return bool(full)

    def keep(self, rows: NDArray[np.float64]) -> None:
        if self.sink is not None and self.failed is None:
            try:
                self.sink.write(row_times(self.system, self.taken, len(rows)), rows)
            except FileError as error:
                self.failed = error
        self.kept.append(rows[-self.taken % self.every :: self.every].copy())
        self.taken += len(rows)

    def rows(self) -> NDArray[np.float64]:
        """All complete rows, or every n-th of them; shape (rows, recorded variables)."""
        board = self.board
        count = int(board.state[loop.ROWS]) if board.flags[STEPPING] else 0
        if len(board.rows) == 1:
            # An FMU may have overwritten the number of rows. It is limited to the rows that there can be.
            rows = board.rows[0][: max(0, min(count, board.capacity - 2))]
            return rows if sys.platform == "linux" else rows.copy()
        self.drain()
        due = -(-int(board.state[loop.POINT]) // self.system.decimation)
        if self.taken + count > due + 1:
            # The process ended after it handed a window over and before it began the next: its count is the old one.
            count = 0
        self.keep(board.window[: max(0, min(count, board.capacity))])
        rows, self.kept = np.concatenate(self.kept), []
        return rows

    # What happened

    def result(self, presses: Presses) -> Result:
        """The result of the run. Raises the error that ended the run early."""
        outcome = self.outcome
        error = None if outcome is None else outcome.error
        if outcome is not None and outcome.bug:
            raise RuntimeError(f"in the process of the FMUs:\n{outcome.bug}")
        if error is not None and not issubclass(error[0], RunError):
            raise _rebuilt(error)
        finished = bool(self.board.flags[FINISHED]) and self.process.code == 0
        complete = int(self.board.state[loop.POINT]) == self.system.steps or (outcome is not None and outcome.ended)
        complete = complete and bool(self.board.flags[STEPPING])
        elapsed = clock_time.perf_counter() - self.started
        result = make_result(
            self.system,
            self.rows(),
            self.board.state,
            every=self.every,
            messages=self.messages,
            dropped_messages=self.dropped + (0 if outcome is None else outcome.dropped_messages),
            solver={} if outcome is None else outcome.solver,
            partial=error is not None or not complete or (outcome is not None and outcome.stopped),
            total_seconds=elapsed,
            stepping_seconds=elapsed if outcome is None else outcome.seconds,
        )
        failure: RunError | None = None
        if self.failed is not None:
            failure = RecordError(str(self.failed), time=self.board.time())
        elif error is not None:
            failure = _rebuilt(error)
        elif presses.count > 0:
            # Also after a complete run: what called this may have more to do.
            raise Interrupted(result, presses.number)
        elif not finished:
            limit = f"after {self.timeout:g} s, the limit for a call" if self.timed_out else ""
            failure = process_error(self.board, self.process.code, limit=limit)
        if failure is not None:
            failure.result = result
            raise failure
        return result

    # Threads that read the pipes

    def read_channel(self, file: BinaryIO) -> None:
        """Read messages until the end of the pipe."""
        for item in sent(file):
            self.came.put(item)
        self.came.put(None)

    def read_printed(self, file: BinaryIO) -> None:
        """Read the text that FMUs print. The first lines become messages; the others are only counted."""
        line, cut, lines = b"", False, 0

        def end_line() -> None:
            nonlocal line, cut, lines
            if line.strip():
                lines += 1
                if lines <= PRINTED_LINES:
                    text = line.decode("utf-8", "replace").rstrip() + (" ..." if cut else "")
                    self.came.put(Message(self.board.called()[0], self.board.time(), "OK", "printed", text))
                else:
                    self.dropped += 1
            line, cut = b"", False

        with contextlib.suppress(OSError, ValueError):
            while content := file.read(2**16):
                *whole, rest = content.split(b"\n")
                for part in whole:
                    line, cut = line + part[: MAX_TEXT - len(line)], cut or len(line) + len(part) > MAX_TEXT
                    end_line()
                line, cut = line + rest[: MAX_TEXT - len(line)], cut or len(line) + len(rest) > MAX_TEXT
        end_line()


def _rebuilt(error: tuple[type[CosimError], tuple[Any, ...], dict[str, Any]]) -> Any:
    """An error of the other process, made without a call of its constructor."""
    kind, arguments, attributes = error
    made = kind.__new__(kind, *arguments)
    vars(made).update(attributes)
    return made
