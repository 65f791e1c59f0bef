"""``cosim linearize``: computes the state space of an instance and the margins of its loop."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import DescriptionError
from .console import check_plot, common_arguments, print_note, set_argument, show, write_files
from .parser import timeout_argument
from .systems import given_values

if TYPE_CHECKING:
    from ..design.linearize import StateSpace
    from ..design.margins import Margins
    from ..design.workers import Loadable

LIMIT = 1e-8
"""A largest eigenvalue nearer to 1 than this is at the limit of stability: the controller's model is no more exact."""


def add(commands: Any) -> None:
    """Add ``linearize``."""
    linearize = commands.add_parser(
        "linearize",
        help="state space of an instance, margins of its loop",
        description="State space of an FMU, or of an instance of a system at a time of its run; margins of the loop. "
        "They hold for the smallest motions around that point: at rest friction is a spring, in motion it has the "
        "slope of its curve over speed.",
    )
    linearize.examples = (
        "cosim linearize maeda2008/step --instance plant --at 0 --set trajectory.amplitude=1e-7 "
        "controller.sensor_resolution=0 --inputs command --outputs position --margins --plot bode.png",
    )
    linearize.add_argument("source", metavar="FMU|SYSTEM", help="an FMU or a system, by path or name")
    linearize.add_argument(
        "--instance", default="plant", metavar="NAME", help="instance of the system that is linearized (default: plant)"
    )
    linearize.add_argument(
        "--at", default="0", metavar="TIME", help="time of the run in s, as 0.01 or t=0.01 (default: 0)"
    )
    linearize.add_argument("--inputs", nargs="+", metavar="VAR", help="inputs of the state space (default: all)")
    linearize.add_argument("--outputs", nargs="+", metavar="VAR", help="outputs of the state space (default: all)")
    set_argument(linearize, several=True)
    linearize.add_argument(
        "--margins",
        action="store_true",
        help="margins of the loop with --controller, opened at the command of the instance",
    )
    linearize.add_argument(
        "--controller", default="controller", metavar="NAME", help="instance that closes the loop (default: controller)"
    )
    linearize.add_argument("--plot", type=Path, metavar="FILE", help="Bode picture of the first input and output")
    timeout_argument(linearize, "the run", "3600")
    common_arguments(linearize, _linearize)


def _linearize(options: argparse.Namespace) -> int:
    from ..design import linearize
    from ..design.workers import Limit, Loadable, Worker
    from ..fmu.places import find_system, has_ending

    try:
        at = float(options.at.removeprefix("t="))
    except ValueError:
        raise DescriptionError(f"--at {options.at}: give seconds, such as t=0.01.") from None
    check_plot(options.plot)
    values = given_values(options.values)
    file = find_system(options.source, options.fmus)
    alone = has_ending(file, ".fmu")
    if alone:
        if at != 0.0:
            raise DescriptionError("an FMU alone is linearized where it starts. Give a system for another time.")
        if options.margins:
            raise DescriptionError("margins need a system with the loop.")
        start = {name.removeprefix(f"{file.stem}.").removeprefix("fmu."): value for name, value in values.items()}
        system, instance = linearize.alone(file, start), "fmu"
    else:
        from ..system.system import read_system

        system, instance = read_system(file, values, fmus=options.fmus), options.instance
    # In a process of its own, an FMU that crashes does not end this command.
    limit = Limit(options.timeout)
    with Worker() as worker:
        source = Loadable.of(system)
        model = worker.call(_model, source, instance, at, options.inputs, options.outputs, limit=limit)
        margins = options.margins and worker.call(_margins, source, at, options.controller, instance, limit=limit)
    notes = [f"{name} changes nothing here: it is saturated or switched off." for name in model.idle_inputs]
    notes += [f"{name} has no derivative here: it is rounded or switched off." for name in model.idle_outputs]
    for note in notes:
        print_note(f"note: {note}")
    found: Margins | None = None
    if margins:
        drawn, found = margins
        title = "Loop transfer function, sampled"
    else:
        drawn, title = model, f"{model.inputs[0]} to {model.outputs[0]}"
    _show(options, model, found, notes, f"{options.source} at {at:g} s")
    return 0 if write_files((options.plot, lambda path: linearize.plot_bode(path, drawn, title=title))) else 1


def _model(
    source: Loadable, instance: str, at: float, inputs: Sequence[str] | None, outputs: Sequence[str] | None
) -> StateSpace:
    from ..design.linearize import linearize

    return linearize(source.system(), instance=instance, at=at, inputs=inputs, outputs=outputs)


def _margins(source: Loadable, at: float, controller: str, plant: str) -> tuple[StateSpace, Margins]:
    from ..design.margins import loop_margins

    return loop_margins(source.system(), at=at, controller=controller, plant=plant)


def _show(
    options: argparse.Namespace, model: StateSpace, found: Margins | None, notes: Sequence[str], title: str
) -> None:
    """Print the equations and poles, and the margins if there are any."""
    matrices = {name: getattr(model, name).tolist() for name in ("A", "B", "C", "D")}
    poles = [[float(pole.real), float(pole.imag)] for pole in model.poles]
    content = {
        "states": model.states,
        "inputs": model.inputs,
        "outputs": model.outputs,
        "units": model.units,
        **matrices,
        "poles": poles,
        "margins": None if found is None else vars(found),
        "notes": notes,
    }
    rows: list[tuple[str, ...]] = [("", "State space in these units", "Unit")]
    names = (*model.states, *model.inputs)
    for left, right, labels in ((model.A, model.B, model.states), (model.C, model.D, model.outputs)):
        for label, x, u in zip(labels, left.tolist(), right.tolist(), strict=True):
            shown = f"der({label})" if labels is model.states else label
            rows.append((shown, f"= {_sum((*x, *u), names)}", model.units.get(label, "")))
    show(options, content, rows, title, numbers=False)
    if options.json:
        return
    if len(model.states):
        show(options, {}, _pole_rows(poles), "Poles")
    if found is not None:
        show(options, {}, _margin_rows(found), f"Loop with {options.controller}, opened at {options.instance}.command")


def _sum(factors: Sequence[float], names: Sequence[str]) -> str:
    """The sum of the names times their factors, such as ``2*x - 0.5*y``; ``0`` if all factors are 0."""
    text = ""
    for factor, name in zip(factors, names, strict=True):
        if factor != 0.0:
            sign = ("-" if factor < 0.0 else "") if not text else " - " if factor < 0.0 else " + "
            text += sign + (f"{abs(factor):.6g}*" if abs(factor) != 1.0 else "") + name
    return text or "0"


def _pole_rows(poles: Sequence[Sequence[float]]) -> list[tuple[str, ...]]:
    """The poles, slow ones first; each conjugate pair once."""
    rows: list[tuple[str, ...]] = [("Pole / 1/s", "Frequency / Hz", "Damping", "Time constant / s")]
    small = 1e-9 * max(math.hypot(*pole) for pole in poles)  # 0 but for rounding
    for real, imaginary in sorted(poles, key=lambda pole: math.hypot(*pole)):
        size = math.hypot(real, imaginary)
        if size <= small:
            rows.append(("0", "0", "-", "-"))
        elif abs(imaginary) <= small:
            rows.append((f"{real:.6g}", f"{size / (2.0 * math.pi):.4g}", "-", f"{-1.0 / real:.4g}"))
        elif imaginary > 0.0:
            pair = f"{real:.6g} +- {imaginary:.6g}j"
            rows.append((pair, f"{size / (2.0 * math.pi):.4g}", f"{-real / size:.4g}", "-"))
    return rows


def _margin_rows(found: Margins) -> list[tuple[str, ...]]:
    """The margins as they are read: in dB, degrees, Hz and ms."""
    stable = "yes" if found.stable else "no"
    if abs(found.spectral_radius - 1.0) < LIMIT:
        stable = "limit"
    rows: list[tuple[str, ...]] = [
        ("Margin", "Value", "Unit", ""),
        ("Stable", stable, "", f"largest eigenvalue {found.spectral_radius:.8g}"),
    ]

    def row(name: str, value: float, unit: str, remark: str) -> None:
        exists = math.isfinite(value)
        rows.append((name, f"{value:.4g}" if exists else "none", unit, remark if exists else "the loop does not cross"))

    if stable == "no":
        hertz = found.mode_frequency / (2.0 * math.pi)
        swing = f"swings at {hertz:.4g} Hz and " if hertz > 0.0 else ""
        growth = f"{found.spectral_radius:.4g} times a sample"
        rows.append(("", "", "", f"the smallest motion {swing}grows {growth}, until a limit or friction bounds it"))
    decibel = 20.0 * math.log10(found.gain) if math.isfinite(found.gain) else math.inf
    row("Gain", decibel, "dB", f"factor {found.gain:.4g}, at {found.gain_frequency / (2.0 * math.pi):.4g} Hz")
    row("Phase", math.degrees(found.phase), "deg", f"at {found.crossover / (2.0 * math.pi):.4g} Hz")
    row("Delay", 1e3 * found.delay, "ms", "")
    row("Sensitivity, largest", 20.0 * math.log10(found.sensitivity), "dB", f"factor {found.sensitivity:.4g}")
    return rows
