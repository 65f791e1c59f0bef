"""``cosim linearize``: computes the state space of an instance and the margins of its loop."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import DescriptionError
from .console import check_plot, common_arguments, print_note, set_argument, show, write_files
from .systems import given_values

if TYPE_CHECKING:
    from ..design.linearize import Margins, StateSpace


def add(commands: Any) -> None:
    """Add ``linearize``."""
    linearize = commands.add_parser(
        "linearize",
        help="state space of an instance, margins of its loop",
        description="State space of an FMU, or of an instance of a system at a time of its run; margins of the loop.",
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
    linearize.add_argument("--margins", action="store_true", help="margins of the loop with --controller")
    linearize.add_argument(
        "--controller", default="controller", metavar="NAME", help="instance that closes the loop (default: controller)"
    )
    linearize.add_argument("--plot", type=Path, metavar="FILE", help="Bode picture of the first input and output")
    common_arguments(linearize, _linearize)


def _linearize(options: argparse.Namespace) -> int:
    from ..design import linearize
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
        source: Any = file
        start = {name.removeprefix(f"{file.stem}.").removeprefix("fmu."): value for name, value in values.items()}
        model = linearize.linearize(source, inputs=options.inputs, outputs=options.outputs, start=start)
    else:
        from ..system.system import read_system

        source = read_system(file, values, fmus=options.fmus)
        model = linearize.linearize(
            source, instance=options.instance, at=at, inputs=options.inputs, outputs=options.outputs
        )
    notes = [f"{name} changes nothing here: it is saturated or switched off." for name in model.idle_inputs]
    for note in notes:
        print_note(f"note: {note}")
    found: Margins | None = None
    if options.margins:
        if alone:
            raise DescriptionError("margins need a system with the loop.")
        loop, found = linearize.loop_margins(source, at=at, controller=options.controller, plant=options.instance)
        drawn, title = loop, "Loop transfer function, sampled"
    else:
        drawn, title = model, f"{model.inputs[0]} to {model.outputs[0]}"
    _show(options, model, found, notes, f"{options.source} at {at:g} s")
    return 0 if write_files((options.plot, lambda path: linearize.plot_bode(path, drawn, title=title))) else 1


def _show(
    options: argparse.Namespace, model: StateSpace, found: Margins | None, notes: Sequence[str], title: str
) -> None:
    """Print the matrices, and the margins if there are any."""
    matrices = {name: getattr(model, name).tolist() for name in ("A", "B", "C", "D")}
    poles = [[float(pole.real), float(pole.imag)] for pole in model.poles]
    content = {
        "states": model.states,
        "inputs": model.inputs,
        "outputs": model.outputs,
        **matrices,
        "poles": poles,
        "margins": None if found is None else vars(found),
        "notes": notes,
    }
    rows: list[tuple[str, ...]] = [("", *model.states, *model.inputs)]
    for names, left, right in (
        ([f"der({state})" for state in model.states], model.A, model.B),
        (list(model.outputs), model.C, model.D),
    ):
        for i, name in enumerate(names):
            rows.append((name, *(f"{float(value):.6g}" for value in (*left[i], *right[i]))))
    show(options, content, rows, title)
    if found is not None and not options.json:
        units = {"gain_frequency": "rad/s", "phase": "rad", "crossover": "rad/s", "delay": "s"}
        rows = [("Margin", "", ""), ("stable", "yes" if found.stable else "no", "")]
        rows += [(name, f"{value:.6g}", units.get(name, "")) for name, value in vars(found).items() if name != "stable"]
        show(options, {}, rows, f"Loop with {options.controller}")
