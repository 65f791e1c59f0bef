"""The command line: ``cosim run``, ``check``, ``info``, ``list``, ``study``, ``verify``.

Exit codes: 0 done, 1 a simulation failed, 2 a description is wrong, 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from math import isfinite
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rich.box import SIMPLE, SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from .console import complain, fmus_argument, remark, standard_output
from .design.commands import add_commands
from .errors import CosimError, DescriptionError, suggest
from .verify_command import add_verify

if TYPE_CHECKING:
    from rich.progress import Progress

    from .fmu import Fmu, Variable
    from .master import RunError
    from .metrics import Row
    from .results import Result
    from .system import System

MAX_SHOWN_MESSAGES = 20
TOOLS = ("control", "distributed", "pyarrow", "scipy")
"""Packages of the extra ``tools``, which design tools need."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        return options.command(options)
    except DescriptionError as error:
        problems = error.problems
        if len(problems) > 1:
            complain(f"{len(problems)} problems:")
        for problem in problems:
            complain(problem)
        return 2
    except CosimError as error:
        complain(str(error))
        return 1
    except ModuleNotFoundError as error:
        if error.name not in TOOLS:
            raise
        complain(f"{error.name} is not installed, and this command needs it: install motion-cosim[tools].")
        return 2
    except KeyboardInterrupt:
        complain("Interrupted.")
        return 130
    except BrokenPipeError:
        # Whoever read our output (head, less) has gone.
        sys.stderr.close()
        return 1


class _Version(argparse.Action):
    """Looks the version up only when it is asked for: that takes longer than the rest of the parser."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        parser.exit(message=f"cosim {version('motion-cosim')}\n")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cosim",
        description="Co-simulation of FMI 2.0 FMUs for precision motion.",
        epilog="Exit codes: 0 done, 1 a simulation failed, 2 a description is wrong, 130 interrupted.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    run = commands.add_parser(
        "run",
        help="run a system",
        description="Run a system and show what came out.",
        epilog="Example: cosim run studies/shams2010/fsmc_5sin.toml --set plant.m=70 --output result.parquet",
    )
    _system_arguments(run)
    run.add_argument("--output", type=Path, metavar="FILE", help="write the record as .csv or .parquet")
    run.add_argument("--plot", type=Path, metavar="FILE", help="draw the run, such as run.png")
    run.add_argument("--json", action="store_true", help="print the summary as JSON, for scripts")
    run.add_argument(
        "--keep-going", action="store_true", help="go on if a connection carries a value that is not finite"
    )
    run.add_argument("--debug", action="store_true", help="show everything the FMUs log, not only what went wrong")
    run.set_defaults(command=_run)

    check = commands.add_parser(
        "check",
        help="check a system without running it",
        description="Check a system file and say how it will run.",
        epilog="Example: cosim check studies/shams2010/fsmc_5sin.toml",
    )
    _system_arguments(check)
    check.set_defaults(command=_check)

    export = commands.add_parser(
        "export",
        help="write a system as SSP for other tools, or as TOML",
        description="Write a system with its FMUs as an SSP 1.0 package, which other tools run too, or as a TOML file.",
        epilog="Example: cosim export studies/shams2010/fsmc_5sin.toml -o fsmc_5sin.ssp",
    )
    _system_arguments(export)
    export.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="SYSTEM.ssp, or SYSTEM.toml with SYSTEM_fmus/"
    )
    export.set_defaults(command=_export)

    info = commands.add_parser(
        "info",
        help="show the variables of an FMU",
        description="Show what an FMU offers: variables with unit, start value and bounds, and its feedthrough.",
        epilog="Example: cosim info BallscrewStage",
    )
    info.add_argument("fmu", metavar="FMU", help="a name in the FMU folder, such as BallscrewStage, or an .fmu file")
    fmus_argument(info)
    info.set_defaults(command=_info)

    listing = commands.add_parser(
        "list", help="list FMUs, systems and studies", description="List the FMUs found and the systems shipped."
    )
    fmus_argument(listing)
    listing.set_defaults(command=_list)

    fmus = commands.add_parser(
        "fmus", help="hand FMUs out", description="Hand FMUs out; 'cosim list' shows which there are."
    ).add_subparsers(metavar="WHAT", required=True)
    copy = fmus.add_parser(
        "copy",
        help="copy FMUs into a folder, for other tools",
        description="Copy FMUs into a folder, for other tools. Files that are the same already stay as they are.",
        epilog="Example: cosim fmus copy my_fmus BallscrewStage FuzzySlidingMode Trajectory",
    )
    copy.add_argument("folder", type=Path, metavar="DIR", help="folder to copy to; it is made if it is not there")
    copy.add_argument("names", nargs="*", metavar="NAME", help="FMUs, such as BallscrewStage (default: all)")
    copy.add_argument("--force", action="store_true", help="replace files of the same name")
    fmus_argument(copy)
    copy.set_defaults(command=_copy)

    study = commands.add_parser(
        "study",
        help="run a study and write its report",
        description="Run all systems of a study and write its report: what was published, what was measured.",
        epilog="Example: cosim study shams2010 --output results/shams2010",
    )
    study.add_argument("name", metavar="NAME", help="a study, such as shams2010; cosim list shows all")
    study.add_argument("--output", type=Path, metavar="DIR", help="folder of the report (default: results/NAME)")
    study.add_argument("--runs", default="*", metavar="PATTERN", help="only the runs that match, such as 'fsmc_*'")
    study.add_argument("--jobs", type=int, default=2, metavar="N", help="runs carried out at a time (default: 2)")
    fmus_argument(study)
    study.set_defaults(command=_study)

    add_verify(commands, _fmu_path)
    add_commands(commands)
    return parser


def _system_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("system", metavar="SYSTEM", help="a system file, or one of 'cosim list' (shams2010/fsmc_5sin)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="INST.VAR=VALUE",
        dest="values",
        help="a start value, such as plant.m=70, controller.T_s=2e-4 or trajectory.kind=sine; may be repeated",
    )
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


# Systems


def _system(options: argparse.Namespace) -> System:
    from .system import parse_value, read_system

    values: dict[str, object] = {}
    problems: list[str] = []
    for item in options.values:
        name, equals, value = item.partition("=")
        if not equals:
            problems.append(f"--set {item}: write INSTANCE.VARIABLE=VALUE, such as plant.m=70.")
        else:
            values[name.strip()] = parse_value(value.strip())
    if problems:
        raise DescriptionError(problems)
    order = options.order
    if order is not None and order not in ("sequential", "parallel"):
        order = [name.strip() for name in order.split(",")]
    return read_system(
        _system_path(options.system),
        values,
        fmus=options.fmus,
        stop_time=options.stop_time,
        step_size=options.step_size,
        order=order,
        record=options.record,
        decimation=options.decimation,
    )


def _system_path(text: str) -> Path:
    from .system import shipped_file, shipped_systems

    path = shipped_file(text)
    if path.exists() or text.endswith((".toml", ".ssp", ".ssd")):
        return path
    raise DescriptionError(f"{text}: neither a file nor a system shipped.{suggest(text, shipped_systems())}")


def _check(options: argparse.Namespace) -> int:
    system = _system(options)
    console = standard_output()
    console.print(f"[bold]{escape(system.description or system.name)}[/]", soft_wrap=True)
    table = Table(box=SIMPLE_HEAD)
    for heading in ("Instance", "FMU", "Start values", "Steps over"):
        table.add_column(heading)
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


def _export(options: argparse.Namespace) -> int:
    from .ssp import write_ssp, write_toml

    writers = {".ssp": write_ssp, ".toml": write_toml}
    suffix = options.output.suffix.lower()
    if suffix not in writers:
        raise DescriptionError(f"{options.output}: write to a file that ends in .ssp or .toml.")
    system = _system(options)
    path = writers[suffix](system, options.output)
    standard_output().print(
        f"{escape(str(path))}: {len(system.instances)} instances, {len(system.connections)} connections."
    )
    return 0


def _run(options: argparse.Namespace) -> int:
    begun = time.perf_counter()
    if options.output is not None:
        from .results import check_output

        check_output(options.output)
    system = _system(options)
    from .master import Interrupted, RunError, simulate

    if not options.json:
        for note in system.notes:
            remark(f"note: {note}")
    try:
        with _Bar(system) as bar:
            result = simulate(system, progress=bar.update, debug=options.debug, keep_going=options.keep_going)
    except RunError as error:
        _failed(error, options)
        return 1
    except Interrupted as interruption:
        complain(f"Interrupted. {_kept(interruption.result, options)}")
        _finish(interruption.result, options, begun)
        return 130
    _finish(result, options, begun)
    return 0


def _failed(error: RunError, options: argparse.Namespace) -> None:
    if error.result is not None:
        _show_messages(error.result, but=error.message)
    complain(str(error))
    if error.result is not None and error.result.time.size:
        remark(_kept(error.result, options))
        _save(error.result, options)


def _kept(result: Result, options: argparse.Namespace) -> str:
    if not result.time.size:
        return "Nothing had been computed."
    rows = f"Computed up to {result.time[-1]:.9g} s ({result.time.size} rows)"
    if options.output is None:
        return f"{rows}; name a file with --output to keep them."
    return f"{rows}, kept in {options.output}."


def _save(result: Result, options: argparse.Namespace) -> None:
    if options.output is not None:
        result.save(options.output)
    if options.plot is not None and result.time.size > 1:
        from .plots import plot_run

        plot_run(result, options.plot)


def _finish(result: Result, options: argparse.Namespace, begun: float) -> None:
    """Messages, files and the summary that end a run."""
    _show_messages(result)
    _save(result, options)
    figures = _figures(result)
    facts = result.metadata
    simulated = facts["steps"] * facts["step_size"]
    factor = simulated / facts["stepping_seconds"] if facts["stepping_seconds"] > 0.0 else float("inf")
    if options.json:
        summary = {
            "system": facts["system"],
            "system_hash": facts["system_hash"],
            "partial": result.partial,
            "steps": facts["steps"],
            "step_size": facts["step_size"],
            "simulated_seconds": simulated,
            "stepping_seconds": facts["stepping_seconds"],
            "elapsed_seconds": time.perf_counter() - begun,
            "real_time_factor": factor,
            "warnings": facts["warnings"],
            "solver": {name: dict(counts) for name, counts in result.solver.items()},
            "figures": [
                {"name": row.name, "value": row.value if isfinite(row.value) else None, "unit": row.unit}
                for row in figures
            ],
            "output": None if options.output is None else str(options.output),
            "plot": None if options.plot is None else str(options.plot),
        }
        sys.stdout.write(json.dumps(summary, indent=2) + "\n")
        return
    table = Table(
        title=escape(str(facts["description"] or facts["system"])), title_justify="left", show_header=False, box=SIMPLE
    )
    table.add_column()
    table.add_column(justify="right")
    table.add_column()
    table.add_row("Simulated", f"{simulated:.9g}", "s")
    table.add_row("Steps", f"{facts['steps']}", f"of {facts['step_size']:g} s")
    table.add_row("Time of the steps", f"{facts['stepping_seconds']:.3g}", f"s, {factor:.3g} times real time")
    for instance, counts in result.solver.items():
        if "rhs_evaluations" in counts and facts["steps"]:
            per_step = counts["rhs_evaluations"] / facts["steps"]
            rejected = f", {counts['rejected']:.0f} rejected" if counts.get("rejected") else ""
            steps = f"{counts.get('steps', 0.0):.0f} steps{rejected}"
            table.add_row(f"{escape(instance)}: equations evaluated", f"{per_step:.3g}", f"times a step ({steps})")
    if figures:
        table.add_section()
    for row in figures:
        value, unit = (f"{row.value:.4g}", row.unit) if isfinite(row.value) else ("never", "")
        table.add_row(escape(row.name), value, escape(unit))
    console = standard_output()
    console.print(table)
    for file in (options.output, options.plot):
        if file is not None:
            console.print(f"Written: {escape(str(file))}")


def _figures(result: Result) -> list[Row]:
    """Tracking figures, none for a run too short to have them."""
    from . import metrics

    try:
        return metrics.summary(result)
    except DescriptionError:
        return []


def _show_messages(result: Result, but: str = "") -> None:
    """What FMUs logged, without the message ``but``, which is told elsewhere."""
    messages = [message for message in result.messages if message.text != but]
    for message in messages[:MAX_SHOWN_MESSAGES]:
        remark(str(message))
    more = len(messages) - MAX_SHOWN_MESSAGES + result.dropped_messages
    if more > 0:
        remark(f"and {more} more messages")


class _Bar(AbstractContextManager["_Bar"]):
    """A progress bar for work of more than a second, on a terminal only."""

    def __init__(self, system: System) -> None:
        self._length = float(system.stop_time - system.start_time)
        self._start = time.perf_counter()
        self._bar: Progress | None = None

    def update(self, fraction: float) -> None:
        if self._bar is None:
            if time.perf_counter() - self._start < 1.0 or not sys.stderr.isatty():
                return
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            columns = BarColumn(), TextColumn("{task.completed:.3g} of {task.total:g} s"), TimeRemainingColumn()
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._bar.add_task("", total=self._length)
            self._bar.start()
        self._bar.update(self._bar.task_ids[0], completed=fraction * self._length)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


# FMUs, lists, studies


def _info(options: argparse.Namespace) -> int:
    from .fmu import read_fmu

    fmu = read_fmu(_fmu_path(options.fmu, options.fmus))
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
    firsts = {elements[0]: (name, len(elements)) for name, elements in fmu.arrays.items()}
    others = {element for elements in fmu.arrays.values() for element in elements[1:]}
    order = {"input": 0, "output": 1, "parameter": 2}
    rows: list[tuple[str, Variable]] = []
    for variable in sorted(fmu.variables.values(), key=lambda v: order.get(v.causality, 3)):
        if variable.name in firsts:
            name, length = firsts[variable.name]
            rows.append((f"{name}[1..{length}]", variable))
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


def _fmu_path(text: str, folder: Path | None) -> Path:
    from .system import find_fmus

    if text.endswith(".fmu") or "/" in text:
        return Path(text)
    folder = folder if folder is not None else find_fmus(Path.cwd())
    known = {path.stem: path for path in folder.glob("*.fmu")} if folder is not None else {}
    if text in known:
        return known[text]
    raise DescriptionError(f"no FMU '{text}' in {folder or 'build/fmus/native'}.{suggest(text, known)}")


def _copy(options: argparse.Namespace) -> int:
    from .handout import copy_fmus
    from .system import find_fmus

    source = options.fmus if options.fmus is not None else find_fmus(Path.cwd())
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


def _list(options: argparse.Namespace) -> int:
    from .fmu import read_fmu
    from .system import PREBUILT, find_fmus, shipped_systems

    console = standard_output()
    folder = options.fmus if options.fmus is not None else find_fmus(Path.cwd())
    fmus: dict[Path, Fmu | str] = {}
    for path in sorted(folder.glob("*.fmu")) if folder is not None else ():
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
    studies = sorted({path.parent.name for path in systems.values() if (path.parent / "study.py").is_file()})
    if studies:
        console.print(f"[bold]Studies[/] {escape(', '.join(studies))}")
    return 0


def _description(path: Path) -> str:
    try:
        document: Mapping[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return "not readable"
    return str(document.get("description", ""))


def _study(options: argparse.Namespace) -> int:
    from . import study

    return study.main(options.name, options.output, runs=options.runs, jobs=options.jobs, fmus=options.fmus)


if __name__ == "__main__":
    sys.exit(main())
