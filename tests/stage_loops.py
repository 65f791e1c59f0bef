"""Closed loops of the ballscrew stage run by the components' own methods, and the cases of the reference traces."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from motion_loops import rk4

from fmus.controllers.complementary_sliding_mode import ComplementarySlidingMode
from fmus.controllers.fuzzy_sliding_mode import FuzzySlidingMode
from fmus.controllers.sliding_mode import SlidingMode
from fmus.physics.sampling import VelocitySource
from fmus.physics.sliding import FrictionVelocity, SlidingController
from fmus.plant.ballscrew_stage import BallscrewStage
from fmus.sources.trajectory import Trajectory, TrajectoryKind

REFERENCES = Path(__file__).parent / "references" / "shams"
CONTROLLERS: dict[str, type[SlidingController]] = {
    kind.__name__: kind for kind in (SlidingMode, ComplementarySlidingMode, FuzzySlidingMode)
}
CHOICES = {"friction_velocity": FrictionVelocity, "velocity_source": VelocitySource, "kind": TrajectoryKind}


@cache
def traces(file: str) -> dict[str, np.ndarray]:
    with np.load(REFERENCES / f"{file}.npz") as data:
        return dict(data)


CASES: dict[str, dict[str, Any]] = json.loads((REFERENCES / "cases.json").read_text())


def start(values: dict[str, Any]) -> dict[str, Any]:
    """Start values as components take them: names of choices become their members."""
    return {name: CHOICES[name][value] if name in CHOICES else value for name, value in values.items()}


def controller(case: dict[str, Any]) -> SlidingController:
    return CONTROLLERS[case["controller"]](**start(case["controller_start"]))


def stage_loop(case: dict[str, Any], samples: int) -> np.ndarray:
    """Table position, screw position and command of the first samples, the plant by Runge-Kutta at 1 us."""
    plant, control, source = (
        BallscrewStage(**case["plant_start"]),
        controller(case),
        Trajectory(**start(case["trajectory_start"])),
    )
    x, memory = plant.initial(), control.initial()
    load = case["load_torque"]
    rows = np.zeros((samples, 3))
    for k in range(samples):
        t = k * control.T_s
        r, seen = source.output(t), plant.output(t, x, plant.Input())
        screw = case["feedback"] == "screw"
        u = control.Input(
            position_ref=r.position,
            velocity_ref=r.velocity,
            acceleration_ref=r.acceleration,
            position=plant.l_p * seen.angle if screw else seen.position,
            velocity=plant.l_p * seen.speed if screw else seen.velocity,
        )
        y = control.output(t, memory, u)
        memory = control.update(t, memory, u, y)
        rows[k] = seen.position, plant.l_p * seen.angle, y.command
        drive = plant.Input(command=y.command, load_torque=load)
        h = control.T_s / 100
        for i in range(100):
            x = plant.update(t, rk4(plant, t + i * h, x, drive, step=h), drive)
    return rows
