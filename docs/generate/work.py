"""Work and precision of the integrator in the FMUs, against a reference that another program solved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import cosim
from cosim.result.plots import COLOURS, save
from fmus.references.experiments import EXPERIMENTS

from .markup import table

ROOT = Path(__file__).resolve().parents[2]
NAME, EXPERIMENT = "BallscrewStage", "reversals"
TOLERANCES = tuple(10.0**-n for n in range(3, 12))


def measured(pictures: Path, benchmark: dict[str, Any]) -> dict[str, Any]:
    """Table of errors and work of one experiment; draws work.svg and others.svg."""
    experiment = next(found for found in EXPERIMENTS[NAME] if found.name == EXPERIMENT)
    folder = ROOT / "fmus" / "references" / NAME
    wanted = cosim.read_record(folder / f"{EXPERIMENT}_reference.csv")
    rows: list[tuple[float, float, float, float]] = []
    for tolerance in TOLERANCES:
        system = cosim.make_system(
            {
                "connections": ["log.command -> plant.command", "log.load_torque -> plant.load_torque"],
                "experiment": {"stop_time": experiment.step_size * experiment.steps, "step_size": experiment.step_size},
                "signals": {
                    "log": {
                        "file": str(folder / f"{EXPERIMENT}_stimuli.csv"),
                        "interpolation": "hold",
                        "columns": {name: {"column": name, "unit": "N.m"} for name in ("command", "load_torque")},
                    }
                },
                "instances": {"plant": {"fmu": NAME, "start": {**experiment.parameters, "tolerance": tolerance}}},
                "record": {"variables": [f"plant.{name}" for name in wanted.columns]},
            }
        )
        result = cosim.simulate(system)
        error = max(
            float(np.max(np.abs(result[f"plant.{name}"] - values)) / np.max(np.abs(values)))
            for name, values in wanted.columns.items()
        )
        counters = result.solver["plant"]
        steps = experiment.steps
        rows.append((tolerance, error, counters["rhs_evaluations"] / steps, counters["rejected"] / counters["steps"]))
    draw_work(pictures / "work.svg", rows)
    draw_others(pictures / "others.svg", benchmark["more"]["points"])
    heads = ("`tolerance`", "Largest error of an output, relative", "Evaluations a step of 2 ms", "Rejected")
    shown = [(f"{t:.0e}", f"{e:.1e}", f"{n:.0f}", f"{100.0 * share:.0f} %") for t, e, n, share in rows]
    ratios = [ratio for _, *row in benchmark["rows"] for ratio in row]
    return {
        "work_table": table(heads, shown),
        "work_outputs": ", ".join(wanted.columns),
        "work_least": f"{min(ratios):g}",
        "work_most": f"{max(ratios):g}",
    }


def draw_work(path: Path, rows: list[tuple[float, float, float, float]]) -> None:
    """Error over evaluations, with the tolerance at each point."""

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        axes.loglog([row[2] for row in rows], [row[1] for row in rows], "o-", color=COLOURS[0])
        for tolerance, error, count, _ in rows:
            axes.annotate(f"{tolerance:.0e}", (count, error), (7, 3), textcoords="offset points")
        axes.set(xlabel="Evaluations of the derivative a step of 2 ms", ylabel="Largest relative error of an output")
        axes.set_title(f"{NAME}, experiment {EXPERIMENT}: error and work at each tolerance")
        axes.set_xlim(rows[0][2] / 1.2, rows[-1][2] * 1.6)

    save(path, draw, (6.6, 3.8))


def draw_others(path: Path, points: dict[str, dict[str, list[list[float]]]]) -> None:
    """Work over error of this integrator and others, one panel a replay."""

    def draw(figure: Any) -> None:
        for axes, (title, solvers) in zip(figure.subplots(1, len(points)), points.items(), strict=True):
            for i, (name, found) in enumerate(solvers.items()):
                _, errors, counts = zip(*found, strict=True)
                axes.loglog(counts, errors, "o-", color=COLOURS[i], markersize=3, label=name)
            axes.set_title(title.replace(", 10 kHz", ",\n10 kHz").replace("N.m, held", "N.m,\nheld"))
            axes.set_xlabel("Evaluations a sample")
        figure.axes[0].set_ylabel("Largest relative error of a state")
        figure.axes[0].legend()

    save(path, draw, (7.6, 3.9))
