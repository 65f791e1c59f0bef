"""Reference results inside FMUs: the files of the layered standard fmi-ls-ref, written and read.

A manifest lists files that belong to an FMU, by role. One of them may be an experiments file (``.exp``, draft
ma-hs-experiments): experiments with parameters (SSV), stimuli and references (CSV). These standards have no tolerance
for the difference between a replay and its references. An annotation of type ``motion-cosim`` gives it by signal:

    abs(difference) <= absolute + relative*max(abs(reference))        the largest value of the signal in the experiment

The annotation also says that the stimuli are held: the inputs of a row apply from its time to that of the next.
The draft has two forms: times are attributes of an experiment, or of its element TransientSimulation. Both are read,
the second is written. Files of other makers are not trusted: no file outside the FMU's folder is read.
"""

from __future__ import annotations

import csv
import importlib
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree.ElementTree import Element, SubElement, register_namespace

from ..errors import DescriptionError, shortened
from ..fmu.xml import document, parse

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"

MANIFEST = "fmi-ls-manifest.xml"

EXPERIMENTS = "experiments.exp"

ANNOTATION = "motion-cosim"

NAMESPACE = "urn:motion-cosim:references:1"

MANIFEST_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"

MANIFEST_ATTRIBUTES = {
    "fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    "fmi-ls-version": "1.0.0-alpha.1",
    "fmi-ls-description": "Layered Standard providing information on related files included in an FMU.",
}

CSV_TYPE, SSV_TYPE, EXPERIMENTS_TYPE = "text/csv", "application/x-ssp-parameter-set", "application/x-ma-hs-experiments"

EXPERIMENTS_TYPES = (EXPERIMENTS_TYPE, "application/x-ma-ls-experiments")
"""MIME types of an experiments file; the second one is of an earlier draft."""

_lxml: Any = importlib.import_module("lxml.etree")


@dataclass(frozen=True)
class Tolerance:
    """The largest difference allowed between a signal and its reference."""

    absolute: float
    """In the unit of the signal."""
    relative: float
    """As a share of the largest magnitude of the reference."""

    def limit(self, largest: float) -> float:
        """The largest difference allowed where the reference reaches ``largest``."""
        return self.absolute + self.relative * largest


@dataclass(frozen=True)
class Related:
    """A file that a manifest lists."""

    source: str
    """URI, relative to the manifest."""
    role: str
    type: str
    description: str = ""


@dataclass(frozen=True)
class ReferenceExperiment:
    """An experiment of an experiments file; ``None`` stands for a value that the file does not give."""

    name: str
    description: str = ""
    start_time: float | None = None
    stop_time: float | None = None
    step_size: float | None = None
    tolerance: float | None = None
    """Relative tolerance of the solver."""
    parameters: str | None = None
    """URI of an SSV file, relative to the experiments file."""
    stimuli: str | None = None
    references: str | None = None
    held: bool = False
    """Whether inputs keep the value of a row until the next row; otherwise the importer interpolates."""
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict[str, Tolerance])


@dataclass(frozen=True)
class Table:
    """A CSV file: names of the columns other than time, times in s, and the cells as text."""

    names: tuple[str, ...]
    times: tuple[float, ...]
    rows: tuple[tuple[str, ...], ...]

    def column(self, name: str) -> list[str]:
        """The cells of the column ``name``, as text."""
        place = self.names.index(name)
        return [row[place] for row in self.rows]


# ---- writing ----


def write_manifest(files: Iterable[Related]) -> bytes:
    """A manifest that lists ``files``."""
    register_namespace("fmi-ls", MANIFEST_NAMESPACE)
    root = Element(
        "fmiReferences", {f"{{{MANIFEST_NAMESPACE}}}{name}": value for name, value in MANIFEST_ATTRIBUTES.items()}
    )
    for file in files:
        SubElement(root, "Related", type=file.type, source=file.source, role=file.role, description=file.description)
    return document(root)


def write_experiments(name: str, description: str, experiments: Iterable[ReferenceExperiment]) -> bytes:
    """An experiments file; every experiment must have its times."""
    register_namespace("cosim", NAMESPACE)  # SSP files use this prefix for another namespace
    root = Element("Experiments", name=name, description=description)
    for experiment in experiments:
        element = SubElement(root, "Experiment", name=experiment.name, description=experiment.description)
        if experiment.tolerance is not None:
            element.set("tolerance", repr(experiment.tolerance))
        times = {
            "startTime": experiment.start_time,
            "stopTime": experiment.stop_time,
            "stepSize": experiment.step_size,
        }
        SubElement(element, "TransientSimulation", {k: repr(v) for k, v in times.items() if v is not None})
        for tag, source in (
            ("Parameters", experiment.parameters),
            ("Stimuli", experiment.stimuli),
            ("References", experiment.references),
        ):
            if source is not None:
                SubElement(element, tag, source=source)
        annotation = SubElement(SubElement(element, "Annotations"), "Annotation", type=ANNOTATION)
        comparison = SubElement(annotation, _own("Comparison"), stimuli="held" if experiment.held else "interpolated")
        for signal, tolerance in experiment.tolerances.items():
            SubElement(
                comparison,
                _own("Tolerance"),
                name=signal,
                absolute=repr(tolerance.absolute),
                relative=repr(tolerance.relative),
            )
    return document(root)


def write_csv(names: Sequence[str], rows: Iterable[Sequence[str]]) -> bytes:
    """A CSV file with the time in the first column; names are quoted, numbers given as text are not."""
    lines = [",".join('"{}"'.format(name.replace('"', '""')) for name in ("time", *names))]
    lines += [",".join(row) for row in rows]
    return ("\n".join(lines) + "\n").encode()


def _own(tag: str) -> str:
    return f"{{{NAMESPACE}}}{tag}"


# ---- reading ----


def read_manifest(folder: Path) -> list[Related]:
    """The files listed in the manifest of an FMU unpacked into ``folder``; none if it has no manifest.

    Raises DescriptionError if the manifest cannot be read.
    """
    path = folder / FOLDER / MANIFEST
    return read_manifest_file(path) if path.is_file() else []


def read_manifest_file(path: Path) -> list[Related]:
    """The files listed in a manifest. Raises DescriptionError if it cannot be read."""
    root = _parse(path, "fmiReferences")
    problems: list[str] = []
    files: list[Related] = []
    for element in root.findall("Related"):
        missing = [name for name in ("source", "role") if not element.get(name)]
        if missing:
            problems.append(f"{MANIFEST}, line {element.sourceline}: Related without {' and '.join(missing)}.")
            continue
        kind = str(element.get("type", "application/octet-stream"))
        files.append(Related(element.get("source"), element.get("role"), kind, element.get("description", "")))
    if problems:
        raise DescriptionError(problems)
    return files


def read_experiments(path: Path) -> list[ReferenceExperiment]:
    """The experiments of a file. Raises DescriptionError with all its problems."""
    root = _parse(path, "Experiments")
    problems: list[str] = []
    experiments: list[ReferenceExperiment] = []
    for element in root.findall("Experiment"):
        name = str(element.get("name") or "")
        said = f"{path.name}, line {element.sourceline}: experiment '{name}'"
        if not name:
            problems.append(f"{path.name}, line {element.sourceline}: an experiment without name.")
        if name in {experiment.name for experiment in experiments}:
            problems.append(f"{said} is there twice. Name each once.")
        transient = element.find("TransientSimulation")
        other = [child for child in element if child.tag in _OTHER_ANALYSES]
        if other:
            problems.append(f"{said}: analysis {other[0].tag} is not replayed, only TransientSimulation is.")
        times = element if transient is None else transient
        numbers: dict[str, float | None] = {}
        for attribute, owner in (
            ("startTime", times),
            ("stopTime", times),
            ("stepSize", times),
            ("tolerance", element),
        ):
            numbers[attribute] = _number(owner, attribute, said, problems)
        sources: dict[str, str | None] = {}
        for tag in ("Parameters", "Stimuli", "References"):
            child = element.find(tag)
            sources[tag] = None if child is None else child.get("source")
            if child is not None and not child.get("source"):
                problems.append(f"{said}: {tag} without source.")
        held, tolerances = _comparison(element, said, problems)
        experiments.append(
            ReferenceExperiment(
                name,
                str(element.get("description") or ""),
                numbers["startTime"],
                numbers["stopTime"],
                numbers["stepSize"],
                numbers["tolerance"],
                sources["Parameters"],
                sources["Stimuli"],
                sources["References"],
                held,
                tolerances,
            )
        )
    if not experiments:
        problems.append(f"{path.name}: no experiment in it.")
    if problems:
        raise DescriptionError(problems)
    return experiments


_OTHER_ANALYSES = (
    "SteadyState",
    "ParameterOptimization",
    "SetPointOptimization",
    "SensitivityAnalysis",
    "TrajectoryOptimization",
    "Linearization",
)


def _comparison(element: Any, said: str, problems: list[str]) -> tuple[bool, dict[str, Tolerance]]:
    """Whether stimuli are held, and the tolerances by signal, from the annotation of an experiment.

    Without an annotation stimuli are interpolated and there are no tolerances.
    """
    tolerances: dict[str, Tolerance] = {}
    held = False
    for annotation in element.findall("Annotations/Annotation"):
        if annotation.get("type") != ANNOTATION:
            continue
        for comparison in annotation.findall(_own("Comparison")):
            held = comparison.get("stimuli") == "held"
            for entry in comparison.findall(_own("Tolerance")):
                where = f"{said}: tolerance of '{entry.get('name', '')}'"
                absolute = _number(entry, "absolute", where, problems) or 0.0
                relative = _number(entry, "relative", where, problems) or 0.0
                if absolute < 0.0 or relative < 0.0:
                    problems.append(f"{where} is negative. Give 0 or more.")
                tolerances[str(entry.get("name", ""))] = Tolerance(absolute, relative)
    return held, tolerances


def _number(element: Any, attribute: str, said: str, problems: list[str]) -> float | None:
    text = element.get(attribute)
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        problems.append(f"{said}: {attribute} = '{text}' is not a finite number.")
        return None
    return value


def read_csv(path: Path) -> Table:
    """A CSV file: a header whose first name is ``time``, then rows of as many cells, times not descending.

    Cells are separated by the comma, semicolon or tab that follows the name ``time``. Raises DescriptionError naming
    file and line.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        separator = re.match(r'\s*"?time"?\s*([,;\t])', text, re.IGNORECASE)
        delimiter = separator[1] if separator else ","
        lines = list(csv.reader(io.StringIO(text), delimiter=delimiter, skipinitialspace=True, strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise DescriptionError(f"{path.name}: not a readable CSV file ({error}).") from None
    if not lines or not lines[0] or lines[0][0].strip().lower() != "time":
        found = lines[0][0].strip() if lines and lines[0] else ""
        raise DescriptionError(f"{path.name}: the first column is '{found}'. It must be 'time'.")
    names = tuple(name.strip() for name in lines[0][1:])
    problems = [f"{path.name}: column '{name}' is there twice." for name in sorted(set(names)) if names.count(name) > 1]
    times: list[float] = []
    rows: list[tuple[str, ...]] = []
    for number, cells in enumerate(lines[1:], start=2):
        if not cells:
            continue
        if len(cells) != len(names) + 1:
            problems.append(f"{path.name}, line {number}: {len(cells)} cells, the header has {len(names) + 1}.")
            continue
        try:
            time = float(cells[0])
        except ValueError:
            time = math.nan
        if not math.isfinite(time):
            problems.append(f"{path.name}, line {number}: time '{cells[0]}' is not a finite number.")
        elif times and time < times[-1]:
            problems.append(f"{path.name}, line {number}: time {time:g} s is before {times[-1]:g} s above it.")
        times.append(time)
        rows.append(tuple(cell.strip() for cell in cells[1:]))
    if not rows and not problems:
        problems.append(f"{path.name}: no rows.")
    if problems:
        raise DescriptionError(shortened(problems))
    return Table(names, tuple(times), tuple(rows))


def locate(source: str, beside: Path, folder: Path) -> Path:
    """The file that the URI ``source`` means, relative to ``beside``, in the FMU unpacked into ``folder``.

    Raises DescriptionError if the URI is absolute or leaves the FMU, or if the file is missing.
    """
    parts = urlsplit(source)
    if parts.scheme or parts.netloc or parts.path.startswith("/"):
        raise DescriptionError(f"'{source}': only files inside the FMU are read. Give a relative path.")
    path = (beside / unquote(parts.path)).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise DescriptionError(f"'{source}' points outside the FMU. Refused.")
    if not path.is_file():
        raise DescriptionError(f"'{source}' is not in the FMU.")
    return path


def _parse(path: Path, tag: str) -> Any:
    try:
        root = parse(path.read_bytes())
    except _lxml.XMLSyntaxError as error:
        raise DescriptionError(f"{path.name}: not valid XML: {error}") from None
    if root.tag != tag:
        raise DescriptionError(f"{path.name}: the root element is '{root.tag}'. It must be '{tag}'.")
    return root
