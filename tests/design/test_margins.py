"""Margins of loops: closed forms, equations linearized by difference quotients, known responses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg

import cosim
from cosim.design.linearize import StateSpace, linearize
from cosim.design.margins import loop_margins, margins, series
from cosim.design.rest_of_loop import realize, rest_of_loop
from cosim.errors import DescriptionError
from cosim.master.instance import CallError
from cosim.master.simulation import Simulation
from cosim.model import unflatten
from cosim.system.system import System, make_system, read_system
from fmus.controllers.fuzzy_sliding_mode import FuzzySlidingMode
from fmus.physics.nct import REFERENCE_ERROR, REFERENCE_RATE
from fmus.plant.ballscrew_stage import BallscrewStage

STUDIES = Path(__file__).parents[2] / "studies"
T_S = 2e-4


@pytest.fixture(scope="module")
def frictionless(native: Path) -> System:
    still = {"plant.F_C": 0.0, "plant.F_S": 0.0, "trajectory.amplitude": 1e-7, "controller.sensor_resolution": 0.0}
    return read_system(STUDIES / "maeda2008" / "step.toml", still, fmus=native)


# Loops of systems


@pytest.mark.parametrize("source", ["input", "difference"])
def test_the_loop_closes_through_all_measurements(native: Path, source: str) -> None:
    """Cascade on mass and damping: L(z) in closed form, with the position loop and the velocity loop."""
    h, K_pos, omega_v, T_i, M, l_p, tau = 1e-3, 40.0, 250.0, 0.02, 10.0, 1e-3, 5e-4
    controller = {"T_s": h, "K_pos": K_pos, "omega_v": omega_v, "T_i": T_i, "M": M, "l_p": l_p, "command_max": 0.0}
    measured = {"input": ("velocity", "velocity"), "difference": ("position", "motor_position")}[source]
    loop = {
        "connections": [
            "plant.position -> controller.position",
            f"plant.{measured[0]} -> controller.{measured[1]}",
            {"from": "controller.command", "to": "plant.command", "factor": 10.0},
        ],
        "experiment": {"stop_time": 1.0, "step_size": h, "order": ["controller", "plant"]},
        "instances": {
            "controller": {
                "fmu": "CascadePid",
                "start": {**controller, "velocity_source": source, "velocity_filter_time": tau},
            },
            "plant": {"fmu": "LinearMotor", "start": {"m": 10.0, "b": 250.0, "k_t": 2.0, "K_a": 50.0}},
        },
    }
    ours, found = loop_margins(make_system(loop, fmus=native), at=0.0)
    omega = np.array([1.0, 30.0, 300.0, 3000.0])
    z = np.exp(1j * omega * h)
    # gain/(s + a) and gain/(s (s + a)) with the input held over h
    gain, a = 10.0 * 100.0 / 10.0, 250.0 / 10.0
    pole = math.exp(-a * h)
    speed = gain / a * (1.0 - pole) / (z - pole)
    position = gain / a * (h / (z - 1.0) - (1.0 - pole) / (a * (z - pole)))
    blend = math.exp(-h / tau)
    estimate = speed if source == "input" else (1.0 - blend) * (1.0 - 1.0 / z) / h / (1.0 - blend / z) * position
    expected = M * omega_v * l_p * (1.0 + h / T_i / (z - 1.0)) * (K_pos * position + estimate)
    assert ours.response(omega)[:, 0, 0] == pytest.approx(expected, rel=1e-5)
    assert found.stable


def test_the_loop_goes_through_every_instance_between(native: Path) -> None:
    """A second controller after the first, here one that passes the command on: the loop of the first alone."""
    h = 1e-3
    loop: dict[str, Any] = {
        "connections": [
            "plant.position -> controller.position",
            {"from": "controller.command", "to": "plant.command", "factor": 0.01},
        ],
        "experiment": {"stop_time": 1.0, "step_size": h, "order": ["controller", "plant"]},
        "instances": {
            "controller": {"fmu": "CascadeP", "start": {"T_s": h, "K_pos": 30.0, "K_vel": 5.0, "command_max": 0.0}},
            "plant": {"fmu": "NominalStage", "start": {"K": 1.0, "alpha": 50.0}},
        },
    }
    alone, found = loop_margins(make_system(loop, fmus=native), at=0.0)
    loop["instances"]["feedforward"] = {"fmu": "FrictionFeedforward", "start": {"T_s": h, "share": 0.0}}
    loop["connections"][1:] = [
        {"from": "controller.command", "to": "feedforward.force", "factor": 1.0},
        {"from": "feedforward.command", "to": "plant.command", "factor": 0.01},
    ]
    loop["experiment"]["order"] = ["controller", "feedforward", "plant"]
    through, same = loop_margins(make_system(loop, fmus=native), at=0.0)
    omega = np.array([1.0, 30.0, 300.0])
    assert through.response(omega) == pytest.approx(alone.response(omega), rel=1e-6)
    assert same.phase == pytest.approx(found.phase, rel=1e-6)


@pytest.mark.parametrize(
    "order", ["parallel", ["trajectory", "force", "plant", "controller"]], ids=["parallel", "plant before controller"]
)
def test_a_late_command_turns_the_loop_by_a_sample(native: Path, order: Any) -> None:
    name = STUDIES / "rubio2015" / "p_pi_1khz.toml"
    prompt, _ = loop_margins(
        read_system(name, fmus=native, order=["trajectory", "force", "controller", "plant"]), at=0.0
    )
    late, _ = loop_margins(read_system(name, fmus=native, order=order), at=0.0)
    omega = np.array([3.0, 30.0, 300.0])
    turned = prompt.response(omega)[:, 0, 0] * np.exp(-1j * omega * 1e-3)
    assert late.response(omega)[:, 0, 0] == pytest.approx(turned, rel=1e-6)


def test_a_loop_in_motion_is_that_of_its_equations(native: Path) -> None:
    """A fuzzy controller on a stage that slides: one sample of both, by difference quotients of the equations."""
    system = read_system(STUDIES / "shams2010" / "fsmc_2pi.toml", fmus=native)
    at, h = 0.3, 1e-4
    inputs = list(system.instance("controller").fmu.inputs)
    states = ["state.angle", "state.speed", "bristle", "largest_speed", "table"]
    record = [f"controller.{name}" for name in (*inputs, "command")] + [f"plant.{name}" for name in states]
    run = cosim.simulate(system.changed(record=record, decimation=1, stop_time=at))
    start = system.instance("controller").start
    controller = FuzzySlidingMode(**{name: value for name, value in start.items() if name != "velocity_source"})  # pyright: ignore[reportArgumentType]
    plant = BallscrewStage()
    x = controller.State()
    for row in range(len(run.time)):
        u = _record(controller.Input, [run[f"controller.{name}"][row] for name in inputs])
        y = controller.output(run.time[row], x, u)
        if row < len(run.time) - 1:
            x = controller.update(run.time[row], x, u, y)
    assert y.command == pytest.approx(run["controller.command"][-1], rel=1e-12)

    def sample(values: NDArray[np.float64]) -> NDArray[np.float64]:
        now = _record(controller.State, values[: len(list(x))])
        measured = _record(controller.Input, values[len(list(x)) :])
        given = controller.output(at, now, measured)
        return np.array([*controller.update(at, now, measured, given), given.command], dtype=np.float64)

    def rates(values: NDArray[np.float64]) -> NDArray[np.float64]:
        angle, speed, bristle, command = (float(value) for value in values)
        here = plant.State(
            angle=angle,
            speed=speed,
            bristle=bristle,
            table=float(run["plant.table"][-1]),
            largest_speed=float(run["plant.largest_speed"][-1]),
        )
        there = plant.derivative(at, here, plant.Input(command=command))
        return np.array([there.angle, there.speed, there.bristle])

    ours = _quotients(sample, np.array([*x, *u], dtype=np.float64))
    n = len(list(x))
    A, B, C, D = ours[:n, :n], ours[:n, n:], ours[n:, :n], ours[n:, n:]
    point = [run[f"plant.{name}"][-1] for name in states[:3]]
    stage = _quotients(rates, np.array([*point, y.command]))
    step = linalg.expm(np.vstack((stage, np.zeros((1, 4)))) * h)
    measured = np.zeros((len(inputs), 3))
    measured[inputs.index("position"), 0] = measured[inputs.index("velocity"), 1] = plant.l_p
    closed = np.block([[step[:3, :3] + step[:3, 3:] @ D @ measured, step[:3, 3:] @ C], [B @ measured, A]])
    expected = float(np.max(np.abs(np.linalg.eigvals(closed))))
    _, found = loop_margins(system, at=at)
    assert found.stable
    assert found.spectral_radius == pytest.approx(expected, abs=1e-4)


def _record(kind: type[Any], values: Any) -> Any:
    return kind(**unflatten(kind, iter([float(value) for value in values])))


def _quotients(function: Any, point: NDArray[np.float64]) -> NDArray[np.float64]:
    columns: list[NDArray[np.float64]] = []
    for i, value in enumerate(point):
        size = max(1e-7 * abs(value), 1e-10)
        up, down = point.copy(), point.copy()
        up[i], down[i] = value + size, value - size
        columns.append((function(up) - function(down)) / (up[i] - down[i]))
    return np.array(columns).T


def test_rounding_makes_no_states(native: Path) -> None:
    """The integrator of the controller at rest, where friction is a spring: stable, though by little."""
    system = read_system(STUDIES / "shams2010" / "csmc_5sin.toml", fmus=native)
    loop, found = loop_margins(system, at=0.0)
    assert len(loop.A) == 3
    assert found.stable
    assert found.spectral_radius == pytest.approx(0.99999875, abs=1e-8)


def test_margins_refuse_what_they_do_not_cover(native: Path, frictionless: System) -> None:
    with pytest.raises(DescriptionError, match=r"trajectory is no part of a loop with plant"):
        loop_margins(frictionless, at=0.0, controller="trajectory")
    with pytest.raises(DescriptionError, match=r"plant\.position has no derivative at t = 0 s: it is rounded"):
        loop_margins(frictionless.changed({"plant.position_resolution": 1e-8}), at=0.0)
    rounded = frictionless.changed({"controller.sensor_resolution": 1e-5})
    with pytest.raises(DescriptionError, match=r"command does not change with position of plant"):
        loop_margins(rounded, at=0.0)


def test_a_plant_without_derivatives_is_named(native: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*given: object) -> None:
        raise CallError("fmu", "fmi2GetDirectionalDerivative", time=0.0, status="Error", message="")

    monkeypatch.setattr(Simulation, "partial_derivatives", fails)
    with pytest.raises(DescriptionError, match=r"NominalStage gives no partial derivatives.*Ask its maker for"):
        linearize(native / "NominalStage.fmu")


def test_the_rest_of_a_loop_is_its_controller(frictionless: System) -> None:
    """PI on the NCT's slope and the difference: C(z) in closed form, its sign that of the measured position."""
    K_P, K_I, alpha = 300.0, 4e4, REFERENCE_RATE[1] / REFERENCE_ERROR[1]
    system = frictionless.changed({"controller.K_P": K_P, "controller.K_I": K_I})
    found = rest_of_loop(system, "plant", "command", "controller").linear(0.0)
    omega = np.array([10.0, 300.0, 5000.0])
    z = np.exp(1j * omega * T_S)
    rate = alpha + (1.0 - 1.0 / z) / T_S
    expected = -(K_P + K_I * T_S * z / (z - 1.0)) * rate
    assert found.response(omega)[:, 0, 0] == pytest.approx(expected, rel=1e-4)
    with pytest.raises(DescriptionError, match="not linear"):
        rest_of_loop(frictionless, "plant", "command", "controller").linear(0.0, 1e-3)


# Known loops and responses


def test_states_that_a_relation_ties_are_left_out() -> None:
    """Angle and bristle of a stage at rest: both are the integral of the speed, so two states say everything."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, -2.0, -5.0], [0.0, 1.0, 0.0]])
    model = StateSpace(A, np.array([[0.0], [3.0], [0.0]]), np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 1)))
    less = model.reduced()
    assert len(less.A) == 2
    omega = np.array([0.5, 3.0, 40.0])
    assert less.response(omega) == pytest.approx(model.response(omega))
    assert np.sort_complex(less.poles) == pytest.approx(np.sort_complex(np.roots([1.0, 2.0, 5.0])))


def test_the_delay_margin_is_that_of_all_crossovers() -> None:
    """1000/(s (s + 5)) beside a resonance at 2000 rad/s of gain 1.5: it decides about the delay alone."""
    omega_0, zeta = 2000.0, 0.02
    A = np.zeros((4, 4))
    A[0, 0], A[1, 0] = -5.0, 1.0
    A[2, 3], A[3, 2], A[3, 3] = 1.0, -(omega_0**2), -2.0 * zeta * omega_0
    B = np.array([[1000.0], [0.0], [0.0], [1.5 * 2.0 * zeta * omega_0]])
    plant = StateSpace(A, B, np.array([[0.0, 1.0, 0.0, 1.0]]), np.zeros((1, 1)))
    loop = plant.held(1e-4)
    found = margins(loop)
    omega = np.geomspace(1.0, 2e4, 400_000)
    L = loop.response(omega)[:, 0, 0]
    over = np.abs(L) >= 1.0
    crossed = np.flatnonzero(over[:-1] != over[1:])
    assert len(crossed) > 1
    delays = (np.angle(L[crossed]) + math.pi) % (2.0 * math.pi) / omega[crossed]
    assert found.stable
    assert found.delay == pytest.approx(float(np.min(delays)), rel=1e-3)
    assert found.delay < 0.5 * found.phase / found.crossover


def test_a_response_that_no_small_linear_controller_has_is_refused() -> None:
    """A pulse that comes after the samples of which the model is made."""
    markov = np.zeros((80, 1))
    markov[:2, 0], markov[70, 0] = 1.0, 0.5
    assert len(realize(markov[:61], 1e-3, "controller").A) == 1
    with pytest.raises(DescriptionError, match=r"controller: the answer .* order up to 12"):
        realize(markov, 1e-3, "controller")


def test_margins_of_a_known_loop() -> None:
    """k/(z - 1) with k = 0.5: stable to k = 2 at the Nyquist frequency; phase of 1/(z - 1) is -pi/2 - omega*T/2."""
    loop = StateSpace(np.array([[1.0]]), np.array([[1.0]]), np.array([[0.5]]), np.zeros((1, 1)), T_s=0.1)
    found = margins(loop)
    crossover = 2.0 * math.asin(0.25) / 0.1
    assert found.stable
    assert found.gain == pytest.approx(4.0, rel=1e-3)
    assert found.gain_frequency == pytest.approx(math.pi / 0.1, rel=1e-3)
    assert found.crossover == pytest.approx(crossover, rel=1e-3)
    assert found.phase == pytest.approx(0.5 * math.pi - 0.05 * crossover, rel=1e-3)
    assert found.delay == pytest.approx(found.phase / crossover, rel=1e-3)
    assert found.spectral_radius == pytest.approx(0.5)
    assert not margins(
        series(StateSpace(*(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[5.0]]))), loop)
    ).stable


def test_a_constant_of_motion_does_not_count_as_unstable_but_a_hidden_growth_does() -> None:
    """The loop of the test above beside a state that nothing drives and whose value the output adds."""
    for hidden, stable in ((1.0, True), (1.1, False)):
        A, B = np.array([[1.0, 0.0], [0.0, hidden]]), np.array([[1.0], [0.0]])
        found = margins(StateSpace(A, B, np.array([[0.5, 1.0]]), np.zeros((1, 1)), T_s=0.1))
        assert found.stable is stable
        assert found.spectral_radius == pytest.approx(0.5 if stable else hidden)


def test_realization_of_a_known_response() -> None:
    k = np.arange(61)
    markov = np.where(k == 0, 2.0, 3.0 * 0.8 ** np.maximum(k - 1, 0) + 1.0)
    model = realize(markov, 1e-3)
    assert model.A.shape == (2, 2)
    assert sorted(model.poles.real) == pytest.approx([0.8, 1.0])
    assert model.D[0, 0] == 2.0
