"""Every controller on every plant: errors, activity of the command and robustness, with and without friction model."""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import rankdata, spearmanr

from cosim.errors import DescriptionError
from cosim.result import metrics, plots
from cosim.result.metrics import Array
from cosim.result.result import Result
from cosim.study import Numbers, Outcomes, Picture, Run, Value, read_study
from cosim.study.pictures import Signals, over_time
from cosim.study.report import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HERE = Path(__file__).parent
UM = 1e6


def tuning() -> ModuleType:
    """The script beside this file that designs the systems."""
    name = f"cosim_ranking_tune_{abs(hash(HERE))}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, HERE / "tune.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


TUNE = tuning()
ENTRIES: Mapping[str, ModuleType] = TUNE.controllers(HERE)
CONTROLLERS = {name: str(entry.TITLE) for name, entry in ENTRIES.items()}
GAINS = TUNE.read_gains(HERE)
PLANTS = {"shams": "Shams", "feng": "Feng X", "maeda": "Maeda", "motor": "Linear motor", "nominal": "Nominal"}
FRICTION = ("shams", "feng", "maeda")
"""Plants with dry friction: they have a column without and a column with a friction model."""
MODELS = {False: "without model", True: "with model"}
REFERENCES: Mapping[str, Mapping[str, Value]] = {
    "move": {
        "trajectory.kind": "jerk_limited",
        "trajectory.amplitude": 1e-2,
        "trajectory.velocity_max": 0.05,
        "trajectory.acceleration_max": 1.0,
        "trajectory.jerk_max": 50.0,
        "trajectory.out_and_back": True,
        "trajectory.dwell": 0.2,
        "trajectory.repetitions": 0.0,
    },
    "fast": {"trajectory.amplitude": 1e-3, "trajectory.frequency": 2.0},
    "slow": {"trajectory.amplitude": 5e-4, "trajectory.frequency": 0.25},
}
"""References for the judgement: moves of 10 mm, sines of 1 mm at 2 Hz and of 0.5 mm at 0.25 Hz. Tuning uses none."""
WINDOW = (1.0, 5.0)
MACHINES = 64
BOXES: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "shams": {
        "plant.m": (0.75, 1.5),
        "plant.friction_scale": (0.7, 1.4),
        "plant.sigma_0": (0.5, 2.0),
        "plant.sigma_2": (0.5, 2.0),
    },
    "feng": {
        "plant.m": (0.5, 2.0),
        "plant.friction_scale": (0.7, 1.4),
        "plant.sigma_0": (0.5, 2.0),
        "plant.sigma_2": (0.5, 2.0),
    },
    "maeda": {
        "plant.J": (0.8, 1.25),
        "plant.friction_scale": (0.7, 1.4),
        "plant.K_n": (0.7, 1.4),
        "plant.sigma_2": (0.5, 2.0),
    },
    "motor": {"plant.m": (0.8, 1.25), "plant.b": (0.5, 2.0), "plant.K_t": (0.5, 2.0), "plant.K_n": (0.5, 2.0)},
    "nominal": {"plant.alpha": (0.7, 1.4), "plant.K": (0.8, 1.25)},
}
"""Ranges of the factors by which machines differ, on mass, friction, stiffness, damping and gain."""


# Runs


def columns(plant: str) -> tuple[bool, ...]:
    """Without and, if the plant has dry friction, with its model."""
    return (False, True) if plant in FRICTION else (False,)


def activity(controller: str, plant: str) -> Callable[[Result, tuple[float, float]], Numbers]:
    """Total variation of the force as acceleration of the nominal mass, m/s2 in a second."""

    def measure(result: Result, window: tuple[float, float]) -> Numbers:
        data = TUNE.PLANTS[plant]
        name = next(name for name in result.names if name.rpartition(".")[0] not in ("trajectory", "plant"))
        at_screw = name.startswith("controller.") and getattr(ENTRIES[controller], "AT_SCREW", False)
        part = metrics.window(result.time, *window)
        variation = metrics.total_variation(result.time[part], result[name][part])
        return {"command_tv": variation / ((data.lead if at_screw else 1.0) * data.M)}

    return measure


def start_values(controller: str, plant: str, model: bool, seed: int) -> dict[str, Value]:
    """Gains found with ``seed``, as changes of the system that has the gains of the first seed."""
    row = GAINS[controller][plant][TUNE.COLUMNS[model]][str(seed)]["gains"]
    found: dict[str, Any] = {}
    for instance, start in TUNE.starts(ENTRIES[controller], TUNE.PLANTS[plant], TUNE.Gains(*row), model).items():
        for name, value in start.items():
            values = value if isinstance(value, list) else None
            found |= (
                {f"{instance}.{name}[{i}]": item for i, item in enumerate(values, start=1)}
                if values
                else {f"{instance}.{name}": value}
            )
    return found


def runs() -> dict[str, Run]:
    """All runs by name: controller, plant, column, reference or machines, seed. Raises DescriptionError."""
    missing = [name for name in CONTROLLERS if name not in GAINS]
    if missing:
        names = " ".join(missing)
        raise DescriptionError(f"{HERE}: no gains for {names}. Run python tune.py --controllers {names}.")
    found: dict[str, Run] = {}
    for controller in CONTROLLERS:
        for plant in PLANTS:
            for model in columns(plant):
                name = TUNE.system_name(controller, plant, model)
                system, measure = f"systems/{name}.toml", activity(controller, plant)
                for reference, values in REFERENCES.items():
                    for seed in TUNE.SEEDS:
                        changed = {} if seed == TUNE.SEEDS[0] else start_values(controller, plant, model, seed)
                        label = f"{name}_{reference}" + ("" if seed == TUNE.SEEDS[0] else f"_seed{seed}")
                        found[label] = Run(system, {**values, **changed}, None, WINDOW, measure, 20)
                found[f"{name}_machines"] = Run(
                    system, REFERENCES["fast"], 1.5, (0.75, 1.5), measure, 1000, machines=MACHINES, box=BOXES[plant]
                )
    return found


# What the runs say


def figure(outcomes: Outcomes, name: str, controller: str, plant: str, model: bool, case: str, seed: int = 1) -> float:
    """A figure of a run; for a plant without dry friction it is the same in both columns."""
    system = TUNE.system_name(controller, plant, model and plant in FRICTION)
    return outcomes.number(f"{system}_{case}{'' if seed == TUNE.SEEDS[0] else f'_seed{seed}'}", name)


def places(outcomes: Outcomes, name: str, model: bool, seed: int = 1) -> Array:
    """Mean place of every controller over plants and references, 1 is best; equal figures share a place."""
    found = [
        rankdata([figure(outcomes, name, c, plant, model, reference, seed) for c in CONTROLLERS])
        for plant in PLANTS
        for reference in REFERENCES
    ]
    return np.mean(found, axis=0)


def named(values: Sequence[float] | Array) -> Numbers:
    """Values by the names of the controllers."""
    return dict(zip(CONTROLLERS.values(), map(float, values), strict=True))


def correlation(one: Array, other: Array) -> float:
    """Spearman's rank correlation: 1 for the same order."""
    result: Any = spearmanr(one, other)
    return float(result.statistic)


def correlations(outcomes: Outcomes) -> Numbers:
    """Rank correlations that show how the order depends on the choices of the study."""
    rms = {model: places(outcomes, "error_rms", model) for model in MODELS}
    found = {f"seeds, {MODELS[m]}": correlation(rms[m], places(outcomes, "error_rms", m, 2)) for m in MODELS}
    for model, text in MODELS.items():
        found[f"rms and largest, {text}"] = correlation(rms[model], places(outcomes, "error_max", model))
        found[f"rms and variation, {text}"] = correlation(rms[model], places(outcomes, "command_tv", model))
    return {**found, "with and without model": correlation(rms[False], rms[True])}


def gain_of_model(outcomes: Outcomes) -> Numbers:
    """rms error without the friction model divided by that with it.

    The ratio is the geometric mean over plants with friction and references.
    """
    ratios = [
        [
            math.log(figure(outcomes, "error_rms", c, plant, False, reference))
            - math.log(figure(outcomes, "error_rms", c, plant, True, reference))
            for plant in FRICTION
            for reference in REFERENCES
        ]
        for c in CONTROLLERS
    ]
    return named(np.exp(np.mean(ratios, axis=1)))


def machines(name: str, model: bool) -> Callable[[Outcomes], Numbers]:
    """Figure of the machines divided by that of the nominal machine; the largest ratio over the plants."""

    def measure(outcomes: Outcomes) -> Numbers:
        return named(
            [
                max(
                    figure(outcomes, f"error_rms_{name}", c, plant, model, "machines")
                    / figure(outcomes, "error_rms", c, plant, model, "machines")
                    for plant in PLANTS
                )
                for c in CONTROLLERS
            ]
        )

    return measure


def over_diagonal(_: Outcomes) -> Numbers:
    """Lowest cost on the diagonal divided by that with three free gains: geometric mean over plants, columns, seeds."""
    found: list[float] = []
    for controller in CONTROLLERS:
        rows = [row for plant in GAINS[controller].values() for column in plant.values() for row in column.values()]
        found.append(math.exp(np.mean([math.log(row["cost_diagonal"] / row["cost"]) for row in rows])))
    return named(found)


def seeds(outcomes: Outcomes) -> Numbers:
    """Ratio of the larger to the smaller rms error of two seeds: median over plants, columns and references."""
    return named(
        [
            float(
                np.median(
                    [
                        math.exp(
                            abs(
                                math.log(
                                    figure(outcomes, "error_rms", c, p, m, r, 1)
                                    / figure(outcomes, "error_rms", c, p, m, r, 2)
                                )
                            )
                        )
                        for p in PLANTS
                        for m in columns(p)
                        for r in REFERENCES
                    ]
                )
            )
            for c in CONTROLLERS
        ]
    )


def place_measure(name: str, model: bool) -> Callable[[Outcomes], Numbers]:
    """Mean places as a measure."""
    return lambda outcomes: named(places(outcomes, name, model))


MEASURES: dict[str, Callable[[Outcomes], Numbers]] = {
    **{
        f"places_{short}_{TUNE.COLUMNS[model]}": place_measure(name, model)
        for short, name in {"rms": "error_rms", "max": "error_max", "variation": "command_tv"}.items()
        for model in MODELS
    },
    **{f"machines_{name}_{TUNE.COLUMNS[m]}": machines(name, m) for name in ("p90", "worst") for m in MODELS},
    "correlations": correlations,
    "gain_of_model": gain_of_model,
    "over_diagonal": over_diagonal,
    "seeds": seeds,
}


def conclusion(outcomes: Outcomes) -> str:
    """What a user should conclude, in five sentences; the names and figures come from the runs."""

    def best(values: Numbers, count: int = 1) -> str:
        return ", ".join(f"{name} ({number(values[name])})" for name in sorted(values, key=lambda n: values[n])[:count])

    def least_and_most(values: Numbers) -> str:
        low, high = (choose(values, key=lambda n: values[n]) for choose in (min, max))
        return f"{number(values[low])} ({low}) to {number(values[high])} ({high})"

    rms = {model: named(places(outcomes, "error_rms", model)) for model in MODELS}
    calm = named(places(outcomes, "command_tv", True))
    order = correlations(outcomes)
    p90 = {model: machines("p90", model)(outcomes) for model in MODELS}
    alike = min(order["seeds, without model"], order["seeds, with model"], order["with and without model"])
    return f"""
1. The mean places by rms error lead with {best(rms[False], 4)} without a model of friction and
   {best(rms[True], 4)} with it: places as near as these are decided by the plant, so read the figures of yours below.
2. The same model of friction divides the error by {least_and_most(gain_of_model(outcomes))}: for most that is more than
   the step to the next controller, and nobody gets it for nothing, as sentence 5 says.
3. Tuning counts as much: three free gains divide the cost of one knob by {least_and_most(over_diagonal(outcomes))}, and
   two searches differ by a factor of {least_and_most(seeds(outcomes))} in the median.
4. The order itself is steady, with rank correlations of at least {number(alike)} between two seeds and between with and
   without model, but it says nothing about a calm command (correlation with the order by variation:
   {number(order["rms and variation, with model"])}), where {best(calm, 3)} lead.
5. On nine of ten machines of the box the error grows by no more than {best(p90[False], 3)} without the model, and
   with it by {least_and_most(p90[True])}: what is tuned with a good model is lost first where the machine is another.
"""


def tables(outcomes: Outcomes) -> str:
    """The figures behind the ranking, in Markdown."""
    parts: list[str] = []
    for reference in REFERENCES:
        for name, text, factor in (
            ("error_rms", "rms error in µm", UM),
            ("error_max", "largest error in µm", UM),
            ("command_tv", "variation of the force in m/s² a second", 1.0),
        ):
            head = [
                f"{title} {TUNE.COLUMNS[m]}" if p in FRICTION else title
                for p, title in PLANTS.items()
                for m in columns(p)
            ]
            rows = [
                [number(factor * figure(outcomes, name, c, p, m, reference)) for p in PLANTS for m in columns(p)]
                for c in CONTROLLERS
            ]
            lines = [f"| {title} | {' | '.join(row)} |" for title, row in zip(CONTROLLERS.values(), rows, strict=True)]
            rule = "|---" * (len(head) + 1) + "|"
            parts.append(f"**{reference}: {text}**\n\n| | {' | '.join(head)} |\n{rule}\n" + "\n".join(lines))
    return "\n\n".join(parts)


# Pictures


def draw_maps(name: str, factor: float, unit: str) -> Callable[[Outcomes, Path], None]:
    """Draw tables of controllers and plants, one for each reference and column; a cell has a colour and a number."""

    def draw(outcomes: Outcomes, path: Path) -> None:
        def fill(canvas: Figure) -> None:
            for i, (reference, model) in enumerate((r, m) for r in REFERENCES for m in MODELS):
                axes = canvas.add_subplot(len(REFERENCES), 2, i + 1)
                values = np.array(
                    [[factor * figure(outcomes, name, c, p, model, reference) for p in PLANTS] for c in CONTROLLERS]
                )
                shown = np.log10(np.maximum(values, 1e-12))
                axes.imshow(shown, cmap="YlOrRd", aspect="auto")
                axes.grid(visible=False)
                dark = float(shown.min()) + 0.75 * float(np.ptp(shown))
                for (row, column), value in np.ndenumerate(values):
                    colour = "white" if shown[row, column] > dark else "black"
                    axes.text(column, row, f"{value:.3g}", ha="center", va="center", fontsize=7.5, color=colour)
                axes.set_xticks(range(len(PLANTS)), list(PLANTS.values()), fontsize=7.5)
                labels = list(CONTROLLERS.values()) if i % 2 == 0 else [""] * len(CONTROLLERS)
                axes.set_yticks(range(len(CONTROLLERS)), labels, fontsize=8)
                axes.set_title(f"{reference}, {MODELS[model]} [{unit}]", fontsize=9)

        plots.save(path, fill, (10.0, 0.6 + 3.1 * len(REFERENCES)))

    return draw


def draw_choice(outcomes: Outcomes, path: Path) -> None:
    """Draw error over activity on the moves, one panel for each plant; lines lead to the points with friction model."""
    from matplotlib.ticker import NullFormatter

    def fill(canvas: Figure) -> None:
        for i, (plant, text) in enumerate(PLANTS.items()):
            axes = canvas.add_subplot(2, 3, i + 1)
            for j, (controller, label) in enumerate(CONTROLLERS.items()):
                x, y = (
                    [factor * figure(outcomes, name, controller, plant, model, "move") for model in columns(plant)]
                    for name, factor in (("command_tv", 1.0), ("error_rms", UM))
                )
                axes.plot(x, y, "-", color=plots.COLOURS[j % len(plots.COLOURS)], linewidth=0.8)
                axes.plot(x[-1], y[-1], "o", color=plots.COLOURS[j % len(plots.COLOURS)], markersize=5.0)
                axes.annotate(label, (x[-1], y[-1]), textcoords="offset points", xytext=(4.0, 3.0), fontsize=6.5)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.margins(0.3, 0.15)
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.set_title(text, fontsize=9)
            axes.set_xlabel("Total variation [m/s²/s]", fontsize=8)
            axes.set_ylabel("rms error [µm]", fontsize=8)

    plots.save(path, fill, (11.0, 6.6))


STUDY = read_study(
    HERE / "claims.toml",
    runs(),
    {
        "rms": Picture("rms error", draw_maps("error_rms", UM, "µm")),
        "largest": Picture("Largest error", draw_maps("error_max", UM, "µm")),
        "choice": Picture("Error against activity on the moves; dots: with model where there is friction", draw_choice),
        "reversals": over_time(
            "X axis of Feng et al. with model, moves of 10 mm",
            [
                Signals(
                    "Error",
                    "m",
                    {text: f"{c}_feng_model_move: plant.position - trajectory.position"},
                    (1.0, 3.0),
                    colours=(i,),
                )
                for i, (c, text) in enumerate(CONTROLLERS.items())
            ],
            columns=2,
        ),
    },
    measures=MEASURES,
    chapters={"What to conclude": conclusion, "All figures": tables},
)
