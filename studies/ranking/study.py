"""Every controller on every plant: errors, activity of the command and robustness, tuned by one rule."""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from cosim.result import metrics, plots
from cosim.result.metrics import Array
from cosim.study import Claim, Numbers, Outcomes, Picture, Rule, Run, Status, Study, Value, at_least, at_most

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HERE = Path(__file__).parent
UM = 1e6
CONTROLLERS = {
    "p_pi": "P-PI",
    "cascade": "Cascade",
    "cascade_observer": "Cascade + observer",
    "super_twisting": "Super-twisting",
    "smc": "SMC",
    "csmc": "CSMC",
    "fsmc": "FSMC",
    "nctf_pi": "NCTF PI",
    "nctf_fuzzy": "NCTF fuzzy",
}
PLANTS = {"shams": "Shams", "feng": "Feng X", "maeda": "Maeda", "motor": "Linear motor", "nominal": "Nominal"}
CASES = {"friction": "Friction +30 %", "mass": "Mass +10 %", "late": "One sample of delay", "encoder": "Encoder 0.1 µm"}
Values = Mapping[str, Value]


def tuning() -> ModuleType:
    """The script beside this file that designed the systems."""
    name = "cosim_study_ranking_tune"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, HERE / "tune.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


# Runs

CHANGED: Mapping[str, Mapping[str, Values]] = {
    "shams": {
        "friction": {"plant.friction_scale": 1.3},
        "mass": {"plant.m": 62.4 + 14.6},
        "encoder": {"plant.resolution": 1e-7},
    },
    "feng": {
        "friction": {"plant.friction_scale": 1.3},
        "mass": {"plant.m": 60.0 + 38.0},
        "encoder": {"plant.resolution": 1e-7},
    },
    "maeda": {
        "friction": {"plant.friction_scale": 1.3},
        "mass": {"plant.m": 1.1 * 3.57, "plant.J": 1.1 * 1.81e-4},
        "encoder": {"plant.position_resolution": 1e-7},
    },
    # No dry friction: damping and cutting force change.
    "motor": {
        "friction": {"plant.b": 325.0, "plant.K_t": 1.3 * 3.5e9, "plant.K_n": 1.3 * 2.1e9},
        "mass": {"plant.m": 11.0},
        "encoder": {"plant.position_resolution": 1e-7},
    },
    # No dry friction: damping changes at the same actuator.
    "nominal": {
        "friction": {"plant.alpha": 1.3 * 215.2, "plant.K": 5.672e-3 / 1.3},
        "mass": {"plant.alpha": 215.2 / 1.1},
        "encoder": {"plant.position_resolution": 1e-7},
    },
}
MOVE: Values = {
    "trajectory.kind": "jerk_limited",
    "trajectory.amplitude": 1e-2,
    "trajectory.velocity_max": 0.05,
    "trajectory.acceleration_max": 1.0,
    "trajectory.jerk_max": 50.0,
    "trajectory.out_and_back": True,
    "trajectory.dwell": 0.2,
    "trajectory.repetitions": 0.0,
}
WINDOW = (1.0, 5.0)


def runs() -> dict[str, Run]:
    found: dict[str, Run] = {}
    for controller in CONTROLLERS:
        for plant in PLANTS:
            name = f"{controller}_{plant}"
            system = f"systems/{name}.toml"
            found[f"{name}_sine"] = Run(system, window=WINDOW, keep_every=5)
            found[f"{name}_move"] = Run(system, MOVE, window=WINDOW, keep_every=20)
            found[f"{name}_late"] = Run(f"systems/{name}_late.toml", window=WINDOW, keep_every=1000)
            for case, values in CHANGED[plant].items():
                found[f"{name}_{case}"] = Run(system, values, window=WINDOW, keep_every=1000)
    return found


# What the runs say


def rms(outcomes: Outcomes, controller: str, plant: str, case: str = "sine") -> float:
    """rms error in m."""
    return outcomes.number(f"{controller}_{plant}_{case}", "error_rms")


def activity(outcomes: Outcomes, controller: str, plant: str, case: str = "sine") -> float:
    """Total variation of the command in a second, as acceleration of the nominal mass: m/s2/s."""
    data = tuning().PLANTS[plant]
    lead = data.lead if controller in ("smc", "csmc", "fsmc") else 1.0
    return outcomes.number(f"{controller}_{plant}_{case}", "command_tv") / (lead * data.M)


def matrix(value: Callable[[str, str], float]) -> Array:
    """One row a controller, one column a plant."""
    return np.array([[value(controller, plant) for plant in PLANTS] for controller in CONTROLLERS])


def ranks(outcomes: Outcomes, figure: Callable[[str, str], float]) -> dict[str, float]:
    """Mean place over the plants, 1 is best."""
    values = matrix(figure)
    places = np.argsort(np.argsort(values, axis=0), axis=0) + 1.0
    return dict(zip(CONTROLLERS.values(), places.mean(axis=1).tolist(), strict=True))


def plants_where(condition: Callable[[Outcomes, str], bool]) -> Callable[[Outcomes], float]:
    """On how many of the five plants a condition holds."""
    return lambda outcomes: float(sum(condition(outcomes, plant) for plant in PLANTS))


def better(one: str, other: str, case: str = "sine") -> Callable[[Outcomes], float]:
    return plants_where(lambda outcomes, plant: rms(outcomes, one, plant, case) < rms(outcomes, other, plant, case))


def order_of_shams(outcomes: Outcomes, plant: str) -> bool:
    smc, csmc, fsmc = (rms(outcomes, controller, plant) for controller in ("smc", "csmc", "fsmc"))
    return fsmc < csmc < smc


def mean_places(outcomes: Outcomes) -> Numbers:
    return ranks(outcomes, lambda c, p: rms(outcomes, c, p) + rms(outcomes, c, p, "move"))


def worst_growth(case: str) -> Callable[[Outcomes], Numbers]:
    """Largest growth of the rms error over the plants, by controller."""
    return lambda outcomes: {
        text: max(rms(outcomes, controller, plant, case) / rms(outcomes, controller, plant) for plant in PLANTS)
        for controller, text in CONTROLLERS.items()
    }


def first(name: str) -> Rule:
    return Rule(f"{name} has the lowest", lambda m, _: min(m, key=lambda key: m[key]) == name)


ON_PLANTS: Mapping[Status, Rule] = {"reproduced": at_least(5.0), "order only": at_least(3.0)}
ELSEWHERE, TABLE = "What the papers claim, on plants they did not try", "The ranking"


def claims() -> tuple[Claim, ...]:
    return (
        Claim(
            "E1",
            "FSMC is better than CSMC, and CSMC than SMC (Shams)",
            "on the ballscrew stage",
            "of 5 plants",
            plants_where(order_of_shams),
            ON_PLANTS,
            ELSEWHERE,
            "rms error, sine",
        ),
        Claim(
            "E2",
            "Super-twisting is better than P-PI (Rubio)",
            "on the linear motor",
            "of 5 plants",
            better("super_twisting", "p_pi"),
            ON_PLANTS,
            ELSEWHERE,
            "rms error, sine",
            "It pays for the bound it is designed for with chatter: with a reserve of 0.1 m/s² alone it was 3 of 5.",
        ),
        Claim(
            "E3",
            "Fuzzy NCTF with the reference's velocity beats NCTF with PI on continuous motion (Purtojo)",
            "on the nominal stage",
            "of 5 plants",
            better("nctf_fuzzy", "nctf_pi"),
            ON_PLANTS,
            ELSEWHERE,
            "rms error, sine",
        ),
        Claim(
            "E4",
            "A disturbance observer is better than none (Feng)",
            "on the X-Y table",
            "of 5 plants",
            better("cascade_observer", "cascade"),
            ON_PLANTS,
            ELSEWHERE,
            "rms error, sine",
            "Each is tuned on its own: the observer may take the margin that the loop needs.",
        ),
        Claim(
            "E5",
            "FSMC is smooth: its command varies no more than that of SMC (Shams)",
            "no chatter",
            "of 5 plants",
            plants_where(lambda o, plant: activity(o, "fsmc", plant) <= 1.5 * activity(o, "smc", plant)),
            ON_PLANTS,
            ELSEWHERE,
            "total variation, sine",
        ),
        Claim(
            "R1",
            "FSMC has the best mean place",
            "Shams: best of three",
            "place",
            mean_places,
            {"reproduced": first("FSMC")},
            TABLE,
            "rms error, sine and move, mean place on five plants",
        ),
        *(
            Claim(
                f"R{i}",
                f"Robust to: {text}",
                "rms error at most doubled",
                "rms over nominal",
                worst_growth(case),
                {"reproduced": at_most(2.0)},
                TABLE,
                "worst plant",
            )
            for i, (case, text) in enumerate(CASES.items(), start=2)
        ),
    )


# Pictures


def draw_maps(
    maps: Callable[[Outcomes], Mapping[str, Array]], *, log: bool, unit: str = ""
) -> Callable[[Outcomes, Path], None]:
    """Tables of controllers and plants side by side, a colour and a number a cell."""

    def draw(outcomes: Outcomes, path: Path) -> None:
        found = maps(outcomes)

        def fill(figure: Figure) -> None:
            for i, (title, values) in enumerate(found.items()):
                axes = figure.add_subplot(math.ceil(len(found) / 2), 2, i + 1)
                shown = np.log10(np.maximum(values, 1e-12)) if log else np.clip(values, 0.8, 5.0)
                axes.imshow(shown, cmap="YlOrRd", aspect="auto", vmin=None if log else 0.8, vmax=None if log else 5.0)
                axes.grid(visible=False)
                low, high = (float(shown.min()), float(shown.max())) if log else (0.8, 5.0)
                for (row, column), value in np.ndenumerate(values):
                    colour = "white" if shown[row, column] > low + 0.75 * (high - low) else "black"
                    axes.text(column, row, f"{value:.3g}", ha="center", va="center", fontsize=7.5, color=colour)
                axes.set_xticks(range(len(PLANTS)), list(PLANTS.values()), fontsize=7.5)
                labels = list(CONTROLLERS.values()) if i % 2 == 0 else [""] * len(CONTROLLERS)
                axes.set_yticks(range(len(CONTROLLERS)), labels, fontsize=8)
                axes.set_title(f"{title}{f' [{unit}]' if unit else ''}", fontsize=9)

        plots.save(path, fill, (10.0, 0.6 + 3.1 * math.ceil(len(found) / 2)))

    return draw


def errors_of(outcomes: Outcomes) -> Mapping[str, Array]:
    return {
        "rms, sine 5 mm": matrix(lambda c, p: UM * rms(outcomes, c, p)),
        "rms, move of 10 mm": matrix(lambda c, p: UM * rms(outcomes, c, p, "move")),
        "Largest, sine": matrix(lambda c, p: UM * outcomes.number(f"{c}_{p}_sine", "error_max")),
        "Largest, move": matrix(lambda c, p: UM * outcomes.number(f"{c}_{p}_move", "error_max")),
    }


def growth_of(outcomes: Outcomes) -> Mapping[str, Array]:
    return {
        text: matrix(lambda c, p, case=case: rms(outcomes, c, p, case) / rms(outcomes, c, p))
        for case, text in CASES.items()
    }


def activity_of(outcomes: Outcomes) -> Mapping[str, Array]:
    return {
        "Sine": matrix(lambda c, p: activity(outcomes, c, p)),
        "Sine, encoder 0.1 µm": matrix(lambda c, p: activity(outcomes, c, p, "encoder")),
    }


def draw_choice(outcomes: Outcomes, path: Path) -> None:
    """What a user weighs: error against activity, one panel a plant."""

    from matplotlib.ticker import NullFormatter

    def fill(figure: Figure) -> None:
        for i, (plant, text) in enumerate(PLANTS.items()):
            axes = figure.add_subplot(2, 3, i + 1)
            for j, (controller, label) in enumerate(CONTROLLERS.items()):
                x, y = (
                    activity(outcomes, controller, plant, "encoder"),
                    UM * rms(outcomes, controller, plant, "encoder"),
                )
                axes.plot(x, y, "o", color=plots.COLOURS[j % len(plots.COLOURS)], markersize=5.0)
                axes.annotate(label, (x, y), textcoords="offset points", xytext=(4.0, 3.0), fontsize=6.5)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.margins(0.3, 0.15)
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.set_title(text, fontsize=9)
            axes.set_xlabel("Total variation [m/s²/s]", fontsize=8)
            axes.set_ylabel("rms error [µm]", fontsize=8)

    plots.save(path, fill, (11.0, 6.6))


def draw_feng(outcomes: Outcomes, path: Path) -> None:
    """Errors on the X axis of Feng about a reversal of the sine."""
    panels: list[plots.Panel] = []
    for i, (controller, text) in enumerate(CONTROLLERS.items()):
        result = outcomes.result(f"{controller}_feng_sine")
        part = metrics.window(result.time, 2.4, 3.4)
        error = (result["plant.position"] - result["trajectory.position"])[part]
        panels.append(plots.Panel("Error", "m", (plots.Series(text, result.time[part], error, i),)))
    plots.plot_panels(path, panels, columns=2)


STUDY = Study(
    title="Every controller on every plant",
    source="The five papers of this library; none of them compares across plants.",
    text="""
Nine controllers on five plants, all at 10 kHz with the same references (a sine of 5 mm at 0.5 Hz and jerk-limited
moves of 10 mm), the same disturbance (0.05 m/s² of the mass at 3 Hz), the same measurement (position only, velocity by
difference and a filter of 0.5 ms) and the same largest force. They know the mass and damping of the nominal plant;
those with a friction model take 0.8 of its dry friction.

**Rule of tuning** (`tune.py`): all gains follow from one knob, a bandwidth ω: fast pole ω, position pole ω/4, integral
ω/8. Each knob is tried at the same fourteen values, 1.5 apart, on the sine with one sample of delay; values at which
the loop swings by itself are out, and it is set one step below the one with the least rms error. The gain on the
connection turns each command into that of the plant. This is equal effort, not each controller's best: NCTF control
with PI does not use the reference's velocity and lags any moving reference, for which it is not made.

Errors count from 1 s to 5 s. Where a plant has no dry friction, "friction +30 %" is its damping (and cutting force).
""",
    runs=runs(),
    claims=claims(),
    pictures={
        "errors": Picture("Errors in µm", draw_maps(errors_of, log=True, unit="µm")),
        "robustness": Picture("rms error over that of the nominal case", draw_maps(growth_of, log=False)),
        "activity": Picture(
            "Total variation of the command, as acceleration of the mass, m/s² in a second",
            draw_maps(activity_of, log=True, unit="m/s²/s"),
        ),
        "choice": Picture("Error against activity with an encoder of 0.1 µm", draw_choice),
        "reversals": Picture("X axis of Feng et al. on the sine", draw_feng),
    },
)
