"""``cosim export``: a system for other tools."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.markup import escape

from ..errors import DescriptionError
from .console import print_note, standard_output
from .systems import given_system, system_arguments


def add(commands: Any) -> None:
    """Add ``export``."""
    export = commands.add_parser(
        "export",
        help="write a system as SSP for other tools, or as TOML",
        description="Write a system with its FMUs as an SSP 1.0 package, which other tools run too, or as a TOML file.",
        epilog="Example: cosim export studies/shams2010/fsmc_5sin.toml -o fsmc_5sin.ssp",
    )
    system_arguments(export)
    export.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="SYSTEM.ssp, or SYSTEM.toml with SYSTEM_fmus/"
    )
    export.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    """Write a system as SSP or TOML."""
    from ..system.ssp_write import lost_elsewhere, write_ssp
    from ..system.toml_write import write_system

    writers = {".ssp": write_ssp, ".toml": write_system}
    suffix = options.output.suffix.lower()
    if suffix not in writers:
        raise DescriptionError(f"{options.output}: write to a file that ends in .ssp or .toml.")
    system = given_system(options)
    path = writers[suffix](system, options.output)
    standard_output().print(
        f"{escape(str(path))}: {len(system.instances)} instances, {len(system.connections)} connections."
    )
    for lost in lost_elsewhere(system) if suffix == ".ssp" else ():
        print_note(f"note: {lost}")
    return 0
