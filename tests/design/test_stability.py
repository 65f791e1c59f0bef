"""Stability: Jury's test against roots, closed form, two inertias, practical limits, maps; linear models."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from nctf_reference import LARGEST_DAMPING

from cosim.commands.cli import main
from cosim.design.linearize import StateSpace, linearize, plot_bode
from cosim.design.margins import loop_margins
from cosim.design.stability import (
    Case,
    characteristic_polynomial,
    closed_form_limits,
    judge,
    jury_stable,
    limit_map,
    linear_gain_limit,
    linear_limits,
    nctf_spectral_radius,
    oscillation,
    plot_limit_map,
    practical_limit,
    read_map,
    search_limit,
)
from cosim.errors import DescriptionError
from cosim.master.simulation import Simulation, simulate
from cosim.system.system import System, read_system
from fmus.plant.compliant_ballscrew import CompliantBallscrew

STUDY = Path(__file__).parents[2] / "studies" / "maeda2008"
SMALL = {"trajectory.amplitude": 1e-5, "controller.K_I": 0.0}
T_S = 2e-4


# Linear limits


def test_jury_agrees_with_roots() -> None:
    rng = np.random.default_rng(1)
    stable = 0
    for zeta, W, a in 10.0 ** rng.uniform((-2.0, -2.0, -3.0), (2.0, 0.0, 0.0), (3000, 3)):
        polynomial = characteristic_polynomial(zeta, W, a)
        inside = bool(np.max(np.abs(np.roots(polynomial))) < 1.0)
        stable += inside
        assert jury_stable(polynomial) == inside
    assert 300 < stable < 2700


@pytest.mark.parametrize(
    ("coefficients", "stable"), [((1.0, -0.5), True), ((1.0, -1.5), False), ((2.0, 0.0, 1.9), True)]
)
def test_jury_of_known_polynomials(coefficients: tuple[float, ...], stable: bool) -> None:
    assert jury_stable(coefficients) is stable


def test_polynomial_is_that_of_the_sampled_loop() -> None:
    """Eigenvalues of the loop assembled from plant, difference and integrator are the polynomial's roots."""
    alpha, zeta, W = 505.0, 1.3, 0.22
    K = 32.3e-3
    plant = StateSpace(
        np.array([[0.0, 1.0], [0.0, -alpha]]), np.array([[0.0], [alpha * K]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))
    )
    K_P, K_I = 2.0 * zeta * W / T_S / (alpha * K), (W / T_S) ** 2 / (alpha * K)
    radius = nctf_spectral_radius(plant, K_P=K_P, K_I=K_I, alpha=alpha, T_s=T_S)
    roots = np.roots(characteristic_polynomial(zeta, W, alpha * T_S))
    assert radius == pytest.approx(np.max(np.abs(roots)), rel=1e-9)


@pytest.mark.parametrize(("W", "closed", "sampled"), LARGEST_DAMPING)
def test_largest_stable_damping_ratio(W: float, closed: float, sampled: float) -> None:
    assert closed_form_limits(W)[1] == pytest.approx(closed, rel=1e-3)
    assert linear_limits(W, 0.101)[1] == pytest.approx(sampled, rel=1e-3)


def test_closed_form_is_the_limit_of_jury_for_a_fast_sampled_plant() -> None:
    for W in (0.05, 0.3, 0.8):
        assert linear_limits(W, 1e-7) == pytest.approx(closed_form_limits(W), rel=1e-5)


def test_smallest_stable_damping_ratio_and_no_stable_one() -> None:
    assert closed_form_limits(0.25)[0] == pytest.approx(0.065, abs=5e-4)
    assert linear_limits(0.25, 0.101)[0] == pytest.approx(0.055, abs=5e-4)
    beyond = 2.0 * math.sqrt(2.0) - 2.0 + 1e-3
    assert all(math.isnan(value) for value in (*closed_form_limits(beyond), *closed_form_limits(2.5)))
    assert math.isnan(linear_limits(beyond, 1e-7)[1])


# Linear models of FMUs


@pytest.fixture(scope="module")
def frictionless(native: Path) -> System:
    still = {"plant.F_C": 0.0, "plant.F_S": 0.0, "trajectory.amplitude": 1e-7, "controller.sensor_resolution": 0.0}
    return read_system(STUDY / "step.toml", still, fmus=native)


def test_state_space_is_that_of_the_two_inertias(frictionless: System) -> None:
    model = linearize(frictionless, instance="plant", inputs=["command"], outputs=["position"]).reduced()
    J, m, l_p, K_n, C_n, K_m, s_2 = 1.81e-4, 3.57, 2e-3 / (2.0 * math.pi), 8.3e5, 1700.0, 0.172, 9.7e-4
    assert model.states == ("state.position", "state.velocity", "deflection", "state.speed")
    expected = [
        [0.0, 1.0, 0.0, 0.0],
        [0.0, -C_n / m, K_n / m, C_n * l_p / m],
        [0.0, -1.0, 0.0, l_p],
        [0.0, C_n * l_p / J, -K_n * l_p / J, -(s_2 + C_n * l_p**2) / J],
    ]
    np.testing.assert_allclose(model.A, expected, rtol=1e-9, atol=1e-12)
    assert model.B[:, 0] == pytest.approx([0.0, 0.0, 0.0, K_m / J])


def test_state_space_with_friction_is_that_of_difference_quotients(native: Path) -> None:
    """At a point of the motion with all bristles deflected: derivatives read after small changes of the state."""
    system = read_system(STUDY / "step.toml", {"trajectory.amplitude": 1e-4}, fmus=native)
    model = linearize(system, instance="plant", at=0.01)
    with Simulation(system) as simulation:
        simulation.restore(simulation.pause(0.01))
        names = model.states
        here = [simulation.value("plant", name) for name in names]
        current = simulation.value("plant", "command")
    plant = CompliantBallscrew()

    def rates(values: list[float]) -> np.ndarray:
        state = CompliantBallscrew.State(
            position=values[0],
            velocity=values[1],
            deflection=values[2],
            speed=values[3],
            bristle=values[4],
            guide_bristle=values[5],
        )
        moved = plant.derivative(0.01, state, CompliantBallscrew.Input(command=current))
        return np.array(list(moved)[: len(names)])

    for i, name in enumerate(names):
        size = max(abs(here[i]), 1e-9) * 1e-6
        up, down = list(here), list(here)
        up[i], down[i] = here[i] + size, here[i] - size
        quotient = (rates(up) - rates(down)) / (2.0 * size)
        assert model.A[:, i] == pytest.approx(quotient, rel=1e-5, abs=1e-6 * float(np.max(np.abs(quotient)) + 1e-9)), (
            name
        )


@pytest.mark.parametrize(("delay", "limit"), [(0, 653.1), (1, 571.8)])
def test_ultimate_gain_of_the_two_inertias_without_friction(frictionless: System, delay: int, limit: float) -> None:
    model = linearize(frictionless, instance="plant", inputs=["command"], outputs=["position"]).reduced()
    assert linear_gain_limit(model, alpha=505.0, T_s=T_S, delay=delay) == pytest.approx(limit, rel=5e-3)
    # The controller FMU, realized from its response, says the same: gain times gain margin.
    start = {"controller.K_P": 400.0, "controller.K_I": 0.0, "controller.compute_delay": delay}
    _, found = loop_margins(frictionless, at=0.0, start=start)
    assert found.stable
    assert 400.0 * found.gain == pytest.approx(limit, rel=5e-3)


def test_an_fmu_alone_is_linear_where_it_starts(native: Path) -> None:
    model = linearize(native / "NominalStage.fmu", start={"alpha": 100.0, "K": 2e-3}, inputs=["command"])
    np.testing.assert_allclose(model.A, [[0.0, 1.0], [0.0, -100.0]])
    np.testing.assert_allclose(model.B, [[0.0], [0.2]])
    assert sorted(model.poles.real) == [-100.0, 0.0]
    omega = np.array([1.0, 100.0, 3000.0])
    expected = 0.2 / (1j * omega * (1j * omega + 100.0))
    assert model.response(omega)[:, 0, 0] == pytest.approx(expected)
    ours = model.to_control()
    assert isinstance(ours, control.StateSpace)
    assert np.asarray(ours(1j * omega[1]))[0, 0] == pytest.approx(expected[1])
    sampled = model.held(0.01)
    assert sampled.A[1, 1] == pytest.approx(math.exp(-1.0))


def test_a_saturated_command_moves_nothing(native: Path) -> None:
    model = linearize(STUDY / "step.toml", instance="plant", at=0.01, inputs=["command"], fmus=native)
    assert not np.any(model.B)
    assert model.idle_inputs == ("command",)
    with pytest.raises(DescriptionError, match=r"plant\.command changes nothing at t = 0\.01 s, so there is no loop"):
        loop_margins(STUDY / "step.toml", at=0.01, fmus=native)


def test_the_command_notes_an_input_that_moves_nothing(native: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = [
        "linearize",
        str(STUDY / "step.toml"),
        "--inputs",
        "command",
        "--outputs",
        "position",
        "--fmus",
        str(native),
    ]
    assert main([*given, "--at", "0.01", "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["notes"] == ["command changes nothing here: it is saturated or switched off."]
    assert "note: command changes nothing" in captured.err
    assert main([*given, "--at", "0", "--set", "trajectory.amplitude=1e-7", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["notes"] == []


def test_bode_picture(frictionless: System, tmp_path: Path) -> None:
    plot_bode(tmp_path / "bode.png", linearize(frictionless, instance="plant", inputs=["command"]))
    assert (tmp_path / "bode.png").stat().st_size > 5000


# The detector


def signals(kind: str) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(3000) * T_S
    ring = np.sin(2.0 * math.pi * 100.0 * time)
    return time, {
        "sustained": 1e-6 * ring,
        "drifting": 1e-6 * ring + 1e-4 * time,
        "small": 1e-8 * ring,
        "decaying": 1e-4 * ring * np.exp(-10.0 * time),
        "creep": 1e-5 * np.exp(-0.5 * (1.0 - time)) * (1.0 + time) ** 3,
    }[kind]


@pytest.mark.parametrize(
    ("kind", "sustained"),
    [("sustained", True), ("drifting", True), ("small", False), ("decaying", False), ("creep", False)],
)
def test_detector(kind: str, sustained: bool) -> None:
    assert oscillation(*signals(kind)).sustained is sustained


def test_detector_measures_size_and_frequency() -> None:
    found = oscillation(*signals("drifting"))
    assert found.size == pytest.approx(2e-6, rel=0.06)  # the trend takes a little of the sine
    assert found.frequency == pytest.approx(100.0, abs=4.0)


def test_search_finds_the_first_limit_of_the_scan() -> None:
    asked: list[float] = []

    def oscillates(gain: float) -> bool:
        asked.append(gain)
        return gain > 7.3 and not 9.5 < gain < 11.0

    limit = search_limit(oscillates, 1.0, 100.0)
    assert limit.stable <= 7.3 < limit.unstable < 1.005 * limit.stable
    assert limit.runs == len(asked) < 30
    assert math.isnan(search_limit(lambda gain: True, 1.0, 2.0).stable)
    assert math.isnan(search_limit(lambda gain: False, 1.0, 2.0).unstable)


# Practical limits


@pytest.mark.parametrize(("delay", "limit"), [(0, 2395.0), (1, 1832.0)])
def test_ultimate_gain(native: Path, delay: int, limit: float) -> None:
    overrides = SMALL | {"controller.compute_delay": delay}
    found = practical_limit(STUDY / "step.toml", overrides, first=1000.0, fmus=native)
    assert found.value == pytest.approx(limit, rel=0.03)
    assert found.unstable / found.stable < 1.006


def test_limit_cycle(native: Path) -> None:
    overrides: dict[str, Any] = SMALL | {"controller.K_P": 2600.0}
    result = simulate(read_system(STUDY / "step.toml", overrides, fmus=native, stop_time=0.6))
    found = judge(result, "plant.position")
    assert found.sustained
    assert found.size == pytest.approx(7.0e-6, rel=0.05)
    assert found.frequency == pytest.approx(110.0, abs=10.0)


def test_map_of_the_reference(native: Path, tmp_path: Path) -> None:
    limits = {0.05: 78.0, 0.1: 38.2, 0.2: 17.9, 0.25: 13.5, 0.3: 10.3}
    case = Case("nominal", {"trajectory.amplitude": 1e-5}, tuple(limits), 505.0, first=1500.0)
    seen: list[tuple[int, int]] = []
    found = limit_map(
        STUDY / "step.toml", [case], K=32.3e-3, fmus=native, progress=lambda done, total: seen.append((done, total))
    )
    assert seen == [(i + 1, 6) for i in range(6)]
    for point in found.points:
        assert point.found == pytest.approx(limits[point.W], rel=0.05)
        assert point.practical == pytest.approx(2400.0 * 505.0 * 32.3e-3 * T_S / (2.0 * point.W), rel=0.03)
        assert 3.9 < point.practical / point.linear < 4.5
        assert not point.starts_unstable
    plot_limit_map(found, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("name", "gains"),
    [("friction", (645.0, 1817.0, 2400.0, 2900.0)), ("inclination", (3870.0, 2400.0, 1520.0, 980.0))],
)
def test_ultimate_gains_of_the_shipped_maps(native: Path, name: str, gains: tuple[float, ...]) -> None:
    """The figures of the independent simulation for cases 2 and 3; their W are left to the benchmark."""
    file = read_map(STUDY / "limits" / f"{name}.toml", fmus=native)
    assert sum(len(case.W) for case in file.cases) == 18
    for case, gain in zip(file.cases, gains, strict=True):
        found = practical_limit(
            file.system, {**case.overrides, "controller.K_I": 0.0}, first=0.8 * gain, last=1.3 * gain
        )
        assert found.value == pytest.approx(gain, rel=0.03), case.name


def test_map_files_are_checked(native: Path, tmp_path: Path) -> None:
    file = tmp_path / "map.toml"
    file.write_text('system = "a.toml"\nalfa = 1.0\n[cases.one]\nWs = [1.0]\n', encoding="utf-8")
    with pytest.raises(DescriptionError) as refusal:
        read_map(file, fmus=native)
    for text in ("alfa: unknown key", "Did you mean 'alpha'", "alpha: missing", "cases.one.Ws: unknown key"):
        assert text in str(refusal.value)
