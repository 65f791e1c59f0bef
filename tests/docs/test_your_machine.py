"""The machine of the tutorial "your machine": its records are those of plain equations, its fits find the truth."""

from __future__ import annotations

import ast
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.design.fit import Fitted, fit
from cosim.design.fit_file import make_fit
from cosim.record.read import read_record

DOCS = Path(__file__).resolve().parents[2] / "docs"
LOGS = DOCS / "examples" / "your_machine"
sys.path.insert(0, str(LOGS))
import make_records as made  # noqa: E402

PARAMETERS = ("J_rot", "F_C", "F_S", "v_s", "sigma_0", "sigma_1", "sigma_2")
TRUTH = {**{f"plant.{name}": made.STAGE[name] for name in PARAMETERS}, "position delay": made.STAGE["delay"]}


def test_every_value_of_the_stage_is_found_to_one_per_cent(native: Path) -> None:
    found = fit(LOGS / "stage_fit.toml", workers=2)
    assert found.values == pytest.approx(TRUTH, rel=0.01)
    (other,) = (c for c in found.comparisons if c.validates and c.output == "position")
    assert 2.0e-8 < other.rms < 2.1e-8


def test_the_tutorial_judges_by_the_truth() -> None:
    script = ast.parse((DOCS / "tutorials" / "2_your_machine.py").read_text(encoding="utf-8"))
    said = [node.value for node in script.body if isinstance(node, ast.Assign) and ast.unparse(node.targets) == "TRUTH"]
    assert [ast.literal_eval(value) for value in said] == [TRUTH]


@pytest.mark.parametrize(
    ("file", "reference", "seed"),
    [("stage.csv", made.stage_reference, 1), ("stage_other.csv", made.other_reference, 2)],
)
def test_the_records_of_the_stage_are_those_of_the_plain_equations(file: str, reference: Any, seed: int) -> None:
    record = read_record(LOGS / file)
    count = 150
    wanted = reference(record.time)
    np.testing.assert_allclose(record.column("reference"), wanted, rtol=1e-9, atol=1e-15)
    begun = made.stage_signals(wanted[:count])
    padded = {name: np.pad(values, (0, len(wanted) - count)) for name, values in begun.items()}
    rows = made.measured(padded, made.STAGE_NOISE, made.STAGE_RESOLUTION, seed)
    for name in ("position", "command"):
        # Rounded to a multiple of the resolution, which another processor may do differently where it lies between two.
        off = np.abs(record.column(name)[:count] - rows[name][:count])
        assert np.max(off) <= 1.01 * made.STAGE_RESOLUTION[name]
        assert np.mean(off > 0.5 * made.STAGE_RESOLUTION[name]) < 0.02


def motor(**changes: Any) -> Fitted:
    document = tomllib.loads((LOGS / "motor_fit.toml").read_text(encoding="utf-8"))
    document["parameters"] |= changes
    return fit(make_fit(document, folder=LOGS), workers=2)


def test_mass_damping_and_delay_of_the_motor_are_found(native: Path) -> None:
    found = motor().values
    assert found["plant.m"] == pytest.approx(made.MOTOR["m"], rel=1e-3)
    assert found["plant.b"] == pytest.approx(made.MOTOR["b"], rel=1e-3)
    assert found["position delay"] == pytest.approx(made.MOTOR["delay"], rel=1e-2)
    assert found["plant.velocity_start (first)"] == pytest.approx(made.MOTOR["velocity_start"], rel=1e-2)


def test_force_constant_mass_and_damping_of_the_motor_only_act_together(native: Path) -> None:
    found = motor(**{"plant.K_a": {}})
    assert [set(weak.names) for weak in found.weak] == [{"plant.m", "plant.b", "plant.K_a"}]
