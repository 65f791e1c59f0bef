"""Identification of the NCT: a coasting mass with its closed form, the reference ballscrew, noise, nodes, files."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from nctf_reference import module

from cosim.design.identify import (
    Nct,
    identify_nct,
    monotone,
    nct_from_signals,
    pi_gains,
    plot_nct,
    reduce_nodes,
    write_nct,
    write_start,
)
from cosim.errors import DescriptionError
from cosim.master.simulation import simulate
from cosim.system.system import read_system

STUDY = Path(__file__).parents[2] / "studies" / "maeda2008"


def coasting(step: float, *, deceleration: float = 0.08, viscous: float = 5.0, drive: float = 1.5) -> np.ndarray:
    """Rows t, u, x, v of a mass with Coulomb and viscous friction, pushed for 0.1 s: the closed form.

    While it moves der(v) = push - deceleration - viscous*v, so v goes exponentially towards its end value.
    """
    time = np.arange(round(0.6 / step) + 1) * step
    end = 0.1

    def phase(t: np.ndarray, v_0: float, push: float) -> tuple[np.ndarray, np.ndarray]:
        final = (push - deceleration) / viscous
        fade = np.exp(-viscous * t)
        return final * t + (v_0 - final) / viscous * (1.0 - fade), final + (v_0 - final) * fade

    x_1, v_1 = phase(np.array([end]), 0.0, drive)
    stop = end + math.log(1.0 + viscous * v_1[0] / deceleration) / viscous
    pushed, free, rests = time <= end, (time > end) & (time < stop), time >= stop
    x, v = np.zeros_like(time), np.zeros_like(time)
    x[pushed], v[pushed] = phase(time[pushed], 0.0, drive)
    x[free], v[free] = phase(time[free] - end, v_1[0], 0.0)
    x[free] += x_1
    x[rests] = phase(np.array([stop - end]), v_1[0], 0.0)[0] + x_1
    return np.column_stack((time, np.where(time < end - 0.5 * step, 2.0, 0.0), x, v))


def rate_at(error: float, *, deceleration: float = 0.08, viscous: float = 5.0) -> float:
    """Velocity of the coasting mass at ``error`` before its stop: error = v/c - a/c^2*ln(1 + c*v/a) solved for v."""
    low, high = 0.0, 1.0
    for _ in range(200):
        v = 0.5 * (low + high)
        way = v / viscous - deceleration / viscous**2 * math.log1p(viscous * v / deceleration)
        low, high = (v, high) if way < error else (low, v)
    return low


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_coasting_mass_gives_its_closed_form(measured: bool, direction: float) -> None:
    t, u, x, v = coasting(1e-5).T
    nct = nct_from_signals(t, direction * u, direction * x + 3.0, direction * v if measured else None, e_lin=1e-6)
    assert nct.alpha == pytest.approx(rate_at(1e-6) / 1e-6, rel=3e-3)
    inside = nct.error[1:-1]
    assert np.interp(inside, nct.error, nct.rate) == pytest.approx([rate_at(e) for e in inside], rel=3e-3)
    assert (nct.error[0], nct.rate[0]) == (0.0, 0.0)
    assert nct.u_r == direction * 2.0
    assert nct.t_r == pytest.approx(0.1)
    assert math.isclose(nct.K, x[-1] / 0.2, rel_tol=1e-9)
    assert nct.h_max == pytest.approx(np.max(v), rel=1e-4)
    assert nct_from_signals(t, u, x, v, alpha=nct.alpha).e_lin == pytest.approx(1e-6, rel=3e-3)


@pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 0.02), (2.5e-9, 0.02), (1e-8, 0.04), (1e-7, 0.15)])
def test_noisy_quantised_positions_at_5_khz_serve(noise: float, tolerance: float) -> None:
    rng = np.random.default_rng(11)
    t, u, x, _ = coasting(2e-4).T
    seen = 1.24e-9 * np.round((x + noise * rng.uniform(-1.0, 1.0, x.size)) / 1.24e-9)
    nct = nct_from_signals(t, u, seen, e_lin=2e-6)
    assert nct.alpha == pytest.approx(rate_at(2e-6) / 2e-6, rel=tolerance)
    assert np.all(np.diff(nct.rate) >= 0.0)
    far = nct.error[nct.error > 1e-4]
    assert np.interp(far, nct.error, nct.rate) == pytest.approx([rate_at(e) for e in far], rel=0.02)


# The reference ballscrew: figures of an independent simulation


@pytest.fixture(scope="module")
def reference(native: Path) -> Nct:
    return identify_nct(STUDY / "pulse.toml", alpha=505.0, fmus=native)


def test_the_reference_pulse_has_its_figures(reference: Nct) -> None:
    assert reference.rest == pytest.approx(25.8350e-3, rel=1e-4)
    assert reference.h_max == pytest.approx(134.473e-3, rel=1e-3)
    assert reference.reach == pytest.approx(18.4044e-3, rel=1e-3)
    assert reference.spring_back == pytest.approx(1.0464e-6, rel=1e-2)
    assert math.isclose(reference.K, 43.06e-3, rel_tol=1e-3)


@pytest.mark.parametrize(("alpha", "e_lin"), [(505.0, 0.6426e-6), (250.0, 2.660e-6), (1010.0, 0.1600e-6)])
def test_linear_part_of_the_reference(native: Path, alpha: float, e_lin: float) -> None:
    assert identify_nct(STUDY / "pulse.toml", alpha=alpha, fmus=native).e_lin == pytest.approx(e_lin, rel=1e-2)


def test_pulse_that_gives_the_published_gain(native: Path) -> None:
    """K = 32.3 mm/(A.s) at 6 A for 32.88 ms."""
    system = read_system(STUDY / "pulse.toml", fmus=native, step_size="2e-5")

    def gain(time: float) -> float:
        # alpha near the origin does not depend on the pulse.
        return identify_nct(system.changed({"source.dwell": time}), alpha=505.0).K

    low, high = 32.6e-3, 33.2e-3
    one, other = gain(low), gain(high)
    assert low + (32.3e-3 - one) / (other - one) * (high - low) == pytest.approx(32.88e-3, rel=5e-3)


def test_without_a_choice_the_spring_back_ends_the_linear_part(native: Path) -> None:
    nct = identify_nct(STUDY / "pulse.toml", fmus=native)
    assert nct.e_lin == nct.spring_back
    assert nct.alpha == pytest.approx(396.0, rel=1e-2)


def test_recorded_positions_of_the_reference_give_its_slope(native: Path, tmp_path: Path) -> None:
    """5 kHz, 1.24 nm, velocity from the positions: 506.4 1/s at 0.64 um in the independent simulation."""
    system = read_system(STUDY / "pulse.toml", {"plant.position_resolution": 1.24e-9}, fmus=native, step_size="2e-4")
    result = simulate(system)
    file = tmp_path / "record.csv"
    rows = np.column_stack((result.time, result["plant.command"], result["plant.position"]))
    np.savetxt(file, rows, delimiter=",", header="t,u,x", comments="", fmt="%.12g")
    assert identify_nct(file, e_lin=0.64e-6).alpha == pytest.approx(506.4, rel=5e-3)


# Nodes


def test_nodes_stay_as_near_as_those_of_the_reference_script() -> None:
    script = module("nct_table")
    error, rate = script.identified_points()
    nodes = reduce_nodes(error, rate)
    *_, worst = script.table()
    assert nodes[0].size == 128
    assert set(nodes[0]) <= set(error)
    assert np.max(np.abs(np.interp(error[1:], *nodes) / rate[1:] - 1.0)) <= worst


def test_few_points_are_filled_up_with_the_last() -> None:
    error, rate = reduce_nodes(np.array([0.0, 1.0, 2.0]), np.array([0.0, 3.0, 4.0]), 5)
    assert list(error) == [0.0, 1.0, 2.0, 2.0, 2.0]
    assert list(rate) == [0.0, 3.0, 4.0, 4.0, 4.0]


def test_monotone_is_the_nearest_sequence_that_never_falls() -> None:
    assert list(monotone(np.array([1.0, 3.0, 2.0, 2.0, 5.0]))) == pytest.approx([1.0, 7 / 3, 7 / 3, 7 / 3, 5.0])
    rng = np.random.default_rng(5)
    values = np.linspace(0.0, 1.0, 40) + 0.3 * rng.standard_normal(40)
    best = monotone(values)
    assert np.all(np.diff(best) >= 0.0)
    for _ in range(200):
        other = np.sort(best + 0.1 * rng.standard_normal(40))
        assert np.sum((best - values) ** 2) <= np.sum((other - values) ** 2)


def test_gains_are_those_of_the_reference_compensator() -> None:
    proportional, integral = pi_gains(505.0, 32.3e-3, omega_n=0.25 / 2e-4, zeta=6.264)
    assert proportional == pytest.approx(960.0, rel=1e-4)
    assert integral == pytest.approx(95791.31287741778)


# Files


def test_the_start_file_runs(reference: Nct, native: Path, tmp_path: Path) -> None:
    """A stage that steps by 1 mm with the identified NCT settles as with the shipped one."""
    (tmp_path / "step.toml").write_bytes((STUDY / "step.toml").read_bytes())
    write_start(reference, tmp_path / "start.toml", gains=(960.0, 95791.3), base="step.toml")
    assert tomllib.loads((tmp_path / "start.toml").read_text(encoding="utf-8"))["base"] == "step.toml"
    results = [
        simulate(read_system(path, {"trajectory.amplitude": 1e-3}, fmus=native, stop_time=0.3))
        for path in (tmp_path / "start.toml", STUDY / "step.toml")
    ]
    found, shipped = (result["plant.position"] for result in results)
    assert np.max(np.abs(found - shipped)) < 2e-7
    assert not np.array_equal(found, shipped)


def test_curve_and_picture(reference: Nct, tmp_path: Path) -> None:
    write_nct(reference, tmp_path / "nct.csv")
    error, rate = np.loadtxt(tmp_path / "nct.csv", delimiter=",", skiprows=1).T
    assert error == pytest.approx(reference.error, rel=1e-9)
    assert rate == pytest.approx(reference.rate, rel=1e-9)
    plot_nct(reference, tmp_path / "nct.png")
    assert (tmp_path / "nct.png").stat().st_size > 5000


# Units


@pytest.mark.parametrize(
    ("head", "scale"), [("t,u,x,v", 1.0), ("t [ms],u,x [mm],v [mm/s]", 1e3), ("t,u,x [rad],v [rad/s]", 1.0)]
)
def test_columns_count_in_their_units(tmp_path: Path, head: str, scale: float) -> None:
    t, u, x, v = coasting(2e-4).T
    wanted = nct_from_signals(t, u, x, v, e_lin=1e-6)
    columns = (t * 1e3 if "ms" in head else t, u, x * scale, v * scale)
    rows = "\n".join(",".join(repr(float(value)) for value in row) for row in zip(*columns, strict=True))
    (tmp_path / "pulse.csv").write_text(f"{head}\n{rows}\n", encoding="utf-8")
    found = identify_nct(tmp_path / "pulse.csv", e_lin=1e-6)
    assert (found.K, found.alpha, found.rest) == pytest.approx((wanted.K, wanted.alpha, wanted.rest), rel=1e-9)


@pytest.mark.parametrize(("head", "text"), [("t,u,x [N],v", "x is in N. Give"), ("t,u,x,v [m]", "v is in m. Give")])
def test_columns_of_another_kind_are_refused(tmp_path: Path, head: str, text: str) -> None:
    (tmp_path / "pulse.csv").write_text(f"{head}\n0,0,0,0\n1,1,1,1\n", encoding="utf-8")
    with pytest.raises(DescriptionError, match=f"column {re.escape(text)}"):
        identify_nct(tmp_path / "pulse.csv", e_lin=1e-6)


# What does not serve


def test_signals_that_do_not_serve_are_refused(tmp_path: Path) -> None:
    t, u, x, v = coasting(2e-4).T
    for arguments, given, text in (
        ((t, 0.0 * u, x, v), {}, "no pulse"),
        ((t, u + 1.0, x, v), {}, "no pulse"),
        ((t, np.where(t < 0.05, 1.0, u), x, v), {}, "more than one value"),
        ((t[:800], u[:800], x[:800], v[:800]), {"e_lin": 1e-6}, "still moves"),
        ((t**1.5, u, x, v), {}, "not equally spaced"),
        ((t, u, x, v), {"alpha": 1.0}, "not on the curve"),
        ((t, u, x, v), {"alpha": -1.0}, "not on the curve"),
        ((t, u, x, v), {"e_lin": 1.0}, "not on the curve"),
        ((t, u, x, v), {}, "hardly springs back"),
        ((t, u, x, v), {"e_lin": 1e-6, "alpha": 500.0}, "Give one"),
        ((t[::400], u[::400], x[::400], v[::400]), {"e_lin": 1e-6}, "too few|sample faster"),
    ):
        with pytest.raises(DescriptionError, match=text):
            nct_from_signals(*arguments, **given)
    (tmp_path / "bad.csv").write_text("t,u,y\n0,1,2\n", encoding="utf-8")
    with pytest.raises(DescriptionError, match="Give t in s"):
        identify_nct(tmp_path / "bad.csv")
