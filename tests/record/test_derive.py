"""Derivatives of records: exact for the polynomials that a method promises, known for a sine, refused otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.errors import DescriptionError
from cosim.record.derive import derivative_name, derivative_unit, differences, smoothed
from cosim.units import parse_unit

TIME = np.arange(200) * 1e-3
UNEVEN = np.cumsum(np.tile([1e-3, 2e-3, 1.5e-3], 40))


@pytest.mark.parametrize("time", [TIME, UNEVEN, 5.0 + TIME])
def test_differences_are_exact_for_a_parabola(time: np.ndarray) -> None:
    values = 3.0 - 2.0 * time + 7.0 * time**2
    assert differences(time, values, 1) == pytest.approx(-2.0 + 14.0 * time, rel=1e-9)
    assert differences(time, values, 2) == pytest.approx(np.full(time.size, 14.0), rel=1e-6)


def test_differences_are_of_second_order() -> None:
    """Halving the step divides the error by four: f''' of a sine is known."""
    errors: list[float] = []
    for n in (100, 200, 400):
        time = np.linspace(0.0, 1.0, n + 1)
        found = differences(time, np.sin(6.0 * time), 1) - 6.0 * np.cos(6.0 * time)
        errors.append(float(np.max(np.abs(found[1:-1]))))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.02)
    # h^2/6 * 6^3 at 100 steps
    assert errors[0] == pytest.approx(1e-4 / 6.0 * 216.0, rel=0.02)


@pytest.mark.parametrize("order", [1, 2])
def test_polynomials_of_the_fitted_degree_pass_unchanged_up_to_the_ends(order: int) -> None:
    polynomial = np.polynomial.Polynomial([1.0, -2.0, 30.0, 400.0])
    found = smoothed(TIME, polynomial(TIME), order, window=11e-3, polynomial=3)
    assert found == pytest.approx(polynomial.deriv(order)(TIME), rel=1e-7, abs=1e-7)


def test_smoothing_takes_noise_away() -> None:
    time = np.arange(20000) * 1e-3
    noise = np.random.Generator(np.random.PCG64(1)).standard_normal(time.size) * 1e-6
    rough = differences(time, noise, 1)
    smooth = smoothed(time, noise, 1, window=21e-3, polynomial=2)
    # Variances of both filters for white noise: 1/(2 h^2), and 12/((n^2-1) n h^2) with n samples (Savitzky and Golay).
    expected = np.sqrt(12.0 / ((21**2 - 1) * 21.0) / 0.5)
    assert np.std(smooth) / np.std(rough) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("time", "window", "polynomial", "order", "text"),
    [
        (UNEVEN, 0.02, 3, 1, "smoothing needs equally spaced samples"),
        (TIME, 1e-3, 3, 1, "smoothing.window = 0.001 s holds 1 samples of 0.001 s"),
        (TIME, 0.01, 1, 2, "a degree of at least 2"),
        (TIME, 0.5, 3, 1, "smoothing.window = 0.5 s is longer than the record, 200 samples"),
    ],
)
def test_smoothing_that_cannot_be(time: np.ndarray, window: float, polynomial: int, order: int, text: str) -> None:
    with pytest.raises(DescriptionError, match=text):
        smoothed(time, np.sin(time), order, window=window, polynomial=polynomial)


def test_two_samples_have_no_derivative() -> None:
    with pytest.raises(DescriptionError, match="2 samples: derivatives need at least 3"):
        differences(TIME[:2], TIME[:2], 1)


@pytest.mark.parametrize(
    ("unit", "first", "second"),
    [
        ("m", "m/s", "m/s2"),
        ("N.m", "N.m/s", "N.m/s2"),
        ("m/s", "m/s2", "m/s3"),
        ("N.m/(rad.s)", "N.m/(rad.s2)", "N.m/(rad.s3)"),
        ("1", "1/s", "1/s2"),
        ("degC", "", ""),
        ("counts", "", ""),
        ("", "", ""),
    ],
)
def test_units_of_derivatives(unit: str, first: str, second: str) -> None:
    assert (derivative_unit(unit, 1), derivative_unit(unit, 2)) == (first, second)
    if first:
        per_second = parse_unit("1/s")
        assert parse_unit(first).matches(parse_unit(unit).times(per_second))
        assert parse_unit(second).matches(parse_unit(unit).times(per_second).times(per_second))


def test_names_of_derivatives_are_those_of_fmi() -> None:
    assert (derivative_name("x", 1), derivative_name("x", 2)) == ("der(x)", "der(x,2)")
