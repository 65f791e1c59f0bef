"""Tune every controller for every plant by one rule and write the systems of the ranking.

All loops are sampled at 10 kHz and measure the position only (velocity by difference and a filter of 0.5 ms). They
know the nominal mass M and viscous damping of the plant at the table, those with a friction model 0.8 of its dry
friction, and may use the same largest force: four times what static friction, damping and 1.5 m/s2 need. Every
controller has one knob, omega, from which its gains follow so that the loop on a mass M has its fast pole near omega,
its position pole near omega/4, its integral near omega/8. The plants differ by the gain on the connection from the
controller's command to theirs.

Equal effort: each knob is tried at the same fourteen values, 1.5 apart, on the sine of the study with one sample of
delay in the loop. Values at which the loop swings by itself are out: the command varies more than 500 times as much
as the motion needs. The knob is set one step below the value with the least rms error of the others, a margin to the
edge of stability.

``python tune.py`` writes ``systems/CONTROLLER_PLANT.toml`` and ``..._late.toml`` (one sample of delay).
It needs the FMUs in build/fmus/native and takes some minutes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import CosimError
from cosim.master.simulation import simulate
from cosim.result import metrics
from cosim.system.system import make_system

HERE = Path(__file__).parent
FMUS = HERE.parents[1] / "build" / "fmus" / "native"
T_S, FILTER = 1e-4, 5e-4
KNOBS = tuple(float(round(value)) for value in np.geomspace(40.0, 8000.0, 14))
Start = dict[str, Any]
FEED_LEAD = 1.5915494309189535e-3


@dataclass(frozen=True)
class Plant:
    """A plant and what its table shows: mass, damping, friction (SI); one N at the table is ``unit`` of its command."""

    text: str
    fmu: str
    start: Start
    M: float
    B: float
    F_C: float
    F_S: float
    unit: float
    disturbance: tuple[str, float]
    """Input for disturbances, and its value for one N against positive motion."""
    lead: float = 1e-3
    friction: tuple[float, float, float, float] = (1e5, 300.0, 0.0, 1e-2)
    """sigma_0, sigma_1, sigma_2, v_s at the screw, for models of friction."""

    @property
    def force_max(self) -> float:
        return 4.0 * (self.F_S + 1.5 * self.M + self.B * 0.05)

    @property
    def reserve(self) -> float:
        """Acceleration in m/s2 for what is not known: 0.1 m/s2, and 0.3 of the damping at 50 mm/s."""
        return 0.1 + 0.3 * self.B * 0.05 / self.M

    @property
    def needed_variation(self) -> float:
        """Change of the force in N a second that sine, reversals and disturbance need."""
        inertia, reversals, disturbance = 2.0 * 5e-3 * math.pi**2, 2.0 * self.F_C / self.M, 12.0 * 0.05
        return self.M * (inertia + reversals + disturbance)


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


def measured() -> Start:
    return {"T_s": T_S, "velocity_source": "difference", "velocity_filter_time": FILTER}


def p_pi(plant: Plant, omega: float) -> Start:
    return {
        **measured(),
        "K_v": omega / 4.0,
        "K_p": plant.M * omega,
        "K_i": omega / 8.0,
        "m_hat": plant.M,
        "b_hat": plant.B,
        "k_t": 1.0,
        "K_a": 1.0,
        "command_max": plant.force_max,
    }


def super_twisting(plant: Plant, omega: float) -> Start:
    # Levant's 1.5 sqrt(C), 1.1 C; C: friction and reserve change within 1/omega.
    C = (plant.F_C / plant.M + plant.reserve) * omega
    return {
        **measured(),
        "mu": omega / 4.0,
        "lambda_": (omega / 8.0) ** 2,
        "Lambda": 1.5 * plant.M * math.sqrt(C),
        "W": 1.1 * plant.M * C,
        "m_hat": plant.M,
        "b_hat": plant.B,
        "k_t": 1.0,
        "K_a": 1.0,
        "command_max": plant.force_max,
    }


def cascade(plant: Plant, omega: float) -> Start:
    return {
        **measured(),
        "K_pos": omega / 4.0,
        "omega_v": omega,
        "T_i": 8.0 / omega,
        "M": plant.M,
        "l_p": 1.0,
        "command_max": plant.force_max,
    }


def sliding(plant: Plant, omega: float) -> tuple[Start, float]:
    """What the three sliding-mode controllers share, and the switching gain at the screw."""
    l_p = plant.lead
    J = plant.M * l_p**2
    sigma_0, sigma_1, sigma_2, v_s = plant.friction
    has_friction = plant.F_S > 0.0
    viscous = plant.B * l_p**2
    gain = plant.F_S * l_p + J * plant.reserve / l_p
    return {
        **measured(),
        "l_p": l_p,
        "J_hat": J,
        "lambda_": omega / 4.0,
        "sigma_0_hat": sigma_0,
        "sigma_1_hat": sigma_1 if has_friction else 0.0,
        "sigma_2_hat": sigma_2 if has_friction else viscous,
        "F_C_hat": max(0.8 * plant.F_C * l_p, 1e-9),
        "F_S_hat": max(0.8 * plant.F_S * l_p, 1e-9),
        "v_s_hat": v_s,
        "command_max": plant.force_max * l_p,
    }, gain


def sliding_mode(plant: Plant, omega: float) -> Start:
    start, gain = sliding(plant, omega)
    return {**start, "sigma_2_tilde": 0.0, "eta": plant.reserve / plant.lead, "phi": gain / (start["J_hat"] * omega)}


def complementary(plant: Plant, omega: float) -> Start:
    start, gain = sliding(plant, omega)
    return {
        **start,
        "sigma_2_tilde": 0.0,
        "eta": plant.reserve / plant.lead,
        "phi": 2.0 * gain / (start["J_hat"] * omega),
    }


def fuzzy(plant: Plant, omega: float) -> Start:
    start, gain = sliding(plant, omega)
    G_u = 1.2 * gain
    G_s = start["J_hat"] * omega / (0.375 * G_u)
    return {**start, "G_u": G_u, "G_s": G_s, "G_c": 0.5 * G_s}


def nctf_pi(plant: Plant, omega: float) -> Start:
    slope, reach = omega / 4.0, 0.5
    return {
        **measured(),
        "K_P": plant.M * omega,
        "K_I": plant.M * omega**2 / 8.0,
        "nct.error": [0.0, *([reach / slope] * 127)],
        "nct.rate": [0.0, *([reach] * 127)],
        "sensor_resolution": 0.0,
        "command_max": plant.force_max,
    }


def nctf_fuzzy(plant: Plant, omega: float) -> Start:
    h_max, slope = 0.5, omega / 4.0
    h_zero = plant.force_max / (2.0 * plant.M * omega)
    return {
        **measured(),
        "alpha": slope,
        "e_1": 0.5 * h_max / slope,
        "A": 2.0 * h_max / slope,
        "h_max": h_max,
        "h_zero": h_zero,
        "u_i_max": h_max * 8.0 / omega,
        "u_i_zero": h_zero * 8.0 / omega,
        "u_r": plant.force_max,
        "w_z": 0.02 * plant.force_max,
        "command_max": plant.force_max,
    }


CONTROLLERS: Mapping[str, tuple[str, str, Any]] = {
    "p_pi": ("P-PI control", "PPi", p_pi),
    "cascade": ("cascade control", "CascadePid", cascade),
    "cascade_observer": ("cascade control with disturbance observer", "CascadePid", cascade),
    "super_twisting": ("super-twisting control", "SuperTwisting", super_twisting),
    "smc": ("sliding-mode control", "SlidingMode", sliding_mode),
    "csmc": ("complementary sliding-mode control", "ComplementarySlidingMode", complementary),
    "fsmc": ("fuzzy sliding-mode control", "FuzzySlidingMode", fuzzy),
    "nctf_pi": ("NCTF control with PI compensator", "NctfPi", nctf_pi),
    "nctf_fuzzy": ("NCTF control with fuzzy compensator", "NctfFuzzy", nctf_fuzzy),
}
USES_ACCELERATION = ("PPi", "SuperTwisting", "SlidingMode", "ComplementarySlidingMode", "FuzzySlidingMode")


def document(name: str, plant: Plant, omega: float) -> dict[str, Any]:
    """The system of a controller on a plant, as a system file holds it."""
    text, fmu, design = CONTROLLERS[name]
    unit = plant.unit / plant.lead if fmu.endswith("SlidingMode") else plant.unit
    port, share = plant.disturbance
    connections: list[Any] = [
        "trajectory.position -> controller.position_ref",
        "plant.position -> controller.position",
    ]
    if fmu == "CascadePid":
        connections += [
            "trajectory.position_next -> controller.position_next",
            "plant.position -> controller.motor_position",
        ]
    elif fmu != "NctfPi":
        connections.append("trajectory.velocity -> controller.velocity_ref")
    if fmu in USES_ACCELERATION:
        connections.append("trajectory.acceleration -> controller.acceleration_ref")
    if unit == 1.0:
        connections.append("controller.command -> plant.command")
    else:
        connections.append({"from": "controller.command", "to": "plant.command", "factor": unit})
    connections.append({"from": "disturbance.position", "to": f"plant.{port}", "factor": 10.0 * share * plant.M})
    instances: dict[str, Any] = {
        "trajectory": {
            "fmu": "Trajectory",
            "start": {"kind": "sine", "amplitude": 5e-3, "frequency": 0.5, "soft_start": 0.5, "T_s": T_S},
        },
        # 0.1 m of it are 1 m/s2 of the mass.
        "disturbance": {"fmu": "Trajectory", "start": {"kind": "sine", "amplitude": 5e-3, "frequency": 3.0}},
        "controller": {"fmu": fmu, "start": design(plant, omega)},
        "plant": {"fmu": plant.fmu, "start": plant.start},
    }
    order = ["trajectory", "disturbance", "controller", "plant"]
    if name.endswith("observer"):
        connections += [
            "plant.position -> observer.position",
            "observer.disturbance_estimate -> controller.disturbance_estimate",
            "controller.force -> observer.applied_force",
        ]
        instances["observer"] = {
            "fmu": "DisturbanceObserver",
            "start": {**measured(), "g": omega / 4.0, "m_hat": plant.M, "b_hat": plant.B},
        }
        order.insert(2, "observer")
    return {
        "description": f"{text[0].upper()}{text[1:]} of {plant.text}, 10 kHz",
        "connections": connections,
        "experiment": {"stop_time": 5.0, "step_size": T_S, "order": order},
        "instances": instances,
        "record": {"variables": ["trajectory.position", "plant.position", "controller.command"]},
    }


def trial(system: dict[str, Any]) -> tuple[float, float]:
    """rms error in m and total variation of the command after the first second, with one sample of delay.

    Infinite if the run fails.
    """
    late = {**system, "experiment": {**system["experiment"], "order": "parallel", "stop_time": 3.0}}
    try:
        result = simulate(make_system(late, folder=HERE, fmus=FMUS))
    except CosimError:
        return math.inf, math.inf
    part = metrics.window(result.time, 1.0)
    error = metrics.rms((result["plant.position"] - result["trajectory.position"])[part])
    variation = metrics.total_variation(result.time[part], result["controller.command"][part])
    return (error, variation) if math.isfinite(error + variation) else (math.inf, math.inf)


def tuned(name: str, plant: Plant) -> float:
    """The knob of a controller on a plant."""
    unit = plant.lead if CONTROLLERS[name][1].endswith("SlidingMode") else 1.0
    limit = 500.0 * plant.needed_variation * unit
    found = [trial(document(name, plant, omega)) for omega in KNOBS]
    calm = [i for i, (_, variation) in enumerate(found) if variation <= limit]
    best = min(calm, key=lambda i: found[i][0])
    return KNOBS[max(best - 1, 0)]


def toml(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(item) for item in value) + "]"
    if isinstance(value, dict):
        inside = ", ".join(f"{k if k.isidentifier() else toml(k)} = {toml(v)}" for k, v in value.items())
        return "{ " + inside + " }"
    if isinstance(value, float):
        return f"{value:.10g}" if "e" in f"{value:.10g}" or "." in f"{value:.10g}" else f"{value:.1f}"
    return str(value)


def text(system: dict[str, Any], omega: float) -> str:
    """A system file."""
    lines = [
        f"# Written by tune.py: omega = {omega:g} rad/s.",
        f"description = {toml(system['description'])}",
        "connections = [",
        *(f"    {toml(connection)}," for connection in system["connections"]),
        "]",
        "",
        "[experiment]",
        *(f"{key} = {toml(value)}" for key, value in system["experiment"].items()),
    ]
    for name, instance in system["instances"].items():
        lines += ["", f"[instances.{name}]", f"fmu = {toml(instance['fmu'])}"]
        if instance["start"]:
            lines.append(f"start = {toml(instance['start'])}")
    return "\n".join([*lines, "", "[record]", f"variables = {toml(system['record']['variables'])}", ""])


def main() -> None:
    """Tune and write everything."""
    (HERE / "systems").mkdir(exist_ok=True)
    for name in CONTROLLERS:
        for key, plant in PLANTS.items():
            omega = tuned(name, plant)
            system = document(name, plant, omega)
            path = HERE / "systems" / f"{name}_{key}.toml"
            path.write_text(text(system, omega), encoding="utf-8")
            late = (
                f'base = "{path.name}"\ndescription = "{system["description"]}, one sample of delay"\n\n'
                '[experiment]\norder = "parallel"\n'
            )
            path.with_name(f"{name}_{key}_late.toml").write_text(late, encoding="utf-8")


if __name__ == "__main__":
    main()
