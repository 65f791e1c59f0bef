"""Closed loops of components run by their own methods, and the reference traces they are compared with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cosim.model import Controller, Plant, unflatten
from fmus.controllers.disturbance_observer import DisturbanceObserver
from fmus.controllers.p_pi import PPi
from fmus.controllers.super_twisting import SuperTwisting
from fmus.plant.linear_motor import LinearMotor

REFERENCES = Path(__file__).parent / "references" / "rubio_feng"


@cache
def reference(file: str) -> dict[str, Any]:
    with np.load(REFERENCES / f"{file}.npz") as data:
        return dict(data)


def rk4(plant: Plant, t: float, x: Any, u: Any, *, step: float, parts: int = 1) -> Any:
    """The state a ``step`` later with held inputs."""
    h = step / parts

    def moved(rate: Any, factor: float) -> Any:
        return type(x)(**unflatten(type(x), (a + factor * b for a, b in zip(x, rate, strict=True))))

    for j in range(parts):
        s = t + j * h
        r_1 = plant.derivative(s, x, u)
        r_2 = plant.derivative(s + 0.5 * h, moved(r_1, 0.5 * h), u)
        r_3 = plant.derivative(s + 0.5 * h, moved(r_2, 0.5 * h), u)
        r_4 = plant.derivative(s + h, moved(r_3, h), u)
        mean = ((a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(r_1, r_2, r_3, r_4, strict=True))
        x = moved(type(x)(**unflatten(type(x), mean)), h)
    return x


@dataclass
class Sampled:
    """A controller with its state; a call is one sample."""

    component: Controller
    t: float = 0.0

    def __post_init__(self) -> None:
        self.x = self.component.initial()
        self.k = 0
        self.pending: Any = None

    def output(self, **inputs: float) -> Any:
        """Output of this sample; ``update`` finishes it."""
        self.u = self.component.Input(**inputs)
        self.y = self.component.output(self.k * self.component.T_s, self.x, self.u)
        return self.y

    def update(self, **late: float) -> None:
        """Next sample; ``late`` are inputs that were not known when the output was taken."""
        known = {item.name: getattr(self.u, item.name) for item in fields(self.u)}
        u = self.component.Input(**(known | late))
        self.x = self.component.update(self.k * self.component.T_s, self.x, u, self.y)
        self.k += 1

    def __call__(self, **inputs: float) -> Any:
        y = self.output(**inputs)
        self.update()
        return y


Motor = PPi | SuperTwisting


def motor_loop(
    controller: Motor, samples: int, *, disturbed: bool = False, observer: DisturbanceObserver | None = None
) -> np.ndarray:
    """Position error, velocity error and force at each sample, as ``make_references.py`` has them."""
    plant = LinearMotor()
    control, estimator = Sampled(controller), Sampled(observer) if observer else None
    x = plant.initial()
    found = np.zeros((samples, 3))
    for k in range(samples):
        t = k * controller.T_s
        s, c = math.sin(3.0 * t), math.cos(3.0 * t)
        estimate = estimator.output(position=x.position).disturbance_estimate if estimator else 0.0
        y = control(
            position_ref=1e-6 * s,
            velocity_ref=3e-6 * c,
            acceleration_ref=-9e-6 * s,
            position=x.position,
            disturbance_estimate=estimate,
        )
        if estimator:
            estimator.update(applied_force=y.force)
        found[k] = 1e-6 * s - x.position, 3e-6 * c - x.velocity, y.force
        middle = t + 0.5 * controller.T_s
        force = -26e-6 + 46e-6 * math.sin(4.83 * middle + 2.65) if disturbed else 0.0
        x = rk4(plant, t, x, plant.Input(command=y.command, disturbance_force=force), step=controller.T_s)
    return found


def assert_follows(found: np.ndarray, name: str, tolerance: float) -> None:
    """Each column within ``tolerance`` of its own largest value in the reference."""
    expected = reference("linear_motor")[name][: len(found)]
    scale = np.max(np.abs(expected), axis=0)
    assert np.max(np.abs(found - expected) / scale) < tolerance


def assert_limited_and_odd(controller: Controller, values: Sequence[float], limit: float, **state: float) -> None:
    """The command is finite and within ``limit``; with opposite inputs ``values`` and ``state`` it is the opposite."""
    kind: Any = type(controller)
    x, mirrored = kind.State(**state, started=1.0), kind.State(**{n: -v for n, v in state.items()}, started=1.0)
    u = kind.Input(**unflatten(kind.Input, iter(values)))
    opposite = kind.Input(**unflatten(kind.Input, (-value for value in values)))
    y = controller.output(0.0, x, u)
    assert all(math.isfinite(value) for value in (*y, *controller.update(0.0, x, u, y)))
    # the command is the first output of each
    assert abs(next(iter(y))) <= limit
    assert next(iter(controller.output(0.0, mirrored, opposite))) == -next(iter(y))
