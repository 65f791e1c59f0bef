"""Jobs for other importers, each with the rows that ``cosim run`` gives for it, and the comparison of two traces."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import fmpy

from cosim.fmu.description import Fmu, read_fmu
from cosim.master.simulation import simulate
from cosim.system.ssp_write import write_ssp
from cosim.system.system import System, make_system, read_system

STEPS = 100
INPUTS = {"command": 0.3, "position_ref": 1e-5, "velocity_ref": 1e-3, "position": 2e-6, "velocity": 2e-4}
"""Inputs held during a run of a single FMU; others keep their start value."""
MULTIPLES = {
    "controller 4": ("shams2010/smc_5sin", {"controller": 4}),
    "plant 2, controller 4": ("shams2010/fsmc_5sin", {"plant": 2, "controller": 4}),
}
"""Systems with instances that step less often than the others; no study has one."""


@dataclass(frozen=True)
class Case:
    """A job and the rows expected: those after a step, and for feedthrough those before the next."""

    job: dict[str, Any]
    rows: list[list[float]]
    start: list[float]
    delayed: tuple[bool, ...]
    """Outputs of sampled components: when they are read decides which sample is seen."""
    set_enumerations: bool = False
    """Whether an Enumeration has another value than the FMU's own."""
    set_others: bool = False
    """Whether an Integer, a Boolean or a String has another value than the FMU's own."""
    transforms: bool = False
    """Whether a connection has a factor or an offset."""
    order: str = "as single FMUs"
    """In which order ``cosim run`` stepped the system."""

    @property
    def components(self) -> tuple[str, ...]:
        """The names of the FMUs that are run."""
        instances = self.job.get("instances")
        return tuple(dict.fromkeys(Path(i["path"]).stem for i in instances)) if instances else (self.job["name"],)


def fmu_case(path: Path, steps: int = STEPS, *, held: bool = True) -> Case:
    """One FMU by itself, inputs held (or left at their start values), against ``cosim run`` of the same."""
    fmu = read_fmu(path)
    outputs = [name for name in fmu.outputs if fmu.variables[name].type == "Real"]
    inputs = {name: INPUTS[name] for name in fmu.inputs if held and name in INPUTS}
    step = Decimal(repr(fmu.step_size))
    document = {
        "experiment": {"stop_time": steps * step, "step_size": step},
        "instances": {"fmu": {"fmu": str(path), "start": inputs}},
        "record": {"variables": [f"fmu.{name}" for name in outputs]},
    }
    job = {
        "kind": "fmu",
        "path": str(path),
        "name": fmu.identifier,
        "guid": fmu.guid,
        "inputs": inputs,
        "outputs": outputs,
        "references": {name: v.reference for name, v in fmu.variables.items()},
        "step": float(step),
        "steps": steps,
        "continuous_states": fmpy.read_model_description(str(path)).numberOfContinuousStates,
    }
    return _case(job, make_system(document), [("fmu", name) for name in outputs])


def single_case(path: Path, folder: Path, steps: int = STEPS) -> Case:
    """One FMU by itself as a system of one instance, its inputs held by their start values, written as SSP."""
    job = fmu_case(path, steps).job
    document = {
        "experiment": {"stop_time": steps * job["step"], "step_size": job["step"]},
        "instances": {"fmu": {"fmu": str(path), "start": job["inputs"]}},
    }
    return _system_case(make_system(document, name=job["name"]), job["name"], folder, "sequential", steps)


def fmi3_case(path: Path, native: Case) -> Case:
    """An FMI 3.0 FMU against ``cosim run`` of the FMI 2.0 one of the same name, whose arrays are scalars."""
    case = foreign_fmi3_case(path, native.job["steps"], native.job["step"])
    columns = {name: k for k, name in enumerate(native.job["outputs"])}
    if unknown := [name for name in case.job["outputs"] if name not in columns]:
        raise ValueError(f"{path.name}: outputs that the FMI 2.0 FMU has not: {', '.join(unknown)}.")
    chosen = [columns[name] for name in case.job["outputs"]]
    return replace(
        case,
        job={**case.job, "inputs": native.job["inputs"]},
        rows=[[row[k] for k in chosen] for row in native.rows],
        start=[native.start[k] for k in chosen],
        delayed=tuple(native.delayed[k] for k in chosen),
    )


def foreign_fmi3_case(path: Path, steps: int, step: float) -> Case:
    """An FMI 3.0 FMU with its start values and no expectation yet."""
    description = fmpy.read_model_description(str(path))
    found = [v for v in description.modelVariables if v.causality == "output" and v.type == "Float64"]
    outputs = list({v.valueReference: v for v in reversed(found)}.values())[::-1]  # no alias names
    sizes = {v.name: math.prod(v.shape or ()) for v in outputs}
    elements = [n if s == 1 else f"{n}[{k + 1}]" for n, s in sizes.items() for k in range(s)]
    job = {
        "kind": "fmu",
        "path": str(path),
        "name": description.coSimulation.modelIdentifier,
        "guid": description.instantiationToken,
        "inputs": {},
        "outputs": elements,
        "variables": list(sizes),
        "places": [[v.valueReference, sizes[v.name]] for v in outputs],
        "references": {v.name: v.valueReference for v in description.modelVariables},
        "events": description.coSimulation.hasEventMode,
        "step": step,
        "steps": steps,
    }
    return Case(job, [], [], ())


def system_case(path: Path, folder: Path, fmus: Path, order: str = "parallel", steps: int = STEPS) -> Case:
    """The first steps of a system, written as SSP into ``folder``; ``order`` is parallel or sequential."""
    system = read_system(path, fmus=fmus)
    return _system_case(system, f"{path.parent.name}/{path.stem}", folder, order, steps)


def multiple_case(name: str, studies: Path, folder: Path, fmus: Path, steps: int = STEPS) -> Case:
    """One of MULTIPLES, in parallel order."""
    base, multiples = MULTIPLES[name]
    system = read_system(studies / f"{base}.toml", fmus=fmus)
    document = copy.deepcopy(dict(system.document))
    for instance, multiple in multiples.items():
        document["instances"][instance]["step_multiple"] = multiple
    changed = make_system(document, name=name, folder=system.folder, fmus=fmus)
    return _system_case(changed, f"{base} {name}", folder, "parallel", steps)


def _system_case(system: System, name: str, folder: Path, order: str, steps: int) -> Case:
    system = system.changed(stop_time=system.start_time + steps * system.step_size, order=order, decimation=1)
    entries = [
        (instance.name, name)
        for instance in system.instances
        for name in instance.fmu.outputs
        if instance.fmu.variables[name].type == "Real"
    ]
    system = system.changed(record=[".".join(entry) for entry in entries])
    changed = {
        instance.fmu.variables[name].type
        for instance in system.instances
        for name, value in instance.start.items()
        if value != instance.fmu.variables[name].start
    }
    stem = name.replace("/", "_").replace(" ", "_")
    package = write_ssp(system, folder / f"{stem}.ssp")
    if "Enumeration" in changed:
        write_ssp(system, folder / f"{stem}.integers.ssp", integers=True)
    job = {
        "kind": "system",
        "path": str(package),
        "name": name,
        "outputs": [".".join(entry) for entry in entries],
        "references": {f"{i}.{name}": system.variable(i, name).reference for i, name in entries},
        "step": float(system.step_size),
        "steps": steps,
        "instances": [
            {
                "name": instance.name,
                "path": str(instance.fmu.path),
                "start": {n: [instance.fmu.variables[n].type, value] for n, value in instance.start.items()},
            }
            for instance in system.instances
        ],
        "connections": [[*c.source, *c.target] for c in system.connections],
    }
    case = _case(job, system, entries)
    first = dict(zip(entries, case.start, strict=True))
    job["first"] = [[*c.target, first[c.source]] for c in system.connections if c.source in first]
    return replace(
        case,
        set_enumerations="Enumeration" in changed,
        set_others=bool(changed & {"Integer", "Boolean", "String"}),
        transforms=any(c.factor != 1.0 or c.offset != 0.0 for c in system.connections),
        order=order,
    )


def _case(job: dict[str, Any], system: System, entries: Sequence[tuple[str, str]]) -> Case:
    result = simulate(system)
    columns = [result[".".join(entry)] for entry in entries]
    rows = [[float(column[k]) for column in columns] for k in range(job["steps"] + 1)]
    fmus: dict[str, Fmu] = {instance.name: instance.fmu for instance in system.instances}
    delayed = tuple(
        bool(fmus[name].dependencies.get(variable)) or ("T_s" in fmus[name].variables and bool(fmus[name].inputs))
        for name, variable in entries
    )
    return Case(job, rows[1:], rows[0], delayed)


def compare(case: Case, rows: Sequence[Sequence[float]]) -> tuple[float, str]:
    """The largest difference of an output, as a share of its largest value, and that output.

    What is seen of a controller depends on when an importer reads: right after a step its output still is the one
    applied over it, the row of ``cosim run`` before; after new inputs have been set it answers them, which
    ``cosim run`` shows in the same row in sequential order, and in the next in parallel order.
    """
    if len(rows) != len(case.rows):
        return math.inf, f"{len(rows)} rows for {len(case.rows)}, all outputs"
    if widths := {len(row) for row in rows} - {len(case.job["outputs"])}:
        return math.inf, f"{widths} values in a row for {len(case.job['outputs'])} outputs, all outputs"
    for column, name in enumerate(case.job["outputs"]):
        if not all(math.isfinite(row[column]) for row in rows):
            return math.inf, name
    worst = (0.0, "")
    before = [case.start, *case.rows[:-1]]
    for column, name in enumerate(case.job["outputs"]):
        found = [row[column] for row in rows]
        expected = [row[column] for row in case.rows]
        scale = max(map(abs, [*expected, case.start[column]]))
        pairs = [list(zip(found, expected, strict=True))]
        if case.delayed[column]:
            pairs.append(list(zip(found, [row[column] for row in before], strict=True)))
            pairs.append(list(zip(found[:-1], expected[1:], strict=True)))
        difference = min(max(abs(a - b) for a, b in pair) for pair in pairs) / (scale or 1.0)
        if not difference <= worst[0]:
            worst = (difference, name)
    return worst
