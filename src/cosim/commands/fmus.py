"""``cosim fmus copy``: copies FMUs for other tools."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.markup import escape

from ..errors import DescriptionError
from .console import fmus_argument, standard_output


def add(commands: Any) -> None:
    """Add ``fmus``."""
    fmus = commands.add_parser(
        "fmus", help="hand FMUs out", description="Hand FMUs out; 'cosim list' shows which there are."
    ).add_subparsers(metavar="WHAT", required=True)
    copy = fmus.add_parser(
        "copy",
        help="copy FMUs into a folder, for other tools",
        description="Copy FMUs into a folder, for other tools. Files that are the same already stay as they are.",
    )
    copy.examples = ("cosim fmus copy my_fmus BallscrewStage FuzzySlidingMode Trajectory",)
    copy.add_argument("folder", type=Path, metavar="DIR", help="folder to copy to; it is made if it is not there")
    copy.add_argument("names", nargs="*", metavar="NAME", help="FMUs, such as BallscrewStage (default: all)")
    copy.add_argument("--force", action="store_true", help="replace files of the same name")
    fmus_argument(copy)
    copy.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    """Copy FMUs into a folder."""
    from ..fmu.copies import copy_fmus
    from ..fmu.places import find_fmus

    source = options.fmus if options.fmus is not None else find_fmus()
    if source is None:
        raise DescriptionError("no FMUs found. Build them, or name their folder with --fmus.")
    written = copy_fmus(source, options.folder, options.names, force=options.force)
    console = standard_output()
    if written:
        names = ", ".join(path.stem for path in written)
        console.print(f"Copied from {escape(str(source))} to {escape(str(options.folder))}: {escape(names)}")
    else:
        console.print(f"Nothing to copy: {escape(str(options.folder))} holds them already.")
    return 0
