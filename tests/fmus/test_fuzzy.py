"""The nine rules against published values and against the centroid by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fmus.physics.fuzzy import centroid, nine_rules

PUBLISHED = [
    (1.0, -1.0, -0.833333333),
    (1.0, 0.0, -0.5),
    (0.0, -1.0, -0.5),
    (1.0, 1.0, 0.0),
    (0.5, -0.5, -0.310606061),
    (0.25, -0.75, -0.370726496),
    (0.5, 0.0, -0.25),
    (0.1, -0.1, -0.070700152),
    (0.01, -0.01, -0.007450781),
    (0.3, 0.2, -0.044326241),
    (-0.6, 0.1, 0.293105756),
    (0.05, 0.02, -0.02058548),
]
GRID = np.linspace(-1.0, 1.0, 40001)
PEAKS = (-1.0, -0.5, 0.0, 0.5, 1.0)
RULES = {
    ("N", "P"): "PB",
    ("N", "Z"): "PS",
    ("N", "N"): "ZO",
    ("Z", "P"): "PS",
    ("Z", "Z"): "ZO",
    ("Z", "N"): "NS",
    ("P", "P"): "ZO",
    ("P", "Z"): "NS",
    ("P", "N"): "NB",
}
"""Rules 1 to 9 as printed."""
INPUT_PEAKS = {"N": -1.0, "Z": 0.0, "P": 1.0}
OUTPUT_PEAKS = dict(zip(("NB", "NS", "ZO", "PS", "PB"), PEAKS, strict=True))

units = st.floats(-1.0, 1.0)
heights = st.floats(0.0, 1.0)


def centroid_on_grid(clipped: list[tuple[float, float]]) -> float:
    """Centroid of triangles, given as peak and height of the cut, joined by maximum; trapezoidal rule."""
    shape = np.zeros_like(GRID)
    for peak, height in clipped:
        shape = np.maximum(shape, np.minimum(np.maximum(1.0 - np.abs(GRID - peak) / 0.5, 0.0), height))
    return float(np.trapezoid(shape * GRID, GRID) / np.trapezoid(shape, GRID))


def inference_on_grid(s: float, s_c: float) -> float:
    def degree(value: float, peak: float) -> float:
        return max(0.0, 1.0 - abs(value - peak))

    fired = [
        (OUTPUT_PEAKS[out], min(degree(s, INPUT_PEAKS[one]), degree(s_c, INPUT_PEAKS[other])))
        for (one, other), out in RULES.items()
    ]
    return centroid_on_grid(fired)


@pytest.mark.parametrize(("s", "s_c", "published"), PUBLISHED)
def test_published_values(s: float, s_c: float, published: float):
    assert nine_rules(s, s_c) == pytest.approx(published, abs=1e-9)


@given(units, units)
def test_centroid_equals_brute_force(s: float, s_c: float):
    # Trapezoidal rule, spacing 5e-5: kinks cost spacing^2 each.
    assert nine_rules(s, s_c) == pytest.approx(inference_on_grid(s, s_c), abs=1e-7)


@given(st.lists(heights, min_size=5, max_size=5))
def test_centroid_of_any_heights_equals_brute_force(cuts: list[float]):
    # A lower aggregate has a smaller area to divide the same quadrature error by.
    assume(max(cuts) > 0.05)
    expected = centroid_on_grid(list(zip(PEAKS, cuts, strict=True)))
    assert centroid(*cuts) == pytest.approx(expected, abs=1e-6)


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_rules_are_odd_clipped_and_bounded(s: float, s_c: float):
    assert nine_rules(-s, -s_c) == -nine_rules(s, s_c)
    assert nine_rules(s, s_c) == nine_rules(float(np.clip(s, -1.0, 1.0)), float(np.clip(s_c, -1.0, 1.0)))
    assert abs(nine_rules(s, s_c)) <= 5.0 / 6.0 + 1e-15


@given(st.floats(1e-9, 1e-3), st.floats(-1e-3, -1e-9))
def test_slope_at_the_origin_opposes_the_surfaces(s: float, s_c: float):
    # P of s and N of s_c cut NS at the larger of both, NB at the smaller; ZO has area 1, NS twice its height h at -1/2
    # less the overlap h at -1/4.
    larger = max(s, -s_c)
    assert nine_rules(s, s_c) == pytest.approx(-0.75 * larger, rel=5e-3)
