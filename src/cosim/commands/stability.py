"""``cosim stability``: computes the stability limits of NCTF control."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .console import Bar, check_plot, common_arguments, set_argument, show, write_files
from .parser import RUN_LIMIT, positive, timeout_argument
from .systems import given_values


def add(commands: Any) -> None:
    """Add ``stability``."""
    stability = commands.add_parser(
        "stability",
        help="limits of stability of NCTF control",
        description="Limits of stability of NCTF control.",
    ).add_subparsers(metavar="WHAT", required=True)
    linear = stability.add_parser(
        "linear",
        help="of the sampled linear loop",
        description="Stable damping ratios of the sampled linear loop, by Jury's test and in closed form.",
    )
    linear.examples = ("cosim stability linear --W 0.1 0.25 0.4 --alpha 505 --T-s 2e-4",)
    linear.add_argument(
        "--W",
        type=positive,
        nargs="+",
        default=[0.05, 0.1, 0.2, 0.3, 0.4],
        help="values of omega_n*T_s (default: 0.05 0.1 0.2 0.3 0.4)",
    )
    linear.add_argument(
        "--alpha", type=positive, required=True, metavar="1/s", help="slope of the NCT near zero, in 1/s"
    )
    linear.add_argument(
        "--T-s", type=positive, required=True, metavar="s", help="sampling time of the controller, in s"
    )
    linear.add_argument("--json", action="store_true", help="print the result as JSON")
    linear.set_defaults(command=_linear)
    practical = stability.add_parser(
        "practical",
        help="ultimate gain by simulation",
        description="The gain at which a step no longer comes to rest.",
    )
    practical.examples = ("cosim stability practical maeda2008/step --set trajectory.amplitude=1e-5 controller.K_I=0",)
    practical.add_argument("system", type=Path, metavar="SYSTEM", help="a system file with an NCTF loop")
    set_argument(practical, several=True)
    practical.add_argument("--gain", metavar="INST.VAR", help="the gain that grows (default: controller.K_P)")
    practical.add_argument(
        "--position", metavar="INST.VAR", help="the position that must come to rest (default: plant.position)"
    )
    practical.add_argument(
        "--first", type=positive, default=300.0, metavar="GAIN", help="gain at which the scan begins (default: 300)"
    )
    practical.add_argument(
        "--last", type=positive, default=20000.0, metavar="GAIN", help="gain at which it ends (default: 20000)"
    )
    practical.add_argument(
        "--swing", type=positive, default=50e-9, metavar="m", help="least oscillation that counts, in m (default: 5e-8)"
    )
    practical.add_argument("--stop-time", default="0.6", metavar="s", help="end of a run, in s (default: 0.6)")
    timeout_argument(practical, "a run", RUN_LIMIT)
    common_arguments(practical, _practical)
    maps = stability.add_parser(
        "map",
        help="limits of several objects over omega_n*T_s",
        description="Linear, practical and simulated limits of the damping ratio, as a map file asks for.",
    )
    maps.examples = ("cosim stability map maeda2008/limits/friction --plot friction.png",)
    maps.add_argument("file", type=Path, metavar="MAP", help="a map file (.toml)")
    maps.add_argument("--plot", type=Path, metavar="FILE", help="draw the map")
    timeout_argument(maps, "a run", f"timeout in MAP, else {RUN_LIMIT}")
    common_arguments(maps, _map)


def _linear(options: argparse.Namespace) -> int:
    from ..design.stability import closed_form_limits, linear_limits

    limits = {W: (*linear_limits(W, options.alpha * options.T_s), *closed_form_limits(W)) for W in options.W}
    names = ("zeta_min", "zeta_max", "closed_form_min", "closed_form_max")
    content = {"limits": [{"W": W, **dict(zip(names, found, strict=True))} for W, found in limits.items()]}
    rows = [(f"{W:g}", *(f"{value:.5g}" for value in found)) for W, found in limits.items()]
    title = f"Stable damping ratios, alpha*T_s = {options.alpha * options.T_s:.4g}"
    show(options, content, [("omega_n*T_s", "smallest", "largest", "closed form, smallest", "largest"), *rows], title)
    return 0


def _practical(options: argparse.Namespace) -> int:
    from ..design.stability import practical_limit

    limit = practical_limit(
        options.system,
        given_values(options.values),
        gain=options.gain,
        position=options.position,
        first=options.first,
        last=options.last,
        swing=options.swing,
        stop_time=options.stop_time,
        timeout=options.timeout,
        fmus=options.fmus,
    )
    content = {"limit": limit.value, "stable": limit.stable, "unstable": limit.unstable, "runs": limit.runs}
    rows = [(name, f"{value:.6g}") for name, value in content.items()]
    show(options, content, [(options.gain or "Gain", ""), *rows], f"Practical limit of {options.system}")
    return 0


def _map(options: argparse.Namespace) -> int:
    from ..design.stability import limit_map, plot_limit_map, read_map

    check_plot(options.plot)
    file = read_map(options.file, fmus=options.fmus)
    with Bar("Limits") as bar:
        found = limit_map(
            file.system, file.cases, K=file.K, timeout=options.timeout or file.timeout, progress=bar.update
        )
    content = {
        "ultimate": dict(found.ultimate),
        "mean_deviation": found.mean_deviation,
        "runs": found.runs,
        "points": [{**vars(point), "deviation": point.deviation} for point in found.points],
    }
    rows = [
        (
            point.case,
            f"{point.W:g}",
            f"{point.linear:.4g}",
            f"{point.practical:.4g}",
            f"below {point.found:.4g}" if point.starts_unstable else f"{point.found:.4g}",
            f"{100.0 * point.deviation:.1f} %",
        )
        for point in found.points
    ]
    title = (
        f"{file.description}: damping ratios; mean deviation {100.0 * found.mean_deviation:.1f} %, {found.runs} runs"
    )
    show(options, content, [("Case", "omega_n*T_s", "linear", "practical", "simulated", "deviation"), *rows], title)
    return 0 if write_files((options.plot, lambda path: plot_limit_map(found, path))) else 1
