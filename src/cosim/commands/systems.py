"""The arguments of all commands that take a system, and the system that they name."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..errors import DescriptionError
from .console import fmus_argument, set_argument

if TYPE_CHECKING:
    from ..system.system import System


def system_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of every command that takes a system."""
    parser.add_argument(
        "system",
        metavar="SYSTEM|FMU",
        help="a system file, one of 'cosim list' (shams2010/fsmc_5sin), or an FMU, which runs alone then",
    )
    set_argument(parser)
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


def base_argument(parser: argparse.ArgumentParser, completes: str, default: str = "none") -> None:
    """Add ``--base``, the system that the written file ``completes``."""
    parser.add_argument("--base", metavar="SYSTEM", help=f"the system that {completes} completes (default: {default})")


def given_values(items: Sequence[str]) -> dict[str, object]:
    """The values of ``--set`` by variable. Raises DescriptionError with all items that cannot be read."""
    from ..system.values import parse_settings

    return parse_settings(items)


def given_system(options: argparse.Namespace) -> System:
    """The checked system that the arguments name. Raises DescriptionError with all problems, including ``--set``."""
    from ..system.system import read_system

    problems: list[str] = []
    values: dict[str, object] = {}
    try:
        values = given_values(options.values)
    except DescriptionError as error:
        problems += error.problems
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


def units_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--units``; ``stated_units`` reads it."""
    parser.add_argument(
        "--units", action="extend", nargs="+", default=[], metavar="COLUMN=UNIT", help="units that records do not say"
    )


def stated_units(items: Sequence[str]) -> dict[str, str]:
    """The units that ``--units`` states, by column."""
    return {name: unit for name, _, unit in (item.rpartition("=") for item in items)}
