"""No sampling instant is missed or met twice, however the importer's time is made: counted, not compared with times."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import pytest
from conftest import WORKSPACE
from counter import Counter
from counting import STEPS, T_S, program, run
from instances import OK, Instance

from cosim.export.contract import Fmi
from cosim.export.package import build, build_python

Run = Callable[..., tuple[int, float]]


@pytest.fixture(scope="module")
def counting(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """``counting.run`` for a version of FMI."""
    programs: dict[Fmi, Path] = {}

    def run_version(fmi: Fmi, *arguments: object) -> tuple[int, float]:
        if fmi not in programs:
            programs[fmi] = program(fmi, tmp_path_factory.mktemp("counting"))
        return run(programs[fmi], *arguments)

    return run_version


@pytest.mark.parametrize("start", ["0", "1e6"])
@pytest.mark.parametrize(("p", "q"), STEPS)
@pytest.mark.parametrize("T_s", T_S)
def test_added_up_time_misses_no_sample(counting: Run, T_s: str, p: int, q: int, start: str) -> None:
    """1e6 steps; benchmarks/sampling.py makes 1e8."""
    assert counting(2, T_s, p, q, 1_000_000, start, "sum")[0] == 0


def test_the_clock_drifts_by_many_samples(counting: Run) -> None:
    """What the tests above withstand: at 1e6 s a sum of 1e-5 s is off by a sample after some 2e5 steps."""
    assert abs(counting(2, "1e-5", 1, 1, 2_000_000, "1e6", "sum")[1]) > 5.0


@pytest.mark.parametrize("clock", ["product", "difference"])
@pytest.mark.parametrize(("p", "q"), STEPS)
@pytest.mark.parametrize("T_s", ["1e-3", "1e-5", "0.0003333333333333333"])
def test_other_clocks_of_importers(counting: Run, T_s: str, p: int, q: int, clock: str) -> None:
    start = "1e6" if clock == "difference" else "1000"
    assert counting(2, T_s, p, q, 500_000, start, clock)[0] == 0


@pytest.mark.parametrize(("p", "q"), [(2, 3), (5, 4), (7, 1000), (999, 1000), (1, 10000), (12, 1)])
def test_any_common_measure(counting: Run, p: int, q: int) -> None:
    assert counting(2, "1e-4", p, q, 1_000_000, "1e6", "sum")[0] == 0


@pytest.mark.parametrize("options", [(), ("events",)])
@pytest.mark.parametrize(("p", "q"), STEPS)
@pytest.mark.parametrize("start", ["0", "1e6"])
def test_fmi3_counts_in_the_same_way(counting: Run, p: int, q: int, start: str, options: tuple[str, ...]) -> None:
    assert counting(3, "1e-5", p, q, 500_000, start, "sum", *options)[0] == 0


@pytest.mark.parametrize(("p", "q"), [(1, 1), (1, 2), (1, 7)])
@pytest.mark.parametrize("start", ["0", "1e6"])
def test_fmi3_early_return_meets_every_instant(counting: Run, p: int, q: int, start: str) -> None:
    assert counting(3, "1e-4", p, q, 500_000, start, "sum", "events", "early")[0] == 0


@pytest.fixture(scope="module", params=["native", "python"])
def counter(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The counter as FMU of both flavours."""
    make = build if request.param == "native" else build_python
    return make(Counter, tmp_path_factory.mktemp(request.param), WORKSPACE.cache)


def expected(steps: list[Fraction]) -> list[tuple[float, float]]:
    """Step whose input was seen last, and samples taken, after each of steps given in T_s."""
    rows: list[tuple[float, float]] = []
    position, samples, seen = Fraction(0), 0, -1
    for k, step in enumerate(steps):
        position += step
        while samples < position:
            samples, seen = samples + 1, k
        rows.append((seen, samples))
    return rows


def counted(
    path: Path, T_s: float, steps: list[Fraction], start: float, saved_every: int = 0
) -> list[tuple[float, float]]:
    """The same from an FMU whose importer adds up its time; now and then it goes on in the other of two instances."""
    rows: list[tuple[float, float]] = []
    with Instance(path) as one, Instance(path, "other") as other:
        for each in (one, other):
            each.initialize({"T_s": T_s}, start=start)
        fmu, idle = one, other
        t = start
        for k, step in enumerate(steps):
            if saved_every and k % saved_every == saved_every - 1:
                serial = fmu.fmu.serializeFMUstate(fmu.fmu.getFMUstate())
                idle.fmu.setFMUstate(idle.fmu.deSerializeFMUstate(serial))
                fmu, idle = idle, fmu
            h = step.numerator * T_s / step.denominator
            fmu.set({"step": k})
            fmu.step(t, h)
            seen, samples = fmu.get(["seen", "samples"])
            rows.append((seen, samples))
            t += h
    return rows


PATTERNS = {
    "T_s": [Fraction(1)],
    "T_s/2": [Fraction(1, 2)],
    "T_s/7": [Fraction(1, 7)],
    "3 T_s": [Fraction(3)],
    "changing": [Fraction(1, 3), Fraction(1, 6), Fraction(2), Fraction(1, 2), Fraction(5, 4), Fraction(3, 4)],
}


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize(("T_s", "start"), [(1e-3, 0.0), (1e-5, 1e6), (0.0003333333333333333, 1e6)])
def test_flavours_count_alike(counter: Path, T_s: float, start: float, pattern: str) -> None:
    steps = PATTERNS[pattern] * (3000 // len(PATTERNS[pattern]))
    assert counted(counter, T_s, steps, start) == expected(steps)


def test_a_restored_instance_goes_on_counting(counter: Path) -> None:
    steps = PATTERNS["changing"] * 100
    assert counted(counter, 1e-5, steps, 1e6, saved_every=7) == expected(steps)


def test_a_step_without_common_measure_goes_by_time(counter: Path) -> None:
    """h = 0.3719264 T_s, then again T_s from wherever that ended: between two instants."""
    T_s, odd = 1e-3, 0.3719264
    with Instance(counter) as fmu:
        fmu.initialize({"T_s": T_s})
        t = 0.0
        for k in range(1000):
            fmu.step(t, odd * T_s)
            t += odd * T_s
            assert fmu.get(["samples"]) == [int((k + 1) * odd) + 1]
        before = int(1000 * odd) + 1
        for k in range(1000):
            fmu.step(t, T_s)
            t += T_s
            assert fmu.get(["samples"]) == [before + k + 1]


def test_instants_are_told_apart_though_close(counter: Path) -> None:
    """A step that ends 0.4 % of T_s before an instant leaves that sample to the next step."""
    T_s = 1e-3
    with Instance(counter) as fmu:
        fmu.initialize({"T_s": T_s})
        fmu.step(0.0, 0.99602371 * T_s)
        assert fmu.get(["samples"]) == [1.0]
        fmu.step(0.99602371 * T_s, 0.0071312 * T_s)  # across the instant, by a step that is no fraction of T_s
        assert fmu.get(["samples"]) == [2.0]


def test_too_many_samples_are_refused_at_once(counter: Path) -> None:
    with Instance(counter) as fmu:
        fmu.initialize({"T_s": 1e-9})
        assert fmu.step_status(0.0, 10.0) != OK
        text = "holds 1e+10 samples of T_s = 1e-09 s, but one step may hold 10000000. Take shorter steps"
        assert text in fmu.messages[-1]


def test_tunable_parameter_renews_what_is_derived_from_it(counter: Path) -> None:
    """exp(log_scale) is computed once for each value, not at each sample."""
    with Instance(counter) as fmu:
        fmu.initialize({"T_s": 1e-3})
        fmu.set({"step": 5.0})
        shown: list[float] = []
        for k in range(4):
            fmu.set({"log_scale": float(k // 2)})
            fmu.step(k * 1e-3, 1e-3)
            shown += fmu.get(["seen"])
    assert shown == pytest.approx([5.0, 5.0, 5.0 * math.e, 5.0 * math.e])
