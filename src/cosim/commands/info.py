"""``cosim info``: shows the variables of an FMU."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.padding import Padding

from .console import fmus_argument, make_table, print_note, standard_output

if TYPE_CHECKING:
    from rich.console import Console

    from ..fmu.description import Fmu
    from ..fmu.variables import Variable


ROOM = 40
"""Smallest width in which descriptions are read well beside the other columns."""
GAP = 3
"""Width between two columns of a table."""
SHOWN_FINDINGS = 30
"""Largest number of findings about the file that are shown. They fit on one screen."""


def add(commands: Any) -> None:
    """Add ``info``."""
    info = commands.add_parser(
        "info",
        help="show the variables of an FMU",
        description="Show what an FMU offers: variables with unit, start value and bounds, and its feedthrough.",
    )
    info.examples = ("cosim info BallscrewStage",)
    info.add_argument("fmu", metavar="FMU", help="a name in the FMU folder, such as BallscrewStage, or an .fmu file")
    fmus_argument(info)
    info.set_defaults(command=_run)


def _run(options: argparse.Namespace) -> int:
    """Show the variables of an FMU."""
    from ..fmu.description import read_fmu
    from ..fmu.places import find_fmu

    fmu = read_fmu(find_fmu(options.fmu, options.fmus))
    console = standard_output()
    console.print(f"[bold]{escape(fmu.name)}[/] {escape(fmu.version)} {escape(fmu.description)}")
    step = f", step {fmu.step_size:g} s" if fmu.step_size is not None else ""
    stop = f", stop {fmu.stop_time:g} s" if fmu.stop_time is not None else ""
    path = fmu.path.relative_to(Path.cwd()) if fmu.path.is_relative_to(Path.cwd()) else fmu.path
    console.print(
        f"{escape(str(path))}; FMI {fmu.fmi}; platforms {', '.join(fmu.platforms) or 'none'}{step}{stop}",
        soft_wrap=True,
    )
    _print_variables(console, fmu)
    for finding in fmu.findings[:SHOWN_FINDINGS]:
        print_note(f"note: {finding}")
    if len(fmu.findings) > SHOWN_FINDINGS:
        print_note(f"note: and {len(fmu.findings) - SHOWN_FINDINGS} more findings like these.")
    for obstacle in fmu.obstacles:
        print_note(f"note: cannot run here: {obstacle}")
    console.print("Outputs and the inputs they depend on directly:")
    unstated = fmu.unstated if fmu.inputs else ()
    for output in fmu.outputs:
        assumed = " (the file does not say: all count)" if output in unstated else ""
        console.print(f"  {escape(output)}: {escape(', '.join(fmu.dependencies[output]) or 'none')}{assumed}")
    return 0


def _print_variables(console: Console, fmu: Fmu) -> None:
    """Print the variables as a table; where that leaves no room for the descriptions, each below its variable."""
    rows = [
        (variable.causality, (name, _units(variable), _start(variable), _range(variable)), _description(variable))
        for name, variable in _rows(fmu)
    ]
    headings = "Variable", "Unit", "Start", "Range"
    widths = [max(len(cells[i]) for cells in (headings, *(cells for _, cells, _ in rows))) for i in range(4)]
    room = console.width - sum(widths) - 4 * GAP
    if room >= min(ROOM, max((len(text) for *_, text in rows), default=0)):
        table = make_table(*headings, "Description", right=("Start",), whole=headings)
        for group, entries in groupby(rows, key=lambda row: row[0]):
            table.add_section()
            table.add_row(f"[bold]{group}[/]")
            for _, cells, text in entries:
                table.add_row(*map(escape, (*cells, text)))
        console.print(table)
        return

    def line(cells: Sequence[str]) -> str:
        name, unit, start, bounds = cells
        return f"{name:<{widths[0]}}   {unit:<{widths[1]}}   {start:>{widths[2]}}   {bounds}".rstrip()

    console.print(f"\n[bold]{line(headings)}[/]")
    for group, entries in groupby(rows, key=lambda row: row[0]):
        console.print(f"\n[bold]{group}[/]")
        for _, cells, text in entries:
            console.print(escape(line(cells)), soft_wrap=True)
            if text:
                console.print(Padding(escape(text), (0, 0, 0, 4), expand=False))
    console.print()


def _rows(fmu: Fmu) -> list[tuple[str, Variable]]:
    """Variables with the names to show: inputs, outputs, parameters, then the others. An array is one row."""
    arrays = {name: array for name, array in fmu.arrays.items() if array.shape}
    firsts = {array.elements[0]: f"{name}[{array.span}]" for name, array in arrays.items()}
    others = {element for array in arrays.values() for element in array.elements[1:]}
    order = {"input": 0, "output": 1, "parameter": 2}
    rows: list[tuple[str, Variable]] = []
    for variable in sorted(fmu.variables.values(), key=lambda v: order.get(v.causality, 3)):
        if variable.name in firsts:
            rows.append((firsts[variable.name], variable))
        elif variable.name not in others:
            rows.append((variable.name, variable))
    return rows


def _description(variable: Variable) -> str:
    """The variable's description, its type if this is not Real, and whether it is tunable."""
    facts: list[str] = []
    if variable.items:
        facts.append(", ".join(variable.items))
    elif variable.type != "Real":
        facts.append(variable.type)
    if variable.causality == "parameter" and variable.variability == "tunable":
        facts.append("tunable")
    return f"{variable.description} ({'; '.join(facts)})" if facts else variable.description


def _range(variable: Variable) -> str:
    if variable.items or (variable.min is None and variable.max is None):
        return ""
    low, high = ("" if bound is None else f"{bound:.6g}" for bound in (variable.min, variable.max))
    return f"{low} .. {high}".strip()


def _units(variable: Variable) -> str:
    shown = variable.display_unit
    return (variable.unit or "") + (f" ({shown.name})" if shown is not None else "")


def _start(variable: Variable) -> str:
    for item, number in variable.items.items():
        if number == variable.start:
            return item
    if isinstance(variable.start, bool):
        return str(variable.start).lower()
    return f"{variable.start:g}" if isinstance(variable.start, float) else str(variable.start or "")
