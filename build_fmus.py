"""Build the FMUs: ``build_fmus.py [NAME ...] [--flavour native|python|both] [--fmi 2|3] [--platform host|all]``.

``python build_fmus.py --references [NAME ...]`` makes again what FMUs carry beside their models: reference results,
validation picture and icon, in ``fmus/references``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from cosim.errors import CosimError
from cosim.export.compile import TARGETS, host_platform
from cosim.export.loop_library import FOLDER, compile_loop
from cosim.export.python.python_package import BINARIES
from cosim.export.workspace import Flavour, Workspace

ROOT = Path(__file__).resolve().parent
WORKSPACE = Workspace(ROOT, ROOT / "build" / "cache")
LABELS: dict[Flavour, str] = {"native": "Native", "python": "Python", "fmi3": "Native FMI 3.0"}


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Build the FMUs of fmus/.", epilog="Example: build_fmus.py Trajectory")
    parser.add_argument("names", nargs="*", metavar="NAME", help="components, e.g. BallscrewStage (default: all)")
    parser.add_argument(
        "--flavour", choices=["native", "python", "both"], default="native", help="compiled, or Python with PythonFMU"
    )
    parser.add_argument("--fmi", type=int, choices=[2, 3], default=2, help="version of the interface (default: 2)")
    parser.add_argument("--platform", choices=["host", "all", *TARGETS], default="host", help="default: host")
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="default: build/fmus/native, /python or /fmi3; with --flavour both, DIR/native and DIR/python",
    )
    parser.add_argument(
        "--references",
        action="store_true",
        help="make the reference results, validation pictures and icons in fmus/references anew, build nothing",
    )
    arguments = parser.parse_args()
    if arguments.fmi == 3 and arguments.flavour != "native":
        parser.error("--fmi 3: PythonFMU makes FMI 2.0 only. Leave --flavour out.")
    return arguments


def _references(names: list[str], console: Console) -> int:
    """Write ``fmus/references``; the number of components whose FMU does not meet its references."""
    from cosim.reference.make import write
    from fmus.references.experiments import EXPERIMENTS
    from fmus.references.icons import drawer

    failed = 0
    for name in names:
        if name not in EXPERIMENTS:
            console.print(f"{name}: no experiments in fmus/references/experiments.py, no references.", markup=False)
            continue
        try:
            report = write(WORKSPACE, name, EXPERIMENTS[name], drawer(name))
        except CosimError as error:
            failed += 1
            console.print(str(error), style="red", markup=False)
            continue
        worst = max(signal.share for outcome in report.outcomes for signal in outcome.signals)
        console.print(f"{name}: {len(report.outcomes)} experiments, at most {worst:.2g} of a tolerance", markup=False)
    return failed


def _platforms(choice: str, flavour: Flavour) -> tuple[str, ...]:
    if choice == "all":
        return tuple(BINARIES if flavour == "python" else TARGETS)
    return (host_platform() if choice == "host" else choice,)


def _build(names: list[str], output: Path, platforms: tuple[str, ...], flavour: Flavour, console: Console) -> int:
    """Build what changed of one flavour, show a table; the number of components that could not be built."""
    stale = WORKSPACE.stale(names, output, platforms, flavour)
    seconds: dict[str, float] = {}
    problems: dict[str, str] = {}
    if stale:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console) as progress:
            task = progress.add_task(f"Building {LABELS[flavour]} FMUs", total=len(stale))
            for name, spent, error in WORKSPACE.build(stale, output, platforms, flavour):
                seconds[name] = spent
                if error:
                    problems[name] = str(error)
                progress.advance(task)
    table = Table(title=f"{LABELS[flavour]} FMUs in {output} for {', '.join(platforms)}")
    for head in ("FMU", "size / kB", "time / s", "state"):
        table.add_column(head, justify="left" if head in ("FMU", "state") else "right")
    for name in names:
        state = "failed" if name in problems else "built" if name in seconds else "unchanged"
        target = output / f"{name}.fmu"
        size = f"{target.stat().st_size / 1024:.0f}" if target.exists() else ""
        table.add_row(name, size, f"{seconds[name]:.1f}" if name in seconds else "", state)
    console.print(table)
    for text in problems.values():
        console.print(text, style="red", markup=False)
    return len(problems)


def main() -> int:
    """Build the flavours asked for; exit code 2 for a wrong name, 1 if a component cannot be built."""
    arguments, console = _arguments(), Console()
    flavours: tuple[Flavour, ...] = ("native", "python") if arguments.flavour == "both" else (arguments.flavour,)
    if arguments.fmi == 3:
        flavours = ("fmi3",)
    try:
        names = WORKSPACE.select(arguments.names)
        if arguments.references:
            return 1 if _references(names, console) else 0
        platforms = {flavour: _platforms(arguments.platform, flavour) for flavour in flavours}
        compile_loop(_platforms(arguments.platform, "native"), FOLDER, WORKSPACE.cache)
    except CosimError as error:
        console.print(str(error), style="red", markup=False)
        return 2
    base = arguments.output or ROOT / "build" / "fmus"
    plain = arguments.output is not None and len(flavours) == 1
    failed = 0
    for flavour in flavours:
        failed += _build(names, base if plain else base / flavour, platforms[flavour], flavour, console)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
