"""``cosim learn``: learns parameters from closed-loop runs."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .console import Bar, check_files, check_plot, common_arguments, set_argument, show, write_files
from .parser import RUN_LIMIT, count, timeout_argument
from .systems import base_argument, given_values

if TYPE_CHECKING:
    from ..design.pulse import Learned, Monitored


def add(commands: Any) -> None:
    """Add ``learn``."""
    learn = commands.add_parser(
        "learn", help="learn friction pulses", description="Learn parameters from closed-loop runs."
    ).add_subparsers(metavar="WHAT", required=True)
    pulse = learn.add_parser(
        "friction-pulse",
        help="amplitude and duration over reverse acceleration",
        description="Learn the tables of FrictionPulse, 782 runs an axis; with --monitor only if friction has changed.",
    )
    pulse.examples = ("cosim learn friction-pulse feng2015/circle --axis x y --output results/pulses",)
    pulse.add_argument("system", type=Path, metavar="SYSTEM", help="a system file with FrictionPulse on its axes")
    pulse.add_argument(
        "--axis",
        nargs="+",
        default=[""],
        metavar="NAME",
        help="axes to learn: x for instances trajectory_x, pulse_x ... (default: names without axis)",
    )
    pulse.add_argument(
        "--output",
        type=Path,
        default=Path("results/pulses"),
        metavar="DIR",
        help="folder of the tables (default: results/pulses)",
    )
    base_argument(pulse, "DIR/tables.toml", "SYSTEM")
    pulse.add_argument(
        "--monitor", action="store_true", help="compare J with DIR/AXIS.json; learn anew above 1.5 times"
    )
    set_argument(pulse, several=True)
    pulse.add_argument("--workers", type=count, default=1, metavar="N", help="threads (default: 1; runs are short)")
    pulse.add_argument("--plot", type=Path, metavar="FILE", help="draw the tables")
    timeout_argument(pulse, "a run", RUN_LIMIT)
    common_arguments(pulse, _learn)


def _learn(options: argparse.Namespace) -> int:
    from ..design import pulse
    from ..fmu.places import base_name
    from ..system.system import read_system

    tables = options.output / "tables.toml"
    check_files(tables)
    check_plot(options.plot)
    well = True
    values = given_values(options.values)
    system = read_system(options.system, fmus=options.fmus)
    given: dict[str, Any] = {"overrides": values, "timeout": options.timeout, "fmus": options.fmus}
    base = base_name(options.base or options.system, tables)
    learned: dict[str, pulse.Learned] = {}
    checks: dict[str, list[pulse.Monitored]] = {}
    anew: list[str] = []
    for name in options.axis:
        file = options.output / f"{name or 'axis'}.json"
        axis = pulse.Axis.named(name)
        if options.monitor:
            learned[axis.pulse] = pulse.load(file)
            found = pulse.monitor(system, learned[axis.pulse], axis, **given)
            checks[axis.pulse] = found
            if max(point.ratio for point in found) <= pulse.RELEARN:
                continue
        with Bar(f"Runs of {axis.pulse}") as bar:

            def advance(stage: str, done: int, total: int, bar: Bar = bar) -> None:
                bar.update(done, total, stage)

            learned[axis.pulse] = pulse.learn_friction_pulse(
                system, axis, **given, workers=options.workers, progress=advance
            )
        anew.append(axis.pulse)
        # Saved at once: what was learned is kept if the next axis fails or is interrupted.
        well = write_files((file, partial(pulse.save, learned[axis.pulse]))) and well
    content = {name: _content(result, checks.get(name, []), name in anew) for name, result in learned.items()}
    rows: list[tuple[str, ...]] = [
        ("Pulse", "acceleration [mm/s2]", "t_c [ms]", "duration [ms]", "amplitude [mm/s]", "J [um]", "J over nominal")
    ]
    for name, result in learned.items():
        rows += _rows(name, result, checks.get(name, []))
    kept = "nothing learned anew" if not anew else f"tables in {tables}"
    show(options, {"pulses": content, "tables": str(tables) if anew else None}, rows, f"Friction pulses, {kept}")
    written = write_files(
        (tables if anew else None, lambda path: pulse.write_start(learned, path, base=base, system=system)),
        (options.plot, lambda path: pulse.plot_learned(learned, path)),
    )
    return 0 if well and written else 1


def _content(result: Learned, checked: Sequence[Monitored], anew: bool) -> dict[str, Any]:
    """What was learned for one axis, for JSON."""
    from ..design.pulse import ACCELERATIONS

    return {
        "learned": anew,
        "t_c": result.t_c.tolist(),
        "durations": result.durations.tolist(),
        "amplitudes": [result.tables.at(a)[0] for a in ACCELERATIONS],
        "nominal_J": result.nominal.tolist(),
        "monitored_ratio": [point.ratio for point in checked],
        "spread": result.spread,
        "runs": dict(result.runs) if anew else {},
        "seconds": result.seconds,
    }


def _rows(name: str, result: Learned, checked: Sequence[Monitored]) -> Iterator[tuple[str, ...]]:
    """A row of the table for each acceleration."""
    from ..design.pulse import ACCELERATIONS

    for i, a in enumerate(ACCELERATIONS):
        A, T = result.tables.at(a)
        cells = (1e3 * a, 1e3 * float(result.t_c[i]), 1e3 * T, 1e3 * A, 1e6 * float(result.nominal[i]))
        yield (name, *(f"{value:.4g}" for value in cells), f"{checked[i].ratio:.2f}" if checked else "")
