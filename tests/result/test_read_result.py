"""Results read back from their files: values to the last bit, and all that is known about them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import result, stage

from cosim.errors import DescriptionError
from cosim.record.description import Column, description_path
from cosim.record.read import read_record
from cosim.result.read import holds_result, read_result
from cosim.result.result import Message, Result
from cosim.result.summary import summary


def run() -> Result:
    time = np.arange(5) * 0.1
    values = np.array([1.0, np.nan, np.inf, -0.0, 1 / 3])
    messages = [Message("p", 0.1, "Warning", "logStatus", 'hot, "very"')]
    made = result(time, {"p.x": (values, "m"), 'c.a "b", [1]': (2.0 * time, "1")}, messages=messages)
    display = Column("p.x", "m", "Place, of the table", "mm", 1000.0, 0.0)
    return replace(made, partial=True, dropped_messages=3, columns=(display, made.columns[1]))


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_result_comes_back_as_it_was(tmp_path: Path, ending: str) -> None:
    made = run()
    back = read_result(made.save(tmp_path / f"a{ending}"))
    assert back.time.tobytes() == made.time.tobytes()
    assert back.rows.tobytes() == made.rows.tobytes()
    assert back.columns == made.columns
    assert back.metadata == made.metadata
    assert (back.partial, back.messages, back.dropped_messages) == (True, made.messages, 3)
    assert back.solver == made.solver
    assert back.displayed("p.x")[4] == 1000.0 / 3.0


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_figures_of_merit_are_those_of_the_run(tmp_path: Path, ending: str) -> None:
    made = stage()
    path = made.save(tmp_path / f"a{ending}")
    assert summary(read_result(path)) == summary(made)
    assert holds_result(path)


def test_files_of_others_hold_no_result(tmp_path: Path) -> None:
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    for name in ("a.parquet", "a.csv", "a.mat", "missing.csv", "missing.parquet"):
        assert not holds_result(tmp_path / name)


def test_records_know_the_units_of_a_csv_file_of_a_run(tmp_path: Path) -> None:
    record = read_record(stage().save(tmp_path / "a.csv"))
    assert record.units == {"t.position": "m", "p.position": "m", "c.command": "N.m"}


def test_without_the_file_beside_it_a_csv_file_has_no_units(tmp_path: Path) -> None:
    path = stage().save(tmp_path / "a.csv")
    description_path(path).unlink()
    back = read_result(path)
    assert back["p.position"].tobytes() == stage()["p.position"].tobytes()
    assert (back.unit("p.position"), dict(back.metadata), back.messages) == ("1", {}, ())
    assert not holds_result(path)


def test_a_file_that_changed_after_its_run_is_refused(tmp_path: Path) -> None:
    path = stage().save(tmp_path / "a.csv")
    path.write_text(path.read_text() + "9,9,9,9\n")
    with pytest.raises(DescriptionError, match=r"changed after the run\. Remove a\.csv-metadata\.json"):
        read_result(path)


def test_a_foreign_file_beside_a_record_does_no_harm(tmp_path: Path) -> None:
    path = stage().save(tmp_path / "a.csv")
    for text in ("", "[]", '{"notes": []}', '{"notes": [{"other": 1}]}', "\x00"):
        description_path(path).write_text(text)
        assert read_result(path).unit("p.position") == "1"


def test_a_description_written_otherwise_is_refused(tmp_path: Path) -> None:
    path = stage().save(tmp_path / "a.csv")
    text = description_path(path).read_text()
    description_path(path).write_text(text.replace("display_factor", "factor"))
    with pytest.raises(DescriptionError, match=r"a\.csv.*not known here"):
        read_result(path)


def test_cells_that_are_no_numbers_are_told(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,x\n0,1\n1,nan\n2,off\n")
    with pytest.raises(DescriptionError) as caught:
        read_result(path)
    assert len(caught.value.problems) == 1
    assert f"{path}: line 4, row 3, column x: 'off' is not a number" in caught.value.problems[0]


def test_a_record_of_another_kind_is_no_result(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("x,y\n0,1\n")
    with pytest.raises(DescriptionError, match="its first column is not 'time'"):
        read_result(path)
