"""``cosim check``: everything that is wrong with a system, without running it."""

from __future__ import annotations

import argparse
from typing import Any

from rich.markup import escape

from .console import make_table, standard_output
from .systems import given_system, system_arguments


def add(commands: Any) -> None:
    """Add ``check``."""
    check = commands.add_parser(
        "check",
        help="check a system without running it",
        description="Check a system file and say how it will run.",
        epilog="Example: cosim check studies/shams2010/fsmc_5sin.toml",
    )
    system_arguments(check)
    check.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    """Check a system and say how it will run."""
    system = given_system(options)
    console = standard_output()
    console.print(f"[bold]{escape(system.description or system.name)}[/]", soft_wrap=True)
    table = make_table("Instance", "FMU", "Start values", "Steps over", whole=("Instance", "Steps over"))
    for instance in system.instances:
        values = ", ".join(f"{name} = {value}" for name, value in list(instance.start.items())[:8])
        more = f" and {len(instance.start) - 8} more" if len(instance.start) > 8 else ""
        over = f"{system.step_size * instance.step_multiple} s"
        table.add_row(escape(instance.name), escape(instance.fmu.name), escape(values + more), over)
    console.print(table)
    for connection in system.connections:
        scaled = "" if connection.factor == 1.0 else f" * {connection.factor:g}"
        shifted = "" if connection.offset == 0.0 else f" + {connection.offset:g}"
        source, target = (".".join(end) for end in (connection.source, connection.target))
        console.print(f"  {escape(source)}{scaled}{shifted} -> {escape(target)}")
    how = "parallel, one step of delay" if system.parallel else ", ".join(system.visits)
    console.print(f"Order: {escape(how)}")
    console.print(
        f"{system.steps} steps of {system.step_size} s from {system.start_time} s to {system.stop_time} s, "
        f"{len(system.record)} variables recorded, {system.steps // system.decimation + 1} rows"
    )
    for note in system.notes:
        console.print(f"[yellow]note:[/] {escape(note)}")
    console.print("No problems.")
    return 0
