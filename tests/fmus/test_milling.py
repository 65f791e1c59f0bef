"""Cutting force: against the surface kept in bins, closed forms and the published figures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import reference

from cosim.errors import DescriptionError
from fmus.physics.milling import Side, uncut_thickness
from fmus.plant.linear_motor import LinearMotor
from fmus.sources.milling_force import MillingForce

CASES = {
    "slot": MillingForce(),
    "ploughing": MillingForce(h_min=0.3e-6),
    "thin": MillingForce(h_min=0.3e-6, feed_per_tooth=0.25e-6),
    "even_teeth": MillingForce(h_min=0.9e-6, run_out=0.01e-6),
    "one_tooth": MillingForce(h_min=0.3e-6, run_out=0.6e-6),
}


@pytest.mark.parametrize("name", CASES)
def test_force_and_chip_are_those_of_a_surface_kept_in_bins(name: str):
    expected = reference("milling")[name]
    revolution = 1.0 / 192.0
    times = (np.arange(len(expected)) + 0.5) / 360.0 * revolution
    got = np.array([list(CASES[name].output(float(t))) for t in times])
    # Rounding of the bins: 1e-12 of a chip of 1 um, and of a force of 0.1 N.
    assert np.max(np.abs(got[:, 2:] - expected[:, 2:])) < 1e-18
    assert np.max(np.abs(got[:, :2] - expected[:, :2])) < 1e-12


def test_published_figures_of_the_slot():
    times = (np.arange(720) + 0.5) / 720.0 / 192.0
    x, y = np.array([list(CASES["slot"].output(float(t)))[:2] for t in times]).T

    def harmonic(n: int) -> float:
        return float(2.0 * abs(np.mean(x * np.exp(-2j * np.pi * 192.0 * n * times))))

    found = [x.mean(), y.mean(), x.min(), x.max(), harmonic(1), harmonic(2), harmonic(4)]
    # Figures of an earlier simulation of 720 bins, rounded; 1 % of each, half a digit of the last harmonic.
    assert found == pytest.approx([-0.0542, 0.0892, -0.2152, 0.0993, 0.0596, 0.1059, 0.0048], rel=0.01, abs=5e-5)


@given(
    advance=st.floats(1e-9, 5e-6),
    run_out=st.floats(0.0, 2e-6),
    h_min=st.floats(0.0, 2e-6),
    passages=st.integers(1, 40),
)
def test_chip_equals_the_history_of_one_angle(advance: float, run_out: float, h_min: float, passages: int):
    offset = (run_out, -run_out)
    surface = run_out
    margin = math.inf
    chip = 0.0
    for n in range(1, passages + 1):
        tooth = n % 2
        surface -= advance
        h = offset[tooth] - surface
        chip = max(0.0, h)
        margin = min(margin, abs(h - h_min), abs(h))
        if h >= h_min and h > 0.0:
            surface = offset[tooth]
    # On the limit between cutting and ploughing rounding decides; both are right there.
    if margin > 1e-15:
        assert uncut_thickness(advance, float(passages), run_out, h_min) == pytest.approx(chip, abs=1e-18)


@given(phi=st.floats(0.01, 3.13), run_out=st.floats(0.0, 2e-6), tooth=st.sampled_from([0, 1]))
def test_without_ploughing_the_chip_is_the_least_of_four_passages(phi: float, run_out: float, tooth: int):
    a = 1e-6 * math.sin(phi)
    own = run_out if tooth == 0 else -run_out
    expected = max(0.0, min(q * a + own - (own if q % 2 == 0 else -own) for q in range(1, 5)))
    passage = 10.0 if tooth == 0 else 11.0
    assert uncut_thickness(a, passage, run_out, 0.0) == pytest.approx(expected, abs=1e-18)


@given(advance=st.floats(1e-8, 5e-6), run_out=st.floats(0.0, 2e-6))
def test_two_passages_remove_what_two_feeds_bring(advance: float, run_out: float):
    chips = [uncut_thickness(advance, n, run_out, 0.0) for n in (8.0, 9.0)]
    assert sum(chips) == pytest.approx(2.0 * advance, rel=1e-9)


def test_table_gets_the_opposite_force():
    tool, table = MillingForce(), MillingForce(side=Side.table)
    for t in (1e-4, 1.3e-3, 4e-3):
        a, b = tool.output(t), table.output(t)
        assert (a.force_x, a.force_y) == (-b.force_x, -b.force_y)
        assert a.uncut_thickness == b.uncut_thickness


def test_no_force_before_the_start_and_without_feed():
    late = MillingForce(start_time=1.0)
    assert list(late.output(0.999)) == [0.0] * 4
    assert list(late.output(1.001)) == pytest.approx(list(MillingForce().output(0.001)), rel=1e-9)
    idle = MillingForce(feed_per_tooth=0.0, h_min=0.3e-6)
    assert {abs(value) for k in range(500) for value in idle.output(k * 3e-5)} == {0.0}


def test_a_tooth_cuts_only_between_entry_and_exit():
    source = MillingForce(entry_angle=1.0, exit_angle=2.0, run_out=0.0)
    period = 1.0 / 192.0
    for angle in np.linspace(0.0, 2.0 * math.pi, 200):
        chip = source.output(float(3.0 * period + angle / (2.0 * math.pi) * period)).uncut_thickness[0]
        assert (chip > 0.0) == (1.0 < angle < 2.0)


def test_force_is_continuous_without_ploughing():
    x = np.array([CASES["slot"].output(k * 1e-6).force_x for k in range(5400)])
    # The steepest is the entry: 2 um of chip come in 1.3 ms, and the force rises with the power 0.65 of it.
    assert np.max(np.abs(np.diff(x))) < 3.0 * 0.2 * (1e-6 / 1.3e-3) ** 0.65


def test_exit_before_entry_is_refused():
    for kind in (MillingForce, LinearMotor):
        with pytest.raises(DescriptionError, match="exit_angle must not be below entry_angle"):
            kind(entry_angle=2.0, exit_angle=1.0)
