"""``cosim identify``: identifies parameters from a recorded or simulated experiment."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..errors import DescriptionError
from .console import check_files, check_plot, common_arguments, print_note, show, write_files
from .parser import number, positive, timeout_argument
from .systems import base_argument, stated_units, units_argument


def add(commands: Any) -> None:
    """Add ``identify``."""
    identify = commands.add_parser(
        "identify",
        help="first values from a log or a pulse: friction, nominal characteristic trajectory",
        description="Identify friction from a log, or a nominal characteristic trajectory (NCT) from a pulse.",
    ).add_subparsers(metavar="WHAT", required=True)
    nct = identify.add_parser(
        "nct",
        help="from a system or a recorded CSV",
        description="Identify the NCT from a system that drives its plant with a pulse, or from a CSV with columns "
        "t, u, x (and v).",
    )
    nct.examples = ("cosim identify nct maeda2008/pulse --alpha 505 --plot nct.png",)
    nct.add_argument("source", metavar="SYSTEM|CSV", help="a system file or a .csv")
    nct.add_argument("--alpha", type=positive, metavar="1/s", help="slope of the linear part, in 1/s")
    nct.add_argument("--e-lin", type=positive, metavar="m", help="position error at which the linear part ends, in m")
    nct.add_argument(
        "--omega-n", type=positive, metavar="rad/s", help="with --zeta: natural frequency of the compensator"
    )
    nct.add_argument("--zeta", type=positive, metavar="RATIO", help="with --omega-n: damping ratio of the compensator")
    nct.add_argument("--position", metavar="INST.VAR", help="position of the system (default: plant.position)")
    nct.add_argument(
        "--velocity",
        metavar="INST.VAR",
        help="velocity of the system; '' differentiates the position (default: plant.velocity)",
    )
    nct.add_argument("--input", metavar="INST.VAR", help="input of the plant (default: plant.command)")
    nct.add_argument("--output", type=Path, metavar="FILE", help="write the curve (.csv)")
    nct.add_argument("--start", type=Path, metavar="FILE", help="write a system file with the NCT (.toml)")
    base_argument(nct, "the start file")
    nct.add_argument("--plot", type=Path, metavar="FILE", help="draw the phase plane")
    timeout_argument(nct)
    common_arguments(nct, _identify)
    _add_friction(identify)


def _add_friction(identify: Any) -> None:
    friction = identify.add_parser(
        "friction",
        help="first values of inertia and friction from a log of position and force",
        description="First values of inertia, sliding friction of both directions, break-away and presliding stiffness "
        "from a log (.csv, .parquet, .mat), and which of them the log excites.",
    )
    friction.examples = (
        "cosim identify friction docs/examples/your_machine/stage.csv --position position --force command "
        "--factor 125.66 --unit N --plot friction.png",
    )
    friction.add_argument("record", type=Path, metavar="RECORD", help="a log: .csv, .parquet or .mat")
    friction.add_argument(
        "--position", default="position", metavar="COLUMN", help="column of the position (default: position)"
    )
    friction.add_argument(
        "--force", default="force", metavar="COLUMN", help="column of the force, torque or command (default: force)"
    )
    friction.add_argument(
        "--factor", type=number, default=1.0, metavar="K", help="force for one unit of its column (default: 1)"
    )
    friction.add_argument("--unit", metavar="UNIT", help="unit of the force (default: as the record says, else N)")
    friction.add_argument("--time", metavar="COLUMN", help="column of time (default: time or t)")
    friction.add_argument(
        "--sampling-time", type=positive, metavar="SECONDS", help="sampling time of a record without times"
    )
    units_argument(friction)
    friction.add_argument(
        "--window",
        type=number,
        nargs=2,
        metavar=("FROM", "TO"),
        help="use only this part of the record, in s (default: all)",
    )
    friction.add_argument("--plot", type=Path, metavar="FILE", help="draw friction over velocity")
    common_arguments(friction, _friction)


def _friction(options: argparse.Namespace) -> int:
    from ..design import friction

    check_plot(options.plot)
    look = friction.identify_friction(
        options.record,
        position=options.position,
        force=options.force,
        factor=options.factor,
        force_unit=options.unit,
        time=options.time,
        sampling_time=options.sampling_time,
        units=stated_units(options.units),
        **({} if options.window is None else {"span": tuple(options.window)}),
    )
    if not options.json:
        for note in look.notes:
            print_note(f"note: {note}")
    rows: list[tuple[str, ...]] = [("First values", "Value", "+-", "Unit", "From")]
    for v in look.values:
        figures = (f"{v.value:.5g}", f"{v.deviation:.2g}") if v.excited else ("not excited", "")
        rows.append((v.name, *figures, v.unit, v.why))
    show(options, friction.summary(look), rows, f"{options.record}: {look.samples} samples")
    if not options.json:
        unit = "mm/s" if look.length == "m" else "mrad/s"
        rows = [(unit, look.unit, "+-")]
        for curve in (look.negative, look.positive):
            lines = zip(curve.velocity, curve.friction, curve.spread, strict=True)
            rows += sorted((f"{1e3 * v:.4g}", f"{f:.4g}", f"{s:.2g}") for v, f, s in lines)
        rows[1:] = sorted(rows[1:], key=lambda row: float(row[0]))
        show(options, {}, rows, "Friction over velocity")
        print_note(f"{100.0 * look.slow_share:.2g} % of the samples move slower than a hundredth of the largest speed.")
    plotted = write_files(
        (options.plot, lambda path: friction.plot_friction(look, path, title=str(options.record))),
    )
    return 0 if plotted else 1


def _identify(options: argparse.Namespace) -> int:
    from ..design import identify
    from ..fmu.places import base_name, shipped_file
    from ..system.system import read_system

    if (options.omega_n is None) != (options.zeta is None):
        raise DescriptionError("--omega-n and --zeta go together: give both or none.")
    check_files(options.output, options.start)
    check_plot(options.plot)
    base = system = None
    if options.start is not None and options.base is not None:
        base = base_name(options.base, options.start)
        system = read_system(shipped_file(base, options.start.parent), fmus=options.fmus)
    nct = identify.identify_nct(
        options.source,
        alpha=options.alpha,
        e_lin=options.e_lin,
        position=options.position,
        velocity=options.velocity or None,
        differentiate=options.velocity == "",
        command=options.input,
        timeout=options.timeout,
        fmus=options.fmus,
    )
    gains = None if options.zeta is None else nct.gains(options.omega_n, options.zeta)
    figures: list[tuple[str, float, str]] = [
        ("alpha", nct.alpha, "1/s"),
        ("e_lin", nct.e_lin, "m"),
        ("K", nct.K, "m/s a unit of command"),
        ("u_r", nct.u_r, "unit of command"),
        ("t_r", nct.t_r, "s"),
        ("rest", nct.rest, "m"),
        ("spring_back", nct.spring_back, "m"),
        ("h_max", nct.h_max, "m/s"),
        ("reach", nct.reach, "m"),
        *([] if gains is None else [("K_P", gains[0], ""), ("K_I", gains[1], "")]),
    ]
    rows = [(name, f"{value:.6g}", unit) for name, value, unit in figures]
    show(options, {name: value for name, value, _ in figures}, [("NCT", "", ""), *rows], str(options.source))
    written = write_files(
        (options.output, lambda path: identify.write_nct(nct, path)),
        (options.start, lambda path: identify.write_start(nct, path, gains=gains, base=base, system=system)),
        (options.plot, lambda path: identify.plot_nct(nct, path)),
    )
    return 0 if written else 1
