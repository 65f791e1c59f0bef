"""``cosim list``: lists FMUs, systems and studies."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from ..errors import DescriptionError
from ..fmu.text import read_toml
from .console import fmus_argument, make_table, standard_output

if TYPE_CHECKING:
    from ..fmu.description import Fmu


def add(commands: Any) -> None:
    """Add ``list``."""
    listing = commands.add_parser(
        "list", help="list FMUs, systems and studies", description="List the FMUs found and the systems shipped."
    )
    fmus_argument(listing)
    listing.set_defaults(command=_run)
    listing.examples = ("cosim list",)


def _run(options: argparse.Namespace) -> int:
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
    table = make_table("", "", "", "", right=("2",), whole=("0", "1", "2"))
    for path, fmu in fmus.items():
        size = f"{path.stat().st_size / 1024:.0f} kB"
        if isinstance(fmu, str):
            table.add_row(escape(path.stem), "", size, f"[red]{escape(fmu)}[/]")
            continue
        more = f" (also for {', '.join(sorted(set(fmu.platforms) - common))})" if set(fmu.platforms) - common else ""
        obstacles = "".join(f" [red]Cannot run here: {escape(obstacle)}[/]" for obstacle in fmu.obstacles)
        table.add_row(escape(path.stem), escape(fmu.version), size, escape(fmu.description + more) + obstacles)
    console.print(table)
    systems = shipped_systems()
    console.print("[bold]Systems[/]" if systems else "No systems found.")
    table = make_table("", "", whole=("0",))
    for name, path in systems.items():
        table.add_row(escape(name), escape(_description(path)))
    console.print(table)
    studies = shipped_studies()
    if studies:
        console.print(f"[bold]Studies[/] {escape(', '.join(studies))}")
    return 0


def _description(path: Path) -> str:
    try:
        return str(read_toml(path).get("description", ""))
    except DescriptionError:
        return "not readable"
