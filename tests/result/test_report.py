"""The page of a run: self-contained, small, and with every peak, read back as a browser would."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import html
from recordings import result, stage

from cosim.errors import DescriptionError
from cosim.result.plots import Panel, Series, envelope
from cosim.result.report import Chart, Drawing, Notes, Section, Table, Text, write_report
from cosim.result.result import Message
from cosim.result.run_report import report_run

HUGE = html.HTMLParser(huge_tree=True, encoding="utf-8")


def page(path: Path) -> Any:
    return html.fromstring(path.read_bytes(), parser=HUGE)


def charts(root: Any) -> list[dict[str, Any]]:
    return [json.loads(script.text) for script in root.iter("script") if script.get("class") == "data"]


def numbers(text: str) -> Any:
    return np.frombuffer(base64.b64decode(text), "<f8")


def test_page_of_a_run_tells_everything(tmp_path: Path) -> None:
    run = stage()
    path = report_run(run, tmp_path / "run.html", notes=["thinned"])
    root = page(path)
    text = root.text_content()
    assert root.findtext(".//h1") == "A stage <b>on</b> a table"
    assert [h2.text for h2 in root.iter("h2")] == [
        *("Notes", "Figures of merit", "Signals", "System", "Solver", "Provenance"),
    ]
    for said in ("p.load is not connected", "thinned", "70", "62.4", "sine", "c0ffee" * 10, "p" * 64, "0.001 s"):
        assert said in text
    cells = {row[0].text_content(): [cell.text_content() for cell in row[1:]] for row in root.iter("tr")}
    assert cells["Position error, maximum from 0.5 s"] == ["1", "µm"]
    assert cells["p.error (10 elements)"] == ["1e-06 to 1e-05", "all 0", "m"]
    assert cells["p"] == ["Stage", "2", "0.1", "p" * 64]


def test_charts_hold_the_samples(tmp_path: Path) -> None:
    run = stage()
    (chart,) = charts(page(report_run(run, tmp_path / "run.html")))
    position, error, command = chart["panels"]
    assert [panel["title"] for panel in chart["panels"]] == ["Position [mm]", "Error [µm]", "Command [N·m]"]
    assert [line["label"] for line in position["lines"]] == ["position", "reference"]
    assert numbers(position["lines"][0]["x"]) == pytest.approx(run.time, rel=1e-15)
    assert numbers(position["lines"][0]["y"]) == pytest.approx(1e3 * run["p.position"], rel=1e-14)
    assert numbers(error["lines"][0]["y"]).max() == pytest.approx(1.0, rel=1e-6)
    assert numbers(command["lines"][0]["y"]).tolist() == run["c.command"].tolist()
    assert chart["x"] == {"title": "Time [s]", "log": False, "range": [0.0, 1.0]}


def test_a_million_rows_fit_and_keep_a_spike_of_one_sample(tmp_path: Path) -> None:
    count, spike = 1_000_000, 777_777
    time = np.arange(count) * 1e-5
    names = [f"p.x{i}" for i in range(12)]
    columns = {name: (np.sin(time + i), "A") for i, name in enumerate(names)}
    columns["p.x7"][0][spike] = 9.0
    path = report_run(result(time, columns), tmp_path / "run.html")
    assert path.stat().st_size <= 6_000_000
    (chart,) = charts(page(path))
    line = chart["panels"][0]["lines"][7]
    x, y = numbers(line["x"]), numbers(line["y"])
    assert y.max() == 9.0
    assert x[y.argmax()] == time[spike]
    assert 200 < x.size < 100_000
    assert "no peak is lost" in chart["note"]


def test_envelope_keeps_extremes_beside_samples_that_are_not_finite() -> None:
    y = np.zeros(10_000)
    y[123], y[124], y[9_999], y[0] = np.nan, 5.0, -3.0, np.inf
    x, kept = envelope(np.arange(10_000.0), y, 100)
    finite = kept[np.isfinite(kept)]
    assert (finite.max(), finite.min()) == (5.0, -3.0)
    assert x[kept == 5.0].tolist() == [124.0]


def test_a_stretch_that_is_not_finite_stays_a_gap() -> None:
    y = np.zeros(10_000)
    y[5_000:5_500] = np.nan
    x, kept = envelope(np.arange(10_000.0), y, 100)
    assert np.all(np.isnan(kept[(x >= 5_000) & (x < 5_500)]))
    assert np.isnan(kept).any()


def test_page_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    """Its policy forbids a browser to; nothing on it would."""
    root = page(report_run(stage(), tmp_path / "run.html"))
    (policy,) = root.xpath("//meta[@http-equiv='Content-Security-Policy']/@content")
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy
    assert not root.xpath("//@src | //link | //iframe | //object | //img")
    assert all(href.startswith("#") for href in root.xpath("//a/@href"))


def test_texts_of_users_do_not_become_markup(tmp_path: Path) -> None:
    nasty = "</script><script>alert(1)</script>"
    panel = Panel(nasty, "1", (Series(nasty, np.arange(3.0), np.arange(3.0)),), heading=nasty)
    parts = [Text(nasty), Notes([nasty]), Table([(nasty, 1.0)], (nasty, "n"), nasty), Chart([panel], caption=nasty)]
    path = write_report(tmp_path / "a.html", nasty, [Section(nasty, parts)], subtitle=nasty)
    root = page(path)
    assert len(list(root.iter("script"))) == 4
    assert root.findtext(".//h1") == nasty
    assert charts(root)[0]["panels"][0]["lines"][0]["label"] == nasty


def test_diagram_shows_blocks_ports_and_units(tmp_path: Path) -> None:
    root = page(report_run(stage(), tmp_path / "run.html"))
    (svg,) = root.iter("svg")
    texts = [text.text for text in svg.iter("text")]
    for said in ("t", "Trajectory", "position_ref", "m", "rad", "\N{MULTIPLICATION SIGN}0.0016 m", "N·m"):
        assert said in texts
    assert "p.angle [rad] → c.position, \N{MULTIPLICATION SIGN}0.0016 m" in [title.text for title in svg.iter("title")]


def test_signals_beside_those_of_the_loops_are_drawn_by_their_units(tmp_path: Path) -> None:
    base = stage()
    columns = {name: (base[name], base.unit(name)) for name in base.names}
    columns |= {f"p.x{i:02}": (base.time * i, "V") for i in range(40)} | {"p.T": (base.time, "K")}
    root = page(report_run(result(base.time, columns), tmp_path / "run.html"))
    _, others = charts(root)
    labels = [[line["label"] for line in panel["lines"]] for panel in others["panels"]]
    assert [len(lines) for lines in labels] == [8, 8, 8, 8]
    assert labels[3][-1] == "p.x31"
    assert "Not drawn: p.x32, p.x33" in root.text_content()
    assert "p.T." in root.text_content()


def test_messages_and_an_early_end_are_told(tmp_path: Path) -> None:
    run = result(np.arange(3.0), {"p.x": (np.arange(3.0), "V")}, messages=[Message("p", 1.0, "Warning", "log", "hot")])
    text = page(report_run(run, tmp_path / "a.htm")).text_content()
    assert "1 s p [Warning] hot" in text


def test_sections_without_parts_are_left_out(tmp_path: Path) -> None:
    path = write_report(tmp_path / "a.html", "T", [Section("A", []), Section("B", [Drawing("<svg></svg>", "note")])])
    assert [h2.text for h2 in page(path).iter("h2")] == ["B"]


def test_numbers_that_are_not_finite_are_said_to_be_none(tmp_path: Path) -> None:
    path = write_report(tmp_path / "a.html", "T", [Section("A", [Table([("x", float("nan"))])])])
    assert [td.text for td in page(path).iter("td")] == ["x", "none"]


def test_another_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"must end in \.html or \.htm"):
        write_report(tmp_path / "run.pdf", "T", [])


def test_without_plotly_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.extras.find_spec", lambda name: None)
    with pytest.raises(DescriptionError, match=r"motion-cosim\[report\]"):
        write_report(tmp_path / "run.html", "T", [])
