"""Elasto-plastic and Maxwell slip friction: symmetry, passivity, steady friction, drift, memory, event location.

LuGre friction has tests of its own in test_lugre.py; here it shows that drift and open loops are seen where they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from instances import Instance
from scipy.integrate import solve_ivp

from cosim.errors import DescriptionError
from fmus.physics.elasto_plastic import elastoplastic_rate, plastic_share
from fmus.physics.lugre import bristle_rate
from fmus.physics.maxwell_slip import element_rate, slips_now
from fmus.plant.ballscrew_stage import BallscrewStage
from fmus.plant.ballscrew_stage_elasto_plastic import BallscrewStageElastoPlastic
from fmus.plant.ballscrew_stage_maxwell_slip import BallscrewStageMaxwellSlip
from fmus.references.maxwell_slip import Located

ELASTIC, SLIP = BallscrewStageElastoPlastic(), BallscrewStageMaxwellSlip()
SIGMA_0, F_C, F_S = 1e5, 6.24, 9.36
L_P = ELASTIC.l_p

speeds = st.floats(-60.0, 60.0)
bristles = st.floats(-1.2e-4, 1.2e-4)
torques = st.floats(-100.0, 100.0)
elements = st.tuples(*(st.floats(-1.2 * part * F_S, 1.2 * part * F_S) for part in SLIP.alpha))
modes = st.tuples(*([st.sampled_from([0.0, 1.0])] * 4))


# Ports, symmetry, limits


def test_plants_have_the_ports_of_the_ballscrew_stage():
    for plant in (ELASTIC, SLIP):
        assert plant.Input is BallscrewStage.Input
        assert plant.Output is BallscrewStage.Output


@given(speeds, bristles, torques, torques)
def test_elasto_plastic_equations_are_odd(speed: float, bristle: float, command: float, load: float):
    x = ELASTIC.State(angle=0.3, speed=speed, bristle=bristle, table=0.3 * L_P)
    mirrored = ELASTIC.State(**{name: -value for name, value in vars(x).items()})
    u, opposite = ELASTIC.Input(command=command, load_torque=load), ELASTIC.Input(command=-command, load_torque=-load)
    for method in (ELASTIC.derivative, ELASTIC.output):
        assert list(method(0.1, mirrored, opposite)) == [-value for value in method(0.1, x, u)]


@given(speeds, elements, modes, torques)
def test_maxwell_slip_equations_are_odd(speed: float, element: Any, slips: Any, command: float):
    x = SLIP.State(angle=0.3, speed=speed, element=element, slips=slips, table=0.3 * L_P)
    mirrored = SLIP.State(
        angle=-0.3, speed=-speed, element=tuple(-value for value in element), slips=slips, table=-0.3 * L_P
    )
    u, opposite = SLIP.Input(command=command), SLIP.Input(command=-command)
    here, there = SLIP.derivative(0.1, x, u), SLIP.derivative(0.1, mirrored, opposite)
    assert there.element == tuple(-value for value in here.element)
    assert there.speed == -here.speed
    assert SLIP.update(0.1, mirrored, opposite).slips == SLIP.update(0.1, x, u).slips


@given(speeds, st.floats(0.0, 1.0))
def test_plastic_share_sets_in_at_the_break_away_deflection(speed: float, part: float):
    assume(speed == 0.0 or abs(speed) > 1e-250)  # the product with a deflection must not underflow
    level = ELASTIC.level(0.0, speed)
    z_ba, z_max = ELASTIC.break_away(0.0, speed), level / SIGMA_0
    assert z_ba == pytest.approx(0.7 * F_C / SIGMA_0)
    direction = 1.0 if speed >= 0.0 else -1.0
    assert plastic_share(direction * part * z_ba, speed, z_ba, level, SIGMA_0) == 0.0
    assert plastic_share(-direction * z_max, speed, z_ba, level, SIGMA_0) == 0.0
    middle = z_ba + part * (z_max - z_ba)
    expected = math.sin(0.5 * math.pi * part) ** 2 if speed != 0.0 else 0.0
    assert plastic_share(direction * middle, speed, z_ba, level, SIGMA_0) == pytest.approx(expected, abs=1e-9)


@given(speeds, bristles)
def test_with_full_slip_elasto_plastic_friction_is_lugre(speed: float, bristle: float):
    level = ELASTIC.level(0.0, speed)
    if abs(bristle) >= level / SIGMA_0 and bristle * speed > 0.0:
        found = elastoplastic_rate(bristle, speed, 0.0, level, SIGMA_0)
        assert found == pytest.approx(bristle_rate(bristle, speed, level, SIGMA_0), rel=1e-12)


def test_without_contact_nothing_moves():
    assert elastoplastic_rate(0.0, 2.0, 0.0, 0.0, SIGMA_0) == 0.0
    assert element_rate(0.0, 0.0, 2.0, 0.0, k=1e4, alpha=0.5, C=1e3) == 0.0


# Steady friction, power


@pytest.mark.parametrize("speed", [1e-4, 1e-3, 1e-2, 1.0, 5.0, -1e-3, -5.0])
def test_steady_friction_is_the_level(speed: float):
    """Started undeflected at a constant speed, both come to level + sigma_2*speed within 1e-9."""
    level = ELASTIC.level(0.0, speed)
    expected = math.copysign(level, speed) + 0.4 * speed
    z_ba = ELASTIC.break_away(0.0, speed)
    end = 60.0 * F_S / (SIGMA_0 * abs(speed))
    solution = solve_ivp(
        lambda _, z: [elastoplastic_rate(float(z[0]), speed, z_ba, level, SIGMA_0)],
        (0.0, end),
        [0.0],
        "Radau",
        rtol=1e-11,
        atol=1e-17,
    )
    x = ELASTIC.State(speed=speed, bristle=float(solution.y[0, -1]))
    assert ELASTIC.output(0.0, x, ELASTIC.Input()).friction_torque == pytest.approx(expected, rel=1e-9)

    # An element sticks until it holds its part; then it stays there.
    held = tuple(math.copysign(part * level, speed) for part in SLIP.alpha)
    x = SLIP.State(speed=speed, element=held, slips=(1.0, 1.0, 1.0, 1.0))
    assert SLIP.output(0.0, x, SLIP.Input()).friction_torque == pytest.approx(expected, rel=1e-9)
    assert SLIP.derivative(0.0, x, SLIP.Input()).element == pytest.approx((0.0,) * 4, abs=1e-12)


def test_power_is_stored_or_dissipated_on_random_states():
    """Friction*speed less what the bristle or the elements store, on 10,000 random states over six decades of speed."""
    generator = np.random.default_rng(5)
    least = math.inf
    for _ in range(10_000):
        speed = float(generator.choice([-1.0, 1.0]) * 10.0 ** generator.uniform(-5.0, 1.8))
        z = float(generator.uniform(-1.2, 1.2)) * F_S / SIGMA_0
        x = ELASTIC.State(speed=speed, bristle=z)
        rate = ELASTIC.rate(0.0, x)
        least = min(least, ELASTIC.torque(x, rate) * speed - SIGMA_0 * z * rate)
        held = tuple(float(generator.uniform(-1.2, 1.2)) * part * F_S for part in SLIP.alpha)
        y = SLIP.State(speed=speed, element=held, slips=tuple(map(float, generator.integers(0, 2, 4))))  # type: ignore[arg-type]
        rates, torque = SLIP.friction(0.0, y)
        least = min(least, torque * speed - sum(F * r / k for F, r, k in zip(held, rates, SLIP.k, strict=True)))
    assert least >= -1e-9


@given(speeds, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_slipping_element_is_drawn_up_no_faster_than_it_would_stick(speed: float, part: float, slips: float):
    level = SLIP.level(0.0, speed)
    F = math.copysign(part * 0.3 * level, speed)
    rate = element_rate(F, round(slips), speed, level, k=2.3e4, alpha=0.3, C=1e3)
    assert rate * math.copysign(1.0, speed) <= 2.3e4 * abs(speed)


def test_an_element_slips_until_the_motion_reverses():
    assert slips_now(0.9, 0.0, 1.0, 10.0, 0.1) == 0.0
    assert slips_now(1.0, 0.0, 1.0, 10.0, 0.1) == 1.0
    assert slips_now(0.9, 1.0, 1.0, 10.0, 0.1) == 1.0
    assert slips_now(0.9, 1.0, -1.0, 10.0, 0.1) == 0.0
    assert slips_now(0.9, 1.0, 0.0, 10.0, 0.1) == 0.0


# The FMUs


def driven(
    folder: Path, name: str, torque: Callable[[float], float], end: float, h: float, **start: float
) -> tuple[np.ndarray[Any, Any], Instance]:
    """Position and friction torque after each step of ``h`` under a torque held over it."""
    rows: list[list[float]] = []
    with Instance(folder / f"{name}.fmu") as plant:
        plant.initialize(start)
        for k in range(round(end / h)):
            plant.set({"command": torque(k * h)})
            plant.step(k * h, h)
            rows.append(plant.get(["position", "friction_torque"]))
    return np.array(rows), plant


@pytest.mark.parametrize(
    ("name", "creep"),
    [("BallscrewStage", 28.35), ("BallscrewStageElastoPlastic", 0.0), ("BallscrewStageMaxwellSlip", 0.0)],
)
def test_drift_under_a_load_below_break_away(native: Path, name: str, creep: float):
    """3 +- 1 N.m at 10 Hz, held over 1 ms: nm a cycle, after ten cycles."""

    def torque(t: float) -> float:
        return 30.0 * t if t < 0.1 else 3.0 + math.sin(20.0 * math.pi * (t - 0.1))

    rows, _ = driven(native, name, torque, 1.3, 1e-3)
    found = 1e9 * (rows[1299, 0] - rows[1199, 0])
    assert found == pytest.approx(creep, abs=0.01)


CORNERS = (0.0, 5.0, 1.0, 5.0, 1.0, 5.0)


def corner_torque(t: float, rate: float, dwell: float) -> float:
    """The torque that goes from corner to corner at ``rate`` and stays at each for ``dwell``."""
    for a, b in pairwise(CORNERS):
        leg = abs(b - a) / rate
        if t < leg:
            return a + (b - a) * t / leg
        t -= leg + dwell
        if t < 0.0:
            return b
    return CORNERS[-1]


def at_corners(folder: Path, name: str, **start: float) -> list[float]:
    """Position in nm after the dwell at each corner; 10 N.m/s, 0.1 s."""
    ends = np.cumsum([abs(b - a) / 10.0 + 0.1 for a, b in pairwise(CORNERS)])
    rows, _ = driven(folder, name, lambda t: corner_torque(t, 10.0, 0.1), float(ends[-1]), 1e-3, **start)
    return [1e9 * float(rows[round(end / 1e-3) - 1, 0]) for end in ends]


def test_minor_loops_of_maxwell_slip_close(native: Path):
    found = at_corners(native, "BallscrewStageMaxwellSlip")
    assert abs(found[2] - found[0]) <= 1e-6 * found[0]
    assert abs(found[4] - found[0]) <= 1e-6 * found[0]
    assert abs(found[3] - found[1]) <= 1e-6 * found[0]
    lugre = at_corners(native, "BallscrewStage")
    assert lugre[2] - lugre[0] > 0.4 * lugre[0], "LuGre forgets; the case can tell"


@pytest.mark.parametrize("torque", [0.5, 1.5, 3.0, 5.0, 7.0])
def test_virgin_curve_of_maxwell_slip_is_the_sum_of_its_elements(native: Path, torque: float):
    """F_S = F_C: a level without Stribeck effect. Torque and deflection after a slow rise and a dwell."""
    rows, _ = driven(
        native, "BallscrewStageMaxwellSlip", lambda t: min(10.0 * t, torque), torque / 10.0 + 0.2, 1e-3, F_C=F_S
    )
    x = float(rows[-1, 0]) / L_P
    assert sum(min(k * x, part * F_S) for k, part in zip(SLIP.k, SLIP.alpha, strict=True)) == pytest.approx(
        torque, rel=1e-8
    )


def test_maxwell_slip_follows_an_event_located_solution(native: Path):
    """Presliding, break-away and reversals: the FMU at two tolerances against explicit modes with located events."""
    h, n = 1e-3, 17
    commands = [11.0 * math.sin(2.0 * math.pi * 60.0 * k * h) for k in range(n)]
    motion, exact = Located(SLIP, 1e-9), []
    for k, command in enumerate(commands):
        motion.step(k * h, (k + 1) * h, command, 0.0)
        exact.append(motion.outputs((k + 1) * h)[2:4])
    reference = np.array(exact)
    assert motion.events >= 7
    errors: list[float] = []
    for tolerance in (1e-6, 1e-9):
        with Instance(native / "BallscrewStageMaxwellSlip.fmu") as plant:
            plant.initialize({"tolerance": tolerance})
            rows: list[list[float]] = []
            for k, command in enumerate(commands):
                plant.set({"command": command})
                plant.step(k * h, h)
                rows.append(plant.get(["angle", "speed"]))
        difference = np.abs(np.array(rows) - reference).max(axis=0)
        errors.append(float(np.max(difference / np.abs(reference).max(axis=0))))
    # The error follows the tolerance; the finer run is as good as the reference.
    assert errors[0] < 1e-3
    assert errors[1] < 1e-6
    assert errors[1] < 0.1 * errors[0]


def test_contradicting_parameters_are_refused():
    with pytest.raises(DescriptionError, match="alpha"):
        BallscrewStageMaxwellSlip(alpha=(0.1, 0.2, 0.3, 0.3))
    with pytest.raises(DescriptionError, match="are all 0"):
        BallscrewStageMaxwellSlip(k=(0.0, 0.0, 0.0, 0.0))
    for kind in (BallscrewStageElastoPlastic, BallscrewStageMaxwellSlip):
        with pytest.raises(DescriptionError, match="F_C = 0 with F_S > 0"):
            kind(F_C=0.0)


def test_start_in_steady_sliding():
    for v in (0.5, -2.0):
        for plant in (
            BallscrewStageElastoPlastic(velocity_start=v * L_P),
            BallscrewStageMaxwellSlip(velocity_start=v * L_P),
        ):
            torque = plant.output(0.0, plant.initial(), plant.Input()).friction_torque
            assert torque == pytest.approx(math.copysign(plant.level(0.0, v), v) + 0.4 * v, rel=1e-9)
