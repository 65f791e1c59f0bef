"""The arguments of every command that takes a system, and the system they ask for."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import DescriptionError, suggest
from .console import fmus_argument, given_values, set_argument

if TYPE_CHECKING:
    from ..system.system import System


def system_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of every command that takes a system."""
    parser.add_argument("system", metavar="SYSTEM", help="a system file, or one of 'cosim list' (shams2010/fsmc_5sin)")
    set_argument(parser)
    parser.add_argument("--stop-time", metavar="SECONDS", help="end of the run, such as 2.5")
    parser.add_argument("--step-size", metavar="SECONDS", help="communication step, such as 1e-4")
    parser.add_argument(
        "--order", metavar="ORDER", help="sequential, parallel, or instances such as trajectory,controller,plant"
    )
    parser.add_argument(
        "--record",
        action="append",
        metavar="PATTERN",
        help="what to record, such as plant.position or 'controller.*'; may be repeated (default: as in the file)",
    )
    parser.add_argument("--decimation", type=int, metavar="N", help="record every N-th communication point")
    fmus_argument(parser)


def given_system(options: argparse.Namespace) -> System:
    """The checked system that the arguments name. Raises DescriptionError."""
    from ..system.system import read_system

    order = options.order
    if order is not None and order not in ("sequential", "parallel"):
        order = [name.strip() for name in order.split(",")]
    return read_system(
        _system_path(options.system),
        given_values(options.values),
        fmus=options.fmus,
        stop_time=options.stop_time,
        step_size=options.step_size,
        order=order,
        record=options.record,
        decimation=options.decimation,
    )


def _system_path(text: str) -> Path:
    from ..fmu.places import shipped_file, shipped_systems

    path = shipped_file(text)
    if path.exists() or text.endswith((".toml", ".ssp", ".ssd")):
        return path
    raise DescriptionError(f"{text}: neither a file nor a system shipped.{suggest(text, shipped_systems())}")
