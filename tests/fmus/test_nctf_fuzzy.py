"""Fuzzy NCTF: published command values, quadrature and grids, recorded inputs, symmetry, closed loops."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_loops import Sampled
from nctf_reference import reference

from cosim.errors import DescriptionError
from fmus.controllers.nctf_fuzzy import NctfFuzzy, Variant
from fmus.physics.nct import (
    Defuzzification,
    centroid,
    clipped_set,
    grid_centroid,
    memberships,
    root_nct_rate,
    rule_heights,
)

EXISTING: dict[str, Any] = {
    "variant": Variant.existing,
    "defuzzification": Defuzzification.singleton,
    "K_f": 0.53,
    "h_zero": 28.36e-3,
    "u_i_zero": 0.384e-3,
}
# Subnormal numbers have too few digits to divide by.
height = st.one_of(st.sampled_from([0.0, 0.5, 1.0]), st.floats(0.0, 1.0, allow_subnormal=False))


def heights_at(u_p: float, u_i: float) -> tuple[float, float, float]:
    """Firing of the reference controller at ``u_p`` mm/s and ``u_i`` mm."""
    c = NctfFuzzy()
    first = memberships(1e-3 * u_p, c.h_max, c.h_zero)
    return rule_heights(first, memberships(1e-3 * u_i, c.u_i_max, c.u_i_zero))


@pytest.mark.parametrize(
    ("u_p", "u_i", "command"),
    [
        (0.1, 0.0, 0.708622717),
        (10.0, 0.0, 5.959152225),
        (56.72, 0.0, 7.083333333),
        (0.05, -1.0, -5.372511468),
    ],
)
def test_exact_centroid_of_the_reference_sets(u_p: float, u_i: float, command: float):
    assert centroid(heights_at(u_p, u_i), 10.0, 0.2) == pytest.approx(command, abs=1e-8)


def s_shape(x: np.ndarray) -> np.ndarray:
    """The set P over 0 ... 1, 0 below."""
    return np.where(x <= 0.0, 0.0, np.where(x <= 0.5, 2.0 * x**2, 1.0 - 2.0 * (1.0 - x) ** 2))


@given(height)
def test_area_and_moment_of_a_clipped_set_are_its_integrals(h: float):
    x = (np.arange(20_000) + 0.5) / 20_000
    m = np.minimum(h, s_shape(x))
    area, moment = clipped_set(h)
    # Midpoint rule: second derivative 4 over 24 of 2.5e-9, and the kink.
    assert area == pytest.approx(np.mean(m), abs=2e-9)
    assert moment == pytest.approx(np.mean(m * x), abs=2e-9)


@given(height, height, height, st.sampled_from([3, 5, 7, 9, 11, 101, 1001]))
def test_grid_centroid_is_the_sum_over_its_points(h_n: float, h_z: float, h_p: float, n: int):
    u = np.linspace(-1.0, 1.0, n)
    m = np.maximum(np.minimum(h_n, s_shape(-u)), np.minimum(h_p, s_shape(u)))
    m[n // 2] = h_z
    expected = 10.0 * float(m @ u) / float(np.sum(m)) if np.sum(m) > 0.0 else 0.0
    assert grid_centroid((h_n, h_z, h_p), 10.0, n) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("n", "largest"), [(101, 0.089), (201, 0.039), (401, 0.014), (1001, 0.0057), (10001, 5.7e-4)])
def test_grid_approaches_the_centroid_of_matching_weight(n: int, largest: float):
    """The figures were sampled at other points: a tenth more is allowed, and not less than half."""
    worst = max(
        abs(grid_centroid(h, 10.0, n) - centroid(h, 10.0, 20.0 / (n - 1)))
        for u_p in np.concatenate([[0.0], np.geomspace(1e-3, 56.72, 200)])
        for u_i in (0.0, 2e-4, 7e-4, 1e-2, 1.0, 20.0)
        for h in (heights_at(float(u_p), u_i),)
    )
    assert 0.5 * largest < worst < 1.1 * largest


def test_singleton_without_weight_makes_a_relay():
    assert centroid(heights_at(0.01, 0.0), 10.0, 0.0) > 4.9
    assert centroid(heights_at(0.01, 0.0), 10.0, 0.2) < 0.1
    assert centroid((0.0, 1.0, 0.0), 10.0, 0.0) == 0.0


def test_rules_are_those_of_the_table():
    sets = {"N": (1.0, 0.0, 0.0), "Z": (0.0, 1.0, 0.0), "P": (0.0, 0.0, 1.0)}
    table = {"N": "NNZ", "Z": "NZP", "P": "ZPP"}  # rows u_p, columns u_i = N, Z, P
    for row, results in table.items():
        for column, result in zip("NZP", results, strict=True):
            assert rule_heights(sets[row], sets[column]) == sets[result]


@pytest.mark.parametrize(("name", "values"), [("proposed", {}), ("existing", EXISTING)])
def test_recorded_inputs_give_the_recorded_commands(name: str, values: dict[str, Any]):
    data = reference("nctf_fuzzy_replay")
    controller = Sampled(NctfFuzzy(**values))
    signals = ("position_ref", "velocity_ref", "position", "velocity")
    commands = [
        controller(**{signal: float(data[signal][k]) for signal in signals}).command for k in range(len(data[name]))
    ]
    # 4e-14 V apart: metres here, millimetres there.
    assert np.max(np.abs(np.array(commands) - data[name])) < 1e-10
    assert np.max(np.abs(data[name])) > 5.0


@given(st.floats(-3e-3, 3e-3), st.floats(2e-5, 2e-4), st.floats(1e-3, 2e-3))
def test_nct_is_odd_continuous_and_held(error: float, e_1: float, A: float):
    shape = {"alpha": 215.2, "e_1": e_1, "A": A, "h_max": 56.72e-3}
    rate = root_nct_rate(error, **shape)
    assert root_nct_rate(-error, **shape) == -rate
    assert abs(rate) <= 56.72e-3 * (1.0 + 1e-12)
    assert root_nct_rate(A, **shape) == pytest.approx(56.72e-3)
    assert root_nct_rate(e_1 * (1.0 + 1e-9), **shape) == pytest.approx(215.2 * e_1, rel=1e-6)


signal = st.floats(-0.01, 0.01)


@given(
    st.lists(st.tuples(signal, signal, signal, signal), min_size=1, max_size=10),
    st.sampled_from(list(Variant)),
    st.sampled_from(list(Defuzzification)),
    st.floats(0.0, 2.0),
    st.floats(0.1, 3.0),
)
def test_command_is_limited_finite_and_odd(
    sequence: list[tuple[float, ...]], variant: Variant, form: Defuzzification, w_z: float, K_f: float
):
    values: dict[str, Any] = {"variant": variant, "defuzzification": form, "w_z": w_z, "K_f": K_f}
    one, other = Sampled(NctfFuzzy(**values)), Sampled(NctfFuzzy(**values))
    names = ("position_ref", "velocity_ref", "position", "velocity")
    for row in sequence:
        y = one(**dict(zip(names, row, strict=True)))
        mirrored = other(**dict(zip(names, (-value for value in row), strict=True)))
        assert all(math.isfinite(value) for value in y)
        assert abs(y.command) <= 10.0
        assert mirrored.command == pytest.approx(-y.command, abs=1e-9)


@pytest.mark.parametrize("form", list(Defuzzification))
def test_at_rest_on_target_the_command_is_zero(form: Defuzzification):
    controller = NctfFuzzy(defuzzification=form)
    assert controller.output(0.0, controller.initial(), controller.Input()).command == 0.0


def test_variants_differ_by_the_velocity_of_the_reference():
    u = NctfFuzzy.Input(position_ref=1e-5, velocity_ref=4e-3, velocity=1e-3)
    u_p = {v: NctfFuzzy(variant=v).output(0.0, NctfFuzzy.State(), u).u_p for v in Variant}
    assert u_p[Variant.proposed] == pytest.approx(215.2e-5 + 3e-3)
    assert u_p[Variant.existing] == pytest.approx(215.2e-5 - 1e-3)


@pytest.mark.parametrize(
    ("values", "text"),
    [({"grid_points": 100}, "odd"), ({"e_1": 2e-3}, "below A"), ({"e_1": 3e-4}, "alpha\\*e_1")],
)
def test_contradicting_parameters_are_refused(values: dict[str, Any], text: str):
    with pytest.raises(DescriptionError, match=text):
        NctfFuzzy(**values)
