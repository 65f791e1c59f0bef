"""Write the references, the validation picture and the icon of a component into ``fmus/references/NAME``."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from ..errors import DescriptionError
from ..export.assets import ICON, MEASURED, PICTURE, folder
from ..export.package import build
from ..export.workspace import Workspace
from ..files import temporary_folder
from ..fmu.description import Fmu, read_fmu
from ..fmu.variables import Value
from ..fmu.xml import document
from ..model import Choice, Component, Plant, declarations
from ..reference import fmi_ls_ref as lsref
from ..system.ssp_write import parameter_set
from .exact import PLANT_TOLERANCE, Validation, scalar_names, tolerance, trace
from .fmi_ls_ref import ReferenceExperiment, Related, write_csv
from .picture import draw
from .replay import Report, verify

DIGITS = 11
"""Significant digits of a reference; the rounding error is small beside every tolerance."""


def write(
    workspace: Workspace, name: str, experiments: Sequence[Validation], icon: Callable[[Path], None] | None = None
) -> Report:
    """Write all assets of a component; returns the replay report of the native FMU with them. ``icon`` draws the icon.

    Raises DescriptionError if the FMU does not run or exceeds a tolerance; then no picture is written.
    """
    kind, source = workspace.component(name), workspace.components()[name]
    target = folder(source, name)
    target.mkdir(parents=True, exist_ok=True)
    with temporary_folder() as scratch:
        fmu = read_fmu(build(kind, scratch, workspace.cache))
        written = _references(kind, fmu, experiments)
        for path in target.iterdir():
            path.unlink()
        for file, content in written.items():
            (target / file).write_bytes(content)
        (target / PICTURE).write_bytes(b"")  # the manifest lists it; it is drawn from the run below
        report = verify(build(kind, scratch / "validated", workspace.cache))
    if report.code:
        raise DescriptionError([*report.problems, *_complaints(report)])
    _picture(report, target / PICTURE, {e.name: e.shown for e in experiments})
    (target / MEASURED).write_text(
        json.dumps(_measured(report, {e.name: e.description for e in experiments}), indent=1) + "\n", encoding="utf-8"
    )
    if icon is not None:
        icon(target / ICON)
    return report


def _references(kind: type[Component], fmu: Fmu, experiments: Sequence[Validation]) -> dict[str, bytes]:
    """Name -> content of the files of the layered standard."""
    files: dict[str, bytes] = {}
    related = [
        Related(lsref.EXPERIMENTS, "experiment/validation", lsref.EXPERIMENTS_TYPE, "Validation experiments"),
        Related(f"../../documentation/{PICTURE}", "report", "image/png", "References and what the native FMU gives"),
    ]
    described: list[ReferenceExperiment] = []
    for validation in experiments:
        stem = re.sub(r"\W+", "_", validation.name)
        about = f"of experiment '{validation.name}'"
        stimuli = parameters = None
        inputs = validation.inputs(kind)
        start = _start(kind, validation)
        if start:
            parameters = f"{stem}_parameters.ssv"
            files[parameters] = document(parameter_set(fmu, start))
            related.append(Related(parameters, "parameter", lsref.SSV_TYPE, f"Parameters {about}"))
        if fmu.inputs:
            stimuli = f"{stem}_stimuli.csv"
            files[stimuli] = _csv(validation, scalar_names(kind.Input), inputs, 17)
            related.append(Related(stimuli, "other", lsref.CSV_TYPE, f"Stimuli {about}"))
        reference = f"{stem}_reference.csv"
        files[reference] = _csv(validation, scalar_names(kind.Output), trace(kind, validation, inputs), DIGITS)
        related.append(Related(reference, "result", lsref.CSV_TYPE, f"Reference results {about}"))
        described.append(
            ReferenceExperiment(
                name=validation.name,
                description=f"{validation.description}. {_TIMING if fmu.inputs else _TIMING_OF_SOURCES}",
                start_time=0.0,
                stop_time=validation.time(validation.steps),
                step_size=validation.step_size,
                tolerance=PLANT_TOLERANCE if issubclass(kind, Plant) else None,
                parameters=parameters,
                stimuli=stimuli,
                references=reference,
                held=True,
                tolerances=dict.fromkeys(scalar_names(kind.Output), tolerance(kind)),
            )
        )
    origin = "integrated by scipy's Radau" if issubclass(kind, Plant) else "evaluated"
    description = f"{kind.__name__}: its Python equations {origin}, without FMI; see documentation/fmi-ls-ref.txt"
    files[lsref.EXPERIMENTS] = lsref.write_experiments(f"{kind.__name__} validation", description, described)
    files[lsref.MANIFEST] = lsref.write_manifest(related)
    return files


_TIMING = (
    "Inputs of a row are set at its time and held until the next; its outputs are those right after the step that ends "
    "then, before new inputs are set."
)

_TIMING_OF_SOURCES = "The outputs of a row are those right after the step that ends at its time."


def _start(kind: type[Component], validation: Validation) -> dict[str, Value]:
    """Parameter values of the experiment: name in the FMU -> value."""
    lines = {declaration.attribute: declaration for declaration in declarations(kind)}
    start: dict[str, Value] = {}
    for attribute, value in validation.parameters.items():
        if attribute not in lines:
            raise DescriptionError(f"{kind.__name__}, experiment '{validation.name}': no parameter '{attribute}'.")
        line = lines[attribute]
        for name, item in zip(line.names, value if line.length is not None else (value,), strict=True):
            start[name] = item.number if isinstance(item, Choice) else item
    return start


def _csv(validation: Validation, names: Sequence[str], rows: Sequence[Sequence[float]], digits: int) -> bytes:
    texts = [
        [_text(validation.time(row), 17), *(_text(value, digits) for value in values)]
        for row, values in enumerate(rows)
    ]
    return write_csv(names, texts)


def _text(value: float, digits: int) -> str:
    """A number rounded to ``digits`` significant digits, without zeros at the end."""
    text = repr(float(f"{value:.{digits}g}") + 0.0)
    return text.removesuffix(".0")


def _picture(report: Report, target: Path, shown: Mapping[str, Sequence[str]]) -> None:
    """Draw the picture with few colours, which makes the file four times smaller."""
    draw(report, target, shown)
    with Image.open(target) as picture:
        reduced = picture.convert("RGB").quantize(32, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    reduced.save(target, optimize=True)


def _measured(report: Report, descriptions: Mapping[str, str]) -> dict[str, Any]:
    """The facts on the validation that the documentation page shows."""
    return {
        "experiments": [
            {
                "name": outcome.experiment.name,
                "description": descriptions[outcome.experiment.name],
                "rows": outcome.rows,
                "step_size": outcome.experiment.step_size,
                "signals": [
                    {
                        "name": signal.name,
                        "unit": signal.unit,
                        "largest_value": float(f"{abs(signal.reference).max():.3g}"),
                        "largest_difference": float(f"{signal.largest:.2g}"),
                        "tolerance": float(f"{signal.limit:.2g}"),
                    }
                    for signal in outcome.signals
                ],
            }
            for outcome in report.outcomes
        ]
    }


def _complaints(report: Report) -> list[str]:
    found: list[str] = []
    for outcome in report.outcomes:
        said = f"{report.name}, experiment '{outcome.experiment.name}'"
        if outcome.failure:
            found.append(f"{said}: {outcome.failure}")
        found += [
            f"{said}: {s.name} differs by {s.largest:.3g} {s.unit} at {s.at:g} s, tolerance {s.limit:.3g} {s.unit}."
            for s in outcome.signals
            if not s.within
        ]
    return found
