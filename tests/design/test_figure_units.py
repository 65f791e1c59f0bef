"""The units of figures: of the tracking figures, and of figures that a file asks for."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.design.plan import Metric, figure_units, measure
from cosim.master.simulation import simulate
from cosim.result.metrics import OF_ONE_SIGNAL
from cosim.system.system import read_system

STUDIES = Path(__file__).parents[2] / "studies"


@pytest.mark.parametrize("name", ["maeda2008/step.toml", "feng2015/circle.toml"])
def test_every_tracking_figure_has_a_unit(native: Path, name: str) -> None:
    system = read_system(STUDIES / name, fmus=native, stop_time=0.1)
    units = figure_units(system, ())
    assert list(units) == list(measure(simulate(system), (), (0.0, 0.1)))
    assert len(units) in (9, 18)
    for figure, unit in units.items():
        force = "A" if name.startswith("maeda") else "N.m"
        command = f"{force}/s" if figure.endswith("_tv") else force
        assert unit == ("m" if "error" in figure else command)


def test_figures_of_a_file_have_the_unit_of_their_signal(native: Path) -> None:
    system = read_system(STUDIES / "maeda2008/step.toml", fmus=native)
    wanted = [Metric(of, of, "plant.velocity") for of in OF_ONE_SIGNAL]
    assert figure_units(system, wanted) == {of: "m/s/s" if of == "total_variation" else "m/s" for of in OF_ONE_SIGNAL}
