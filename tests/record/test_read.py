"""Records from all kinds of files: time, units, metadata, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pyarrow
import pyarrow.parquet
import pytest
import scipy.io

from cosim.errors import DescriptionError
from cosim.record.description import Column
from cosim.record.header import split_label
from cosim.record.read import Record, read_record
from cosim.record.write import RecordWriter

TIME = np.array([0.0, 1e-3, 2e-3, 3e-3])
FORCE = np.array([0.5, -1.25, 0.1, 1.0 / 3.0])


def written(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_text(text, encoding=encoding)
    return path


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("t,x\n0,1\n1,2\n", ""),
        ("t,x [mm]\n0,1\n1,2\n", "mm"),
        ("Time [s],x[mm]\n0,1\n1,2\n", "mm"),
        ("TIME (s);x (µm)\n0;1\n1;2\n", "um"),
        ("t [ms];x [N·m/s²]\n0;1\n1000;2\n", "N.m/s2"),
        ("t;x\ns;mm\n0;1\n1;2\n", "mm"),
        ("t\tx\n[s]\t[counts]\n0\t1\n1\t2\n", "counts"),
        ("t;x\n;°C\n0;1\n1;2\n", "degC"),
        ("t,x\ns,-\n0,1\n1,2\n", "1"),
        ("# t,x\n0,1\n1,2\n", ""),
        ("sep=;\nt;x\n0,0;1,0\n1,0;2,0\n", ""),
        ("time,x,\n0,1,\n1,2,\n", ""),
        (",t,x\n0,0,1\n1,1,2\n", ""),
    ],
    ids=range(13),
)
def test_heads_say_names_and_units(tmp_path: Path, text: str, unit: str) -> None:
    record = read_record(written(tmp_path / "a.csv", text))
    assert record.time.tolist() == [0.0, 1.0]
    assert record.columns["x"].tolist() == [1.0, 2.0]
    assert record.units["x"] == unit


def test_a_signal_called_time_is_not_the_time(tmp_path: Path) -> None:
    record = read_record(written(tmp_path / "a.csv", "a.time,Time,b.t,x\n5,0,6,1\n5,1,6,2\n"))
    assert record.time.tolist() == [0.0, 1.0]
    assert set(record.columns) == {"a.time", "b.t", "x"}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-8"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    record = read_record(written(tmp_path / "a.csv", "t [s];Weg [µm]\n0;1,5\n1;2,5\n", encoding))
    assert record.columns["Weg"].tolist() == [1.5, 2.5]
    assert record.units == {"Weg": "um"}


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        ("plant.a[1]", ("plant.a[1]", "")),
        ("a[1,2]", ("a[1,2]", "")),
        ("a [1]", ("a", "1")),
        ("force (measured)", ("force (measured)", "")),
        ("current (A)", ("current", "A")),
        ("torque [Nm]", ("torque", "N.m")),
        ("speed [1/min]", ("speed", "rpm")),
        ("x", ("x", "")),
        ("[mm]", ("[mm]", "")),
    ],
)
def test_labels_are_split_into_name_and_unit(label: str, expected: tuple[str, str]) -> None:
    assert split_label(label) == expected


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_what_the_writer_writes_reads_back_the_same(tmp_path: Path, ending: str) -> None:
    rows = np.column_stack((FORCE, np.array([1e-300, -0.0, 123456789.123456789, 5e-324])))
    columns = [Column("plant.force", "N", "", "kN", 1e-3), Column('a "quoted" [1]', "m", "", "m")]
    path = tmp_path / f"a{ending}"
    with RecordWriter(path, columns, {"system": "s.toml", "steps": 3, "versions": {"numpy": "2"}}) as writer:
        writer.write(TIME, rows)
        writer.finish({"partial": True})
    record = read_record(path)
    assert record.time.tobytes() == TIME.tobytes()
    for i, column in enumerate(columns):
        assert record.column(column.name).tobytes() == np.ascontiguousarray(rows[:, i]).tobytes()
    assert record.units == {"plant.force": "N", 'a "quoted" [1]': "m"}
    described = {key: value for key, value in record.metadata.items() if key != "columns"}
    assert described == {"system": "s.toml", "steps": 3, "versions": {"numpy": "2"}, "partial": True}


def save_mat(path: Path) -> Path:
    log = {"t": TIME.reshape(-1, 1) * 1e3, "force": FORCE, "axes": np.column_stack((FORCE, 2 * FORCE)), "who": "me"}
    scipy.io.savemat(
        path, {"log": log, "kp": 160.0, "other": np.zeros(9), "flag": np.array([[True, False, True, True]])}
    )
    return path


def test_vectors_of_a_mat_file(tmp_path: Path) -> None:
    record = read_record(save_mat(tmp_path / "a.mat"), units={"log.t": "ms", "log.force": "kN"})
    assert np.array_equal(record.time, TIME * 1e3 * 1e-3)
    assert list(record.columns) == ["log.force", "log.axes[1]", "log.axes[2]", "flag"]
    assert record.columns["flag"].tolist() == [1.0, 0.0, 1.0, 1.0]
    assert record.columns["log.axes[2]"].tolist() == (2 * FORCE).tolist()
    assert record.units["log.force"] == "kN"
    assert record.metadata == {"log.who": "me", "kp": 160.0}


def test_struct_arrays_of_a_mat_file(tmp_path: Path) -> None:
    """Simulink's structure with time holds one element of a struct array for each signal."""
    values = [FORCE.reshape(-1, 1), np.column_stack((FORCE, 2 * FORCE))]
    signals = np.array([(value, "x") for value in values], dtype=[("values", object), ("label", object)])
    scipy.io.savemat(tmp_path / "a.mat", {"Scope": {"time": TIME, "signals": signals}})
    record = read_record(tmp_path / "a.mat")
    names = ["Scope.signals[1].values", "Scope.signals[2].values[1]", "Scope.signals[2].values[2]"]
    assert list(record.columns) == names
    assert record.columns[names[2]].tolist() == (2 * FORCE).tolist()
    assert record.metadata["Scope.signals[2].label"] == "x"


def test_parquet_of_others(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    n = [Decimal("1.0"), Decimal("2.0")]
    pd.DataFrame({"n": n, "Time [ms]": [0, 10], "on": [True, False], "x [mm]": [0.5, 1.5]}).to_parquet(path)
    record = read_record(path)
    assert record.time.tolist() == [0.0, 0.01]
    assert {name: values.tolist() for name, values in record.columns.items()} == {
        "n": [1.0, 2.0],
        "on": [1.0, 0.0],
        "x": [0.5, 1.5],
    }
    assert record.units["x"] == "mm"


def test_only_the_chosen_columns_are_read_and_checked(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", "clock,state,x [mm],y\n0,idle,1,nan\n1,on,2,\n")
    record = read_record(path, time="clock", columns=["x [mm]"])
    assert {name: values.tolist() for name, values in record.columns.items()} == {"x [mm]": [1.0, 2.0]}
    assert record.units == {"x [mm]": "mm"}
    assert read_record(path, time="clock", columns=["x"]).columns["x"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "unit", "time"),
    [
        ("t,x\n0,1\n5,2\n", "ms", [0.0, 5e-3]),
        ("t [s],x\n0,1\n5,2\n", "us", [0.0, 5e-6]),
        ("t,x\n0,1\n5,2\n", "min", [0, 300]),
    ],
)
def test_the_unit_of_time_may_be_said(tmp_path: Path, text: str, unit: str, time: list[float]) -> None:
    record = read_record(written(tmp_path / "a.csv", text), time_unit=unit)
    assert record.time == pytest.approx(time, rel=1e-15)


def test_a_sampling_time_instead_of_times(tmp_path: Path) -> None:
    record = read_record(written(tmp_path / "a.csv", "x\n1\n2\n3\n"), sampling_time=0.1)
    assert record.time.tolist() == [0.0, 0.1, 0.2]


@pytest.mark.parametrize(
    ("text", "options", "expected"),
    [
        ("t,x\n0,1\n0,2\n", {}, "line 3, row 2, column t: 0 s is not after 0 s, the time of the row before."),
        ("t,x\n0,1\n2,2\n1,3\n", {}, "line 4, row 3, column t: 1 s is not after 2 s"),
        ("t [ms],x\n0,1\n2,2\n1,nan\n", {}, "line 4, row 3, column x: nan is not finite"),
        ("t [ms],x\n0,1\n2,2\n1,nan\n", {}, "line 4, row 3, column t: 0.001 s is not after 0.002 s"),
        ("t [mm],x\n0,1\n", {}, "column t: 'mm' is no unit of time."),
        ("t,x\n0,1\n", {"time_unit": "m"}, "column t: 'm' is no unit of time."),
        ("tme,x\n0,1\n", {}, "which column is the time? Name it, or give a sampling time. Did you mean 'tme'?"),
        ("t,x\n0,1\n", {"time": "tt"}, "no column 'tt'."),
        ("t,x\n0,1\n", {"columns": ["position", "y"]}, "no column 'position'. Known: t, x."),
        ("t,x\n0,1\n", {"units": {"y": "mm"}}, "no column 'y'."),
        ("t,x\n0,1\n", {"sampling_time": 0.0}, "sampling time 0 s: must be a finite number above 0."),
        ("t,x\n0,1\n", {"sampling_time": 0.1, "time": "t"}, "give a column of time or a sampling time, not both."),
        ("t,x,x\n0,1,2\n", {}, "more than one column is called 'x'. Rename one."),
        ("t\n0\n1\n", {}, "holds no column beside its time."),
        ("t;x\n0;1,5\n1;2.5\n", {}, "'1,5' in line 2 has a comma, '2.5' in line 3 a point"),
        ("t,x\n0,1_000\n", {}, "'1_000' is not a number"),
        ("t,x\n0,0x1\n", {}, "'0x1' is not a number"),
        ("t,x\n2024-01-01,1\n", {}, "column t: '2024-01-01' is not a number"),
    ],
    ids=range(18),
)
def test_what_is_refused(tmp_path: Path, text: str, options: dict[str, Any], expected: str) -> None:
    with pytest.raises(DescriptionError, match=re.escape(expected)):
        read_record(written(tmp_path / "a.csv", text), **options)


def parquet_nan(path: Path) -> None:
    pd.DataFrame({"t": [0.0, 1.0], "x": [1.0, None]}).to_parquet(path)


def parquet_text(path: Path) -> None:
    pd.DataFrame({"t": [0.0, 1.0], "x": ["on", "off"]}).to_parquet(path)


def parquet_twice(path: Path) -> None:
    table = pyarrow.table([pyarrow.array([0.0, 1.0])] * 3, names=["t", "x", "x"])
    pyarrow.parquet.write_table(table, path)


def parquet_dates(path: Path) -> None:
    pd.DataFrame({"t": pd.date_range("2024-01-01", periods=2), "x": [1.0, 2.0]}).to_parquet(path)


def mat_falling(path: Path) -> None:
    scipy.io.savemat(path, {"t": [0.0, 1.0, 1.0], "x": [1.0, 2.0, 3.0]})


def mat_empty(path: Path) -> None:
    scipy.io.savemat(path, {"name": "nothing"})


def mat_73(path: Path) -> None:
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + bytes(400))


def rubbish(path: Path) -> None:
    path.write_bytes(b"rubbish" * 40)


def missing(path: Path) -> None:
    pass


@pytest.mark.parametrize(
    ("name", "make", "expected"),
    [
        ("a.parquet", parquet_nan, "row 2, column x: nan is not finite."),
        ("a.parquet", parquet_text, "row 1, column x: 'on' is not a number."),
        ("a.parquet", parquet_twice, "more than one column is called 'x'. Rename one."),
        ("a.parquet", parquet_dates, "column t: the values are of type timestamp["),
        ("a.parquet", rubbish, "is no Parquet file that can be read"),
        ("a.parquet", missing, "no such file"),
        ("a.mat", mat_falling, "row 3, column t: 1 s is not after 1 s"),
        ("a.mat", mat_empty, "holds no vectors of numbers"),
        ("a.mat", mat_73, "version 7.3, which is not read. Save it in MATLAB with -v7."),
        ("a.mat", rubbish, "is no MAT file that can be read"),
        ("a.mat", missing, "no such file"),
        ("a.xlsx", missing, "must end in .csv"),
        ("a.csv", missing, "no such file"),
    ],
)
def test_files_that_cannot_serve(tmp_path: Path, name: str, make: Callable[[Path], None], expected: str) -> None:
    make(tmp_path / name)
    with pytest.raises(DescriptionError, match=re.escape(expected)):
        read_record(tmp_path / name)


def test_a_mat_file_that_crashes_its_reader_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """scipy.io.loadmat crashes its process on some damaged files; which ones depends on its memory."""
    monkeypatch.setattr("cosim.record.tables._MAT_PROGRAM", "import os; os.kill(os.getpid(), 9)")
    save_mat(tmp_path / "a.mat")
    with pytest.raises(DescriptionError, match=r"a\.mat: is no MAT file that can be read \(reading it crashed\)"):
        read_record(tmp_path / "a.mat")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("a.parquet", 'to read Parquet needs pyarrow, which is not installed: pip install "motion-cosim[parquet]".'),
        ("a.mat", 'to read MAT files needs scipy, which is not installed: pip install "motion-cosim[tools]".'),
    ],
)
def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, said: str) -> None:
    def absent(module: str) -> ModuleType:
        raise ModuleNotFoundError(module, name=module)

    (tmp_path / name).touch()
    monkeypatch.setattr("cosim.extras.import_module", absent)
    monkeypatch.setattr("cosim.extras.find_spec", lambda package: None)
    with pytest.raises(DescriptionError, match=re.escape(said)):
        read_record(tmp_path / name)


def record_over(time: list[float]) -> Record:
    return Record(Path("a.csv"), np.array(time), {}, {}, {})


def test_steps_that_are_not_the_usual_one_are_told() -> None:
    assert record_over([0.0, 1.0, 2.0, 4.0, 5.0]).uneven() == (
        "a.csv: 1 of 4 steps of time are not the usual 1 s: the first is 2 s, from 2 s (row 3) to 4 s."
    )
    assert record_over([0.0, 0.33, 0.67, 1.0]).uneven() == ""
    assert record_over([0.0]).uneven() == ""


def test_a_record_of_uneven_steps_is_taken_at_equal_ones() -> None:
    time = np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    record = Record(Path("a.csv"), time, {"x": time**2}, {"x": "m"}, {})
    even = record.resampled()
    assert even.time.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    x = record["x"]
    assert even["x"].tolist() == pytest.approx([*x[:3], 0.5 * (x[2] + x[3]), *x[3:]])
    assert record.resampled(2.5).time.tolist() == [0.0, 2.5, 5.0]
    with pytest.raises(DescriptionError, match=r"1 gap of more than 1\.5 steps of 1 s: the first is from 2 s to 4 s"):
        record.resampled(longest_gap=1.5)
    with pytest.raises(DescriptionError, match="a step of 0 s"):
        record.resampled(0.0)
