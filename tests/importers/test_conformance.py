"""The part of the conformance suite that needs no importer but FMPy; ``make conformance`` runs all."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from .cases import Case, compare, fmu_case
from .conform import EXCHANGE_TOLERANCE, PYTHON_TOLERANCE, run


@pytest.fixture(scope="module")
def cases(native: Path) -> list[Case]:
    return [fmu_case(path) for path in sorted(native.glob("*.fmu"))]


@pytest.mark.parametrize("importer", ["fmpy", "fmpy.simulate_fmu"])
def test_native_fmus_run_in_fmpy_as_in_cosim(cases: list[Case], importer: str) -> None:
    outcome = run(importer, cases, sys.executable, "native", tolerance=1e-9)
    assert outcome.problems == []
    assert outcome.runs == len(cases) == 16


def test_python_fmus_run_in_fmpy_as_in_cosim(python: Path) -> None:
    cases = [fmu_case(path, 20) for path in sorted(python.glob("*.fmu"))]
    outcome = run("fmpy.simulate_fmu", cases, sys.executable, "python", tolerance=PYTHON_TOLERANCE)
    assert outcome.problems == []
    assert outcome.runs == len(cases) == 16


def test_plants_run_in_fmpy_as_model_exchange(cases: list[Case]) -> None:
    plants = [case for case in cases if case.job["continuous_states"]]
    outcome = run("fmpy.simulate_fmu ME", plants, sys.executable, "plants", tolerance=EXCHANGE_TOLERANCE)
    assert outcome.problems == []
    assert outcome.runs == len(plants) == 4


def test_comparison_sees_a_wrong_trace() -> None:
    """A plant's output must be in its row; a controller's may be that of the sample before or after, no other."""
    job = {"outputs": ["y"], "steps": 4}
    rows = [[1.0], [4.0], [9.0], [16.0]]
    plant = Case(job, rows, [0.0], (False,))
    assert compare(plant, rows) == (0.0, "")
    assert compare(plant, [[0.0], [1.0], [4.0], [9.0]]) == (7.0 / 16.0, "y")
    assert compare(plant, rows[:3])[0] == float("inf")
    controller = Case(job, rows, [0.0], (True,))
    assert compare(controller, [[0.0], [1.0], [4.0], [9.0]]) == (0.0, "")
    assert compare(controller, [[4.0], [9.0], [16.0], [25.0]]) == (0.0, "")
    assert compare(controller, [[1.0], [4.0], [9.0], [15.0]]) == (1.0 / 16.0, "y")


def test_failures_of_an_importer_are_reported(native: Path) -> None:
    case = fmu_case(native / "PPi.fmu", 5)
    case.job["references"] = dict.fromkeys(case.job["references"], 10**6)
    outcome = run("fmpy", [case], sys.executable, "wrong", tolerance=1e-9)
    assert outcome.runs == 0
    assert outcome.problems[0].startswith("PPi: FMICallException")
