"""``cosim info``, ``list`` and ``fmus copy``: commands that take FMUs."""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

from ..errors import DescriptionError
from .console import standard_output

if TYPE_CHECKING:
    from ..fmu.description import Fmu, Variable


# FMUs, lists, studies


def info_command(options: argparse.Namespace) -> int:
    """Show the variables of an FMU."""
    from ..fmu.description import read_fmu
    from ..fmu.places import find_fmu

    fmu = read_fmu(find_fmu(options.fmu, options.fmus))
    console = standard_output()
    console.print(f"[bold]{escape(fmu.name)}[/] {escape(fmu.version)} {escape(fmu.text)}")
    step = f", step {fmu.step_size:g} s" if fmu.step_size is not None else ""
    stop = f", stop {fmu.stop_time:g} s" if fmu.stop_time is not None else ""
    console.print(f"{escape(str(fmu.path))}; platforms {', '.join(fmu.platforms) or 'none'}{step}{stop}")
    table = Table(box=None, pad_edge=False)
    for heading in ("Variable", "Causality", "Type", "Unit"):
        table.add_column(heading, no_wrap=heading != "Causality")
    for heading in ("Start", "Min", "Max"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("Text")
    for name, variable in _rows(fmu):
        table.add_row(
            escape(name),
            _causality(variable),
            variable.type,
            escape(_units(variable)),
            escape(_start(variable)),
            "" if variable.min is None else f"{variable.min:g}",
            "" if variable.max is None else f"{variable.max:g}",
            escape(variable.text + (f" ({', '.join(variable.items)})" if variable.items else "")),
        )
    console.print(table)
    console.print("Outputs and the inputs they depend on directly:")
    for output in fmu.outputs:
        console.print(f"  {escape(output)}: {escape(', '.join(fmu.dependencies[output]) or 'none')}")
    return 0


def _rows(fmu: Fmu) -> list[tuple[str, Variable]]:
    """Variables with the names to show, parameters first, arrays as one line."""
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


def _causality(variable: Variable) -> str:
    tunable = variable.causality == "parameter" and variable.variability == "tunable"
    return "tunable parameter" if tunable else variable.causality


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


def copy_command(options: argparse.Namespace) -> int:
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


def list_command(options: argparse.Namespace) -> int:
    """List FMUs, systems and studies."""
    from ..fmu.description import read_fmu
    from ..fmu.places import PREBUILT, find_fmus, fmus_in, shipped_studies, shipped_systems

    console = standard_output()
    folder = options.fmus if options.fmus is not None else find_fmus()
    fmus: dict[Path, Fmu | str] = {}
    for path in fmus_in(folder).values() if folder is not None else ():
        try:
            fmus[path] = read_fmu(path)
        except DescriptionError as error:
            fmus[path] = error.problems[0]
    platforms = [set(fmu.platforms) for fmu in fmus.values() if not isinstance(fmu, str)]
    common = set[str]().union(*platforms).intersection(*platforms)
    where = f"in {folder}, installed with cosim" if folder == PREBUILT else f"in {folder}"
    suited = f", for {', '.join(sorted(common))}" if common else ""
    heading = f"[bold]FMUs[/] {escape(where + suited)}" if fmus else "No FMUs found. Build them, or give --fmus."
    console.print(heading, soft_wrap=True)
    table = Table.grid(padding=(0, 2))
    for plain in (True, True, True, True, False):
        table.add_column(no_wrap=plain)
    for path, fmu in fmus.items():
        size = f"{path.stat().st_size / 1024:.0f} kB"
        if isinstance(fmu, str):
            table.add_row("", escape(path.stem), "", size, f"[red]{escape(fmu)}[/]")
            continue
        more = f" (also for {', '.join(sorted(set(fmu.platforms) - common))})" if set(fmu.platforms) - common else ""
        table.add_row("", escape(path.stem), escape(fmu.version), size, escape(fmu.text + more))
    console.print(table)
    systems = shipped_systems()
    console.print("[bold]Systems[/]" if systems else "No systems found.")
    table = Table.grid(padding=(0, 2))
    for name, path in systems.items():
        table.add_row("", escape(name), escape(_description(path)))
    console.print(table)
    studies = shipped_studies()
    if studies:
        console.print(f"[bold]Studies[/] {escape(', '.join(studies))}")
    return 0


def _description(path: Path) -> str:
    try:
        document: Mapping[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return "not readable"
    return str(document.get("description", ""))
