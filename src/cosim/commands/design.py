"""The design tools on the command line. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..errors import CosimError, DescriptionError
from .console import fmus_argument, standard_output
from .systems import settings, settings_argument

if TYPE_CHECKING:
    from rich.progress import Progress


def add_commands(commands: Any) -> None:
    """Add sweep, identify, stability, learn, tune and linearize to the subparsers of ``cosim``."""
    sweep = commands.add_parser(
        "sweep",
        help="run a system over many start values",
        description="Run a system over a grid, list, Latin hypercube or Sobol design of start values. "
        "The same command goes on where an interrupted sweep was.",
        epilog="Example: cosim sweep studies/maeda2008/sweeps/gain_friction.toml --output results/gains",
    )
    sweep.add_argument("file", type=Path, metavar="SWEEP", help="a sweep file (.toml)")
    sweep.add_argument(
        "--output", type=Path, metavar="DIR", help="folder of the data set (default: results/sweeps/NAME)"
    )
    sweep.add_argument("--workers", type=int, metavar="N", help="processes (default: one a core; 0: this process)")
    sweep.add_argument("--scheduler", metavar="ADDRESS", help="a dask scheduler, such as tcp://host:8786")
    sweep.add_argument("--restart", action="store_true", help="delete the runs that are there and start anew")
    _common(sweep, _sweep)

    identify = commands.add_parser(
        "identify",
        help="identify the nominal characteristic trajectory of a stage",
        description="Identify a nominal characteristic trajectory (NCT) from an open-loop pulse.",
    ).add_subparsers(metavar="WHAT", required=True)
    nct = identify.add_parser(
        "nct",
        help="from a system or a recorded CSV",
        description="Identify the NCT from a system that drives its plant with a pulse, or from a CSV with columns "
        "t, u, x (and v).",
        epilog="Example: cosim identify nct studies/maeda2008/pulse.toml --alpha 505 --plot nct.png",
    )
    nct.add_argument("source", metavar="SYSTEM|CSV", help="a system file or a .csv")
    nct.add_argument("--alpha", type=float, metavar="1/s", help="slope of the linear part")
    nct.add_argument("--e-lin", type=float, metavar="m", help="position error at which the linear part ends")
    nct.add_argument("--omega-n", type=float, metavar="rad/s", help="with --zeta: natural frequency of the compensator")
    nct.add_argument("--zeta", type=float, help="with --omega-n: damping ratio of the compensator")
    nct.add_argument("--position", default="plant.position", metavar="INST.VAR")
    nct.add_argument(
        "--velocity", default="plant.velocity", metavar="INST.VAR", help="'' to differentiate the position"
    )
    nct.add_argument("--input", default="plant.command", metavar="INST.VAR")
    nct.add_argument("--output", type=Path, metavar="FILE", help="write the curve (.csv)")
    nct.add_argument("--start", type=Path, metavar="FILE", help="write a system file with the NCT (.toml)")
    nct.add_argument("--base", metavar="NAME", help="the file beside it that the start file completes")
    nct.add_argument("--plot", type=Path, metavar="FILE", help="draw the phase plane")
    _common(nct, _identify)

    stability = commands.add_parser(
        "stability",
        help="limits of stability of NCTF control",
        description="Limits of stability of NCTF control.",
    ).add_subparsers(metavar="WHAT", required=True)
    linear = stability.add_parser(
        "linear",
        help="of the sampled linear loop",
        description="Stable damping ratios of the sampled linear loop, by Jury's test and in closed form.",
        epilog="Example: cosim stability linear --W 0.1 0.25 0.4 --alpha 505 --T-s 2e-4",
    )
    linear.add_argument("--W", type=float, nargs="+", default=[0.05, 0.1, 0.2, 0.3, 0.4], help="omega_n*T_s")
    linear.add_argument("--alpha", type=float, required=True, metavar="1/s", help="slope of the NCT")
    linear.add_argument("--T-s", type=float, required=True, metavar="s", help="sampling time")
    linear.add_argument("--json", action="store_true", help="print the result as JSON")
    linear.set_defaults(command=_linear)
    practical = stability.add_parser(
        "practical",
        help="ultimate gain by simulation",
        description="The gain at which a step no longer comes to rest.",
        epilog="Example: cosim stability practical studies/maeda2008/step.toml --set trajectory.amplitude=1e-5 "
        "controller.K_I=0",
    )
    practical.add_argument("system", type=Path, metavar="SYSTEM")
    settings_argument(practical, several=True)
    practical.add_argument("--gain", default="controller.K_P", metavar="INST.VAR")
    practical.add_argument("--position", default="plant.position", metavar="INST.VAR")
    practical.add_argument("--first", type=float, default=300.0, help="gain at which the scan begins (default: 300)")
    practical.add_argument("--last", type=float, default=20000.0, help="gain at which it ends (default: 20000)")
    practical.add_argument("--swing", type=float, default=50e-9, metavar="m", help="oscillation that counts")
    practical.add_argument("--stop-time", default="0.6", metavar="s", help="end of a run (default: 0.6)")
    _common(practical, _practical)
    maps = stability.add_parser(
        "map",
        help="limits of several objects over omega_n*T_s",
        description="Linear, practical and simulated limits of the damping ratio, as a map file asks for.",
        epilog="Example: cosim stability map studies/maeda2008/limits/friction.toml --plot friction.png",
    )
    maps.add_argument("file", type=Path, metavar="MAP", help="a map file (.toml)")
    maps.add_argument("--plot", type=Path, metavar="FILE", help="draw the map")
    _common(maps, _map)

    learn = commands.add_parser(
        "learn", help="learn friction pulses", description="Learn parameters from closed-loop runs."
    ).add_subparsers(metavar="WHAT", required=True)
    pulse = learn.add_parser(
        "friction-pulse",
        help="amplitude and duration over reverse acceleration",
        description="Learn the tables of FrictionPulse, 782 runs an axis; with --monitor only if friction has changed.",
        epilog="Example: cosim learn friction-pulse studies/feng2015/circle.toml --axis x y --output results/pulses",
    )
    pulse.add_argument("system", type=Path, metavar="SYSTEM")
    pulse.add_argument("--axis", nargs="+", default=[""], metavar="NAME", help="x for trajectory_x, pulse_x ...")
    pulse.add_argument("--output", type=Path, default=Path("results/pulses"), metavar="DIR")
    pulse.add_argument("--base", metavar="NAME", help="the file beside it that DIR/tables.toml completes")
    pulse.add_argument(
        "--monitor", action="store_true", help="compare J with DIR/AXIS.json; learn anew above 1.5 times"
    )
    settings_argument(pulse, several=True)
    pulse.add_argument("--workers", type=int, default=1, metavar="N", help="threads (default: 1; runs are short)")
    pulse.add_argument("--plot", type=Path, metavar="FILE", help="draw the tables")
    _common(pulse, _learn)

    tune = commands.add_parser(
        "tune",
        help="optimize parameters of a system",
        description="Look for the parameters with the least objective that keep all limits.",
        epilog="Example: cosim tune studies/maeda2008/tunings/step_1mm.toml --start tuned.toml --base step.toml",
    )
    tune.add_argument("file", type=Path, metavar="TUNING", help="a tuning file (.toml)")
    tune.add_argument("--workers", type=int, default=2, metavar="N", help="threads (default: 2)")
    tune.add_argument("--start", type=Path, metavar="FILE", help="write a system file with the values found")
    tune.add_argument("--base", metavar="NAME", help="the file beside it that the start file completes")
    _common(tune, _tune)

    linearize = commands.add_parser(
        "linearize",
        help="state space of an instance, margins of its loop",
        description="State space of an FMU, or of an instance of a system at a time of its run; margins of the loop.",
        epilog="Example: cosim linearize studies/maeda2008/step.toml --instance plant --at 0 "
        "--set trajectory.amplitude=1e-7 controller.sensor_resolution=0 --inputs command --outputs position "
        "--margins --plot bode.png",
    )
    linearize.add_argument("source", metavar="FMU|SYSTEM", help="an .fmu or a system file")
    linearize.add_argument("--instance", default="plant", metavar="NAME", help="of the system (default: plant)")
    linearize.add_argument("--at", default="0", metavar="TIME", help="seconds, as 0.01 or t=0.01 (default: 0)")
    linearize.add_argument("--inputs", nargs="+", metavar="VAR")
    linearize.add_argument("--outputs", nargs="+", metavar="VAR")
    settings_argument(linearize, several=True)
    linearize.add_argument("--margins", action="store_true", help="margins of the loop with --controller")
    linearize.add_argument("--controller", default="controller", metavar="NAME")
    linearize.add_argument("--plot", type=Path, metavar="FILE", help="Bode picture of the first input and output")
    _common(linearize, _linearize)


def _common(parser: argparse.ArgumentParser, command: Callable[[argparse.Namespace], int]) -> None:
    parser.add_argument("--json", action="store_true", help="print the result as JSON, for scripts")
    fmus_argument(parser)
    parser.set_defaults(command=command)


def _finite(value: Any) -> Any:
    """``value`` as JSON can hold it: what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]  # pyright: ignore[reportUnknownVariableType]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _show(options: argparse.Namespace, content: Mapping[str, Any], rows: list[tuple[str, ...]], title: str) -> None:
    """The result as JSON, or as a table whose first row holds the headings."""
    if options.json:
        sys.stdout.write(json.dumps(_finite(content), indent=2) + "\n")
        return
    console = standard_output()
    console.print(escape(title), soft_wrap=True)
    table = Table(box=SIMPLE)
    for i, heading in enumerate(rows[0]):
        table.add_column(escape(heading), justify="left" if i == 0 else "right")
    for row in rows[1:]:
        table.add_row(*(escape(cell) for cell in row))
    console.print(table)


class _Bar(AbstractContextManager["_Bar"]):
    """A bar with rate and remaining time on a terminal, for work of more than half a second."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._begun = time.perf_counter()
        self._first = 0
        self._bar: Progress | None = None

    def update(self, done: int, total: int | None, note: str = "") -> None:
        """Show ``done`` of ``total``; without a total only the count."""
        elapsed = time.perf_counter() - self._begun
        if self._bar is None:
            if elapsed < 0.5 or not sys.stderr.isatty():
                return
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            text = TextColumn("{task.description}"), TextColumn("{task.fields[rate]:.3g}/s {task.fields[note]}")
            columns = text[0], BarColumn(), MofNCompleteColumn(), text[1], TimeRemainingColumn()
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._bar.add_task(self._what, total=total, rate=0.0, note="")
            self._bar.start()
        self._bar.update(self._bar.task_ids[0], completed=done, total=total, rate=done / elapsed, note=note)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


# Commands


def _sweep(options: argparse.Namespace) -> int:
    from ..design import sweep as sweeps

    plan = sweeps.read_sweep(options.file, fmus=options.fmus)
    with _Bar("Runs") as bar:

        def show(progress: sweeps.Progress) -> None:
            bar.update(progress.done, progress.total, f"{progress.failed} failed" if progress.failed else "")

        try:
            outcome = sweeps.sweep(
                plan,
                options.output,
                workers=options.workers,
                scheduler=options.scheduler,
                restart=options.restart,
                progress=show,
            )
        except OSError as error:
            raise CosimError(
                f"the data set cannot be written: {error}. What was written is kept; the same command goes on."
            ) from None
    page = sweeps.report(outcome.folder)
    content: dict[str, Any] = {
        "data": str(outcome.folder / "runs"),
        "report": str(page),
        "runs": outcome.runs,
        "new": outcome.new,
        "failed": outcome.failed,
        "elapsed_seconds": outcome.elapsed,
        "run_seconds": outcome.run_seconds,
        "workers": outcome.workers,
    }
    rows = [("Runs", f"{outcome.runs}"), ("of these now", f"{outcome.new}"), ("failed", f"{outcome.failed}")]
    rows += [("Elapsed", f"{outcome.elapsed:.3g} s"), ("Data set", content["data"]), ("Report", content["report"])]
    _show(options, content, [("Sweep", ""), *rows], plan.description or plan.name)
    return 0


def _identify(options: argparse.Namespace) -> int:
    from ..design import identify

    if (options.omega_n is None) != (options.zeta is None):
        raise DescriptionError("--omega-n and --zeta go together: give both or none.")
    nct = identify.identify_nct(
        options.source,
        alpha=options.alpha,
        e_lin=options.e_lin,
        position=options.position,
        velocity=options.velocity or None,
        command=options.input,
        fmus=options.fmus,
    )
    gains = None if options.zeta is None else nct.gains(options.omega_n, options.zeta)
    if options.output is not None:
        identify.write_nct(nct, options.output)
    if options.start is not None:
        identify.write_start(nct, options.start, gains=gains, base=options.base)
    if options.plot is not None:
        identify.plot_nct(nct, options.plot)
    figures: list[tuple[str, float, str]] = [
        ("alpha", nct.alpha, "1/s"),
        ("e_lin", nct.e_lin, "m"),
        ("K", nct.K, "m/s a unit of command"),
        ("u_r", nct.u_r, "unit of command"),
        ("t_r", nct.t_r, "s"),
        ("rest", nct.rest, "m"),
        ("spring_back", nct.spring_back, "m"),
        ("h_max", nct.h_max, "m/s"),
        ("reach", nct.reach, "m"),
        *([] if gains is None else [("K_P", gains[0], ""), ("K_I", gains[1], "")]),
    ]
    rows = [(name, f"{value:.6g}", unit) for name, value, unit in figures]
    _show(options, {name: value for name, value, _ in figures}, [("NCT", "", ""), *rows], str(options.source))
    return 0


def _linear(options: argparse.Namespace) -> int:
    from ..design.stability import closed_form_limits, linear_limits

    limits = {W: (*linear_limits(W, options.alpha * options.T_s), *closed_form_limits(W)) for W in options.W}
    names = ("zeta_min", "zeta_max", "closed_form_min", "closed_form_max")
    content = {"limits": [{"W": W, **dict(zip(names, found, strict=True))} for W, found in limits.items()]}
    rows = [(f"{W:g}", *(f"{value:.5g}" for value in found)) for W, found in limits.items()]
    title = f"Stable damping ratios, alpha*T_s = {options.alpha * options.T_s:.4g}"
    _show(options, content, [("omega_n*T_s", "smallest", "largest", "closed form, smallest", "largest"), *rows], title)
    return 0


def _practical(options: argparse.Namespace) -> int:
    from ..design.stability import practical_limit

    limit = practical_limit(
        options.system,
        settings(options),
        gain=options.gain,
        position=options.position,
        first=options.first,
        last=options.last,
        swing=options.swing,
        stop_time=options.stop_time,
        fmus=options.fmus,
    )
    content = {"limit": limit.value, "stable": limit.stable, "unstable": limit.unstable, "runs": limit.runs}
    rows = [(name, f"{value:.6g}") for name, value in content.items()]
    _show(options, content, [(options.gain, ""), *rows], f"Practical limit of {options.system}")
    return 0


def _map(options: argparse.Namespace) -> int:
    from ..design.stability import limit_map, plot_limit_map, read_map

    file = read_map(options.file, fmus=options.fmus)
    with _Bar("Limits") as bar:
        found = limit_map(file.system, file.cases, K=file.K, progress=bar.update)
    if options.plot is not None:
        plot_limit_map(found, options.plot)
    content = {
        "ultimate": dict(found.ultimate),
        "mean_deviation": found.mean_deviation,
        "runs": found.runs,
        "points": [{**vars(point), "deviation": point.deviation} for point in found.points],
    }
    rows = [
        (
            point.case,
            f"{point.W:g}",
            f"{point.linear:.4g}",
            f"{point.practical:.4g}",
            f"below {point.found:.4g}" if point.starts_unstable else f"{point.found:.4g}",
            f"{100.0 * point.deviation:.1f} %",
        )
        for point in found.points
    ]
    title = (
        f"{file.description}: damping ratios; mean deviation {100.0 * found.mean_deviation:.1f} %, {found.runs} runs"
    )
    _show(options, content, [("Case", "omega_n*T_s", "linear", "practical", "simulated", "deviation"), *rows], title)
    return 0


def _learn(options: argparse.Namespace) -> int:
    from ..design import pulse

    values = settings(options)
    learned: dict[str, pulse.Learned] = {}
    checks: dict[str, list[pulse.Monitored]] = {}
    anew: list[str] = []
    for name in options.axis:
        file = options.output / f"{name or 'axis'}.json"
        axis = pulse.Axis.named(name)
        if options.monitor:
            learned[axis.pulse] = pulse.load(file)
            found = pulse.monitor(options.system, learned[axis.pulse], axis, overrides=values, fmus=options.fmus)
            checks[axis.pulse] = found
            if max(point.ratio for point in found) <= pulse.RELEARN:
                continue
        with _Bar(f"Runs of {axis.pulse}") as bar:

            def show(stage: str, done: int, total: int, bar: _Bar = bar) -> None:
                bar.update(done, total, stage)

            learned[axis.pulse] = pulse.learn_friction_pulse(
                options.system, axis, overrides=values, workers=options.workers, fmus=options.fmus, progress=show
            )
        anew.append(axis.pulse)
        pulse.save(learned[axis.pulse], file)
    tables = options.output / "tables.toml"
    if anew:
        pulse.write_start(learned, tables, base=options.base)
    if options.plot is not None:
        pulse.plot_learned(learned, options.plot)
    content = {
        name: {
            "learned": name in anew,
            "t_c": result.t_c.tolist(),
            "durations": result.durations.tolist(),
            "amplitudes": [result.tables.at(a)[0] for a in pulse.ACCELERATIONS],
            "nominal_J": result.nominal.tolist(),
            "monitored_ratio": [point.ratio for point in checks.get(name, [])],
            "spread": result.spread,
            "runs": dict(result.runs) if name in anew else {},
            "seconds": result.seconds,
        }
        for name, result in learned.items()
    }
    rows: list[tuple[str, ...]] = [
        ("Pulse", "acceleration [mm/s2]", "t_c [ms]", "duration [ms]", "amplitude [mm/s]", "J [um]", "J over nominal")
    ]
    for name, result in learned.items():
        for i, a in enumerate(pulse.ACCELERATIONS):
            A, T = result.tables.at(a)
            ratio = f"{checks[name][i].ratio:.2f}" if name in checks else ""
            cells = (1e3 * a, 1e3 * float(result.t_c[i]), 1e3 * T, 1e3 * A, 1e6 * float(result.nominal[i]))
            rows.append((name, *(f"{value:.4g}" for value in cells), ratio))
    kept = "nothing learned anew" if not anew else f"tables in {tables}"
    _show(options, {"pulses": content, "tables": str(tables) if anew else None}, rows, f"Friction pulses, {kept}")
    return 0


def _tune(options: argparse.Namespace) -> int:
    from ..design.tune import Trial, read_tuning, tune, write_start

    tuning = read_tuning(options.file, fmus=options.fmus)
    with _Bar("Runs") as bar:

        def show(done: int, best: Trial | None) -> None:
            value = math.nan if best is None else best.figures.get(tuning.objective, math.nan)
            bar.update(done, None, f"best {tuning.objective} {value:.4g}")

        tuned = tune(tuning, workers=options.workers, progress=show)
    if options.start is not None:
        write_start(tuned, options.start, base=options.base)
    content = {
        "parameters": dict(tuned.parameters),
        "figures": dict(tuned.best.figures),
        "feasible": tuned.feasible,
        "excess": tuned.best.excess,
        "runs": len(tuned.trials),
        "generations": tuned.generations,
        "message": tuned.message,
    }
    rows = [(name, f"{value:.6g}") for name, value in {**tuned.parameters, **tuned.best.figures}.items()]
    kept = "all limits kept" if tuned.feasible else f"limits NOT kept, excess {tuned.best.excess:.3g}"
    _show(options, content, [("", "Best"), *rows], f"{options.file}: {len(tuned.trials)} runs, {kept}")
    return 0


def _linearize(options: argparse.Namespace) -> int:
    from ..design import linearize
    from ..design.linearize import Margins

    try:
        at = float(options.at.removeprefix("t="))
    except ValueError:
        raise DescriptionError(f"--at {options.at}: give seconds, such as t=0.01.") from None
    values = settings(options)
    from ..fmu.places import find_system, has_ending

    file = find_system(options.source, options.fmus)
    alone = has_ending(file, ".fmu")
    if alone:
        if at != 0.0:
            raise DescriptionError("an FMU alone is linearized where it starts. Give a system for another time.")
        source: Any = file
        start = {name.removeprefix(f"{file.stem}.").removeprefix("fmu."): value for name, value in values.items()}
        model = linearize.linearize(source, inputs=options.inputs, outputs=options.outputs, start=start)
    else:
        from ..system.system import read_system

        source = read_system(file, values, fmus=options.fmus)
        model = linearize.linearize(
            source, instance=options.instance, at=at, inputs=options.inputs, outputs=options.outputs
        )
    found: Margins | None = None
    if options.margins:
        if alone:
            raise DescriptionError("margins need a system with the loop.")
        loop, found = linearize.loop_margins(source, at=at, controller=options.controller, plant=options.instance)
        if options.plot is not None:
            linearize.plot_bode(options.plot, loop, title="Loop transfer function, sampled")
    elif options.plot is not None:
        linearize.plot_bode(options.plot, model, title=f"{model.inputs[0]} to {model.outputs[0]}")
    matrices = {name: getattr(model, name).tolist() for name in ("A", "B", "C", "D")}
    poles = [[float(pole.real), float(pole.imag)] for pole in model.poles]
    content = {
        "states": model.states,
        "inputs": model.inputs,
        "outputs": model.outputs,
        **matrices,
        "poles": poles,
        "margins": None if found is None else vars(found),
    }
    rows: list[tuple[str, ...]] = [("", *model.states, *model.inputs)]
    for names, left, right in (
        ([f"der({state})" for state in model.states], model.A, model.B),
        (list(model.outputs), model.C, model.D),
    ):
        for i, name in enumerate(names):
            rows.append((name, *(f"{float(value):.6g}" for value in (*left[i], *right[i]))))
    _show(options, content, rows, f"{options.source} at {at:g} s")
    if found is not None and not options.json:
        units = {"gain_frequency": "rad/s", "phase": "rad", "crossover": "rad/s", "delay": "s"}
        rows = [("Margin", "", ""), ("stable", "yes" if found.stable else "no", "")]
        rows += [(name, f"{value:.6g}", units.get(name, "")) for name, value in vars(found).items() if name != "stable"]
        _show(options, {}, rows, f"Loop with {options.controller}")
    return 0
