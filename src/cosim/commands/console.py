"""Functions that all commands of ``cosim`` share: tables, errors, notes, the progress bar, JSON, common arguments.

Results go to standard output, everything else to standard error, so that output can be piped.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.markup import escape

from ..errors import CosimError, DescriptionError

if TYPE_CHECKING:
    from rich.progress import Progress
    from rich.table import Table

WIDTH = 80
"""Width in characters of tables that are written to a file or a pipe: the usual width of a terminal."""
QUIET_SECONDS = 1.0
"""Work that takes less time shows no progress bar: a bar that vanishes at once is no help."""


def standard_output() -> Console:
    """Standard output, for text and tables."""
    console = Console(highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = WIDTH
    return console


def print_error(text: str) -> None:
    """Print an error on standard error. Lines are not wrapped, so that the text can be searched."""
    Console(stderr=True, highlight=False, emoji=False, soft_wrap=True).print(
        f"[bold red]error:[/] {escape(harmless(text))}"
    )


def print_note(text: str) -> None:
    """Print a line on standard error."""
    Console(stderr=True, highlight=False, emoji=False, soft_wrap=True).print(escape(harmless(text)))


_CONTROLS = {
    number: f"\\x{number:02x}" for number in (*range(0x20), *range(0x7F, 0xA0)) if chr(number) not in "\t\n"
} | {number: f"\\u{number:04x}" for number in (*range(0x202A, 0x202F), *range(0x2066, 0x206A))}
"""Characters that move the cursor, change colours or titles of a terminal, or turn the direction of writing."""


def harmless(text: str) -> str:
    """``text`` from a file or an FMU, with terminal control characters replaced by visible text."""
    return text.translate(_CONTROLS)


class _Notes(logging.Handler):
    """Prints the log messages of the library, but not of FMUs. The commands show those with the result."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.name != "cosim.fmu":
            print_note(f"{record.levelname.lower()}: {record.getMessage()}")


@contextmanager
def log_on_standard_error() -> Generator[None]:
    """Show warnings of the library on standard error."""
    handler = _Notes(logging.WARNING)
    logger = logging.getLogger("cosim")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def print_json(content: Any) -> None:
    """Print ``content`` as JSON on standard output. Numbers that are not finite become null."""
    sys.stdout.write(json.dumps(_finite(content), indent=2) + "\n")


def make_table(*headings: str, right: Sequence[str] = (), whole: Sequence[str] = (), title: str = "") -> Table:
    """A table in the common style of all commands.

    The columns named in ``right`` are aligned to the right, for numbers. The columns named in ``whole`` are never
    wrapped. In a narrow terminal, the text in other columns is wrapped. A column without a heading has its number (from
    0) as name.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    shown = any(headings)
    table = Table(
        box=SIMPLE_HEAD if shown else None,
        padding=(0, 1) if shown else (0, 2, 0, 0),
        title=escape(title) or None,
        title_justify="left",
        title_style="bold",
        show_header=shown,
        pad_edge=False,
    )
    for number, heading in enumerate(headings):
        name = heading or str(number)
        justify = "right" if name in right else "left"
        table.add_column(escape(heading), justify=justify, overflow="fold", no_wrap=name in whole)
    return table


def show(
    options: argparse.Namespace,
    content: Mapping[str, Any],
    rows: Sequence[Sequence[str]],
    title: str,
    *,
    numbers: bool = True,
) -> None:
    """Show a result: ``content`` as JSON with ``--json``, else ``rows`` as a table. The first row has the headings.

    With ``numbers``, all columns but the first are aligned to the right.
    """
    if options.json:
        print_json(content)
        return
    console = standard_output()
    headings, *lines = rows
    table = make_table(*headings, right=headings[1:] if numbers else ())
    for line in lines:
        table.add_row(*(escape(cell) for cell in line))
    console.print(escape(title), soft_wrap=True)
    console.print(table)


class Bar(AbstractContextManager["Bar"]):
    """A progress bar on a terminal, for work of more than a second."""

    def __init__(self, description: str) -> None:
        self._description = description
        self._begun = time.perf_counter()
        self._bar: Progress | None = None

    def update(self, done: float, total: float | None, note: str = "") -> None:
        """Show ``done`` of ``total``; without a total, only ``done``."""
        if self._bar is None:
            if time.perf_counter() - self._begun < QUIET_SECONDS or not sys.stderr.isatty():
                return
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

            texts = (
                TextColumn("{task.description}"),
                TextColumn("{task.fields[count]} {task.fields[note]}"),
            )
            columns = texts[0], BarColumn(), texts[1], TimeElapsedColumn(), TimeRemainingColumn()
            self._bar = Progress(*columns, console=Console(stderr=True, emoji=False), transient=True)
            self._bar.add_task(escape(self._description), total=total, count="", note="")
            self._bar.start()
        count = f"{done:.4g}" if total is None else f"{done:.4g}/{total:.4g}"
        self._bar.update(self._bar.task_ids[0], completed=done, total=total, count=count, note=escape(note))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


def fmus_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--fmus``."""
    parser.add_argument(
        "--fmus",
        type=Path,
        metavar="DIR",
        help="folder of FMUs given by name (default: build/fmus/native, else those installed)",
    )


class _Extend(argparse.Action):
    """Collects the values of all ``--set`` options."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: object) -> None:
        given = [values] if isinstance(values, str) else list(values)
        setattr(namespace, self.dest, [*getattr(namespace, self.dest), *given])


def set_argument(parser: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add ``--set``, which may be repeated. With ``several``, one option may have several values."""
    parser.add_argument(
        "--set",
        action=_Extend,
        nargs="+" if several else None,
        default=[],
        metavar="INST.VAR=VALUE",
        dest="values",
        help="start values, such as plant.m=70, trajectory.amplitude='10 mm' or trajectory.kind=sine; may be repeated "
        "(of an FMU alone: m=70)",
    )


def check_plot(path: Path | None) -> None:
    """Raise DescriptionError, before anything runs, if the picture of ``--plot`` cannot be drawn or written."""
    if path is not None:
        from ..result.plots import check_picture

        check_picture(path)


def check_page(path: Path | None) -> None:
    """Raise DescriptionError, before anything runs, if the page of ``--report`` cannot be made or written."""
    if path is not None:
        from ..result.report import check_report

        check_report(path)


def problems_of(*checks: Callable[[], object]) -> list[str]:
    """The problems of all DescriptionErrors that these functions raise."""
    problems: list[str] = []
    for check in checks:
        try:
            check()
        except DescriptionError as error:
            problems += error.problems
    return problems


def check_files(*paths: Path | None) -> None:
    """Raise DescriptionError, before anything runs, for all files that cannot be written. None is no file."""
    from ..files import check_writable

    problems = problems_of(*(partial(check_writable, path) for path in paths if path is not None))
    if problems:
        raise DescriptionError(problems)


def write_files(*writers: tuple[Path | None, Callable[[Path], object]]) -> bool:
    """Write the files of a result; each pair is a path (None: no file) and the function that writes it.

    Call it after the result was shown: a full disk then loses a file, but not the result. Prints an error for each file
    that cannot be written; the others are still written. Returns whether all could be written.
    """
    well = True
    for path, write in writers:
        if path is not None:
            try:
                write(path)
            except CosimError as error:
                print_error(str(error))
                well = False
    return well


def common_arguments(parser: argparse.ArgumentParser, command: Callable[[argparse.Namespace], int]) -> None:
    """Add ``--json`` and ``--fmus``, and set the function that runs the command."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON, for scripts")
    fmus_argument(parser)
    parser.set_defaults(command=command)


def _finite(value: Any) -> Any:
    """``value`` with numbers that are not finite replaced by None, because JSON has no such numbers."""
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]  # pyright: ignore[reportUnknownVariableType]
    return None if isinstance(value, float) and not math.isfinite(value) else value
