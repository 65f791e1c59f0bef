"""Work and precision of the FMUs' integrator on the ballscrew stage against scipy and SUNDIALS CVODE.

Equations, Jacobian and integrator are the C sources inside the FMU. Torque is replayed, held over each sample, and
every method starts anew at every sample, as it must in an FMU whose inputs jump. All have the exact Jacobian, relative
tolerances from 1e-2 to 1e-9, absolute ones of that times the nominal of the state. Reference: Runge-Kutta at 0.05 us.

Printed: evaluations of the derivative a sample against the largest error at the ends of samples, of any state relative
to its largest value, and for each accuracy the ratio to the best of the others. The picture goes to
build/benchmarks/integrator.png. A few minutes.
"""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib as mpl
import numpy as np
from figures import Kept, keep
from programs import compile_c, extract_sources
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp
from sksundae.cvode import CVODE

from cosim import read_system, simulate

mpl.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
STAGE = ROOT / "build" / "fmus" / "native" / "BallscrewStage.fmu"
LOOP = ROOT / "studies" / "shams2010" / "fsmc_2pi.toml"
PICTURE = ROOT / "build" / "benchmarks" / "integrator.png"
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
ACCURACIES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
OURS = "this integrator"
N = 3

SHIM = """
#define FMI2_EXPORT static
#include "sources/model.c"
#define PUBLIC __attribute__((visibility("default")))
static State s;
PUBLIC const double *prepare(void) {
    set_start_values(&s);
    s.phase = INITIALIZATION;
    refresh_parameters(&s);
    return nominals;
}
PUBLIC void derivative(const double *x, double command, double *dx) {
    double y[N_STATES] = {x[0], x[1], x[2]};
    inputs(&s)[0] = command;
    variant(&s)->derivative(0.0, y, inputs(&s), parameters(&s), s.c, dx);
}
PUBLIC void jacobian(const double *x, double command, double *matrix) {
    double y[N_STATES] = {x[0], x[1], x[2]}, time_derivative[N_STATES];
    inputs(&s)[0] = command;
    variant(&s)->jacobian(0.0, y, inputs(&s), parameters(&s), s.c, matrix, time_derivative);
}
/* rows: the state at the end of each sample; counts: derivatives, jacobians, decompositions */
PUBLIC int replay(const double *commands, long n, double h, double tolerance, double *x, double *rows, double *counts) {
    double y[N_STATES] = {x[0], x[1], x[2]};
    Integrator integrator = {0};
    Problem problem = {variant(&s)->derivative, variant(&s)->jacobian, NULL, inputs(&s), parameters(&s), s.c, nominals,
                       tolerance, MAX_ATTEMPTS};
    for (long k = 0; k < n; k++) {
        inputs(&s)[0] = commands[k];
        if (integrate(&problem, &integrator, k * h, (k + 1) * h, y)) return 1;
        for (int i = 0; i < 3; i++) rows[3 * k + i] = y[i];
    }
    counts[0] = (double)integrator.derivatives;
    counts[1] = (double)integrator.jacobians;
    counts[2] = (double)integrator.decompositions;
    return 0;
}
PUBLIC void runge_kutta(const double *commands, long n, double h, long parts, const double *x, double *rows) {
    double y[3] = {x[0], x[1], x[2]}, z[3], a[4][3];
    const double d = h / (double)parts, w[4] = {0.0, 0.5 * d, 0.5 * d, d};
    for (long k = 0; k < n; k++) {
        for (long part = 0; part < parts; part++) {
            for (int stage = 0; stage < 4; stage++) {
                for (int i = 0; i < 3; i++) z[i] = y[i] + (stage ? w[stage] * a[stage - 1][i] : 0.0);
                derivative(z, commands[k], a[stage]);
            }
            for (int i = 0; i < 3; i++) y[i] += d / 6.0 * (a[0][i] + 2.0 * a[1][i] + 2.0 * a[2][i] + a[3][i]);
        }
        for (int i = 0; i < 3; i++) rows[3 * k + i] = y[i];
    }
}
"""
POINTER = ctypes.POINTER(ctypes.c_double)


def pointer(values: np.ndarray) -> Any:
    return values.ctypes.data_as(POINTER)


@dataclass(frozen=True)
class Replay:
    """Torque held over samples of ``h`` seconds from ``start``, and the states at their ends."""

    name: str
    h: float
    commands: np.ndarray
    start: np.ndarray
    reference: np.ndarray


@dataclass(frozen=True)
class Measured:
    """One run: largest relative error; evaluations a sample of the derivative and the Jacobian."""

    error: float
    derivatives: float
    jacobians: float
    decompositions: float
    seconds: float


class Stage:
    """The FMU's equations and integrator, compiled from the sources in it."""

    def __init__(self, folder: Path) -> None:
        extract_sources(STAGE, folder)
        (folder / "shim.c").write_text(SHIM)
        library = compile_c(folder / "shim.so", "shim.c", "-lm", library=True)
        self.library = ctypes.CDLL(str(library))
        self.library.prepare.restype = POINTER
        self.nominals = np.array(self.library.prepare()[:N])
        self.derivatives = self.jacobians = 0
        self._rate, self._matrix = np.zeros(N), np.zeros((N, N))

    def derivative(self, x: np.ndarray, command: float) -> np.ndarray:
        self.derivatives += 1
        self.library.derivative(pointer(np.ascontiguousarray(x)), ctypes.c_double(command), pointer(self._rate))
        return self._rate.copy()

    def jacobian(self, x: np.ndarray, command: float) -> np.ndarray:
        self.jacobians += 1
        self.library.jacobian(pointer(np.ascontiguousarray(x)), ctypes.c_double(command), pointer(self._matrix))
        return self._matrix.copy()

    def runge_kutta(self, commands: np.ndarray, h: float, start: np.ndarray, step: float) -> np.ndarray:
        rows = np.zeros((len(commands), N))
        self.library.runge_kutta(
            pointer(commands), len(commands), ctypes.c_double(h), round(h / step), pointer(start), pointer(rows)
        )
        return rows

    def replay(self, case: Replay, tolerance: float) -> Measured:
        rows, counts = np.zeros_like(case.reference), np.zeros(3)
        begin = time.perf_counter()
        failed = self.library.replay(
            pointer(case.commands),
            len(case.commands),
            ctypes.c_double(case.h),
            ctypes.c_double(tolerance),
            pointer(case.start),
            pointer(rows),
            pointer(counts),
        )
        seconds = time.perf_counter() - begin
        assert not failed
        return Measured(error(case, rows), *(float(c) / len(rows) for c in counts), seconds=seconds)


def error(case: Replay, rows: np.ndarray) -> float:
    return float(np.max(np.abs(rows - case.reference) / np.max(np.abs(case.reference), axis=0)))


Solver = Callable[[Stage, float, np.ndarray, float, float], tuple[np.ndarray, int]]
"""Stage, command, state, h, tolerance -> state at the end of the sample, decompositions."""


def scipy_solver(method: str) -> Solver:
    def solve(stage: Stage, command: float, x: np.ndarray, h: float, tolerance: float) -> tuple[np.ndarray, int]:
        done = solve_ivp(
            lambda _, y: stage.derivative(y, command),
            (0.0, h),
            x,
            method,
            jac=lambda _, y: stage.jacobian(y, command),
            rtol=tolerance,
            atol=tolerance * stage.nominals,
        )
        assert done.success, done.message
        return done.y[:, -1], done.nlu

    return solve


def cvode(stage: Stage, command: float, x: np.ndarray, h: float, tolerance: float) -> tuple[np.ndarray, int]:
    def rate(_: float, y: np.ndarray, dy: np.ndarray) -> None:
        dy[:] = stage.derivative(y, command)

    def matrix(_: float, y: np.ndarray, dy: np.ndarray, jacobian: np.ndarray) -> None:
        jacobian[:, :] = stage.jacobian(y, command)

    solver = CVODE(rate, jacfn=matrix, rtol=tolerance, atol=tolerance * stage.nominals, max_num_steps=100_000)
    done = solver.solve(np.array([0.0, h]), x)
    assert done.success, done.message
    return done.y[-1], 0


OTHERS: dict[str, Solver] = {
    "scipy Radau": scipy_solver("Radau"),
    "scipy BDF": scipy_solver("BDF"),
    "scipy LSODA": scipy_solver("LSODA"),
    "SUNDIALS CVODE": cvode,
}


def run(stage: Stage, case: Replay, solver: Solver, tolerance: float) -> Measured:
    """The replay by another solver, its evaluations counted where they are made."""
    stage.derivatives = stage.jacobians = decompositions = 0
    rows, x = np.zeros_like(case.reference), case.start.copy()
    begin = time.perf_counter()
    for k, command in enumerate(case.commands):
        x, made = solver(stage, float(command), x, case.h, tolerance)
        decompositions += made
        rows[k] = x
    seconds = time.perf_counter() - begin
    n = len(rows)
    return Measured(error(case, rows), stage.derivatives / n, stage.jacobians / n, decompositions / n, seconds)


def replays(stage: Stage) -> list[Replay]:
    """Two replays, both with reversals; their references checked with half the step."""
    system = read_system(LOOP)
    loop = np.ascontiguousarray(simulate(system)["controller.command"][:2750], float)
    k = np.arange(300)
    open_loop = 8.0 * np.sin(4.0 * math.pi * k * 1e-3) + 6.0 * np.sin(1.4 * math.pi * k * 1e-3)
    found: list[Replay] = []
    for name, h, commands, first in (
        ("torque of the fuzzy controller, sin 2 pi t mm, 10 kHz, 0.225 s to 0.275 s", 1e-4, loop, 2250),
        ("8 sin 4 pi t + 6 sin 1.4 pi t N.m, held for 1 ms, 0.3 s", 1e-3, open_loop, 0),
    ):
        rows = stage.runge_kutta(commands, h, np.zeros(N), 0.05e-6)
        start = rows[first - 1] if first else np.zeros(N)
        part = Replay(name, h, np.ascontiguousarray(commands[first:]), start.copy(), rows[first:])
        finer = stage.runge_kutta(part.commands, h, part.start, 0.025e-6)
        Console().print(f"{name}: {len(part.commands)} samples, reference good to {error(part, finer):.0e}")
        found.append(part)
    return found


def evaluations_for(accuracy: float, points: list[Measured]) -> float:
    """Evaluations a sample for an error, between the two runs around it in logarithms; the cheapest if all do."""
    if accuracy >= points[0].error:
        return points[0].derivatives
    for one, other in pairwise(points):
        if one.error >= accuracy >= other.error:
            part = math.log(one.error / accuracy) / math.log(one.error / other.error)
            return one.derivatives * (other.derivatives / one.derivatives) ** part
    return math.inf


def main() -> None:
    """Measure, print, draw."""
    console = Console(width=120)
    kept: dict[str, dict[str, list[tuple[float, float, float]]]] = {}
    ratios: dict[str, list[str | float]] = {f"{accuracy:.0e}": [f"{accuracy:.0e}"] for accuracy in ACCURACIES}
    with TemporaryDirectory() as text:
        stage = Stage(Path(text))
        figure, axes = plt.subplots(1, 2, figsize=(12, 5))
        for axis, case in zip(axes, replays(stage), strict=True):
            table = Table(title=case.name)
            for head in (
                "",
                "tolerance",
                "relative error",
                "derivatives",
                "Jacobians",
                "decompositions",
                "us a sample",
            ):
                table.add_column(head, justify="right" if head else "left")
            points = {OURS: [stage.replay(case, tolerance) for tolerance in TOLERANCES]}
            for name, solver in OTHERS.items():
                points[name] = [run(stage, case, solver, tolerance) for tolerance in TOLERANCES]
            for name, measured in points.items():
                for tolerance, m in zip(TOLERANCES, measured, strict=True):
                    lu = "" if name == "SUNDIALS CVODE" or not m.decompositions else f"{m.decompositions:.2f}"
                    us = f"{1e6 * m.seconds / len(case.commands):.2f}" if name == OURS else ""
                    numbers = (f"{m.error:.1e}", f"{m.derivatives:.2f}", f"{m.jacobians:.2f}", lu, us)
                    table.add_row(name, f"{tolerance:.0e}", *numbers)
                kept.setdefault(case.name, {})[name] = [
                    (tolerance, float(f"{m.error:.3g}"), float(f"{m.derivatives:.4g}"))
                    for tolerance, m in zip(TOLERANCES, measured, strict=True)
                ]
                axis.loglog([m.error for m in measured], [m.derivatives for m in measured], "o-", label=name)
            console.print(table)
            summary = Table(title="evaluations of the derivative a sample for an accuracy")
            for head in ("relative error", *points, "best of the others / this"):
                summary.add_column(head, justify="right")
            for accuracy in ACCURACIES:
                needed = {name: evaluations_for(accuracy, measured) for name, measured in points.items()}
                best = min(value for name, value in needed.items() if name != OURS)
                row = [f"{value:.1f}" if math.isfinite(value) else "-" for value in needed.values()]
                summary.add_row(f"{accuracy:.0e}", *row, f"{best / needed[OURS]:.1f}")
                ratios[f"{accuracy:.0e}"].append(round(best / needed[OURS], 1))
            console.print(summary)
            axis.set(title=case.name, xlabel="largest relative error of a state", ylabel="evaluations a sample")
            axis.title.set_fontsize(9)
            axis.grid(True, which="both", alpha=0.3)
        axes[0].legend()
        figure.tight_layout()
        PICTURE.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(PICTURE, dpi=120)
        console.print(f"{PICTURE.relative_to(ROOT)} written")
    keep(
        "integrator",
        Kept(
            "Work of the integrator",
            "Evaluations of the derivative that the best of scipy's Radau, BDF, LSODA and SUNDIALS CVODE needs for an "
            "accuracy, as a multiple of those of the FMU's integrator. Counted, not timed.",
            ("Relative error", *kept),
            list(ratios.values()),
            {"points": kept},
        ),
    )


if __name__ == "__main__":
    main()
