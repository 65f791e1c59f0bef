"""All FMUs and systems in importers that nobody here wrote, compared with ``cosim run``; ``make conformance`` runs it.

    python -m tests.importers.conform --python build/importers/bin/python --output docs/importers.md

Single FMUs have constant inputs; systems run in the importer's own order. An importer that crashes or hangs loses the
job it was at, no other.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Mapping, Sequence
from ctypes.util import find_library
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import fmpy
from rich.console import Console

from cosim.errors import CosimError
from cosim.master.simulation import simulate
from cosim.system.system import make_system

from .cases import (
    MULTIPLES,
    STEPS,
    Case,
    compare,
    fmi3_case,
    fmu_case,
    foreign_fmi3_case,
    multiple_case,
    single_case,
    system_case,
)
from .report import Outcome, Run, data, page

ROOT = Path(__file__).resolve().parents[2]
RUNNER = Path(__file__).with_name("runner.py")
BUGS = Path(__file__).with_name("bugs.py")
TOLERANCE = 1e-9
SYSTEM_TOLERANCE = 1e-6
"""Feedback carries the last bits of a communication point on."""
EXCHANGE_TOLERANCE = 1e-4
"""Other solvers at 1e-8 against RODAS at its default tolerance of 1e-6, over 100 steps."""
PYTHON_STEPS = 24
"""Systems of Python FMUs: their steps take milliseconds."""
SECONDS_A_JOB = 20.0
CRASHES = 3
"""After so many crashes or hangs the rest of an importer's jobs is given up."""


@dataclass(frozen=True)
class Importer:
    """One importer: its function in runner.py, what it needs, and what it sees of a run."""

    name: str
    function: str
    sees: str
    venv: str = "importers"
    program: str = ""
    """Option that gives the path of the program, for those that pip does not install."""
    lacks: tuple[str, ...] = ()
    """What it cannot take: enumerations, other types than Real, transformations, arrays."""
    order: str = "parallel"
    multiples: bool = False
    """Whether it takes instances that step less often than the others."""

    def package(self, case: Case) -> dict[str, Any]:
        """The SSP for this importer: if it knows no Enumeration, the one whose FMUs declare Integers instead."""
        path = Path(case.job["path"])
        integers = case.set_enumerations and "enumerations" in self.lacks
        return {"path": str(path.with_suffix(".integers.ssp") if integers else path)}


AFTER = "outputs read after a step"
SEQUENTIAL = "feedthrough evaluated at the communication point, then all step"
PARALLEL = "parallel (Jacobi): all step with the outputs of the communication point"
FMU_IMPORTERS = (
    Importer("FMPy, function by function", "fmpy", AFTER),
    Importer("FMPy, simulate_fmu", "fmpy.simulate_fmu", AFTER),
    Importer("fmuloader", "fmuloader", AFTER),
    Importer("pathsim-fmi", "pathsim-fmi", AFTER),
    Importer("sofirpy", "sofirpy", AFTER),
    Importer("libcosim (libcosimpy)", "libcosim", AFTER),
    Importer("ecos (ecospy)", "ecos", AFTER),
    Importer("syssimx", "syssimx FMU", AFTER),
    Importer("CoFmuPy", "cofmupy FMU", AFTER, venv="cofmupy"),
    Importer("fmusim", "fmusim", AFTER, program="fmusim"),
)
CHECKERS = (
    Importer("FMILibrary, its log (libcosimpy)", "fmilibrary", "warnings and errors are failures"),
    Importer("fmutool -check (FMU manipulation toolbox)", "fmutool", "no trace"),
    Importer("fmureader", "fmureader", "no trace"),
    Importer("FMUComplianceChecker", "fmu-check", "inputs at their start; warnings are failures", program="fmu_check"),
)
EXCHANGE_IMPORTERS = (
    Importer("FMPy, simulate_fmu", "fmpy.simulate_fmu ME", "CVode at 1e-8"),
    Importer("fmuloader", "fmuloader ME", "scipy's Radau at 1e-8"),
    Importer("pathsim-fmi", "pathsim-fmi ME", "Dormand-Prince at 1e-8"),
    Importer("fmusim", "fmusim ME", "CVode at 1e-8", program="fmusim"),
)
SYSTEM_IMPORTERS = (
    Importer("libcosim (libcosimpy), SSP", "libcosim", PARALLEL, lacks=("enumerations",), multiples=True),
    Importer("ecos (ecospy), SSP", "ecos", PARALLEL, lacks=("enumerations",)),
    Importer("FMU manipulation toolbox, container of an SSP", "fmucontainer", PARALLEL, lacks=("transformations",)),
    Importer(
        "FMPy, container wired by API", "fmpy container", SEQUENTIAL, lacks=("transformations",), order="sequential"
    ),
    Importer("sofirpy, wired by API", "sofirpy systems", SEQUENTIAL, lacks=("transformations",), order="sequential"),
    Importer("syssimx, wired by API", "syssimx", PARALLEL, lacks=("transformations",)),
    Importer(
        "CoFmuPy, wired by API", "cofmupy", PARALLEL, venv="cofmupy", lacks=("transformations", "other types than Real")
    ),
    Importer(
        "OMSimulator, SSP",
        "omsimulator",
        SEQUENTIAL,
        program="omsimulator",
        lacks=("transformations",),
        order="sequential",
    ),
)
FMI3_IMPORTERS = (
    Importer("FMPy, function by function", "fmpy 3.0", AFTER),
    Importer("FMPy, simulate_fmu", "fmpy.simulate_fmu 3.0", AFTER),
    Importer("fmuloader", "fmuloader 3.0", AFTER, lacks=("arrays",)),
    Importer("pathsim-fmi", "pathsim-fmi 3.0", AFTER, lacks=("arrays",)),
    Importer("fmusim", "fmusim", AFTER, program="fmusim"),
)
EVENT_IMPORTERS = (
    Importer("FMPy, simulate_fmu with event mode", "fmpy.simulate_fmu 3.0 events", "outputs in event mode"),
    Importer("fmusim with event mode", "fmusim events", "outputs in event mode", program="fmusim"),
)
PROGRAMS = {
    "fmusim": "fmusim of modelica/Reference-FMUs v0.0.39, now modelica/fmusim",
    "fmu_check": "FMUComplianceChecker of modelica-tools, linked with FMILibrary of modelon-community",
    "omsimulator": "OMSimulator of OpenModelica",
}
"""Option -> what it is the path of."""
REFERENCES = {"2.0": ("Dahlquist", "Feedthrough"), "3.0": ("Dahlquist", "StateSpace", "VanDerPol")}
"""FMI version and folder -> Reference FMUs that are used."""


def results(command: Sequence[str], jobs: Sequence[Mapping[str, Any]], environment: Mapping[str, str]) -> list[Any]:
    """What the runner says of each job; it is started again behind a job at which its process ended or hung."""
    found: list[Any] = []
    crashes = 0
    while len(found) < len(jobs):
        rest = jobs[len(found) :]
        if crashes == CRASHES:
            return found + [{"error": f"not tried after {crashes} crashes"}] * len(rest)
        limit = SECONDS_A_JOB * (2 + len(rest))
        try:
            done = subprocess.run(
                list(command),
                input=json.dumps(rest).encode(),
                capture_output=True,
                check=False,
                timeout=limit,
                env=os.environ | dict(environment),
            )
            said, reason = done.stdout, f"its process ended ({done.returncode}): {done.stderr.decode()[-300:]}"
        except subprocess.TimeoutExpired as error:
            said, reason = error.stdout or b"", f"no end within {limit:.0f} s"
        lines = [json.loads(line) for line in said.splitlines(keepends=True) if line.endswith(b"\n")]
        found += lines
        if len(lines) < len(rest):
            found.append({"error": reason})
            crashes += 1
    return found


def run(
    function: str,
    cases: Sequence[Case],
    python: str,
    what: str,
    *,
    tolerance: float = TOLERANCE,
    environment: Mapping[str, str] | None = None,
    extra: Callable[[Case], Mapping[str, Any]] = lambda _: {},
) -> Outcome:
    """Run the cases in one importer and compare; the largest difference is relative to an output's largest value."""
    outcome = Outcome(function, what)
    jobs = [{**case.job, **extra(case)} for case in cases]
    for case, found in zip(cases, results([python, str(RUNNER), function], jobs, environment or {}), strict=True):
        outcome.version = found.get("version") or outcome.version
        outcome.runs.append(_run(case, found, tolerance))
    return outcome


def _run(case: Case, found: Mapping[str, Any], tolerance: float) -> Run:
    """A job compared; that of a checker has no rows."""
    name, components = case.job["name"], case.components
    if error := found.get("error"):
        return Run(name, components, error=error)
    if not found["rows"]:
        return Run(name, components)
    difference, output = compare(case, found["rows"])
    return Run(name, components, difference, output, differs=not difference <= tolerance)


def shipped_systems() -> list[Path]:
    """The system files of all studies."""
    paths = sorted((ROOT / "studies").glob("*/*.toml"))
    return [path for path in paths if "[instances" in path.read_text() or "base =" in path.read_text()]


def selected(importer: Importer, cases: Sequence[Case]) -> tuple[list[Case], str]:
    """The systems that an importer can take, and a sentence on the others."""
    chosen, reasons = list(cases), []
    if "transformations" in importer.lacks:
        reasons += [f"{sum(c.transforms for c in chosen)} have a factor in a connection, which it does not know"]
        chosen = [c for c in chosen if not c.transforms]
    if "other types than Real" in importer.lacks:
        other = [c for c in chosen if c.set_enumerations or c.set_others]
        reasons += [f"{len(other)} set parameters that are not Real, which it does not know"]
        chosen = [c for c in chosen if c not in other]
    if "enumerations" in importer.lacks:
        count = sum(c.set_enumerations for c in chosen)
        reasons += [f"in {count} of them FMUs that declare their Enumerations as Integer"]
    return chosen, f"{len(chosen)} of {len(cases)}" + "".join(f"; {reason}" for reason in reasons)


class Conformance:
    """One run of everything: where the importers are, what was found."""

    def __init__(self, pythons: Mapping[str, str], programs: Mapping[str, str | None], folder: Path) -> None:
        self.pythons = pythons
        self.programs = programs
        self.folder = folder
        self.console = Console(stderr=True)
        library = find_library(f"python{sys.version_info.major}.{sys.version_info.minor}")
        self.libpython = library or ""

    def one(
        self,
        importer: Importer,
        cases: Sequence[Case],
        what: str,
        *,
        fmus: str,
        tolerance: float = TOLERANCE,
    ) -> Outcome:
        """Run one importer, or say why not; ``fmus`` is the kind of FMUs, see ``Outcome``."""
        outcome = Outcome(importer.name, what, importer.sees, fmus)
        environment: dict[str, str] = {}
        if importer.program and not self.programs.get(importer.program):
            outcome.missing = f"not run: give --{importer.program.replace('_', '-')} PATH"
        if importer.program and fmus == "python":
            environment = {"PYTHONPATH": sysconfig.get_path("purelib"), "COSIM_LIBPYTHON": self.libpython}
            if not self.libpython:
                outcome.missing = "not run: it needs libpython (apt-get install libpython3-dev)"
        if outcome.missing or not cases:
            return outcome
        self.console.print(f"{importer.name}: {what}", markup=False, highlight=False)

        def extra(case: Case) -> dict[str, Any]:
            program = self.programs.get(importer.program) or ""
            return {**importer.package(case), "program": program, "container": str(_container(case))}

        interpreter = self.pythons[importer.venv]
        done = run(
            importer.function, cases, interpreter, what, tolerance=tolerance, environment=environment, extra=extra
        )
        return replace(done, importer=importer.name, sees=importer.sees, fmus=fmus)

    def fmus(self, flavour: str, place: Path) -> list[Outcome]:
        """Every importer of single FMUs."""
        paths = sorted(place.glob("*.fmu"))
        cases, what = [fmu_case(path) for path in paths], f"{len(paths)} {flavour} FMUs"
        found = [self.one(i, cases, what, fmus=flavour) for i in FMU_IMPORTERS]
        oms = replace(SYSTEM_IMPORTERS[-1], name="OMSimulator, SSP of one FMU", lacks=())
        singles = [single_case(path, self.folder) for path in paths]
        return [*found, self.one(oms, singles, what, tolerance=SYSTEM_TOLERANCE, fmus=flavour)]

    def checks(self, flavour: str, place: Path) -> list[Outcome]:
        """Every checker."""
        paths = sorted(place.glob("*.fmu"))
        cases = [fmu_case(path, held=False) for path in paths]
        what = f"{len(paths)} {flavour} FMUs"
        return [self.one(i, cases, what, fmus=flavour) for i in CHECKERS]

    def exchange(self, place: Path) -> list[Outcome]:
        """The plants as model exchange."""
        cases = [fmu_case(path) for path in sorted(place.glob("*.fmu"))]
        plants = [case for case in cases if case.job["continuous_states"]]
        what = f"{len(plants)} native plants"
        return [self.one(i, plants, what, fmus="native", tolerance=EXCHANGE_TOLERANCE) for i in EXCHANGE_IMPORTERS]

    def systems(self, flavour: str, place: Path) -> list[Outcome]:
        """Every importer of systems, and the containers of one of them in ``cosim run``."""
        folder = self.folder / flavour
        steps = PYTHON_STEPS if flavour == "python" else STEPS
        folder.mkdir(parents=True, exist_ok=True)
        orders = {
            order: [system_case(path, folder, place, order, steps) for path in shipped_systems()]
            for order in ("sequential", "parallel")
        }
        found: list[Outcome] = []
        for importer in SYSTEM_IMPORTERS:
            cases, what = selected(importer, orders[importer.order])
            what = f"{flavour} FMUs, systems: {what}"
            found.append(self.one(importer, cases, what, tolerance=SYSTEM_TOLERANCE, fmus=flavour))
            if importer.function == "fmucontainer":
                found.append(self.containers(cases, what))
            if importer.multiples:
                multiples = [multiple_case(name, ROOT / "studies", folder, place, steps) for name in MULTIPLES]
                what = f"{flavour} FMUs, systems with step multiples: {'; '.join(c.job['name'] for c in multiples)}"
                found.append(self.one(importer, multiples, what, tolerance=SYSTEM_TOLERANCE, fmus=flavour))
        return found

    def containers(self, cases: Sequence[Case], what: str) -> Outcome:
        """The containers that the FMU manipulation toolbox made, each as one FMU in ``cosim run``."""
        outcome = Outcome("cosim run, these containers as FMUs", what, AFTER, "container")
        for case in cases:
            job = case.job
            document = {
                "experiment": {"stop_time": Decimal(repr(job["step"])) * job["steps"], "step_size": job["step"]},
                "instances": {"container": {"fmu": str(_container(case))}},
            }
            try:
                result = simulate(make_system(document))
            except CosimError as error:
                outcome.runs.append(Run(job["name"], case.components, error=str(error)))
                continue
            columns = [result[f"container.{name.replace('.', '_')}"] for name in job["outputs"]]
            rows = [[float(column[k + 1]) for column in columns] for k in range(job["steps"])]
            outcome.runs.append(_run(case, {"rows": rows}, SYSTEM_TOLERANCE))
        return outcome

    def fmi3(self, place: Path, native: Path) -> list[Outcome]:
        """FMI 3.0 FMUs in every importer that reads them."""
        paths = sorted(place.glob("*.fmu"))
        cases = [fmi3_case(path, fmu_case(native / path.name)) for path in paths]
        events = [case for case in cases if case.job["events"]]
        what = f"{len(events)} of {len(cases)} FMI 3.0 FMUs, those with event mode"
        found = [self.one(importer, events, what, fmus="fmi3") for importer in EVENT_IMPORTERS]
        return self._fmi3(cases, "FMI 3.0 FMUs", "fmi3") + found

    def reference_fmi3(self, folder: Path) -> list[Outcome]:
        """FMI 3.0 Reference FMUs: FMPy, function by function, is what the others are compared with."""
        cases = [
            foreign_fmi3_case(path, STEPS, _step(path))
            for path in (folder / f"{name}.fmu" for name in REFERENCES["3.0"])
        ]
        baseline = FMI3_IMPORTERS[0]
        command = [self.pythons[baseline.venv], str(RUNNER), baseline.function]
        rows = [found["rows"] for found in results(command, [case.job for case in cases], {})]
        expected = [
            replace(case, rows=row, start=row[0], delayed=(False,) * len(case.job["outputs"]))
            for case, row in zip(cases, rows, strict=True)
        ]
        return self._fmi3(expected, "Reference FMUs (FMI 3.0)", "reference")[1:]

    def _fmi3(self, cases: Sequence[Case], what: str, fmus: str) -> list[Outcome]:
        found: list[Outcome] = []
        for importer in FMI3_IMPORTERS:
            arrays = [c for c in cases if len(c.job["places"]) < len(c.job["outputs"])]
            chosen = [c for c in cases if "arrays" not in importer.lacks or c not in arrays]
            left = f"; {len(arrays)} with arrays as outputs, which it cannot read" if len(chosen) < len(cases) else ""
            found.append(self.one(importer, chosen, f"{len(chosen)} of {len(cases)} {what}{left}", fmus=fmus))
        return found


def _container(case: Case) -> Path:
    return Path(case.job["path"]).with_suffix(".fmu")


def _step(path: Path) -> float:
    description = fmpy.read_model_description(str(path))
    return float(description.coSimulation.fixedInternalStepSize or 0.01)


def bugs(
    pythons: Mapping[str, str], programs: Mapping[str, str | None], references: Path | None
) -> list[dict[str, str]]:
    """What bugs.py found; it runs in the importers' Python."""
    command = [pythons["importers"], str(BUGS), "--cofmupy", pythons["cofmupy"]]
    for option, path in {**programs, "reference_fmus": references}.items():
        command += [f"--{option.replace('_', '-')}", str(path)] if path else []
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    if done.returncode:
        raise RuntimeError(f"{BUGS.name} ended with {done.returncode}: {done.stderr[-1000:]}")
    return json.loads(done.stdout)


def main() -> int:
    """Run everything, write the page; exit code 1 if anything failed or differed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--python", default=sys.executable, help="the Python that has the importers")
    parser.add_argument("--cofmupy", default=sys.executable, help="the Python that has CoFmuPy")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "importers.md")
    parser.add_argument("--reference-fmus", type=Path, help="folder with the Reference FMUs in 2.0/ and 3.0/")
    for option, text in PROGRAMS.items():
        parser.add_argument(f"--{option.replace('_', '-')}", help=f"path of {text}")
    options = parser.parse_args()
    references = options.reference_fmus
    paths = [references / v / f"{name}.fmu" for v in REFERENCES for name in REFERENCES[v]] if references else []
    if missing := [str(path) for path in paths if not path.exists()]:
        parser.error(f"--reference-fmus: no {', '.join(missing)}. Build the Reference FMUs for FMI 2.0 and 3.0.")
    programs: dict[str, str | None] = {
        name: str(Path(path).resolve()) if (path := getattr(options, name)) else None for name in PROGRAMS
    }
    if missing := [path for path in programs.values() if path and not os.access(path, os.X_OK)]:
        parser.error(f"no program at {', '.join(missing)}. Give the path of what was built.")
    pythons = {"importers": options.python, "cofmupy": options.cofmupy}
    folder = ROOT / "build" / "importers-ssp"
    folder.mkdir(parents=True, exist_ok=True)
    places = {flavour: ROOT / "build" / "fmus" / flavour for flavour in ("native", "python", "fmi3")}
    suite = Conformance(pythons, programs, folder)
    both = [(flavour, places[flavour]) for flavour in ("native", "python")]
    sections = [
        ("Single FMUs", "Inputs held.", [o for f, place in both for o in suite.fmus(f, place)]),
        ("Checkers", "", [o for f, place in both for o in suite.checks(f, place)]),
        (
            "Systems",
            f"Every system of the studies; {PYTHON_STEPS} steps with Python FMUs.",
            [o for f, place in both for o in suite.systems(f, place)],
        ),
        ("Model exchange", "", suite.exchange(places["native"])),
    ]
    third = suite.fmi3(places["fmi3"], places["native"]) if places["fmi3"].exists() else []
    if references:
        third += suite.reference_fmi3(references / "3.0")
    if third:
        sections.append(("FMI 3.0", "Reference FMUs are compared with FMPy, function by function.", third))
    shown = bugs(pythons, programs, references.resolve() if references else None)
    text = page(sections, shown)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text, encoding="utf-8")
    options.output.with_suffix(".json").write_text(data(sections), encoding="utf-8")
    sys.stdout.write(text)
    failed = any(outcome.problems for _, _, found in sections for outcome in found)
    return 1 if failed or any(bug["seen"] == "failed" for bug in shown) else 0


if __name__ == "__main__":
    sys.exit(main())
