"""What is written of a run of the conformance suite: docs/importers.md, and docs/importers.json for programs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .cases import STEPS


@dataclass(frozen=True)
class Run:
    """One job in one importer: a single FMU or a system."""

    name: str
    components: tuple[str, ...]
    """The names of its FMUs."""
    difference: float | None = None
    """The largest, as a share of the output's largest value; None of a job without a trace."""
    output: str = ""
    """Where it is."""
    differs: bool = False
    """Whether it is beyond the tolerance."""
    error: str = ""
    """Why it did not run."""

    @property
    def problem(self) -> str:
        """What went wrong, "" if nothing did."""
        if self.differs:
            return f"{self.output} differs by {self.difference:.2g} of its largest value"
        return self.error


@dataclass
class Outcome:
    """What one importer did with a set of jobs."""

    importer: str
    what: str
    sees: str = ""
    fmus: str = ""
    """Which FMUs the jobs have: native, python or fmi3; reference or container for FMUs that are no components."""
    version: str = ""
    missing: str = ""
    """Why it was not run at all."""
    runs: list[Run] = field(default_factory=list[Run])

    @property
    def ran(self) -> int:
        """The number of jobs that ran to their end."""
        return sum(not run.error for run in self.runs)

    @property
    def traces(self) -> int:
        """The number of jobs that could be compared."""
        return sum(run.difference is not None for run in self.runs)

    @property
    def largest(self) -> tuple[float, str]:
        """The largest difference of all jobs, and where it is; (0, "") without one."""
        found = [(run.difference, f"{run.name}, {run.output}") for run in self.runs if run.difference]
        return max(found, default=(0.0, ""))

    @property
    def problems(self) -> list[str]:
        """What went wrong, one text a job."""
        return [f"{run.name}: {run.problem}" for run in self.runs if run.problem]


Section = tuple[str, str, Sequence[Outcome]]
"""A title, a text below it, and what was found."""


def table(found: Sequence[Outcome]) -> list[str]:
    """The outcomes as the lines of a Markdown table, and what went wrong."""
    lines = [
        "| importer | version | what was run | ran | largest difference | where | what it sees |",
        "|" + "---|" * 7,
    ]
    for o in found:
        largest, where = o.largest
        text = f"{largest:.1e}" if largest else o.missing or ("0" if o.traces else "")
        if not o.traces and not o.missing:
            text = "see below" if o.problems else "no problem reported"
        lines.append(f"| {o.importer} | {o.version} | {o.what} | {o.ran} | {text} | {where} | {o.sees} |")
    problems = [f"- {o.importer}, {o.what}: {problem}" for o in found for problem in _short(o.problems)]
    return [*lines, *(["", "What went wrong:", "", *problems] if problems else [])]


def _short(problems: Sequence[str]) -> list[str]:
    """The same problem of many jobs once."""
    texts: dict[str, list[str]] = {}
    for problem in problems:
        name, _, text = problem.partition(": ")
        texts.setdefault(" ".join(text.split()), []).append(name)
    return [f"{', '.join(names) if len(names) < 6 else f'{len(names)} jobs'}: {text}" for text, names in texts.items()]


def page(sections: Sequence[Section], shown: Sequence[Mapping[str, str]]) -> str:
    """docs/importers.md."""
    lines = [
        "# The FMUs and systems in other importers",
        "",
        f"Written by `make conformance`. Everything runs for {STEPS} communication steps; the difference is that from "
        "`cosim run` in the same order, as a share of the output's largest value.",
    ]
    for title, text, found in sections:
        lines += ["", f"## {title}", "", *([text, ""] if text else []), *table(found)]
    lines += [
        "",
        "## Bugs of importers, shown with FMUs that this project did not make",
        "",
        "Each was tried when this page was written; the FMUs were made then by PythonFMU's own exporter, or are "
        "Reference FMUs.",
        "",
        "| importer | version | bug | FMU | seen | what was seen |",
        "|" + "---|" * 6,
        *(f"| {b['importer']} | {b['version']} | {b['bug']} | {b['fmu']} | {b['seen']} | {b['what']} |" for b in shown),
    ]
    return "\n".join([*lines, ""]) + NOTES


NOTES = """
## What is to be known

- Read right after a step, a controller's output is the one applied over that step; an importer that first sets new
  inputs sees the answer to them. Both are compared with the row of `cosim run` that shows the same sample.
- libcosim and ecos know no FMI 2.0 variable of type Enumeration, neither from an SSP nor through their API. Systems
  that set one run there as `cosim export --enumerations integer` writes them: the FMUs in the package declare it as
  Integer, the binary is the same. Without the option such values are `ssv:Integer` for an Enumeration, which both read
  past; `cosim export` says so.
- ecos applies parameters only under the name of their set: `init(parameter_set="start")`.
- fmuloader is run with `cannot_use_memory_management_functions=True`.
- The FMU manipulation toolbox reads the structure of an SSP; parameters and outputs are told to it through its API.
- syssimx makes a step of length zero at the start, which FMI 2.0 does not allow; the step is left out.
- CoFmuPy is run with all FMUs in one group. It and sofirpy are told the inputs of step 1, by `initialization` and
  `start_values`.
- OMSimulator also refuses a connection between different units, with a factor or without. `cosim export` writes the
  annotation that it needs.
- OMSimulator adds its times up, so that the times and steps that an FMU is told may differ in the last bits from
  those of `cosim run`. It also reads outputs between setting the inputs of an FMU and its step; `cosim run` does so
  only where there is feedthrough. FMI allows both, and for the FMUs of this project both are within the figures
  above. FMUs of Dymola in packages of OMSimulator's testsuite answer with another path of their own solver: in
  `embrace_TwoConf` (Dymola 2020) the reads make up to 0.7 %. With them OMSimulator's values are met to the last bit,
  without them those of `cosim run`. In `acvs_compositeModel` (Dymola 2025x) the reads do nothing; at steps of 1/128
  s, whose sums are exact, both agree to 4e-12, and at 0.01 s to 3e-4. There, with OMSimulator's inputs, its times
  give its values to the last bit and the exact times differ by 4e-4.
- FMPy's `simulate_ssp` ignores parameters, so that it runs no system of the studies; pyfmi and mosaik-fmi have no
  wheels.
- Programs that pip does not install are given by their paths,
  `make conformance PROGRAMS="--fmusim PATH --fmu-check PATH --omsimulator PATH --reference-fmus DIR"`:
  fmusim and the Reference FMUs (modelica/Reference-FMUs, v0.0.39 for fmusim; cmake, with libxml2, minizip and CVode;
  DIR has the FMUs for FMI 2.0 in 2.0 and for FMI 3.0 in 3.0), FMUComplianceChecker (modelica-tools; linked with
  FMILibrary 2.4.1 of modelon-community), OMSimulator (OpenModelica; cmake; its wheel downloads the program; built here
  with fmi4c of OMSimulator-3rdParty 1168b8e and SUNDIALS 7.5.0).
"""


def data(sections: Iterable[Section]) -> str:
    """docs/importers.json: for each importer and kind of FMU what became of each component, by itself or in systems.

    A list of objects, one a line, in the order of the tables: ``section``, ``importer``, ``version``, ``fmus``,
    ``sees``, ``missing`` (why it was not run at all) and ``components``: name -> ``jobs`` (how many had the component),
    ``ran``, ``difference`` (the largest, as a share of the output's largest value; null without a trace) and
    ``problems``.
    """
    rows = [
        {
            "section": title,
            "importer": o.importer,
            "version": o.version,
            "fmus": o.fmus,
            "sees": o.sees,
            "missing": o.missing,
            "components": _components(o.runs),
        }
        for title, _, found in sections
        for o in found
        if o.fmus in ("native", "python", "fmi3")
    ]
    return "[\n" + ",\n".join(json.dumps(row, ensure_ascii=False) for row in rows) + "\n]\n"


def _components(runs: Iterable[Run]) -> dict[str, dict[str, Any]]:
    groups: dict[str, list[Run]] = {}
    for run in runs:
        for name in run.components:
            groups.setdefault(name, []).append(run)
    found: dict[str, dict[str, Any]] = {}
    for name in sorted(groups):
        differences = [run.difference for run in groups[name] if run.difference is not None]
        found[name] = {
            "jobs": len(groups[name]),
            "ran": sum(not run.error for run in groups[name]),
            "difference": float(f"{max(differences):.1e}") if differences else None,
            "problems": _short([f"{run.name}: {run.problem}" for run in groups[name] if run.problem]),
        }
    return found
