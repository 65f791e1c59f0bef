"""The integrator of the native FMUs: order, damping, step control and failures on problems of known solution."""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
from collections.abc import Callable
from math import exp, log, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from instances import Instance
from integrator_coefficients import GAMMA, NODE, coefficients
from scipy.linalg import expm
from stage_loops import traces

from cosim.export.compile import FLAGS, RUNTIME
from cosim.export.python import integrator

PROBLEMS = Path(__file__).with_name("integrator_problems.c")
LINEAR, KAPS, BLOW_UP, DOMAIN = range(4)
OK, STEP_TOO_SMALL, TOO_MANY_STEPS, NOT_FINITE = range(4)
FIXED = 1e300
"""A tolerance that accepts any step, so that each call is one step."""


class Memory(ctypes.Structure):
    _fields_ = (
        ("step", ctypes.c_double),
        ("time", ctypes.c_double),
        ("failing", ctypes.c_int),
        *((name, ctypes.c_ulonglong) for name in ("steps", "rejected", "derivatives", "jacobians", "decompositions")),
    )


class Run:
    """Integration of a problem of integrator_problems.c; ``x`` has the count of steps as last element."""

    def __init__(self, library: ctypes.CDLL, problem: int, start: list[float], p: Any = (), **options: Any) -> None:
        self.library = library
        self.problem = problem
        self.x = np.array([*start, 0.0])
        self.p = np.array(p, float).ravel()
        self.memory = Memory()
        self.tolerance: float = options.get("tolerance", 1e-8)
        self.max_steps: int = options.get("max_steps", 100_000)

    def __call__(self, t: float, t_end: float) -> int:
        pointer = ctypes.POINTER(ctypes.c_double)
        return self.library.run(
            self.problem,
            ctypes.c_double(self.tolerance),
            ctypes.c_long(self.max_steps),
            self.p.ctypes.data_as(pointer),
            ctypes.byref(self.memory),
            ctypes.c_double(t),
            ctypes.c_double(t_end),
            self.x.ctypes.data_as(pointer),
        )


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], ctypes.CDLL]:
    """The problems compiled for a number of continuous states as FMUs are compiled."""
    folder = tmp_path_factory.mktemp("integrator")
    known: dict[int, ctypes.CDLL] = {}

    def compiled(n: int) -> ctypes.CDLL:
        if n not in known:
            target = folder / f"problems_{n}.so"
            command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, f"-I{RUNTIME}", f"-DN_CONTINUOUS={n}"]
            subprocess.run([*command, str(PROBLEMS), "-o", str(target), "-lm"], check=True)
            known[n] = ctypes.CDLL(str(target))
        return known[n]

    return compiled


def test_coefficients_are_those_of_the_order_conditions() -> None:
    text = (RUNTIME / "integrator.c").read_text()
    found = {
        name: [float(value) for value in values.replace("\n", " ").split(",")]
        for name, values in re.findall(r"static const double (\w+)\[\w+\] = \{([^}]*)\};", text)
    }
    expected = coefficients()
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name] == [float(value) for value in values], name
    assert f"gamma = {float(GAMMA)}, node = {float(NODE)};" in text


def test_python_flavour_has_the_same_coefficients() -> None:
    known = {name: tuple(float(value) for value in values) for name, values in coefficients().items()}
    assert (float(GAMMA), float(NODE)) == (integrator.GAMMA, integrator.NODE)
    for name, values in known.items():
        assert getattr(integrator, name.upper()) == values, name
    text = (RUNTIME / "integrator.c").read_text()
    assert (integrator.LINEAR_ERROR, integrator.REMAINDER_ERROR) == (0.625, 1.0 / 32.0)
    assert "linear_error = 0.625, remainder_error = 1.0 / 32.0;" in text


def kaps_error(library: ctypes.CDLL, mu: float, steps: int) -> float:
    """Largest error at t = 1 of the method with fixed steps."""
    run = Run(library, KAPS, [1.0, 1.0, 0.0], [mu], tolerance=FIXED)
    for k in range(steps):
        assert run(k / steps, (k + 1) / steps) == OK
    assert (run.memory.steps, run.memory.derivatives, run.memory.jacobians) == (steps, 3 * steps, steps)
    return float(np.max(np.abs(run.x[:3] - [exp(-2.0), exp(-1.0), sin(1.0)])))


def test_order_is_5(library: Callable[[int], ctypes.CDLL]) -> None:
    errors = np.array([kaps_error(library(3), 3.0, steps) for steps in (16, 32, 64, 128)])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([5.0] * 3, abs=0.1)


@pytest.mark.parametrize("mu", [1e2, 1e4, 1e6, 1e8, 1e10])
def test_stiffness_does_not_spoil_a_smooth_solution(library: Callable[[int], ctypes.CDLL], mu: float) -> None:
    # Without stiffness these steps leave 8e-9; order reduction costs most, 1.5e-6, where mu*h is about 10.
    assert kaps_error(library(3), mu, 16) < 3e-6


def test_fast_modes_are_damped_in_one_step(library: Callable[[int], ctypes.CDLL]) -> None:
    """|R(z) - exp(z)| < 0.004 on the negative axis, and R falls as 1/z^2 (L-stability)."""
    for z in -np.logspace(-2, 9, 200):
        run = Run(library(1), LINEAR, [1.0], [z], tolerance=FIXED)
        assert run(0.0, 1.0) == OK
        assert abs(run.x[0] - exp(max(z, -700.0))) < min(0.004, 40.0 / z**2 if z < -10 else 1.0)


def test_oscillations_never_grow(library: Callable[[int], ctypes.CDLL]) -> None:
    """|R| <= 1 on the imaginary axis and in the left half-plane next to it (A-stability)."""
    for y in np.logspace(-3, 6, 300):
        for damping in (0.0, 0.05, 1.0):
            run = Run(library(3), LINEAR, [1.0, 0.0, 0.0], [[-damping * y, y, 0], [-y, -damping * y, 0], [0, 0, 0]])
            run.tolerance = FIXED
            assert run(0.0, 1.0) == OK
            assert np.hypot(*run.x[:2]) <= 1.0 + 1e-12


@pytest.mark.parametrize("n", [1, 3, 12])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10])
def test_linear_systems_of_any_size(library: Callable[[int], ctypes.CDLL], n: int, tolerance: float) -> None:
    """A chain of lags 1e3 to 1e6 times faster than the time integrated over, against the matrix exponential."""
    matrix = np.diag(-np.logspace(1, 6, n)) + np.diag(np.full(n - 1, 3.0), 1) - np.diag(np.full(n - 1, 2.0), -1)
    start = np.linspace(1.0, 2.0, n)
    run = Run(library(n), LINEAR, list(start), matrix, tolerance=tolerance)
    assert run(0.0, 1.0) == OK
    assert np.max(np.abs(run.x[:n] - expm(matrix) @ start)) < tolerance
    assert run.x[n] == run.memory.steps  # update was called once a step accepted


def test_no_continuous_states(library: Callable[[int], ctypes.CDLL]) -> None:
    run = Run(library(0), LINEAR, [], [0.0])
    assert run(2.0, 3.0) == OK
    assert (run.x[0], run.memory.time, run.memory.derivatives) == (1.0, 3.0, 0)


def test_ends_at_the_end_and_leaves_no_remainder(library: Callable[[int], ctypes.CDLL]) -> None:
    run = Run(library(3), KAPS, [1.0, 1.0, 0.0], [1e3])
    for k in range(1000):
        assert run(k * 1e-3, (k + 1) * 1e-3) == OK
        assert run.memory.time == (k + 1) * 1e-3
    assert run.x[:3] == pytest.approx([exp(-2.0), exp(-1.0), sin(1.0)], abs=1e-9)
    assert run.memory.steps < 1100  # one a call once the start is over


def test_a_copy_continues_in_the_same_way(library: Callable[[int], ctypes.CDLL]) -> None:
    first = Run(library(3), KAPS, [1.0, 1.0, 0.5], [1e3])
    assert first(0.0, 0.3) == OK
    second = Run(library(3), KAPS, [0.0, 0.0, 0.0], [1e3])
    second.x, second.memory = first.x.copy(), Memory.from_buffer_copy(first.memory)
    assert first(0.3, 1.0) == second(0.3, 1.0) == OK
    assert bytes(first.x) + bytes(first.memory) == bytes(second.x) + bytes(second.memory)


def test_singular_matrix_is_a_rejected_step(library: Callable[[int], ctypes.CDLL]) -> None:
    rate = 1.0 / float(GAMMA)  # makes 1 - gamma*h*rate vanish at the first attempt, h = 1
    run = Run(library(1), LINEAR, [1.0], [rate])
    assert run(0.0, 1.0) == OK
    assert run.memory.rejected >= 1
    assert run.x[0] == pytest.approx(exp(rate), rel=1e-6)


def test_blow_up_in_finite_time(library: Callable[[int], ctypes.CDLL]) -> None:
    run = Run(library(3), BLOW_UP, [5.0, 2.0, 5.0])
    assert run(0.0, 1.0) in (STEP_TOO_SMALL, NOT_FINITE)
    assert run.memory.time == pytest.approx(0.5, abs=1e-7)
    assert run.memory.failing == 1
    assert run.x[1] > 1e6
    assert np.all(np.isfinite(run.x))


def test_state_leaves_the_domain_of_its_derivative(library: Callable[[int], ctypes.CDLL]) -> None:
    run = Run(library(3), DOMAIN, [0.0, 0.0, 0.0])
    assert run(0.0, 1.0) == NOT_FINITE
    assert run.memory.time == pytest.approx(2.0 - 2.0 * log(2.0), abs=1e-6)
    assert run.memory.failing == 2
    assert run.x[2] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("start", [2.0, np.nan, np.inf])
def test_derivative_not_finite_at_the_start(library: Callable[[int], ctypes.CDLL], start: float) -> None:
    run = Run(library(3), DOMAIN, [1.0, 2.0, start])
    assert run(3.0, 4.0) == NOT_FINITE
    assert (run.memory.time, run.memory.failing, run.memory.steps) == (3.0, 2, 0)
    assert list(run.x[:2]) == [1.0, 2.0]


def test_too_many_steps_can_be_continued(library: Callable[[int], ctypes.CDLL]) -> None:
    run = Run(library(3), KAPS, [1.0, 1.0, 0.0], [1e4], tolerance=1e-12, max_steps=10)
    assert run(0.0, 1.0) == TOO_MANY_STEPS
    reached = run.memory.time
    assert 0.0 < reached < 1.0
    assert run.memory.steps + run.memory.rejected == 10
    # the third state is driven by time: it tells that time and state belong together
    assert run.x[2] == pytest.approx(sin(reached), abs=1e-10)
    run.max_steps = 100_000
    assert run(reached, 1.0) == OK
    assert run.x[:3] == pytest.approx([exp(-2.0), exp(-1.0), sin(1.0)], abs=1e-10)


# ---- step control ----


@pytest.mark.parametrize("z", [-0.5, -1.0, -3.0])
@pytest.mark.parametrize(("share", "rejections"), [(0.98, 0), (1.02, 1)])
def test_weight_of_the_error(library: Callable[[int], ctypes.CDLL], z: float, share: float, rejections: int) -> None:
    """On x' = z x the first step of 1 s is taken up to an estimate of 1, and refused beyond.

    The estimate by hand: 0.625 times the fourth difference of W^4 z ... W^8 z, W = 1/(1 - gamma z), over the tolerance
    times the larger size of the state, 1, and its nominal value, 1. Remainders of a linear derivative are zero.
    """
    w = 1.0 / (1.0 - float(GAMMA) * z)
    estimate = 0.625 * abs(w**4 * (1.0 - w) ** 4 * z)
    run = Run(library(1), LINEAR, [1.0], [z], tolerance=estimate / (2.0 * share), max_steps=1)
    assert run(0.0, 1.0) == (TOO_MANY_STEPS if rejections else OK)
    assert run.memory.rejected == rejections


def test_weight_of_the_remainders(library: Callable[[int], ctypes.CDLL]) -> None:
    """Of x1' = x1^2, x1(0) = 1/2, the first step of 1 s, estimated by hand: the derivative at node and end enters."""
    estimate = remainder_estimate(0.5, 1.0)
    for share, rejections in ((0.98, 0), (1.02, 1)):
        run = Run(library(3), BLOW_UP, [0.0, 0.5, 0.0], tolerance=estimate / share, max_steps=1)
        run(0.0, 1.0)
        assert run.memory.rejected == rejections


def remainder_estimate(x: float, h: float) -> float:
    """The error estimate of x' = x^2 for a tolerance of 1 and a nominal value of 1, by scalars."""
    known = {name: [float(v) for v in values] for name, values in coefficients().items()}
    gamma, node = float(GAMMA), float(NODE)
    f, jacobian = x * x, 2.0 * x
    w = 1.0 / (1.0 - gamma * h * jacobian)
    linear = [w**k * h * f for k in range(9)]

    def remainder(v: float) -> float:
        return h * (x + v) ** 2 - h * f - h * jacobian * v

    to_node = sum(c * value for c, value in zip(known["to_node"], linear[1:], strict=True))
    at_node = remainder(to_node)
    v = sum(c * value for c, value in zip(known["to_end"], linear[1:], strict=True))
    end = v + sum(c * w ** (k + 1) * at_node for k, c in enumerate(known["node_in_stage"]))
    at_end = remainder(end)
    solution = v
    for k, (one, other) in enumerate(zip(known["from_node"], known["from_end"], strict=True)):
        solution += one * w ** (k + 1) * at_node + other * w ** (k + 1) * at_end
    fourth = linear[4] - 4.0 * linear[5] + 6.0 * linear[6] - 4.0 * linear[7] + linear[8]
    departure = w**2 * at_end - w**2 * at_node / node**2
    return (0.625 * abs(fourth) + abs(departure) / 32.0) / (max(abs(x), abs(x + solution)) + 1.0)


def test_no_growth_right_after_a_rejection(library: Callable[[int], ctypes.CDLL]) -> None:
    """Attempts of 1 and 1/2 s meet a singular matrix, one of 1/4 s is taken: the next one is no longer."""
    rate = 1.0 / float(GAMMA)
    run = Run(library(3), LINEAR, [1.0, 1.0, 1.0], np.diag([rate, 2.0 * rate, 0.0]), tolerance=FIXED, max_steps=4)
    assert run(0.0, 1.0) == TOO_MANY_STEPS
    assert (run.memory.rejected, run.memory.steps, run.memory.time) == (2, 2, 0.5)


@pytest.mark.parametrize(("proposal", "reached"), [(0.9, 0.5), (0.6, 0.5), (0.4, 0.4)])
def test_the_last_two_steps_share_what_is_left(
    library: Callable[[int], ctypes.CDLL], proposal: float, reached: float
) -> None:
    """A proposal of 0.9 of what is left would leave a tiny step: two halves instead."""
    run = Run(library(1), LINEAR, [1.0], [-1.0], tolerance=FIXED, max_steps=1)
    run.memory.step = proposal
    assert run(0.0, 1.0) == TOO_MANY_STEPS
    assert run.memory.time == reached


def test_a_proposal_a_little_short_of_the_end_goes_there(library: Callable[[int], ctypes.CDLL]) -> None:
    run = Run(library(1), LINEAR, [1.0], [-1.0], tolerance=FIXED)
    run.memory.step = 0.9995
    assert run(0.0, 1.0) == OK
    assert run.memory.steps == 1


# ---- the stiff plant ----


@pytest.mark.parametrize(
    ("tolerance", "error", "evaluations"),
    # Measured: errors of the angle of 1.2e-9, 7.3e-10 and 2.0e-12 rad; 3.57, 14.13 and 29.55 evaluations a sample.
    [(1e-4, 4e-9, 3.8), (1e-6, 2e-9, 14.8), (1e-8, 1e-11, 31.0)],
)
def test_error_and_cost_on_the_stiff_plant(native: Path, tolerance: float, error: float, evaluations: float) -> None:
    """Ballscrew stage over 2 s: torque held for 0.1 ms, break-away and reversals, eigenvalues to -8.5e5 1/s."""
    reference = traces("open_loop")
    every = round((reference["time"][1] - reference["time"][0]) / 1e-4)
    samples = every * (len(reference["time"]) - 1)
    found = np.zeros(len(reference["time"]))
    with Instance(native / "BallscrewStage.fmu") as stage:
        stage.initialize({"tolerance": tolerance})
        for k in range(samples):
            t = k * 1e-4
            stage.set({"command": 8.0 * sin(4.0 * pi * t) + 6.0 * sin(1.4 * pi * t)})
            stage.step(t, 1e-4)
            if (k + 1) % every == 0:
                found[(k + 1) // every] = stage.get(["angle"])[0]
        (cost,) = stage.get(["solver.rhs_evaluations"])
    assert np.max(np.abs(found - reference["held"][:, 0])) < error
    assert cost / samples < evaluations
