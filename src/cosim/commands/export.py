"""``cosim export``: writes a system for other tools."""

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
    )
    export.examples = ("cosim export shams2010/fsmc_5sin -o fsmc_5sin.ssp",)
    system_arguments(export)
    export.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="SYSTEM.ssp, or SYSTEM.toml with SYSTEM_fmus/"
    )
    export.add_argument(
        "--enumerations",
        choices=("keep", "integer"),
        default="keep",
        help="integer: FMUs in an .ssp declare enumerations as whole numbers, for libcosim and ecos, which know none "
        "(default: keep)",
    )
    export.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    """Write a system as SSP or TOML."""
    from ..system.ssp_write import lost_elsewhere, write_ssp
    from ..system.toml_write import write_system

    suffix, integers = options.output.suffix.lower(), options.enumerations == "integer"
    if suffix not in (".ssp", ".toml"):
        raise DescriptionError(f"{options.output}: write to a file that ends in .ssp or .toml.")
    if suffix == ".toml" and integers:
        raise DescriptionError("--enumerations integer: only for an .ssp; a .toml names the items.")
    system = given_system(options)
    if suffix == ".toml":
        path = write_system(system, options.output)
    else:
        path = write_ssp(system, options.output, integers=integers)
    standard_output().print(
        f"{escape(str(path))}: {len(system.instances)} instances, {len(system.connections)} connections."
    )
    for lost in lost_elsewhere(system, integers=integers) if suffix == ".ssp" else ():
        print_note(f"note: {lost}")
    return 0
