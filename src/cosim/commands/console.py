"""What all commands of ``cosim`` share: how they print, and where they find FMUs given by name."""

from __future__ import annotations

import argparse
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
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"[bold red]error:[/] {escape(text)}")


def remark(text: str) -> None:
    """A line on standard error."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(escape(text))


def fmus_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--fmus``."""
    parser.add_argument(
        "--fmus",
        type=Path,
        metavar="DIR",
        help="folder of FMUs given by name (default: build/fmus/native, else those installed)",
    )
