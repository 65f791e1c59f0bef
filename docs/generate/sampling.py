"""Who sees which sample when: measured in runs of FMUs whose signals carry the time of their sample.

The reference rises with 1 m/s, so that its value in m is its time in s. The controller passes it on. The stage is a
double integrator: the gain of its velocity over a step tells which command it had, so to which time it belongs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import cosim
from cosim.design.stability import practical_limit
from cosim.result.metrics import Array
from cosim.result.plots import COLOURS, save

from .markup import table

STEP = 1e-3
START = 0.01
"""Start of the runs, s: so a command that belongs to no sample, 0 before the first, is told from that of the first."""
SEQUENTIAL = ("trajectory", "controller", "plant")


@dataclass(frozen=True)
class Setting:
    """How the three are stepped, and what is said about it."""

    text: str
    order: tuple[str, ...] | str = SEQUENTIAL
    T_s: float = STEP
    step: float = STEP
    multiple: int = 1


SETTINGS = (
    Setting("order: reference, controller, stage"),
    Setting('order = "parallel"', "parallel"),
    Setting("order: stage before controller", ("plant", "controller", "trajectory")),
    Setting("T_s = 4 steps", T_s=4 * STEP),
    Setting('T_s = 4 steps, step_multiple = 4, "parallel"', "parallel", T_s=4 * STEP, multiple=4),
    Setting("step = 4 T_s", step=4 * STEP),
)


def used_samples(setting: Setting, stop: float = 0.02) -> tuple[Array, Array]:
    """Start of each step, and the time of the sample to which the command of the stage in it belongs, s from the start.

    Before the first sample has arrived the latter is negative.
    """
    order = setting.order if setting.order == "parallel" else list(setting.order)
    system = cosim.make_system(
        {
            "connections": [
                "trajectory.position -> controller.position_ref",
                {"from": "controller.command", "to": "plant.command"},
            ],
            "experiment": {
                "start_time": START,
                "stop_time": START + stop,
                "step_size": setting.step,
                "order": order,
            },
            "instances": {
                "trajectory": {"fmu": "Trajectory", "start": {"kind": "ramp", "feed": 1.0, "amplitude": 100.0}},
                "controller": {
                    "fmu": "CascadeP",
                    "step_multiple": setting.multiple,
                    "start": {"T_s": setting.T_s, "K_pos": 1.0, "K_vel": 1.0, "command_max": 0.0},
                },
                # alpha*K = 1 m/s2 a unit of command, and next to no damping
                "plant": {"fmu": "NominalStage", "start": {"K": 1e9, "alpha": 1e-9, "tolerance": 1e-12}},
            },
            "record": {"variables": ["plant.velocity"]},
        }
    )
    result = cosim.simulate(system)
    return result.time[:-1] - START, np.diff(result["plant.velocity"]) / setting.step - START


def measured(pictures: Path) -> dict[str, Any]:
    """Table of ages, gain limits; draws samples.svg and staircases.svg."""
    found = {setting: used_samples(setting) for setting in SETTINGS}
    draw_samples(pictures / "samples.svg", [found[setting] for setting in SETTINGS[:2]])
    draw_staircases(pictures / "staircases.svg", found)
    rows: list[tuple[str, str, str]] = []
    ages: list[float] = []
    for setting, (time, sample) in found.items():
        late = time >= 8 * STEP - 1e-9  # the first samples are those of the start
        age = 1e3 * (time - sample)[late]
        low, high = round(float(age.min()), 6), round(float(age.max()), 6)
        ages.append(float(np.mean(age)) + 0.5e3 * setting.step)
        rows.append((setting.text, f"{low:g}" + (f" to {high:g}" if high > low else ""), f"{ages[-1]:.3g}"))
    limits = [practical_limit(cosim.read_system("maeda2008/gain", order=order)).stable for order in (None, "parallel")]
    return {
        "ages": table(("Setting", "Age at the start of a step, ms", "Mean age, ms"), rows),
        "gain_sequential": f"{limits[0]:.0f}",
        "gain_parallel": f"{limits[1]:.0f}",
        "gain_lost": f"{100.0 * (1.0 - limits[1] / limits[0]):.0f}",
    }


def draw_samples(path: Path, runs: list[tuple[Array, Array]]) -> None:
    """Lanes of the three, and the way of each sample."""

    def draw(figure: Any) -> None:
        for axes, (time, sample), title in zip(
            figure.subplots(2, 1, sharex=True),
            runs,
            ("Sequential: the command of a step belongs to its start", 'order = "parallel": one sample late'),
            strict=True,
        ):
            for k in range(5):
                axes.barh(0, 0.92, left=1e3 * time[k] + 0.04, height=0.32, color=COLOURS[5], alpha=0.5)
                axes.text(1e3 * time[k] + 0.5, 0.0, f"step {k}", ha="center", va="center")
                axes.plot([1e3 * time[k]] * 2, [2, 1], "o", color="#555555", markersize=4)
                if sample[k] < -1e-9:
                    continue
                colour = COLOURS[k % 2]
                arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.4, "shrinkA": 2, "shrinkB": 2}
                for end, begin in (
                    ((1e3 * sample[k], 1.0), (1e3 * sample[k], 2.0)),
                    ((1e3 * time[k] + 0.06, 0.17), (1e3 * sample[k], 1.0)),
                ):
                    axes.annotate("", end, begin, arrowprops=arrow)
            axes.set(
                yticks=[0, 1, 2], yticklabels=["stage", "controller", "reference"], ylim=(-0.35, 2.3), xlim=(-0.3, 5)
            )
            axes.set_title(title)
            axes.grid(axis="y", visible=False)
            axes.spines["left"].set_visible(False)
        axes.set_xlabel("Time [ms]")

    save(path, draw, (7.4, 4.4))


def draw_staircases(path: Path, found: dict[Setting, tuple[Array, Array]]) -> None:
    """The time of the sample in use over time, one panel a setting."""

    def draw(figure: Any) -> None:
        for axes, (setting, (time, sample)) in zip(figure.subplots(2, 3, sharey=True).flat, found.items(), strict=True):
            ends = np.append(time, time[-1] + setting.step)
            axes.plot([0, 16], [0, 16], color="#999999", linestyle="--", label="no delay")
            axes.stairs(
                np.where(sample > -1e-9, 1e3 * sample, np.nan),
                1e3 * ends,
                baseline=None,
                color=COLOURS[0],
                linewidth=1.6,
                label="in use",
            )
            axes.set_title(setting.text.replace(", step", ",\nstep").replace("order: ", "order:\n"))
            axes.set(xlim=(0, 16), ylim=(-0.5, 16), xticks=range(0, 17, 4), yticks=range(0, 17, 4), xlabel="Time [ms]")
        figure.axes[0].set_ylabel("Time of the sample [ms]")
        figure.axes[3].set_ylabel("Time of the sample [ms]")
        figure.axes[0].legend()

    save(path, draw, (7.6, 5.2))
