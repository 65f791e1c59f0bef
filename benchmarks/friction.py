"""What the friction models do where they differ: the table and the pictures of docs/physics.md.

    python benchmarks/friction.py [release] [drift] [loops] [break-away]

Each part prints its rows, native FMUs beside scipy's Radau on the Python equations, and writes its picture to
docs/pictures. All parts take some minutes; FMUs come from build/fmus/native.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import fmpy
import matplotlib as mpl
import numpy as np
from fmpy.fmi2 import FMU2Slave
from PIL import Image
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

from fmus.plant.ballscrew_stage import BallscrewStage
from fmus.plant.compliant_ballscrew import CompliantBallscrew

mpl.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
LUGRE, ELASTIC, SLIP = "BallscrewStage", "BallscrewStageElastoPlastic", "BallscrewStageMaxwellSlip"
MODELS = {"LuGre": LUGRE, "elasto-plastic": ELASTIC, "generalised Maxwell slip": SLIP}
COLOURS = {"LuGre": "#D55E00", "elasto-plastic": "#0072B2", "generalised Maxwell slip": "#009E73"}
CORNERS = (0.0, 5.0, 1.0, 5.0, 1.0, 5.0)
CONSOLE = Console(width=120)


class Plant:
    """A plant FMU under a command, stepped from Python."""

    def __init__(self, name: str, start: dict[str, float] | None = None) -> None:
        self.folder = TemporaryDirectory()
        path = ROOT / "build" / "fmus" / "native" / f"{name}.fmu"
        fmpy.extract(str(path), unzipdir=self.folder.name)
        description = fmpy.read_model_description(str(path))
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=self.folder.name,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        for key, value in (start or {}).items():
            self.fmu.setReal([self.reference[key]], [value])
        self.fmu.exitInitializationMode()
        self.time = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()
        self.folder.cleanup()

    def get(self, *names: str) -> list[float]:
        return self.fmu.getReal([self.reference[name] for name in names])

    def step(self, command: float, h: float) -> None:
        self.fmu.setReal([self.reference["command"]], [command])
        self.fmu.doStep(self.time, h)
        self.time += h

    def trace(self, torque: Callable[[float], float], end: float, h: float, *names: str) -> np.ndarray:
        """Time and variables after each step."""
        rows: list[list[float]] = []
        for k in range(round(end / h)):
            self.time = k * h
            self.step(torque(k * h), h)
            rows.append([(k + 1) * h, *self.get(*names)])
        return np.array(rows)


def radau(plant: Any, torque: Callable[[float], float], times: Sequence[float], start: Any = None) -> Any:
    """Continuous states of a plant at ``times`` under a torque that is not held; columns in the order of the State."""
    x0 = plant.initial() if start is None else start
    kind = type(x0)
    names = [name for name in vars(x0) if name != "table"]

    def rate(t: float, y: Any) -> list[float]:
        x = kind(**dict(zip(names, map(float, y), strict=True)))
        found = plant.derivative(t, x, plant.Input(command=float(torque(float(t)))))
        return [getattr(found, name) for name in names]

    scale = {"angle": 1e-2, "speed": 1e-2, "bristle": 1e-5}
    atol = [1e-10 * scale.get(name, 1e-6) for name in names]
    y0 = [getattr(x0, name) for name in names]
    span = (times[0], times[-1])
    # Differences of the Jacobian overflow where a state does not act on a rate.
    with np.errstate(over="ignore"):
        found = solve_ivp(
            rate, span, y0, "Radau", t_eval=times, rtol=1e-9, atol=atol, max_step=(span[1] - span[0]) / 100
        )
    return dict(zip(names, found.y, strict=True))


# ---- release: a slow ramp until the screw breaks away ----


@dataclass(frozen=True)
class Release:
    """Friction after break-away under 0.1 N.m/s."""

    least_torque: float
    power: float
    energy: float
    top_speed: float
    slips_at: float
    """Time at which the speed passes 0.05 rad/s, in s."""
    time: np.ndarray
    torque: np.ndarray

    @classmethod
    def of(cls, time: np.ndarray, speed: np.ndarray, torque: np.ndarray) -> Release:
        fed = np.maximum(-torque * speed, 0.0)
        return cls(
            float(torque.min()),
            float(fed.max()),
            float(np.trapezoid(fed, time)),
            float(speed.max()),
            float(time[int(np.argmax(speed > 0.05))]),
            time,
            torque,
        )


def released(name: str, start: dict[str, float], before: int) -> tuple[Release, tuple[float, list[float]]]:
    """The native FMU with 1 ms steps, from ``before`` ms before it slips with 0.2 us; and the state it went on from."""
    with Plant(name, start) as plant:
        kept: list[tuple[float, Any]] = []
        while plant.get("speed")[0] < 0.05:
            if plant.time > 80.0:
                kept.append((plant.time, plant.fmu.getFMUState()))
            if len(kept) > before:
                plant.fmu.freeFMUState(kept.pop(0)[1])
            plant.step(0.1 * plant.time, 1e-3)
        plant.time, state = kept[0]
        plant.fmu.setFMUState(state)
        here = (plant.time, plant.get("angle", "speed", "bristle") if name == LUGRE else [])
        rows: list[list[float]] = []
        h, slipped = 2e-7, 0.0
        # J/sigma_2 = 0.9 ms: 10 ms after the release the speed has settled.
        while not slipped or plant.time < slipped + 10e-3:
            plant.step(0.1 * plant.time, h)
            rows.append([plant.time, *plant.get("speed", "friction_torque")])
            if not slipped and rows[-1][1] > 0.05:
                slipped = plant.time
    return Release.of(*np.array(rows).T), here


def release() -> None:
    table = Table("0.1 N.m/s", "least torque / N.m", "power fed / W", "energy fed / J", "top speed / rad/s")
    cases: list[tuple[str, str, dict[str, float]]] = [
        ("LuGre", LUGRE, {}),
        ("LuGre, v_d = 0.01 rad/s", LUGRE, {"v_d": 0.01}),
        ("LuGre, v_d = 0.1 rad/s", LUGRE, {"v_d": 0.1}),
        ("elasto-plastic", ELASTIC, {}),
        ("generalised Maxwell slip", SLIP, {}),
    ]

    def row(label: str, found: Release) -> None:
        values = (found.least_torque, found.power, found.energy, found.top_speed)
        table.add_row(label, *(f"{value:.4g}" for value in values))

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    for label, name, start in cases:
        # The staircase of 1 ms shifts LuGre's release by some us, which its peak shows.
        found, (time, state) = released(name, start, 100 if name == LUGRE and not start else 20)
        row(label, found)
        if name == LUGRE and "v_d" not in start:
            stage = BallscrewStage()
            x = stage.State(angle=state[0], speed=state[1], bristle=state[2])
            times = found.time[:: max(1, len(found.time) // 200_000)]
            solved = radau(stage, lambda t: 0.1 * t, [time, *times], x)
            torque = [
                stage.output(0.0, stage.State(speed=v, bristle=z), stage.Input()).friction_torque
                for v, z in zip(solved["speed"].tolist()[1:], solved["bristle"].tolist()[1:], strict=True)
            ]
            row(f"{label}, Radau", Release.of(np.array(times), solved["speed"][1:], np.array(torque)))
        at = found.slips_at
        shown = (found.time > at - 1e-3) & (found.time < at + 5e-3)
        axes[0 if name == LUGRE and not start else 1].plot(
            1e3 * (found.time[shown] - at), found.torque[shown], label=label, linewidth=1.2
        )
    for ax in axes:
        ax.set_xlabel("time about the release [ms]")
        ax.set_ylabel("friction torque [N.m]")
        ax.legend(fontsize=8)
    save(figure, "release")
    CONSOLE.print(table)


# ---- drift: a load that oscillates below break-away ----


def load(t: float) -> float:
    """Up to 3 N.m within 0.1 s, then 3 +- 1 N.m at 10 Hz."""
    return 30.0 * t if t < 0.1 else 3.0 + np.sin(20.0 * np.pi * (t - 0.1))


def maeda(t: float) -> float:
    """0.02 +- 0.01 N.m at 50 Hz as current of 0.172 N.m/A."""
    return (0.2 * t if t < 0.1 else 0.02 + 0.01 * np.sin(100.0 * np.pi * (t - 0.1))) / 0.172


def drift() -> None:
    table = Table("case", "solver", "drift / nm a cycle")
    figure, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
    for label, name in MODELS.items():
        with Plant(name) as plant:
            rows = plant.trace(load, 2.1, 1e-3, "position")
        ax.plot(rows[:, 0], 1e9 * rows[:, 1], label=label, color=COLOURS[label], linewidth=1.2)
        table.add_row(f"3 +- 1 N.m at 10 Hz, {label}", "FMU, held 1 ms", f"{1e9 * (rows[-1, 1] - rows[-101, 1]):.4g}")
    stage = BallscrewStage()
    angle = radau(stage, load, [0.0, 1.0, 1.1])["angle"]
    table.add_row("3 +- 1 N.m at 10 Hz, LuGre", "Radau", f"{1e9 * stage.l_p * (angle[2] - angle[1]):.4g}")
    with Plant("CompliantBallscrew") as plant:
        rows = plant.trace(maeda, 0.5, 1e-4, "position")
    table.add_row(
        "0.02 +- 0.01 N.m at 50 Hz, CompliantBallscrew", "FMU, 0.1 ms", f"{1e9 * (rows[-1, 1] - rows[-201, 1]):.4g}"
    )
    position = radau(CompliantBallscrew(), maeda, [0.0, 0.48, 0.5])["position"]
    table.add_row("0.02 +- 0.01 N.m at 50 Hz, CompliantBallscrew", "Radau", f"{1e9 * (position[2] - position[1]):.4g}")
    ax.set_xlabel("time [s]")
    ax.set_ylabel("position [nm]")
    ax.legend(fontsize=8)
    save(figure, "drift")
    CONSOLE.print(table)


# ---- loops: presliding hysteresis ----


def corner(t: float, rate: float = 1.0, dwell: float = 0.0) -> float:
    """The torque that goes from corner to corner at ``rate`` [N.m/s] and stays at each for ``dwell`` [s]."""
    for a, b in pairwise(CORNERS):
        leg = abs(b - a) / rate
        if t < leg:
            return a + (b - a) * t / leg
        t -= leg + dwell
        if t < 0.0:
            return b
    return CORNERS[-1]


def loops() -> None:
    table = Table("0-5-1-5-1-5 N.m", "positions at the corners / nm")
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained", sharey=True)

    def row(label: str, positions: Sequence[float]) -> None:
        table.add_row(label, ", ".join(f"{value:.7g}" for value in positions))

    for ax, (label, name) in zip(axes, MODELS.items(), strict=True):
        for dwell in (0.0, 0.2):
            ends = np.cumsum([abs(b - a) + dwell for a, b in pairwise(CORNERS)])
            with Plant(name) as plant:
                rows = plant.trace(lambda t, d=dwell: corner(t, 1.0, d), float(ends[-1]), 1e-3, "position")
            row(f"{label}, {'dwell 0.2 s' if dwell else '1 N.m/s'}", [1e9 * rows[round(e / 1e-3) - 1, 1] for e in ends])
            if not dwell:
                ax.plot(1e9 * rows[:, 1], [corner(t) for t in rows[:, 0]], color=COLOURS[label], linewidth=1.2)
        ax.set_title(label, fontsize=9)
        ax.set_xlabel("position [nm]")
    ends = np.cumsum([abs(b - a) for a, b in pairwise(CORNERS)])
    stage = BallscrewStage()
    angle = radau(stage, corner, [0.0, *ends])["angle"][1:]
    row("LuGre, Radau", [1e9 * stage.l_p * value for value in angle])
    k, alpha, F_S = (3.2e4, 3.0e4, 2.3e4, 1.5e4), (0.1, 0.2, 0.3, 0.4), 9.36
    # The virgin curve: where the piecewise linear sum holds 5 N.m.
    knees = [part * F_S / stiffness for stiffness, part in zip(k, alpha, strict=True)]
    lines = [sum(min(stiff * x, part * F_S) for stiff, part in zip(k, alpha, strict=True)) for x in knees]
    deflection = float(np.interp(5.0, [0.0, *lines], [0.0, *knees]))
    row("Maxwell slip, piecewise linear sum", [1e9 * stage.l_p * deflection])
    axes[0].set_ylabel("torque [N.m]")
    save(figure, "loops")
    CONSOLE.print(table)


# ---- break-away torque over the rate of the torque ----


def break_away() -> None:
    rates = np.geomspace(0.3, 30.0, 11)
    table = Table("rate / N.m/s", *MODELS, title="break-away torque / N.m: the command when the speed passes 0.1 rad/s")
    found: dict[str, list[float]] = {label: [] for label in MODELS}
    for rate in rates:
        for label, name in MODELS.items():
            with Plant(name) as plant:
                h = min(1e-3, 1e-2 / rate)
                while plant.get("speed")[0] < 0.1:
                    plant.step(rate * plant.time, h)
            found[label].append(rate * plant.time)
        table.add_row(f"{rate:.3g}", *(f"{values[-1]:.4g}" for values in found.values()))
    figure, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
    for label, values in found.items():
        ax.semilogx(rates, values, ".-", label=label, color=COLOURS[label], linewidth=1.2)
    ax.set_xlabel("rate of the torque [N.m/s]")
    ax.set_ylabel("break-away torque [N.m]")
    ax.legend(fontsize=8)
    save(figure, "break_away")
    CONSOLE.print(table)


def save(figure: Any, name: str) -> None:
    """Write a picture of docs/pictures in few colours: a third of the bytes."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    target = PICTURES / f"{name}.png"
    figure.savefig(target, dpi=100, metadata={"Software": None})
    plt.close(figure)
    with Image.open(target) as picture:
        reduced = picture.convert("RGB").quantize(32, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    reduced.save(target, optimize=True)


PARTS = {"release": release, "drift": drift, "loops": loops, "break-away": break_away}


def main() -> int:
    unknown = [name for name in sys.argv[1:] if name not in PARTS]
    if unknown:
        CONSOLE.print(f"no part {unknown}. There are: {', '.join(PARTS)}.")
        return 2
    for name in sys.argv[1:] or PARTS:
        PARTS[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main())
