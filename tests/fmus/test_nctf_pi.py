"""NCTF-PI: recorded inputs, the reference NCT, anti-windup, delay, saturation, odd symmetry, stability limits."""

from __future__ import annotations

import math
from bisect import bisect_right
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import Sampled
from nctf_reference import LARGEST_DAMPING, module, reference
from scipy.linalg import expm

from cosim.errors import DescriptionError
from cosim.model import Plant, interpolate, unflatten
from fmus.controllers.nctf_pi import NctfPi
from fmus.physics.nct import REFERENCE_ERROR, REFERENCE_RATE
from fmus.plant.compliant_ballscrew import CompliantBallscrew
from fmus.plant.nominal_stage import NominalStage

MICRO_STEP = 1e-9
"""A step inside the linear part of the NCT, m."""


@pytest.mark.parametrize("antiwindup", [True, False])
def test_recorded_inputs_give_the_recorded_commands(antiwindup: bool):
    data = reference("nctf_pi_replay")
    controller = Sampled(NctfPi(antiwindup=antiwindup))
    commands = [
        controller(position_ref=float(r), position=float(x)).command
        for r, x in zip(data["position_ref"], data["position"], strict=True)
    ]
    expected = data[f"antiwindup_{antiwindup}"]
    # 2e-13 A apart (metres here, millimetres there); one quantum of the sensor would be 6.7e-3 A.
    assert np.max(np.abs(np.array(commands) - expected)) < 1e-10
    assert np.mean(np.abs(expected) >= 6.0) > 0.1, "the record must visit saturation"


def test_antiwindup_changes_the_record():
    data = reference("nctf_pi_replay")
    assert np.max(np.abs(data["antiwindup_True"] - data["antiwindup_False"])) > 1.0


def test_reference_nct_is_that_of_the_script():
    error, rate, worst = module("nct_table").table()
    assert list(REFERENCE_ERROR) == list(error)
    assert list(REFERENCE_RATE) == list(rate)
    assert worst < 2.4e-4


def test_reference_nct_starts_with_the_identified_slope():
    assert REFERENCE_RATE[1] / REFERENCE_ERROR[1] == pytest.approx(505.0, rel=1e-3)
    assert REFERENCE_ERROR[1] == pytest.approx(0.6426e-6, rel=1e-3)
    assert REFERENCE_RATE[-1] == pytest.approx(134.473e-3, rel=1e-5)


@given(
    nodes=st.lists(st.floats(0.0, 1.0), min_size=2, max_size=40),
    values=st.lists(st.floats(-1.0, 1.0), min_size=40, max_size=40),
    x=st.floats(-0.5, 1.5),
)
def test_interpolation_is_interpolation_by_search(nodes: list[float], values: list[float], x: float):
    x_nodes = sorted({round(node, 4) for node in nodes} | {0.0, 1.0})
    x_nodes.append(x_nodes[-1])  # a repeated last node stands for fewer nodes
    y_nodes = [values[i] for i in range(len(x_nodes) - 1)] + [values[len(x_nodes) - 2]]
    i = min(max(bisect_right(x_nodes, x) - 1, 0), len(x_nodes) - 3)
    part = min(max((x - x_nodes[i]) / (x_nodes[i + 1] - x_nodes[i]), 0.0), 1.0)
    expected = y_nodes[i] + part * (y_nodes[i + 1] - y_nodes[i])
    assert interpolate(x, tuple(x_nodes), tuple(y_nodes)) == pytest.approx(expected, abs=1e-9)


inputs = st.tuples(st.floats(-0.03, 0.03), st.floats(-0.03, 0.03))


@given(st.lists(inputs, min_size=1, max_size=20), st.booleans(), st.floats(0.1, 10.0), st.sampled_from([0.0, 1e-9]))
def test_command_is_limited_finite_and_odd(sequence: list[tuple[float, float]], aw: bool, limit: float, q: float):
    parameters: dict[str, Any] = {"antiwindup": aw, "command_max": limit, "sensor_resolution": 0.0, "K_P": 1e3 * limit}
    one, other = Sampled(NctfPi(**parameters)), Sampled(NctfPi(**parameters))
    rounding = Sampled(NctfPi(**(parameters | {"sensor_resolution": q})))
    for r, x in sequence:
        y, mirrored = one(position_ref=r, position=x), other(position_ref=-r, position=-x)
        assert all(math.isfinite(value) for value in y)
        assert abs(y.command) <= limit
        assert mirrored.command == -y.command
        assert abs(rounding(position_ref=r, position=x).command) <= limit


def test_at_rest_on_target_the_command_is_zero():
    controller = Sampled(NctfPi())
    for _ in range(3):
        y = controller(position_ref=0.0, position=0.0)
    assert tuple(y) == (0.0,) * len(tuple(y))


def test_compute_delay_moves_the_command_by_one_sample():
    data = reference("nctf_pi_replay")
    at_once, late = Sampled(NctfPi()), Sampled(NctfPi(compute_delay=1))
    pairs = [
        (
            at_once(position_ref=float(r), position=float(x)).command,
            late(position_ref=float(r), position=float(x)).command,
        )
        for r, x in zip(data["position_ref"][:300], data["position"][:300], strict=True)
    ]
    commands = [one for one, _ in pairs]
    assert [other for _, other in pairs] == [0.0, *commands[:-1]]


def test_antiwindup_holds_the_integral_only_against_its_own_sign():
    controller = NctfPi(sensor_resolution=0.0)
    for integral, held in ((1.0, True), (0.0, True), (-1.0, False)):
        x = controller.State(integral=integral, started=1.0)
        y = controller.output(0.0, x, controller.Input(position_ref=0.02))  # wants +129 A
        assert y.frozen == float(held)
        assert (y.integral == integral) is held
        assert y.command == 6.0


def test_input_velocity_may_be_measured():
    controller = NctfPi(velocity_source=NctfPi.velocity_source.input)
    y = controller.output(0.0, controller.initial(), controller.Input(velocity=0.25))
    assert y.velocity_hat == 0.25


def test_nodes_must_ascend_from_zero():
    nodes = list(REFERENCE_ERROR)
    nodes[5], nodes[6] = nodes[6], nodes[5]
    with pytest.raises(DescriptionError, match="ascend"):
        NctfPi(nct_error=tuple(nodes))
    with pytest.raises(DescriptionError, match=r"nct\.rate\[1\]"):
        NctfPi(nct_rate=(1e-3, *REFERENCE_RATE[1:]))


# The linear part: loops of the components' own methods, column by column.


def held_response(plant: Plant, T_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and input matrix over one sample of a plant whose derivative is linear."""
    n = len(list(plant.initial()))
    tiny = 1e-6

    def rate(x: np.ndarray, command: float) -> np.ndarray:
        state = plant.State(**unflatten(plant.State, iter(x.tolist())))
        return np.array(list(plant.derivative(0.0, state, plant.Input(command=command)))) / tiny  # type: ignore[call-arg]

    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n] = np.array([rate(tiny * column, 0.0) for column in np.eye(n)]).T
    whole[:n, n] = rate(np.zeros(n), tiny)
    moved = expm(whole * T_s)
    return moved[:n, :n], moved[:n, n]


def spectral_radius(plant: Plant, controller: NctfPi) -> float:
    """Of the sampled loop around the target, where the NCT is a line."""
    transition, enters = held_response(plant, controller.T_s)
    n, kinds = len(enters), type(controller).State

    def sample(vector: np.ndarray) -> np.ndarray:
        x, inner = vector[:n], (vector[n:] * MICRO_STEP).tolist()
        state = kinds(
            integral=inner[0], started=1.0, position_last=inner[1], velocity_last=inner[2], command_last=inner[3]
        )
        u = controller.Input(position=float(x[0]) * MICRO_STEP)
        y = controller.output(0.0, state, u)
        after = controller.update(0.0, state, u, y)
        memory = np.array([after.integral, after.position_last, after.velocity_last, after.command_last])
        return np.concatenate([transition @ x + enters * y.command / MICRO_STEP, memory / MICRO_STEP])

    return float(np.max(np.abs(np.linalg.eigvals(np.array([sample(column) for column in np.eye(n + 4)]).T))))


def linear_nct(alpha: float) -> dict[str, Any]:
    """An NCT that is a line, no quantisation, no saturation."""
    errors = np.linspace(0.0, 1.0, 128)
    return {
        "nct_error": tuple(errors.tolist()),
        "nct_rate": tuple((alpha * errors).tolist()),
        "sensor_resolution": 0.0,
        "command_max": 0.0,
        "antiwindup": False,
    }


def largest(stable: Any, low: float, high: float) -> float:
    """Where ``stable`` ends, by bisection."""
    assert stable(low)
    assert not stable(high)
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


@pytest.mark.parametrize(("delay", "limit"), [(0, 0.6531), (1, 0.5718)])
def test_ultimate_gain_of_the_two_inertias_without_friction(delay: int, limit: float):
    plant = CompliantBallscrew(F_C=0.0, F_S=0.0, command_max=0.0)

    def stable(gain: float) -> bool:
        controller = NctfPi(K_P=1e3 * gain, K_I=0.0, compute_delay=delay, **linear_nct(505.0))
        return spectral_radius(plant, controller) <= 1.0 + 1e-9

    # The integrator of position stays at 1 with a bristle that does not move.
    assert largest(stable, 0.1, 2.0) == pytest.approx(limit, rel=5e-3)


@pytest.mark.parametrize(("W", "closed_form", "sampled"), LARGEST_DAMPING)
def test_linear_stability_limit_of_the_nominal_stage(W: float, closed_form: float, sampled: float):
    T, K = 2e-4, 1e-3

    def stable(alpha: float, zeta: float) -> bool:
        gain = W / T / (alpha * K)
        controller = NctfPi(K_P=2.0 * zeta * gain, K_I=W / T * gain, **linear_nct(alpha))
        return spectral_radius(NominalStage(K=K, alpha=alpha), controller) < 1.0

    for alpha, expected in ((5.0, closed_form), (505.0, sampled)):
        found = largest(partial(stable, alpha), 0.5 * expected, 2.0 * expected)
        assert found == pytest.approx(expected, rel=1e-3)
