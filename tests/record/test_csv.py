"""Measured rows as spreadsheets and measuring tools write them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.commands.cli import main
from cosim.design.identify import nct_from_signals
from cosim.errors import DescriptionError
from cosim.record.read import read_record

POINTS = "t,u,x\n0.0,1.5,-2e-3\n0.1,0,0.25\n"
EXPECTED = {"t": [0.0, 0.1], "u": [1.5, 0.0], "x": [-2e-3, 0.25]}


def semicolons(text: str) -> str:
    return text.replace(",", ";")


@pytest.mark.parametrize(
    "content",
    [
        POINTS.encode(),
        semicolons(POINTS).encode(),
        semicolons(POINTS).replace(".", ",").encode(),
        POINTS.replace(",", "\t").replace(".", ",").encode(),
        b"\xef\xbb\xbf" + POINTS.encode(),
        POINTS.encode("utf-16"),
        POINTS.replace("\n", "\r\n").encode(),
        ("# recorded by hand\n\n" + POINTS.replace("t,u,x", '"t" , "u", "x"') + "\n").encode(),
        POINTS.replace("\n", ",\n").encode(),
        (POINTS.replace("\n", ",,\n") + ",,,,\n,,,,\n").encode(),
        POINTS.replace(",", " ").encode(),
        ("# " + POINTS.replace(",", "   ")).encode(),
        POINTS.replace(",", "  ").replace(".", ",").encode(),
    ],
    ids=[
        *("plain", "semicolon", "decimal comma", "tab", "BOM", "UTF-16", "CRLF", "comment, blanks", "trailing comma"),
        *("trailing commas and rows", "blanks", "blanks, names in a comment", "blanks, decimal comma"),
    ],
)
def test_columns_are_read(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.CSV"
    path.write_bytes(content)
    record = read_record(path)
    assert {"t": record.time.tolist(), **{name: v.tolist() for name, v in record.columns.items()}} == EXPECTED


@pytest.mark.parametrize(
    ("text", "name", "unit"),
    [
        ("t [s];Weg [µm]\n0;1,5\n1;0\n", "Weg", "um"),
        ("t,Kraft °,\n0,1.5\n1,0\n", "Kraft °", ""),
        ('"t","x; filtered [mm]"\n0,1.5\n1,0\n', "x; filtered", "mm"),
        ("t,x; filtered\n0,1.5\n1,0\n", "x; filtered", ""),
        ('t;"x, raw"\n0;1.5\n1;0\n', "x, raw", ""),
        ("t [ns];x\n0;1.5\n1e9;0\n", "x", ""),
    ],
)
def test_heads_of_other_programs(tmp_path: Path, text: str, name: str, unit: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="cp1252")
    record = read_record(path)
    assert record.time == pytest.approx([0.0, 1.0], rel=1e-15)
    assert record.columns[name].tolist() == [1.5, 0.0]
    assert record.units[name] == unit


def test_digital_channels_are_0_and_1(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,on,off\n0,TRUE,False\n1,false,True\n", encoding="utf-8")
    record = read_record(path)
    assert record.columns["on"].tolist() == [1.0, 0.0]
    assert record.columns["off"].tolist() == [0.0, 1.0]


HEADING = "Recorder;A\nSerial;17\n\nTime;x;Time 2;y\n0;1;0;2\n1;2;1;3\n"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (
            HEADING.encode(),
            "line 1 has 2 cells, line 4 has 4. The first line must name the columns: leave out the lines",
        ),
        (b"Curve\nt;x\n0;1\n1;2\n", "line 1 has 1 cell, line 3 has 2. The first line must name the columns"),
        (b"time,x\n2024-01-01T00:00:00,1\n", "'2024-01-01T00:00:00' is not a number but a date or a time of day."),
        (b"t;x\n00:00:01,5;1\n", "'00:00:01,5' is not a number but a date or a time of day. Write times in seconds"),
        (b"t;x\nLREAL;LREAL\n0;1\n", "'LREAL' is not a number. Leave out rows of text, and name the columns to read."),
        ("t;x\n0;1\n".encode("utf-16-le"), "is no text, or UTF-16 without a byte order mark. Save it as UTF-8."),
        (b"PK\x03\x04\x14\x00\x06\x00 a sheet of a spreadsheet", "is a zip archive, not text."),
        (b"\x1f\x8b\x08\x00 compressed", "is no text"),
        (b"t|x\n0|1\n", "Cells are divided by comma, semicolon, tab or blanks."),
    ],
)
def test_other_forms_are_refused_with_the_remedy(tmp_path: Path, content: bytes, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(DescriptionError, match=re.escape(text)):
        read_record(path)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda s: s.replace("0.25", "nan"), "line 3, row 2, column x: nan is not finite. Leave the row out"),
        (lambda s: s.replace("1.5", "-inf"), "line 2, row 1, column u: -inf is not finite."),
        (lambda s: s.replace("0.25", ""), "line 3, row 2, column x: is empty."),
        (lambda s: s.replace("0.25", "O.25"), "line 3, row 2, column x: 'O.25' is not a number."),
        (lambda s: s.replace("0.1,0,0.25", "0.1,0"), "line 3: 2 cells for 3 columns."),
        (lambda s: s.replace("0.25", "0,25"), "line 3: 4 cells for 3 columns."),
        (
            lambda s: semicolons(s).replace("1.5", "1.234,5"),
            "column u: '1.234,5' is not a number. Write it with a point",
        ),
        (lambda s: s.split("\n", 1)[1], "the first line holds numbers. It must name the columns"),
        (lambda s: s.split("\n", 1)[0], "holds no rows below its first line."),
        (lambda s: "", "holds no rows."),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, change: Callable[[str], str], text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(change(POINTS), encoding="utf-8")
    with pytest.raises(DescriptionError, match=re.escape(text)):
        read_record(path)


def test_decimal_commas_between_commas_get_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,u,x\n0,0,1,5,0,25\n", encoding="utf-8")
    with pytest.raises(DescriptionError, match="If numbers have a decimal comma, divide cells by semicolons"):
        read_record(path)


def test_only_the_first_wrong_cells_are_told(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,x\n" + "".join(f"{k},nan\n" for k in range(9)), encoding="utf-8")
    with pytest.raises(DescriptionError) as caught:
        read_record(path)
    assert len(caught.value.problems) == 6
    assert caught.value.problems[-1].endswith("4 more cells like these.")


def test_a_nan_among_measured_rows_ends_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "pulse.csv"
    path.write_text(
        "t,u,x\n" + "".join(f"{k * 1e-3},0,{'nan' if k == 4 else 0.0}\n" for k in range(9)), encoding="utf-8"
    )
    assert main(["identify", "nct", str(path)]) == 2
    assert "line 6, row 5, column x: nan is not finite" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["time", "command", "position", "velocity"])
def test_samples_that_are_not_finite_are_refused(name: str) -> None:
    signals = {key: np.zeros(20) for key in ("time", "command", "position", "velocity")}
    signals[name][7] = np.nan
    with pytest.raises(DescriptionError, match=f"{name} is not finite everywhere; the first such sample is number 8"):
        nct_from_signals(**signals)


def test_tunings_and_sweeps_tell_their_own_keys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "t.toml").write_text('system = "s.toml"\nobjectiv = "error_rms"\nmethod = "grid"\n', encoding="utf-8")
    assert main(["tune", str(tmp_path / "t.toml")]) == 2
    err = capsys.readouterr().err
    assert "objectiv: unknown key. Did you mean 'objective'?" in err
    assert "method: unknown key. Known: description, experiment, generations, limits, metrics, objective" in err
    (tmp_path / "sweep.toml").write_bytes("system = 's.toml'\nmetod = 'grid'\n".encode("utf-16"))
    assert main(["sweep", str(tmp_path / "sweep.toml")]) == 2
    assert "metod: unknown key. Did you mean 'method'?" in capsys.readouterr().err
