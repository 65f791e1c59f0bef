"""What a fit says about its values: intervals under white and coloured residuals, repeatability, noise of a record."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cosim.design.fit_statistics import Block, agreement, fast_noise, memory, peaks, repeatability, spread, untold


def coloured(random: np.random.Generator, count: int, pole: float) -> np.ndarray:
    """First-order noise of variance 1."""
    white = random.standard_normal(count)
    found = np.empty(count)
    found[0] = white[0]
    for k in range(1, count):
        found[k] = pole * found[k - 1] + math.sqrt(1.0 - pole**2) * white[k]
    return found


def never(direction: np.ndarray) -> np.ndarray:
    raise AssertionError("no direction is faint")


def nothing(direction: np.ndarray) -> np.ndarray:
    return np.zeros(500)


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_standard_deviations_are_those_of_repeated_fits(pole: float) -> None:
    random = np.random.default_rng(0)
    count = 2000
    J = 100.0 * np.column_stack([np.sin(np.arange(count) / 50.0), np.ones(count)])
    blocks = [Block("a", "x", slice(0, count))]
    found, said = [], []
    for _ in range(200):
        noise = coloured(random, count, pole)
        found.append(np.linalg.lstsq(J, noise, rcond=None)[0])
        said.append(spread(("a", "b"), blocks, noise - J @ found[-1], J, never).deviation)
    real, told = np.std(found, axis=0), np.median(said, axis=0)
    # 200 fits tell a standard deviation to 5 %; the correlation over time is estimated, too, and a little short.
    assert told == pytest.approx(real, rel=0.25)


def test_a_direction_that_nothing_depends_on_is_named() -> None:
    random = np.random.default_rng(1)
    column = random.standard_normal(500)
    J = 1e3 * np.column_stack([column, 2.0 * column, random.standard_normal(500)])
    off = random.standard_normal(500)
    known = spread(("a", "b", "c"), [Block("r", "x", slice(0, 500))], off, J, nothing)
    assert [set(weak.names) for weak in known.weak] == [{"a", "b"}]
    assert np.isinf(known.deviation).tolist() == [True, True, False]
    assert untold(J, nothing) == [0]


def test_a_larger_step_unmasks_a_direction_that_is_only_noise_of_the_runs() -> None:
    random = np.random.default_rng(1)
    column = random.standard_normal(500)
    # Differences of runs carry errors of integration: the second column seems to tell something of its own.
    J = 1e5 * np.column_stack([column, column]) + 1e2 * random.standard_normal((500, 2))
    assert untold(J, lambda direction: J @ direction) == []
    # The real change along the direction, which is a little off: what is left belongs to the strong direction.
    assert len(untold(J, lambda direction: 1e5 * np.column_stack([column, column]) @ direction)) == 1


@pytest.mark.parametrize(("pole", "least", "most"), [(0.0, 0, 3), (0.9, 15, 60)])
def test_memory_of_residuals(pole: float, least: int, most: int) -> None:
    found = memory(coloured(np.random.default_rng(2), 5000, pole))
    assert least <= found <= most


def test_noise_of_a_record_is_found_below_its_motion() -> None:
    t = 1e-3 * np.arange(4000)
    motion = 1e-3 * np.sin(2.0 * math.pi * 1.0 * t) + 1e-3 * (t > 2.0)
    noise = 1e-8 * np.random.default_rng(0).standard_normal(len(t))
    # Third differences of a sine of 1 Hz at 1 kHz are 2.5e-7 of it, a hundredth of those of the noise.
    assert fast_noise(motion + noise) == pytest.approx(1e-8, rel=0.1)


def test_repeatability_is_the_difference_from_lap_to_lap() -> None:
    t = 1e-3 * np.arange(4001)
    signal = np.sin(2.0 * math.pi * t)
    assert repeatability(t, signal, 1.0) == pytest.approx(0.0, abs=1e-9)
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(t))
    assert repeatability(t, signal + noise, 1.0) == pytest.approx(0.01 * math.sqrt(2.0), rel=0.05)
    assert math.isnan(repeatability(t[:900], signal[:900], 1.0))


def test_figures_of_a_comparison() -> None:
    measured, expected = np.array([1.0, -1.0, 1.0, -1.0]), np.array([1.0, -1.0, 1.0, -0.6])
    figures = agreement(measured, expected)
    assert figures["rms"] == pytest.approx(0.2)
    assert figures["largest"] == pytest.approx(0.4)
    assert figures["relative"] == pytest.approx(20.0)
    assert figures["fit"] == pytest.approx(80.0)
    assert agreement(measured, expected, measured - 0.4)["relative"] == pytest.approx(50.0)


def test_peaks_of_a_spectrum() -> None:
    t = 1e-3 * np.arange(4000)
    found = peaks(t, np.sin(2.0 * math.pi * 50.0 * t) + 0.1 * np.sin(2.0 * math.pi * 120.0 * t))
    assert [round(peak.frequency) for peak in found[:2]] == [50, 120]
    assert found[0].share > 0.95
