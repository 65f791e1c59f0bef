"""``cosim identify``: parameters from a recorded or simulated experiment."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..errors import DescriptionError
from .console import common_arguments, show


def add(commands: Any) -> None:
    """Add ``identify``."""
    identify = commands.add_parser(
        "identify",
        help="identify the nominal characteristic trajectory of a stage",
        description="Identify a nominal characteristic trajectory (NCT) from an open-loop pulse.",
    ).add_subparsers(metavar="WHAT", required=True)
    nct = identify.add_parser(
        "nct",
        help="from a system or a recorded CSV",
        description="Identify the NCT from a system that drives its plant with a pulse, or from a CSV with columns "
        "t, u, x (and v).",
        epilog="Example: cosim identify nct studies/maeda2008/pulse.toml --alpha 505 --plot nct.png",
    )
    nct.add_argument("source", metavar="SYSTEM|CSV", help="a system file or a .csv")
    nct.add_argument("--alpha", type=float, metavar="1/s", help="slope of the linear part")
    nct.add_argument("--e-lin", type=float, metavar="m", help="position error at which the linear part ends")
    nct.add_argument("--omega-n", type=float, metavar="rad/s", help="with --zeta: natural frequency of the compensator")
    nct.add_argument("--zeta", type=float, help="with --omega-n: damping ratio of the compensator")
    nct.add_argument("--position", metavar="INST.VAR", help="default: plant.position")
    nct.add_argument(
        "--velocity", metavar="INST.VAR", help="'' to differentiate the position (default: plant.velocity)"
    )
    nct.add_argument("--input", metavar="INST.VAR", help="default: plant.command")
    nct.add_argument("--output", type=Path, metavar="FILE", help="write the curve (.csv)")
    nct.add_argument("--start", type=Path, metavar="FILE", help="write a system file with the NCT (.toml)")
    nct.add_argument("--base", metavar="NAME", help="the file beside it that the start file completes")
    nct.add_argument("--plot", type=Path, metavar="FILE", help="draw the phase plane")
    common_arguments(nct, _identify)


def _identify(options: argparse.Namespace) -> int:
    from ..design import identify

    if (options.omega_n is None) != (options.zeta is None):
        raise DescriptionError("--omega-n and --zeta go together: give both or none.")
    nct = identify.identify_nct(
        options.source,
        alpha=options.alpha,
        e_lin=options.e_lin,
        position=options.position,
        velocity=options.velocity or None,
        differentiate=options.velocity == "",
        command=options.input,
        fmus=options.fmus,
    )
    gains = None if options.zeta is None else nct.gains(options.omega_n, options.zeta)
    if options.output is not None:
        identify.write_nct(nct, options.output)
    if options.start is not None:
        identify.write_start(nct, options.start, gains=gains, base=options.base)
    if options.plot is not None:
        identify.plot_nct(nct, options.plot)
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
    return 0
