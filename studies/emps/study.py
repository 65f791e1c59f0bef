"""A measured ballscrew axis, EMPS: plants of this library under the measured controller, fitted to the record.

The measured files are not part of this project. The study reads them from the folder that the user names; without a
folder it shows the figures of ``figures.toml``.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.design.fit import Fitted, OutputFit, fit, sensitivities
from cosim.design.fit_file import make_fit
from cosim.design.friction import identify_friction
from cosim.errors import DescriptionError
from cosim.record.read import read_record
from cosim.study import Numbers, Outcome, Outcomes, Run, read_study

HERE = Path(__file__).resolve().parent
RECORD, PULSES = "DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"
L_P = 2.5e-3 / (2.0 * math.pi)
"""Lead of the screw, m/rad."""
FORCE = 35.1507
"""Force of the motor for a command of one volt, N/V."""
FIRST, HALF, PERIOD = 0.049, 12.48, 6.24
"""Times in s: begin of the figures (49 samples are left out, as in the published figures), end of lap 2, one lap."""
NOISE = {"position": 0.19e-6, "command": 0.0096}
"""Noise in m and V: the difference from lap to lap divided by the root of 2. The fit uses it as weights."""
PUBLISHED: Mapping[str, Mapping[str, float]] = {
    "published_symmetric": {"M": 95.1089, "Fv": 203.5034, "Fc": 20.3935, "offset": -3.1648},
    "published_asymmetric": {
        "M": 95.1540,
        "Fv": 166.7061,
        "Fv_negative": 240.4236,
        "Fc": 20.144,
        "Fc_negative": 20.6277,
    },
}
Told = Callable[[Outcome], None]
Signal = np.ndarray[Any, np.dtype[np.float64]]


# ---- fit files ----


@dataclass(frozen=True)
class Plant:
    """A plant of plants.toml."""

    name: str
    text: str
    chosen: str
    after: str
    parameters: Mapping[str, Mapping[str, Any]]


def plants() -> dict[str, Plant]:
    """The plants in the order in which they are fitted."""
    document = tomllib.loads((HERE / "plants.toml").read_text(encoding="utf-8"))
    return {
        name: Plant(name, table["text"], table["chosen"], table.get("after", ""), table["parameters"])
        for name, table in document.items()
    }


def parameters_of(plant: Plant, before: Fitted | None, phases: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Free values of a plant: those of the previous fit start where that fit ended; the plant's own are added."""
    own = {
        name: {**given, **({"start": phases[name]} if name in phases else {})}
        for name, given in plant.parameters.items()
    }
    found: dict[str, dict[str, Any]] = {}
    if before is not None:
        for free, estimate in zip(before.fit.free, before.estimates, strict=True):
            also = [name for name in free.variables[1:] if name not in own]
            found[free.name] = {"start": estimate.value, "also": also, "log": free.log}
            if free.name == "plant.drive_lag":
                found[free.name] |= {"from": free.low, "to": free.high}
    return found | own


def document(parameters: Mapping[str, Any], data: Path, records: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """A fit file."""
    measured = read_record(data / RECORD, time="t", columns=["qm"])
    position = measured.column("qm")
    start = {
        "plant.position_start": float(position[0]),
        "plant.velocity_start": float((position[10] - position[0]) / (measured.time[10] - measured.time[0])),
    }
    common = {"file": str((data / RECORD).resolve()), "time": "t", "start": start}
    return {
        "system": "axis.toml",
        "parameters": dict(parameters),
        "outputs": {
            "position": {
                "signal": "plant.position",
                "column": "qm",
                "unit": "m",
                "reference": "qg",
                "noise": NOISE["position"],
            },
            "command": {"signal": "controller.command", "column": "vir", "unit": "V", "noise": NOISE["command"]},
        },
        "records": {name: {**common, **given} for name, given in records.items()},
    }


WHOLE = {"all": {"window": [FIRST, 24.84], "period": PERIOD}}
LAPS = {
    "first": {"window": [FIRST, HALF]},
    "second": {"window": [HALF, 24.84], "use": "validate"},
}


# ---- figures ----


def figures(fitted: Fitted) -> dict[str, float]:
    """Figures of agreement for the first record of a fit, in m and as shares."""
    position, command = fitted.comparisons[:2]
    return {
        "position_rms": position.rms,
        "position_largest": position.largest,
        "tracking": 0.01 * position.relative,
        "force": 0.01 * command.relative,
        "position_laps": position.repeatability,
        "force_laps": command.repeatability / rms(command.measured),
    }


def rms(signal: Signal) -> float:
    return math.sqrt(float(np.mean(signal**2)))


def physical(fitted: Fitted) -> dict[str, float]:
    """Fitted values, converted to the table as in the benchmark; NAME_s is the standard deviation of NAME."""
    factors = {
        "plant.m": ("M", 1.0),
        "plant.F_C": ("Fc", 1.0 / L_P),
        "plant.F_S": ("Fs", 1.0 / L_P),
        "plant.sigma_2": ("Fv", 1.0 / L_P**2),
        "plant.load_torque": ("offset", 1.0 / L_P),
        "plant.v_s": ("vs", L_P),
        "plant.sigma_0": ("sigma_0", 1.0 / L_P**2),
        "plant.torque_ripple[1]": ("ripple_1", 1.0 / L_P),
        "plant.torque_ripple[2]": ("ripple_2", 1.0 / L_P),
    }
    found: dict[str, float] = {}
    for estimate in fitted.estimates:
        name, factor = factors.get(estimate.name, (estimate.name.removeprefix("plant."), 1.0))
        found[name] = factor * estimate.value
        found[f"{name}_s"] = factor * estimate.deviation if estimate.told else math.inf
    return found


def ripple_starts(comparison: OutputFit, position: Signal) -> dict[str, float]:
    """Amplitude and phase of the torque ripple over a turn, from the residual of the command.

    The loop compensates a torque of the plant by an opposite one. So the ripple is minus the torque by which the
    measured command exceeds the expected one.
    """
    angle = position / L_P
    columns = [part for n in (1.0, 2.0) for part in (np.sin(n * angle), np.cos(n * angle))]
    torque = -FORCE * L_P * (comparison.measured - comparison.expected)
    solution = np.linalg.lstsq(np.column_stack(columns), torque, rcond=None)[0]
    found: dict[str, float] = {}
    for i in (1, 2):
        sine, cosine = (float(value) for value in solution[2 * i - 2 : 2 * i])
        found[f"plant.torque_ripple[{i}]"] = math.hypot(sine, cosine)
        found[f"plant.torque_phase[{i}]"] = math.atan2(cosine, sine)
    return found


def published_start(values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Published values as start values of the plant."""
    negative = values.get("Fc_negative", values["Fc"]) / values["Fc"]
    viscous = values.get("Fv_negative", values["Fv"]) / values["Fv"]
    found: dict[str, dict[str, Any]] = {
        "plant.m": {"start": values["M"]},
        "plant.F_C": {"start": values["Fc"] * L_P, "also": ["plant.F_S"]},
        "plant.F_C_negative": {"start": negative, "also": ["plant.F_S_negative"]},
        "plant.sigma_2": {"start": values["Fv"] * L_P**2},
        "plant.sigma_2_negative": {"start": viscous},
    }
    if "offset" in values:
        found["plant.load_torque"] = {"start": values["offset"] * L_P}
    return found


# ---- the outcomes ----


def outcomes(data: Path | None, fmus: Path | None, told: Told, jobs: int) -> Outcomes:
    """Everything measured on the user's files, or the figures that come with the study."""
    if data is None:
        shipped = tomllib.loads((HERE / "figures.toml").read_text(encoding="utf-8"))
        return Outcomes([outcome(name, numbers) for name, numbers in shipped.items()])
    if not (data / RECORD).is_file():
        raise DescriptionError(
            f"{data}: there is no {RECORD}. The benchmark EMPS is to be had at nonlinearbenchmark.org; without --data "
            "the study shows the figures that come with it."
        )
    found: list[Outcome] = []

    def keep(name: str, numbers: Numbers) -> None:
        found.append(outcome(name, numbers))
        told(found[-1])

    keep("least_squares", least_squares(data))
    for name, values in PUBLISHED.items():
        made = make_fit(document(published_start(values), data, WHOLE), name=name, folder=HERE / "fits", fmus=fmus)
        keep(name, figures(sensitivities(made, workers=jobs)))
    ends: dict[str, Fitted] = {}
    halves: dict[str, Fitted] = {}
    for name, plant in plants().items():
        for kept, records in ((ends, WHOLE), (halves, LAPS)):
            before = kept.get(plant.after)
            starts = ripple_starts(before.comparisons[1], before.comparisons[0].measured) if before else {}
            made = document(parameters_of(plant, before, starts), data, records)
            kept[name] = fit(make_fit(made, name=name, folder=HERE / "fits", fmus=fmus), workers=jobs)
        keep(name, numbers_of(ends[name], halves[name]))
        if (data / PULSES).is_file():
            keep(f"{name}_pulses", with_pulses(ends[name], data, fmus, jobs))
    return Outcomes(found)


def outcome(name: str, numbers: Numbers) -> Outcome:
    return Outcome(name, Run("fits/axis.toml"), numbers, None, 24840)


def numbers_of(whole: Fitted, half: Fitted) -> dict[str, float]:
    """Figures of a plant: of a fit to the whole record, and of a fit to laps 1 and 2 that predicts laps 3 and 4."""
    predicted = [c for c in half.comparisons if c.validates]
    return {
        **figures(whole),
        **physical(whole),
        "fitted_position_rms": half.comparisons[0].rms,
        "fitted_force": 0.01 * half.comparisons[1].relative,
        "predicted_position_rms": predicted[0].rms,
        "predicted_force": 0.01 * predicted[1].relative,
        "loops": float(whole.loops),
        "seconds": whole.seconds,
        "share_in_runs": whole.run_seconds / (whole.seconds * whole.workers),
        "untold": float(len(whole.weak)),
        "converged": float(whole.converged),
    }


def least_squares(data: Path) -> dict[str, float]:
    """Values by least squares over filtered signals, without simulation: the published method with another filter."""
    look = identify_friction(
        data / RECORD, position="qm", force="vir", factor=FORCE, force_unit="N", time="t", span=(FIRST, math.inf)
    )
    names = {
        "inertia": "M",
        "viscous friction": "Fv",
        "Coulomb friction": "Fc",
        "offset": "offset",
        "viscous friction positive": "Fv_positive",
        "viscous friction negative": "Fv_negative",
        "Coulomb friction positive": "Fc_positive",
        "Coulomb friction negative": "Fc_negative",
    }
    slow = {"F_S": "break-away friction", "sigma_0": "presliding stiffness"}
    excited = {f"excites_{short}": float(look.value(name).excited) for short, name in slow.items()}
    return {short: look.value(name).value for name, short in names.items()} | excited | {"slow_share": look.slow_share}


def with_pulses(fitted: Fitted, data: Path, fmus: Path | None, jobs: int) -> dict[str, float]:
    """A fitted plant compared with the second record, which has pulses of force; no value is fitted to this record.

    The benchmark does not document where the pulses act. They are taken as a force of the motor, with the sign that
    follows from the balance of forces in the record.
    """
    record = read_record(data / PULSES, time="t", columns=["qm", "vir", "pulses_N"])
    look = identify_friction(data / PULSES, position="qm", force="vir", factor=FORCE, force_unit="N", time="t")
    sign = pulse_sign(record.time, record.column("qm"), record.column("vir"), record.column("pulses_N"))
    made = document(parameters_of(Plant("", "", "", "", {}), fitted, {}), data, {"second": {"window": [FIRST, 1e9]}})
    position = record.column("qm")
    made["records"]["second"] |= {
        "file": str((data / PULSES).resolve()),
        "start": {
            "plant.position_start": float(position[0]),
            "plant.velocity_start": float((position[10] - position[0]) / (record.time[10] - record.time[0])),
        },
    }
    made["system"] = "pulses.toml" if sign > 0.0 else "pulses_opposing.toml"
    numbers = figures(sensitivities(make_fit(made, folder=HERE / "fits", fmus=fmus), workers=jobs))
    return {**numbers, "sign_of_pulses": sign, "least_squares_M": look.value("inertia").value}


def pulse_sign(time: Signal, position: Signal, command: Signal, pulses: Signal) -> float:
    """1 if a positive pulse pushes like a positive command, -1 if it pushes against it."""
    from scipy.signal import savgol_filter

    step = float(np.median(np.diff(time)))
    x, v, a = (np.asarray(savgol_filter(position, 21, 3, deriv=order, delta=step)) for order in (0, 1, 2))
    force = FORCE * np.asarray(savgol_filter(command, 21, 3))
    columns = np.column_stack([a, v, np.sign(v), np.ones_like(x), -np.asarray(savgol_filter(pulses, 21, 3))])
    return math.copysign(1.0, float(np.linalg.lstsq(columns, force, rcond=None)[0][-1]))


# ---- chapters ----

ROWS = ("published_symmetric", "published_asymmetric", *plants())
NAMES = {
    "published_symmetric": "published values, symmetric",
    "published_asymmetric": "published values, asymmetric",
    **{name: plant.text for name, plant in plants().items()},
}


def agreement_chapter(found: Outcomes) -> str:
    """The plants against the record and its repeatability."""
    lines = [
        "| plant | position rms [µm] | of the tracking error [%] | force [%] | laps 3, 4 predicted from 1, 2 [µm, %] | "
        "runs |",
        "|---|---|---|---|---|---|",
    ]
    for name in ROWS:
        n = found[name].numbers
        half = (
            "published"
            if "loops" not in n
            else f"{1e6 * n['predicted_position_rms']:.3f}, {100 * n['predicted_force']:.2f}"
        )
        lines.append(
            f"| {NAMES[name]} | {1e6 * n['position_rms']:.3f} | {100 * n['tracking']:.3f} | {100 * n['force']:.2f} | "
            f"{half} | {n.get('loops', 0):.0f} |"
        )
    n = found["published_symmetric"].numbers
    lines.append(
        f"| **the machine, lap to lap** | **{1e6 * n['position_laps']:.3f}** | | **{100 * n['force_laps']:.2f}** | | |"
    )
    return "\n".join(lines)


VALUES = {
    "M": ("M", "kg", 1.0),
    "Fv": ("F_v, positive", "N/(m/s)", 1.0),
    "sigma_2_negative": ("F_v negative over positive", "", 1.0),
    "Fc": ("F_C, positive", "N", 1.0),
    "F_C_negative": ("F_C negative over positive", "", 1.0),
    "offset": ("offset", "N", 1.0),
    "Fs": ("F_S", "N", 1.0),
    "vs": ("v_s", "mm/s", 1e3),
    "sigma_0": ("sigma_0", "N/µm", 1e-6),
    "drive_lag": ("lag of the drive", "ms", 1e3),
    "ripple_1": ("ripple once a turn", "N", 1.0),
    "ripple_2": ("ripple twice a turn", "N", 1.0),
}
"""Name of a figure -> its name, unit and factor in the report."""


def values_chapter(found: Outcomes) -> str:
    """Fitted values at the table, with half of their 95 % intervals."""
    names = list(plants())
    lines = ["| value | unit | " + " | ".join(names) + " |", "|---|---|" + "---|" * len(names)]
    for key, (text, unit, factor) in VALUES.items():
        cells: list[str] = []
        for name in names:
            numbers = found[name].numbers
            half = 1.96 * factor * numbers.get(f"{key}_s", math.inf)
            shown = f"{factor * numbers[key]:.4g} ± {half:.2g}" if key in numbers else ""
            cells.append(
                shown if math.isfinite(half) or key not in numbers else f"{factor * numbers[key]:.4g}, not told"
            )
        lines.append(f"| {text} | {unit} | " + " | ".join(cells) + " |")
    ended = ", ".join(
        f"{name}: {found[name].numbers['loops']:.0f} runs in {found[name].numbers['seconds']:.0f} s, "
        f"{100 * found[name].numbers['share_in_runs']:.0f} % of it in runs"
        + ("" if found[name].numbers["converged"] else ", **not converged**")
        for name in names
    )
    return "\n".join(lines) + f"\n\nThe fits on two cores, which did other work, too: {ended}.\n"


def choices_chapter(found: Outcomes) -> str:
    """The choices that were made after the record was seen."""
    return "\n".join(f"* **{plant.text}**: {plant.chosen}" for plant in plants().values())


STUDY = read_study(
    HERE / "claims.toml",
    {name: Run("fits/axis.toml") for name in ("least_squares", *ROWS)},
    {},
    chapters={
        "Plants against the record": agreement_chapter,
        "Fitted values": values_chapter,
        "What was chosen after seeing it": choices_chapter,
    },
    outcomes=outcomes,
)
