"""All FMUs and systems in importers that nobody here wrote, compared with ``cosim run``; ``make conformance`` runs it.

    python -m tests.importers.conform --python build/importers/bin/python --output docs/importers.md

Single FMUs have constant inputs; systems run in the importer's own order, which is parallel (Jacobi) for those here.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import fmpy

from cosim.fmu import Fmu, read_fmu
from cosim.master import simulate
from cosim.ssp import write_ssp
from cosim.system import System, make_system, read_system

ROOT = Path(__file__).resolve().parents[2]
RUNNER = Path(__file__).with_name("runner.py")
STEPS = 100
FMU_IMPORTERS = ("fmpy", "fmpy.simulate_fmu", "fmuloader", "pathsim-fmi", "sofirpy", "libcosim", "ecos")
EXCHANGE_IMPORTERS = ("fmpy.simulate_fmu ME", "fmuloader ME")
SYSTEM_IMPORTERS = ("libcosim", "ecos")
INPUTS = {"command": 0.3, "position_ref": 1e-5, "velocity_ref": 1e-3, "position": 2e-6, "velocity": 2e-4}
"""Inputs held during a run; others keep their start value."""
EXCHANGE_TOLERANCE = 1e-4
"""Other solvers at 1e-8 against RODAS at its default tolerance of 1e-6, over 100 steps."""


PYTHON_TOLERANCE = 1e-6
"""A last bit in a communication point leads scipy's LSODA another way, within its tolerance of 1e-6."""
NOTES = """
## What is to be known

- Read right after a step, a controller's output is the one applied over that step; an importer that first sets new
  inputs sees the answer to them. Both are compared with the row of `cosim run` that shows the same sample.
- fmuloader 0.1.2rc0 declares no result type for `calloc`, so the memory it hands to an FMU has an address cut to 32
  bits: any FMU that uses `allocateMemory` crashes. It is run with `cannot_use_memory_management_functions=True`.
- libcosim and ecos set no parameter of type Enumeration from an SSP (libcosim ends the process when it meets
  `ssv:Enumeration`, ecos warns); `cosim export` writes such values as Integer, which both read past. Systems that give
  an enumeration another value than the FMU's are left out for them.
- ecos applies parameters only under the name of their set: `init(parameter_set="start")`.
- pathsim-fmi's co-simulation block is stepped by its own scheduled function.
- FMPy's `simulate_ssp` ignores parameters and is not compared; OMSimulator's wheel downloads its program when it is
  installed and is not run here; cofmupy and syssimx are not run.
"""


@dataclass
class Outcome:
    """What one importer did with a set of jobs."""

    importer: str
    what: str
    version: str = ""
    runs: int = 0
    largest: float = 0.0
    where: str = ""
    problems: list[str] = field(default_factory=list[str])


@dataclass(frozen=True)
class Case:
    """A job and the rows expected: those after a step, and for feedthrough those before the next."""

    job: dict[str, Any]
    rows: list[list[float]]
    start: list[float]
    delayed: tuple[bool, ...]
    """Outputs of sampled components: when they are read decides which sample is seen."""
    enumerations: tuple[str, ...] = ()
    """Enumeration parameters that have another value than the FMU's."""


def fmu_case(path: Path, steps: int = STEPS) -> Case:
    """One FMU by itself, inputs held, against ``cosim run`` of the same."""
    fmu = read_fmu(path)
    outputs = [name for name in fmu.outputs if fmu.variables[name].type == "Real"]
    inputs = {name: INPUTS[name] for name in fmu.inputs if name in INPUTS}
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


def system_case(path: Path, folder: Path, fmus: Path, steps: int = STEPS) -> Case | None:
    """The first steps of a system as SSP, run in parallel order; None if another tool has no word for it."""
    system = read_system(path, fmus=fmus)
    if any(instance.step_multiple != 1 for instance in system.instances):
        return None
    system = read_system(
        path, fmus=fmus, order="parallel", stop_time=system.start_time + steps * system.step_size, decimation=1
    )
    if system.start_time != 0:
        return None
    entries = [
        (instance.name, name)
        for instance in system.instances
        for name in instance.fmu.outputs
        if instance.fmu.variables[name].type == "Real"
    ]
    system = system.changed(record=[".".join(entry) for entry in entries])
    package = write_ssp(system, folder / f"{path.parent.name}_{path.stem}.ssp")
    references = {f"{i}.{name}": system.variable(i, name).reference for i, name in entries}
    job = {
        "kind": "system",
        "path": str(package),
        "name": f"{path.parent.name}/{path.stem}",
        "outputs": [".".join(entry) for entry in entries],
        "references": references,
        "step": float(system.step_size),
        "steps": steps,
    }
    case = _case(job, system, entries)
    set_ = [
        f"{instance.name}.{name}"
        for instance in system.instances
        for name, value in instance.start.items()
        if instance.fmu.variables[name].type == "Enumeration" and value != instance.fmu.variables[name].start
    ]
    return replace(case, enumerations=tuple(set_))


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


def run(importer: str, cases: Sequence[Case], python: str, what: str, *, tolerance: float = 1e-9) -> Outcome:
    """Run the cases in one importer and compare; the largest difference is relative to an output's largest value."""
    outcome = Outcome(importer, what)
    done = subprocess.run(
        [python, str(RUNNER), importer],
        input=json.dumps([case.job for case in cases]),
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    lines = done.stdout.splitlines()
    if len(lines) < len(cases):
        stopped = cases[len(lines)].job["name"]
        outcome.problems.append(f"{stopped}: the importer's process ended ({done.returncode}): {done.stderr[-300:]}")
    for case, line in zip(cases, lines, strict=False):
        found = json.loads(line)
        outcome.version = found["version"]
        name = case.job["name"]
        if "error" in found:
            outcome.problems.append(f"{name}: {found['error']}")
            continue
        outcome.runs += 1
        if not found["rows"]:
            continue
        difference, output = compare(case, found["rows"])
        if difference > outcome.largest:
            outcome.largest, outcome.where = difference, f"{name}, {output}"
        if not difference <= tolerance:
            outcome.problems.append(f"{name}: {output} differs by {difference:.2g} of its largest value")
    return outcome


def compare(case: Case, rows: Sequence[Sequence[float]]) -> tuple[float, str]:
    """The largest difference of an output, as a share of its largest value, and that output.

    What is seen of a controller depends on when an importer reads: right after a step its output still is the one
    applied over it, the row of ``cosim run`` before; after new inputs have been set it answers them, which
    ``cosim run`` shows in the same row in sequential order, and in the next in parallel order.
    """
    if len(rows) != len(case.rows):
        return math.inf, f"{len(rows)} rows for {len(case.rows)}, all outputs"
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


def outcomes(python: str, flavours: dict[str, Path], folder: Path) -> list[Outcome]:
    """Every importer on every FMU of both flavours, and on every shipped system."""
    found: list[Outcome] = []
    for flavour, place in flavours.items():
        cases = [fmu_case(path) for path in sorted(place.glob("*.fmu"))]
        what, tolerance = f"{len(cases)} {flavour} FMUs", 1e-9 if flavour == "native" else PYTHON_TOLERANCE
        found += [run(importer, cases, python, what, tolerance=tolerance) for importer in FMU_IMPORTERS]
        found.append(run("fmu-manipulation-toolbox", cases, python, f"{len(cases)} {flavour} FMUs, fmutool -check"))
        if flavour == "native":
            plants = [case for case in cases if case.job["continuous_states"]]
            what = f"{len(plants)} plants, model exchange"
            found += [run(i, plants, python, what, tolerance=EXCHANGE_TOLERANCE) for i in EXCHANGE_IMPORTERS]
    systems: list[Case] = []
    for path in sorted((ROOT / "studies").glob("*/*.toml")):
        if "[instances" in path.read_text() or "base =" in path.read_text():
            case = system_case(path, folder, flavours["native"])
            systems += [case] if case else []
    plain = [case for case in systems if not case.enumerations]
    what = f"{len(plain)} of {len(systems)} systems (SSP), parallel order"
    found += [run(importer, plain, python, what, tolerance=1e-6) for importer in SYSTEM_IMPORTERS]
    return found


def table(found: Sequence[Outcome]) -> str:
    """The outcomes as a Markdown page."""
    lines = [
        "# The FMUs and systems in other importers",
        "",
        f"Written by `make conformance`. Each FMU alone, its inputs held, and each system as SSP, for {STEPS} "
        "communication steps; the difference is that from `cosim run` in the same order, as a share of the output's "
        "largest value.",
        "",
        "| importer | version | what was run | ran | largest difference | where |",
        "|---|---|---|---|---|---|",
    ]
    for o in found:
        largest = f"{o.largest:.1e}" if o.largest else "0" if "check" not in o.what else "no problem reported"
        if o.problems and o.importer == "fmu-manipulation-toolbox":
            largest = "see below"
        lines.append(f"| {o.importer} | {o.version} | {o.what} | {o.runs} | {largest} | {o.where} |")
    problems = [f"- {o.importer}, {o.what}: {problem}" for o in found for problem in o.problems]
    if problems:
        lines += ["", "## What went wrong", "", *problems]
    return "\n".join([*lines, ""]) + NOTES


def main() -> int:
    """Run everything, write the page; exit code 1 if anything failed or differed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--python", default=sys.executable, help="the Python that has the importers")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "importers.md")
    options = parser.parse_args()
    fmus = {flavour: ROOT / "build" / "fmus" / flavour for flavour in ("native", "python")}
    folder = ROOT / "build" / "importers-ssp"
    folder.mkdir(parents=True, exist_ok=True)
    found = outcomes(options.python, fmus, folder)
    text = table(found)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text, encoding="utf-8")
    sys.stdout.write(text)
    return 1 if any(outcome.problems for outcome in found) else 0


if __name__ == "__main__":
    sys.exit(main())
