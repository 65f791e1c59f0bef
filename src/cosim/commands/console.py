"""What all commands of ``cosim`` share: how they print, and where they find FMUs given by name."""

from __future__ import annotations

import argparse
import contextlib
import logging
from collections.abc import Generator
from pathlib import Path

from rich.console import Console
from rich.markup import escape

PIPE_WIDTH = 160
"""Width of tables that go to a file or a pipe."""


def standard_output() -> Console:
    """Standard output, for text and tables."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, PIPE_WIDTH)
    return console


def complain(text: str) -> None:
    """An error on standard error, never folded, so that it can be searched for."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"[bold red]error:[/] {escape(harmless(text))}")


def remark(text: str) -> None:
    """A line on standard error."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(escape(harmless(text)))


_CONTROLS = {
    number: f"\\x{number:02x}" for number in (*range(0x20), *range(0x7F, 0xA0)) if chr(number) not in "\t\n"
} | {number: f"\\u{number:04x}" for number in (*range(0x202A, 0x202F), *range(0x2066, 0x206A))}
"""Characters that move the cursor, change colours or titles of a terminal, or turn the direction of writing."""


def harmless(text: str) -> str:
    """``text`` from a file or an FMU, with characters that control a terminal made visible."""
    return text.translate(_CONTROLS)


class _Remarks(logging.Handler):
    """Prints what the library logs, except messages of FMUs, which the commands show with the result."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.name != "cosim.fmu":
            remark(f"{record.levelname.lower()}: {record.getMessage()}")


@contextlib.contextmanager
def log_on_standard_error() -> Generator[None]:
    """Show warnings of the library on standard error."""
    handler = _Remarks(logging.WARNING)
    logger = logging.getLogger("cosim")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def fmus_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--fmus``."""
    parser.add_argument(
        "--fmus",
        type=Path,
        metavar="DIR",
        help="folder of FMUs given by name (default: build/fmus/native, else those installed)",
    )
