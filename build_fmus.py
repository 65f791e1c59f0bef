"""Build the FMUs: ``python build_fmus.py [NAME ...] [--flavour native] [--platform host|all] [--output DIR]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from cosim.errors import CosimError
from cosim.export.package import TARGETS, Workspace, host_platform

ROOT = Path(__file__).resolve().parent
WORKSPACE = Workspace(ROOT, ROOT / "build" / "cache")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Build the FMUs of fmus/.", epilog="Example: build_fmus.py Trajectory")
    parser.add_argument("names", nargs="*", metavar="NAME", help="components, e.g. BallscrewStage (default: all)")
    parser.add_argument("--platform", choices=["host", "all", *TARGETS], default="host", help="default: host")
    parser.add_argument("--output", type=Path, default=ROOT / "build" / "fmus" / "native", metavar="DIR")
    return parser.parse_args()


def main() -> int:
    """Build what changed, show a table; exit code 2 for a wrong name, 1 if a component cannot be built."""
    arguments, console = _arguments(), Console()
    try:
        names = WORKSPACE.select(arguments.names)
        platforms = {"host": (host_platform(),), "all": tuple(TARGETS)}.get(arguments.platform, (arguments.platform,))
    except CosimError as error:
        console.print(str(error), style="red", markup=False)
        return 2
    stale = WORKSPACE.stale(names, arguments.output, platforms)
    seconds: dict[str, float] = {}
    problems: dict[str, str] = {}
    if stale:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console) as progress:
            task = progress.add_task("Building FMUs", total=len(stale))
            for name, spent, error in WORKSPACE.build(stale, arguments.output, platforms):
                seconds[name] = spent
                if error:
                    problems[name] = str(error)
                progress.advance(task)
    table = Table(title=f"FMUs in {arguments.output} for {', '.join(platforms)}")
    for head in ("FMU", "size / kB", "time / s", "state"):
        table.add_column(head, justify="left" if head in ("FMU", "state") else "right")
    for name in names:
        state = "failed" if name in problems else "built" if name in seconds else "unchanged"
        target = arguments.output / f"{name}.fmu"
        size = f"{target.stat().st_size / 1024:.0f}" if target.exists() else ""
        table.add_row(name, size, f"{seconds[name]:.1f}" if name in seconds else "", state)
    console.print(table)
    for text in problems.values():
        console.print(text, style="red", markup=False)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
