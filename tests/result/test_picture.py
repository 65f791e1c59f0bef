"""Pictures of several sources, and how a notebook shows a result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import html
from recordings import result, stage

import cosim
from cosim.errors import DescriptionError
from cosim.record.description import Column
from cosim.record.read import Record
from cosim.result.picture import Picture, plot, source_labels
from cosim.result.plots import Panel
from cosim.result.result import Result

TIME = np.linspace(0.0, 1.0, 101)


def log(factor: float = 1e3, unit: str = "mm") -> Record:
    return Record(Path("a/log.csv"), TIME, {"x": factor * np.sin(TIME)}, {"x": unit}, {})


def other(mass: float) -> Result:
    made = stage()
    values = {**made.metadata["start_values"], "p.m": {"value": mass, "fmu": 62.4, "unit": "kg"}}
    return replace(made, metadata={**made.metadata, "start_values": values})


def lines(panel: Panel) -> dict[str, Any]:
    return {line.label: line.y for line in panel.series}


def test_two_runs_in_one_picture_in_one_line(tmp_path: Path) -> None:
    picture = cosim.plot([stage(), other(80.0)], tmp_path / "both.png")
    assert (tmp_path / "both.png").read_bytes().startswith(b"\x89PNG")
    assert [panel.heading for panel in picture.panels] == [
        *("t.position", "p.position", "c.command", "c: p.position minus t.position"),
    ]
    labels = ["stage.toml, p.m=70.0 kg", "stage.toml, p.m=80.0 kg"]
    assert [list(lines(panel)) for panel in picture.panels] == [labels] * 4
    error = lines(picture.panels[3])[labels[0]]
    assert np.max(np.abs(error)) == pytest.approx(1e-6, rel=1e-6)


def test_a_record_is_drawn_in_the_unit_of_the_run_under_its_own_name() -> None:
    picture = plot([stage(), log()], signals={"p.position": "x"})
    (panel,) = picture.panels
    assert panel.unit == "m"
    assert lines(panel)["log.csv"] == pytest.approx(np.sin(TIME), rel=1e-12)


def test_a_run_alone_is_drawn_by_its_loops() -> None:
    assert [panel.quantity for panel in stage().plot().panels] == ["Position", "Error", "Command"]
    assert [panel.heading for panel in stage().plot(signals=["c.command"]).panels] == ["c.command"]


def test_a_notebook_shows_picture_and_result() -> None:
    assert stage().plot(signals=["c.command"])._repr_png_().startswith(b"\x89PNG")
    root = html.fromstring(stage()._repr_html_())
    cells = [[cell.text_content() for cell in row] for row in root.iter("tr")]
    assert ["Position error, maximum from 0.5 s", "1", "µm"] in cells
    assert ["c.command", "N·m", "-1", "1", "1", "Text of c.command"] in cells
    assert root.findtext(".//b") == "A stage <b>on</b> a table"


def test_html_of_results_without_rows_and_of_many_signals() -> None:
    empty = replace(stage(), time=np.empty(0), rows=np.empty((0, 3)), partial=True)
    assert "ended early" in empty._repr_html_()
    many = result(TIME, {f"p.x{i}": (TIME, "m") for i in range(30)}, connections=[])
    assert "and 10 more signals" in many._repr_html_()


def test_all_endings_are_written(tmp_path: Path) -> None:
    picture = stage().plot(signals=["c.command"])
    assert isinstance(picture, Picture)
    assert picture.save(tmp_path / "a.svg").read_text().lstrip().startswith("<?xml")
    assert picture.save(tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(DescriptionError, match="name of a picture must end in"):
        picture.save(tmp_path / "a.txt")


def test_what_cannot_be_drawn_is_told() -> None:
    with pytest.raises(DescriptionError, match="nothing to draw"):
        plot([])
    with pytest.raises(DescriptionError, match=r"has no 'p\.positon'.*Did you mean 'p\.position'"):
        plot([stage(), log()], signals=["p.positon"])
    with pytest.raises(DescriptionError, match="no two of them"):
        plot([stage(), log()])
    with pytest.raises(DescriptionError, match="different kinds"):
        plot([stage(), log(unit="N")], signals={"p.position": "x"})
    with pytest.raises(DescriptionError, match="1 labels for 2"):
        plot([stage(), stage()], labels=["one"])


def test_what_a_session_shows_is_one_line() -> None:
    assert repr(stage()) == (
        "<Result of stage.toml: 1001 samples from 0 s to 1 s: t.position [m], p.position [m], c.command [N.m]>"
    )
    assert repr(log(unit="mm")).startswith("<Record log.csv: ")
    assert "x [mm]" in repr(log(unit="mm"))
    found = cosim.compare(log(), stage(), {"x": "p.position"})
    assert repr(found).startswith("<Comparison of stage.toml with log.csv: x: rms ")
    assert repr(found["x"]).startswith("<Difference of p.position from x: largest ")
    many = replace(stage(), columns=tuple(Column(f"p.x{i}", "1", "", "1") for i in range(12)))
    assert repr(many).endswith("p.x7 and 4 more>")


def test_a_record_is_read_as_a_result_is() -> None:
    record = log(unit="mm")
    assert record["x"] is record.columns["x"]
    frame = record.to_dataframe(units=True)
    assert list(frame.columns) == ["x [mm]"]
    assert frame["x [mm]"].to_numpy() == pytest.approx(record["x"])
    with pytest.raises(DescriptionError, match=r"no column 'y'"):
        record["y"]


def test_a_result_has_the_figures_of_its_run() -> None:
    figures = {figure.name: figure for figure in stage().figures(start=0.5)}
    expected = float(np.max(np.abs((stage()["p.position"] - stage()["t.position"])[stage().time >= 0.5])))
    assert figures["Position error, maximum from 0.5 s"].value == pytest.approx(1e6 * expected)
    assert figures["Position error, maximum from 0.5 s"].unit == "um"


def test_labels_differ() -> None:
    assert source_labels([stage(), stage(), log()]) == ["stage.toml (1)", "stage.toml (2)", "log.csv"]


def test_dataframe_with_units_in_its_names() -> None:
    frame = stage().to_dataframe(units=True)
    assert list(frame.columns) == ["t.position [m]", "p.position [m]", "c.command [N.m]"]
    assert frame.index.name == "time [s]"
    assert frame.attrs["units"]["c.command"] == "N.m"


def test_dataframe_with_units_reads_back_as_a_record(tmp_path: Path) -> None:
    stage().to_dataframe(units=True).to_csv(tmp_path / "a.csv")
    record = cosim.read_record(tmp_path / "a.csv")
    assert record.units == {"t.position": "m", "p.position": "m", "c.command": "N.m"}
    assert record.time == pytest.approx(stage().time)


def test_xarray_has_units_and_names() -> None:
    pytest.importorskip("xarray", reason="xarray is not installed: install the extra test")
    dataset = stage().to_xarray()
    assert dataset["p.position"].attrs == {"units": "m", "long_name": "Text of p.position"}
    assert dataset["p.position"].dims == ("time",)
    assert dataset["time"].attrs["units"] == "s"
    assert dataset.attrs["system"] == "stage.toml"
    assert float(dataset["c.command"].sel(time=0.1, method="nearest")) == 1.0


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr("cosim.record.frame.import_module", missing)
    with pytest.raises(DescriptionError, match="to_xarray needs xarray"):
        stage().to_xarray()
