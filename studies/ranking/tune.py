"""Systems of the ranking, and the search for the gains of every controller on every plant.

All loops are sampled at 10 kHz and measure the position only (velocity by difference and a filter of 0.5 ms). They
know the nominal mass M and viscous damping B of the plant at the table and have the same force limit: four times the
force for static friction, damping and 1.5 m/s2. A plant with dry friction has two columns: *without* a model of
friction, and *with* the same model for all controllers, LuGre at the reference velocity with 0.8 of the dry friction.
The sliding-mode controllers contain this model; ``FrictionFeedforward`` adds it to the force of all others.

Each controller is a file in ``controllers/`` with its FMU, its connections, and the formulas for its parameters from
three free frequencies: ``gains.fast`` (the fast pole), ``gains.position`` and ``gains.integral``.

Equal budget: 60 simulations for each controller, plant, column and seed. The first 12 lie on a diagonal of the box of
frequencies, the others are steps of a search by random steps (one-fifth rule) around the best. A simulation is the sine
of 5 mm at 0.5 Hz with one sample of delay. The cost is the rms error; it is raised if the command varies more than 50
times as much as the motion needs. The frequencies used are 0.8 of the best ones, a margin to the edge of stability. The
study judges the controllers on other references.

``python tune.py [--controllers NAME ...] [--jobs N]`` writes ``gains.toml`` and ``systems/``; gains that are known are
kept, ``--again`` searches anew. It needs the FMUs in build/fmus/native and takes about ten minutes on two cores.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import sys
import tomllib
import zlib
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from cosim.errors import CosimError
from cosim.master.simulation import simulate
from cosim.result import metrics
from cosim.system.system import make_system

HERE = Path(__file__).parent
FMUS = HERE.parents[1] / "build" / "fmus" / "native"
T_S, FILTER = 1e-4, 5e-4
SEEDS = (1, 2)
BUDGET, DIAGONAL = 60, 12
"""Number of simulations of a search, and of those on the diagonal of the box."""
LOW, HIGH = (40.0, 5.0, 2.0), (8000.0, 2000.0, 2000.0)
"""Box of the three frequencies, 1/s."""
CALM = 50.0
"""Largest variation of the command, relative to the variation that the motion needs, that does not raise the cost.

A command that follows reversals, sine and disturbance has 1; a loop that oscillates has several hundreds.
"""
MARGIN = 0.8
"""Ratio of the frequencies used to the frequencies found: a factor of 1.25 from the edge of oscillation."""
SHARE = 0.8
"""Share of the dry friction that the friction model contains: a model is never perfect."""
COLUMNS = {False: "without", True: "with"}
"""Whether there is a model of friction -> name of the column."""
Start = dict[str, Any]
FEED_LEAD = 1.5915494309189535e-3


@dataclass(frozen=True)
class Plant:
    """A plant, with mass, damping and friction at its table (SI); 1 N at the table needs a command of ``unit``."""

    text: str
    fmu: str
    start: Start
    M: float
    B: float
    F_C: float
    F_S: float
    unit: float
    disturbance: tuple[str, float]
    """Input for disturbances, and its value for a force of 1 N against positive motion."""
    lead: float = 1e-3
    friction: tuple[float, float, float, float] = (1e5, 300.0, 0.0, 1e-2)
    """sigma_0, sigma_1, sigma_2, v_s at the screw, for models of friction."""

    @property
    def force_max(self) -> float:
        return 4.0 * (self.F_S + 1.5 * self.M + self.B * 0.05)

    @property
    def reserve(self) -> float:
        """Reserve of acceleration in m/s2 for unknown forces: 0.1 m/s2, and 0.3 of the damping at 50 mm/s."""
        return 0.1 + 0.3 * self.B * 0.05 / self.M

    @property
    def needed_variation(self) -> float:
        """Variation of the force in N per second that sine, reversals and disturbance need."""
        inertia, reversals, disturbance = 2.0 * 5e-3 * math.pi**2, 2.0 * self.F_C / self.M, 12.0 * 0.05
        return self.M * (inertia + reversals + disturbance)

    def sliding_mode(self, gains: Gains, *, model: bool) -> tuple[Start, float, float]:
        """What the sliding-mode controllers share: start values, reserve of acceleration in m/s2, gain in N.m."""
        l_p = self.lead
        inertia = self.M * l_p**2
        sigma_0, sigma_1, sigma_2, v_s = self.friction
        reserve = self.reserve * 8.0 * gains.integral / gains.fast
        common = {
            "l_p": l_p,
            "J_hat": inertia,
            "lambda_": gains.position,
            "sigma_0_hat": sigma_0,
            "sigma_1_hat": sigma_1 if self.F_S > 0.0 else 0.0,
            "sigma_2_hat": sigma_2 if self.F_S > 0.0 else self.B * l_p**2,
            "F_C_hat": max(0.8 * self.F_C * l_p, 1e-9),
            "F_S_hat": max(0.8 * self.F_S * l_p, 1e-9),
            "v_s_hat": v_s,
            "friction_velocity": "reference" if model or self.F_S == 0.0 else "none",
            "command_max": self.force_max * l_p,
        }
        return common, reserve, self.F_S * l_p + inertia * reserve / l_p


PLANTS = {
    "shams": Plant(
        "the stage of Shams and Safdari",
        "BallscrewStage",
        {},
        M=62.4 + 2.12e-4 / 1.5923e-3**2,
        B=0.4 / 1.5923e-3**2,
        F_C=6.24 / 1.5923e-3,
        F_S=9.36 / 1.5923e-3,
        unit=1.5923e-3,
        disturbance=("load_torque", 1.5923e-3),
        lead=1.5923e-3,
        friction=(1e5, 316.22776601683796, 0.4, 1e-3),
    ),
    "feng": Plant(
        "the X axis of Feng et al.",
        "BallscrewStage",
        {
            "m": 60.0,
            "J_rot": 320.0 * FEED_LEAD**2,
            "l_p": FEED_LEAD,
            "sigma_0": 1.8e7 * FEED_LEAD**2,
            "sigma_1": 2.5e4 * FEED_LEAD**2,
            "sigma_2": 400.0 * FEED_LEAD**2,
            "F_C": 90.0 * FEED_LEAD,
            "F_S": 115.0 * FEED_LEAD,
            "v_s": 2e-3 / FEED_LEAD,
        },
        M=380.0,
        B=400.0,
        F_C=90.0,
        F_S=115.0,
        unit=FEED_LEAD,
        disturbance=("load_torque", FEED_LEAD),
        lead=FEED_LEAD,
        friction=(1.8e7 * FEED_LEAD**2, 2.5e4 * FEED_LEAD**2, 400.0 * FEED_LEAD**2, 2e-3 / FEED_LEAD),
    ),
    "maeda": Plant(
        "the two-mass stage of Maeda and Sato",
        "CompliantBallscrew",
        {"command_max": 0.0},
        M=3.57 + 1.81e-4 / 3.183098861837907e-4**2,
        B=9.7e-4 / 3.183098861837907e-4**2,
        F_C=0.046 / 3.183098861837907e-4,
        F_S=0.046 / 3.183098861837907e-4,
        unit=3.183098861837907e-4 / 0.172,
        disturbance=("load_force", 1.0),
        lead=3.183098861837907e-4,
        friction=(14.6, 0.072, 9.7e-4, 1.0),
    ),
    "motor": Plant(
        "the linear motor of Rubio et al. while it cuts",
        "LinearMotor",
        {"feed_per_tooth": 1e-6},
        M=10.0,
        B=250.0,
        F_C=0.0,
        F_S=0.0,
        unit=0.01,
        disturbance=("disturbance_force", -1.0),
    ),
    "nominal": Plant(
        "the nominal stage of Purtojo et al.",
        "NominalStage",
        {},
        M=1.0,
        B=215.2,
        F_C=0.0,
        F_S=0.0,
        unit=1.0 / (215.2 * 5.672e-3),
        disturbance=("disturbance", 1.0),
    ),
}


class Gains(NamedTuple):
    """Three free frequencies, 1/s."""

    fast: float
    position: float
    integral: float


def controllers(folder: Path = HERE) -> dict[str, ModuleType]:
    """The files of ``controllers/`` by name."""
    found: dict[str, ModuleType] = {}
    for path in sorted((folder / "controllers").glob("*.py")):
        name = f"cosim_ranking_controller_{path.stem}"
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        found[path.stem] = importlib.util.module_from_spec(spec)
        sys.modules[name] = found[path.stem]
        spec.loader.exec_module(found[path.stem])
    return found


def columns(plant: Plant) -> tuple[bool, ...]:
    """Without and with a model of friction; a plant without dry friction has one column."""
    return (False, True) if plant.F_S > 0.0 else (False,)


def starts(controller: ModuleType, plant: Plant, gains: Gains, model: bool) -> dict[str, Start]:
    """Start values that depend on the gains and on the column, by instance."""
    measured = {"T_s": T_S, "velocity_source": "difference", "velocity_filter_time": FILTER}
    own = getattr(controller, "OWN_START", False)
    found = {"controller": {**({} if own else measured), **controller.start(plant, gains, model)}}
    for name, (_, start, _) in extras(controller, plant, gains, model).items():
        found[name] = {**measured, **start}
    if plant.F_S > 0.0 and not getattr(controller, "OWN_MODEL", False):
        sigma_0, sigma_1, _, v_s = plant.friction
        damping = 0.0 if getattr(controller, "CANCELS_DAMPING", True) else plant.B
        found["feedforward"] = {
            "T_s": T_S,
            "share": 1.0 if model else 0.0,
            "sigma_0_hat": sigma_0 / plant.lead**2,
            "sigma_1_hat": sigma_1 / plant.lead**2,
            "sigma_2_hat": damping,
            "F_C_hat": SHARE * plant.F_C,
            "F_S_hat": SHARE * plant.F_S,
            "v_s_hat": v_s * plant.lead,
        }
    return found


def extras(controller: ModuleType, plant: Plant, gains: Gains, model: bool) -> dict[str, Any]:
    """Instances that run before the controller: name -> (FMU, start values, input -> source)."""
    return controller.before(plant, gains, model) if hasattr(controller, "before") else {}


def document(controller: ModuleType, plant: Plant, gains: Gains, model: bool) -> dict[str, Any]:
    """The system of a controller on a plant, as a system file holds it."""
    given = starts(controller, plant, gains, model)
    port, share = plant.disturbance
    added = extras(controller, plant, gains, model)
    output = getattr(controller, "OUTPUT", "command")
    newtons = 1.0 / plant.lead if getattr(controller, "AT_SCREW", False) else 1.0
    connections: list[Any] = [f"{source} -> controller.{name}" for name, source in controller.INPUTS.items()]
    for instance, (_, _, inputs) in added.items():
        connections += [f"{source} -> {instance}.{name}" for name, source in inputs.items()]
    if "feedforward" in given:
        connections += [
            {"from": f"controller.{output}", "to": "feedforward.force", "factor": newtons},
            "trajectory.velocity -> feedforward.velocity_ref",
            {"from": "feedforward.command", "to": "plant.command", "factor": plant.unit},
        ]
        command = "feedforward.command"
    else:
        connections.append({"from": f"controller.{output}", "to": "plant.command", "factor": newtons * plant.unit})
        command = f"controller.{output}"
    connections.append({"from": "disturbance.position", "to": f"plant.{port}", "factor": 10.0 * share * plant.M})
    fmus = {
        "trajectory": "Trajectory",
        "disturbance": "Trajectory",
        **{name: fmu for name, (fmu, _, _) in added.items()},
        "controller": controller.FMU,
        **({"feedforward": "FrictionFeedforward"} if "feedforward" in given else {}),
        "plant": plant.fmu,
    }
    given |= {
        "trajectory": {"kind": "sine", "amplitude": 5e-3, "frequency": 0.5, "soft_start": 0.5, "T_s": T_S},
        # A connection factor makes 0.1 m of this signal an acceleration of 1 m/s2 of the mass.
        "disturbance": {"kind": "sine", "amplitude": 5e-3, "frequency": 3.0},
        "plant": plant.start,
    }
    column = "" if plant.F_S == 0.0 else f", {'with' if model else 'without'} a model of friction"
    return {
        "description": f"{controller.TITLE} on {plant.text}, 10 kHz{column}",
        "connections": connections,
        "experiment": {"stop_time": 5.0, "step_size": T_S, "order": list(fmus)},
        "instances": {name: {"fmu": fmu, "start": given.get(name, {})} for name, fmu in fmus.items()},
        "record": {"variables": ["trajectory.position", "plant.position", command]},
    }


def cost(system: dict[str, Any], plant: Plant) -> float:
    """rms error in m from 0.6 s to 2 s with one sample of delay, raised by a restless command.

    Infinite if the run fails.
    """
    late = {**system, "experiment": {**system["experiment"], "order": "parallel", "stop_time": 2.0}}
    try:
        result = simulate(make_system(late, folder=HERE / "systems", fmus=FMUS))
    except CosimError:
        return math.inf
    part = metrics.window(result.time, 0.6)
    error = metrics.rms((result["plant.position"] - result["trajectory.position"])[part])
    variation = metrics.total_variation(result.time[part], result[system["record"]["variables"][2]][part])
    newtons = 1.0 / plant.lead if system["instances"]["controller"]["fmu"].endswith("SlidingMode") else 1.0
    value = error * max(1.0, variation * newtons / (CALM * plant.needed_variation)) ** 2
    return value if math.isfinite(value) else math.inf


def search(name: str, key: str, model: bool, seed: int) -> tuple[Gains, float, float]:
    """The best gains of ``BUDGET`` simulations, the lowest cost on the diagonal, and the lowest cost of all."""
    controller, plant = controllers()[name], PLANTS[key]
    random = np.random.default_rng([seed, zlib.crc32(f"{name} {key} {model}".encode())])
    low, high = np.log(LOW), np.log(HIGH)

    def value(point: np.ndarray) -> float:
        return cost(document(controller, plant, Gains(*map(float, np.exp(point))), model), plant)

    fast = np.linspace(low[0], high[0], DIAGONAL)
    points = [np.clip(np.array([f, f - math.log(4.0), f - math.log(8.0)]), low, high) for f in fast]
    costs = [value(point) for point in points]
    best, least = points[int(np.argmin(costs))], min(costs)
    diagonal = least
    step = 0.5
    for _ in range(BUDGET - DIAGONAL):
        trial = np.clip(best + step * random.standard_normal(3), low, high)
        found = value(trial)
        if found < least:
            best, least, step = trial, found, step * 1.4
        else:
            step = max(step * 0.92, 0.02)
    return Gains(*(float(f"{MARGIN * value:.4g}") for value in np.exp(best))), diagonal, least


def read_gains(folder: Path = HERE) -> dict[str, Any]:
    """``gains.toml``: controller -> plant -> column -> seed."""
    path = folder / "gains.toml"
    return tomllib.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def system_name(name: str, key: str, model: bool) -> str:
    """Name of a system file without its ending."""
    return f"{name}_{key}{'_model' if model else ''}"


def write(names: Iterable[str], gains: Mapping[str, Any], folder: Path = HERE) -> None:
    """Write the systems of controllers with the gains of the first seed."""
    (folder / "systems").mkdir(exist_ok=True)
    entries = controllers(folder)
    for name in names:
        for key, plant in PLANTS.items():
            for model in columns(plant):
                row = gains[name][key][COLUMNS[model]][str(SEEDS[0])]
                system = document(entries[name], plant, Gains(*row["gains"]), model)
                path = folder / "systems" / f"{system_name(name, key, model)}.toml"
                path.write_text(f"# Written by tune.py.\n{tomli_w.dumps(system)}", encoding="utf-8")


def main() -> None:
    """Tune and write everything."""
    parser = argparse.ArgumentParser(description="Tune controllers, write gains.toml and systems/.")
    parser.add_argument("--controllers", nargs="*", metavar="NAME", help="default: every file in controllers/")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="simulations at a time (default: 2)")
    parser.add_argument("--again", action="store_true", help="search again for gains that are known")
    options = parser.parse_args()
    names = options.controllers or list(controllers())
    gains = {} if options.again else read_gains()
    jobs = [
        (name, key, model, seed)
        for seed in SEEDS
        for name in names
        for key, plant in PLANTS.items()
        for model in columns(plant)
        if str(seed) not in gains.get(name, {}).get(key, {}).get(COLUMNS[model], {})
    ]
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        found = {pool.submit(search, *job): job for job in jobs}
        for future in as_completed(found):
            name, key, model, seed = found[future]
            best, diagonal, least = future.result()
            row = {"gains": list(best), "cost_diagonal": float(f"{diagonal:.4g}"), "cost": float(f"{least:.4g}")}
            gains.setdefault(name, {}).setdefault(key, {}).setdefault(COLUMNS[model], {})[str(seed)] = row
            text = "# Written by tune.py: gains in 1/s (fast, position, integral) by seed; costs in m.\n"
            (HERE / "gains.toml").write_text(text + tomli_w.dumps(_sorted(gains)), encoding="utf-8")
    write(names, gains)


def _sorted(tables: dict[str, Any]) -> dict[str, Any]:
    """The same tables with sorted keys, so that the file does not depend on the order in which searches end."""
    if "gains" in tables:
        return tables
    return {key: _sorted(value) for key, value in sorted(tables.items())}


if __name__ == "__main__":
    main()
