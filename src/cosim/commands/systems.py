"""What all commands share that take a system: their arguments, and how the system is read."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..errors import DescriptionError
from .console import fmus_argument

if TYPE_CHECKING:
    from ..system.system import System


def system_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of every command that takes a system."""
    parser.add_argument(
        "system",
        metavar="SYSTEM|FMU",
        help="a system file, one of 'cosim list' (shams2010/fsmc_5sin), or an FMU, which then runs alone",
    )
    settings_argument(parser)
    parser.add_argument("--stop-time", metavar="SECONDS", help="end of the run, such as 2.5")
    parser.add_argument("--step-size", metavar="SECONDS", help="communication step, such as 1e-4 or 1/30")
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


def settings_argument(parser: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add ``--set``, which takes one value, or with ``several`` all that follow."""
    parser.add_argument(
        "--set",
        action="extend",
        nargs="+" if several else 1,
        default=[],
        metavar="INST.VAR=VALUE",
        dest="values",
        help="a start value, such as plant.m=70, controller.T_s=2e-4 or trajectory.kind=sine; may be repeated",
    )


def settings(options: argparse.Namespace) -> dict[str, object]:
    """The values of ``--set`` by name. Raises DescriptionError."""
    from ..system.values import parse_settings

    return parse_settings(options.values)


def chosen_system(options: argparse.Namespace) -> System:
    """The system that the options name. Raises DescriptionError with every problem, those of ``--set`` included."""
    from ..system.system import read_system

    problems: list[str] = []
    try:
        values = settings(options)
    except DescriptionError as error:
        values, problems = {}, list(error.problems)
    order: str | Sequence[str] | None = options.order
    if isinstance(order, str) and order not in ("sequential", "parallel"):
        order = [name.strip() for name in order.split(",")]
    try:
        system = read_system(
            options.system,
            values,
            fmus=options.fmus,
            stop_time=options.stop_time,
            step_size=options.step_size,
            order=order,
            record=options.record,
            decimation=options.decimation,
        )
    except DescriptionError as error:
        raise DescriptionError([*problems, *error.problems]) from None
    if problems:
        raise DescriptionError(problems)
    return system
