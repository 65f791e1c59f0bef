"""What the pictures show, read back from the figures themselves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from cosim.errors import DescriptionError
from cosim.result import plots
from cosim.result.summary import loops, summary


@dataclass(frozen=True)
class Recording:
    """A result as plots and tables need it."""

    time: np.ndarray
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    connections: Sequence[tuple[str, str]] = ()

    @property
    def names(self) -> Sequence[str]:
        return list(self.columns)

    @property
    def metadata(self) -> Mapping[str, Any]:
        return {"connections": [" -> ".join(ends) for ends in self.connections]}

    def unit(self, name: str) -> str:
        return self.units[name]

    def __getitem__(self, name: str, /) -> np.ndarray:
        return self.columns[name]


def one_axis() -> Recording:
    time = np.arange(20001) * 5e-4
    reference = 5e-3 * np.sin(time)
    error = np.where(time < 1.0, 4e-7, 2e-7 * np.cos(time))
    return Recording(
        time,
        {
            "trajectory.position": reference,
            "plant.position": reference + error,
            "controller.command": np.where(np.arange(time.size) % 2, 1.0, -1.0),
        },
        {"trajectory.position": "m", "plant.position": "m", "controller.command": "N.m"},
        [
            ("trajectory.position", "controller.position_ref"),
            ("plant.position", "controller.position"),
            ("controller.command", "plant.command"),
        ],
    )


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures drawn in a test, instead of files."""
    drawn: list[Figure] = []

    def keep(path: Path, draw: Callable[[Figure], None], size: tuple[float, float]) -> None:
        figure = Figure(figsize=size)
        draw(figure)
        drawn.append(figure)

    monkeypatch.setattr(plots, "save", keep)
    return drawn


def labels(figure: Figure) -> list[str]:
    return [axes.get_ylabel() for axes in figure.axes]


def test_a_run_shows_position_error_and_command_in_display_units(figures: list[Figure]) -> None:
    plots.plot_run(one_axis(), Path("run.png"))
    (figure,) = figures
    assert labels(figure) == ["Position [mm]", "Error [µm]", "Command [N·m]"]
    assert figure.axes[-1].get_xlabel() == "Time [s]"
    error: Any = figure.axes[1].lines[0].get_ydata()
    assert float(np.max(error)) == pytest.approx(0.4, rel=1e-12)
    position: Any = figure.axes[0].lines[0].get_ydata()
    assert float(np.max(position)) == pytest.approx(5.0, rel=1e-4)


def test_a_panel_with_one_line_shows_its_heading_and_the_label_of_the_line(figures: list[Figure]) -> None:
    time = np.linspace(0.0, 1.0, 11)
    plots.plot_panels(Path("log.png"), [plots.Panel("Value", "m", (plots.Series("log.csv", time, time),), heading="x")])
    (axes,) = figures[0].axes
    assert axes.get_title(loc="left") == "x"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["log.csv"]


def test_a_start_far_beyond_the_later_error_is_cut_off_and_told(figures: list[Figure]) -> None:
    one = one_axis()
    start = np.where(one.time < 0.1, 9e-6, 0.0)
    columns = dict(one.columns) | {"plant.position": one["plant.position"] + start}
    plots.plot_run(Recording(one.time, columns, one.units, one.connections), Path("run.png"))
    axes = figures[0].axes[1]
    # the error of the second half is 0.2 um at most
    assert axes.get_ylim() == pytest.approx((-0.3, 0.3), rel=1e-3)
    assert axes.get_title() == "cut off: up to 9.4 µm"


def test_two_axes_show_two_lines_named_by_their_controllers(figures: list[Figure]) -> None:
    one = one_axis()
    columns = {f"{name.split('.')[0]}_{axis}.{name.split('.')[1]}": one[name] for axis in "xy" for name in one.names}
    connections = [
        tuple(f"{end.split('.')[0]}_{axis}.{end.split('.')[1]}" for end in connection)
        for axis in "xy"
        for connection in one.connections
    ]
    units = {name: "N.m" if name.endswith("command") else "m" for name in columns}
    plots.plot_run(Recording(one.time, columns, units, connections), Path("run.png"))  # type: ignore[arg-type]
    assert [line.get_label() for line in figures[0].axes[1].lines] == ["controller_x", "controller_y"]


def test_without_a_loop_everything_recorded_is_shown_by_unit(figures: list[Figure]) -> None:
    one = one_axis()
    plots.plot_run(Recording(one.time, one.columns, one.units), Path("run.png"))
    assert labels(figures[0]) == ["Value [mm]", "Value [N·m]"]
    assert len(figures[0].axes[0].lines) == 2


def test_polar_plot_draws_radius_plus_magnified_deviation(figures: list[Figure]) -> None:
    angle = np.radians(np.arange(0.0, 360.0, 0.2))
    deviation = 1e-6 * np.cos(angle)
    plots.plot_polar(
        Path("polar.png"),
        [plots.Polar("FSMC", 0.02, (plots.Series("F500", angle, deviation),), magnification=5000.0)],
    )
    axes = figures[0].axes[0]
    (trace,) = [line for line in axes.lines if line.get_label() == "F500"]
    x, y = (np.asarray(data, dtype=float) for data in trace.get_data())
    # in units of the radius: 1 + 5000*1e-6/0.02 = 1.25 at +X, 0.75 at -X, closed
    assert x[0] == pytest.approx(1.25)
    assert x[900] == pytest.approx(-0.75)
    assert (x[-1], y[-1]) == (x[0], y[0])
    assert np.hypot(x, y)[:-1] == pytest.approx(1.0 + 0.25 * np.cos(angle))
    assert "radius 20 mm, deviation x 5,000, rings in µm" in axes.get_title()


@given(st.floats(1e-3, 1.0), st.floats(1e-9, 1e-3))
def test_magnification_keeps_the_trace_on_the_page(radius: float, deviation: float) -> None:
    chosen = plots.magnification(radius, deviation)
    assert chosen * deviation <= 0.35 * radius * (1.0 + 1e-12)
    assert 2.5 * chosen * deviation > 0.349 * radius
    assert float(f"{chosen:.0e}") == pytest.approx(chosen)
    assert f"{chosen:.0e}"[0] in "125"


@pytest.mark.parametrize(
    ("unit", "peak", "shown"),
    [
        ("m", 5e-3, "mm"),
        ("m", 3e-7, "um"),
        ("m", 4e-9, "nm"),
        ("m", 0.0, "mm"),
        ("m", 2e-4, "um"),
        ("N", 300.0, "N"),
        ("m/s", 0.25, "mm/s"),
        ("m/s", 6e-3, "mm/s"),
        ("N.m", 6.2, "N.m"),
        ("s", 2e-3, "ms"),
        ("1", 1e-6, "1"),
    ],
)
def test_display_units_suit_the_size(unit: str, peak: float, shown: str) -> None:
    assert plots.display_unit(unit, peak)[0] == shown


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("N.m.s/rad", "N·m·s/rad"),
        ("m/s2", "m/s²"),
        ("kg.m2", "kg·m²"),
        ("um", "µm"),
        ("um/s", "µm/s"),
        ("N.s0.5/m0.5", "N·s^0.5/m^0.5"),
        ("rad", "rad"),
    ],
)
def test_units_are_typeset(unit: str, text: str) -> None:
    assert plots.typeset(unit) == text


@given(st.integers(1, 5000), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_the_envelope_keeps_order_and_every_extreme(size: int, columns: int, seed: int) -> None:
    x = np.arange(size, dtype=float)
    y = np.random.default_rng(seed).normal(size=size)
    x_thin, y_thin = plots.envelope(x, y, columns)
    assert x_thin.size <= 2 * columns + 2
    assert np.all(np.diff(x_thin) >= 0.0)
    assert np.max(np.diff(x_thin), initial=0.0) <= 2.0 * (size / columns + 1.0), "no part of the signal is left out"
    assert np.array_equal(y_thin, y[x_thin.astype(int)])
    assert (y_thin.max(), y_thin.min()) == (y.max(), y.min())


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_pictures_are_written_into_new_folders(tmp_path: Path, ending: str) -> None:
    path = tmp_path / "new" / f"run.{ending}"
    plots.plot_run(one_axis(), path)
    assert path.read_bytes()[:4] in (b"\x89PNG", b"<?xm", b"%PDF")
    assert path.stat().st_size > 5000


def test_an_unknown_ending_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"run\.mp3: the name of a picture must end in \.png, "):
        plots.plot_run(one_axis(), tmp_path / "run.mp3")


def test_nothing_to_draw_is_said() -> None:
    with pytest.raises(DescriptionError, match=r"picture x\.png: nothing to draw"):
        plots.plot_panels(Path("x.png"), [])


def test_errors_and_phase_plane_are_drawn(figures: list[Figure]) -> None:
    run = one_axis()
    error = run["plant.position"] - run["trajectory.position"]
    plots.plot_errors(Path("e.png"), {"SMC": (run.time, error), "FSMC": (run.time, 1e-3 * error)})
    plots.plot_phase_plane(Path("p.png"), [plots.Series("SMC", error, 10.0 * error)])
    assert labels(figures[0]) == ["Error [µm]", "Error [nm]"]
    assert [axes.get_title(loc="left") or axes.get_title() for axes in figures[0].axes] == ["SMC", "FSMC"]
    assert (figures[1].axes[0].get_xlabel(), figures[1].axes[0].get_ylabel()) == ("Error [µm]", "Error rate [µm/s]")


def test_the_table_of_a_run() -> None:
    rows = {row.name: row for row in summary(one_axis(), start=3.0)}
    assert rows["Position error, maximum from 3 s"].unit == "um"
    assert rows["Position error, maximum from 3 s"].value == pytest.approx(0.2, rel=1e-4)
    assert rows["Position error, maximum of the whole run"].value == pytest.approx(0.4, rel=1e-9)
    assert rows["Position error, rms from 3 s"].value == pytest.approx(
        # mean of cos^2 over 3...10
        0.2 * math.sqrt(0.5 + (math.sin(20.0) - math.sin(6.0)) / 28.0),
        rel=1e-3,
    )
    assert rows["Position error, at the end"].value == pytest.approx(0.2 * math.cos(10.0), rel=1e-6)
    assert rows["Command, total variation from 3 s"] == (
        "Command, total variation from 3 s",
        pytest.approx(2.0 / 5e-4),
        "N.m/s",
    )
    assert "Overshoot" not in rows


def test_the_table_of_a_step_tells_overshoot_and_settling() -> None:
    time = np.arange(10001) * 1e-4
    position = 1e-3 * (1.0 - np.exp(-time / 0.02) * np.cos(60.0 * time))
    position[0] = 0.0
    rows = {
        row.name: row
        for row in summary(
            Recording(
                time,
                {"source.position": np.full_like(time, 1e-3), "plant.position": position},
                {"source.position": "m", "plant.position": "m"},
                [("plant.position", "c.position"), ("source.position", "c.position_ref")],
            )
        )
    }
    peak = 1e3 * float(np.max(-np.exp(-time / 0.02) * np.cos(60.0 * time)))
    assert rows["Overshoot"].value == pytest.approx(peak, rel=1e-9)
    assert rows["Settling into 2 % of the step"].unit == "ms"
    assert 0.0 < rows["Settling into 2 % of the step"].value <= 20.0 * math.log(50.0) + 0.1
    assert not any(name.startswith("Command") for name in rows)


def two_axes(turns: float) -> Recording:
    """A circle of 20 mm whose X axis is 0.1 % too short, driven for so many turns."""
    angle = np.linspace(0.0, 2.0 * math.pi * turns, round(7200 * turns) + 1)
    columns = {
        "tx.position": 0.02 * np.cos(angle),
        "px.position": 0.02 * (1.0 - 1e-3) * np.cos(angle),
        "ty.position": 0.02 * np.sin(angle),
        "py.position": 0.02 * np.sin(angle),
    }
    connections = [
        (f"{kind}{axis}.position", f"c{axis}.position{end}")
        for axis in "xy"
        for kind, end in (("t", "_ref"), ("p", ""))
    ]
    return Recording(0.001 * angle, columns, dict.fromkeys(columns, "m"), connections)


def test_the_table_of_a_circle_has_the_figures_of_its_last_turn() -> None:
    rows = {row.name: row.value for row in summary(two_axes(2.3))}
    assert rows["Circular deviation G, turn 2"] == pytest.approx(20.0, rel=1e-3)
    assert rows["Radial deviation F_max, turn 2"] == pytest.approx(0.0, abs=1e-6)
    assert rows["Radial deviation F_min, turn 2"] == pytest.approx(-20.0, rel=1e-6)
    assert rows["Radial deviation, mean, turn 2"] == pytest.approx(-10.0, rel=1e-3)


def test_less_than_a_turn_has_no_circular_figures() -> None:
    assert not any("turn" in row.name for row in summary(two_axes(0.9)))


def test_signals_of_different_units_make_no_loop() -> None:
    run = one_axis()
    units = dict(run.units) | {"trajectory.position": "mm"}
    assert loops(Recording(run.time, run.columns, units, run.connections)) == []
