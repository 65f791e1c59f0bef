"""The command line: ``cosim run``, ``check``, ``info``, ``list``, ``study``, ``verify``.

Exit codes: 0 done, 1 a simulation failed, 2 a description is wrong, 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ..errors import CosimError, DescriptionError
from .check import add_check
from .console import complain, fmus_argument
from .design import add_commands
from .export import add_export
from .fmus import copy_command, info_command, list_command
from .run import run_command
from .systems import system_arguments
from .verify import add_verify

TOOLS = ("control", "distributed", "scipy")
"""Packages of the extra ``tools``, which design tools need."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        return options.command(options)
    except DescriptionError as error:
        problems = error.problems
        if len(problems) > 1:
            complain(f"{len(problems)} problems:")
        for problem in problems:
            complain(problem)
        return 2
    except CosimError as error:
        complain(str(error))
        return 1
    except ModuleNotFoundError as error:
        if error.name not in TOOLS:
            raise
        complain(f"{error.name} is not installed, and this command needs it: install motion-cosim[tools].")
        return 2
    except KeyboardInterrupt:
        complain("Interrupted.")
        return 130
    except BrokenPipeError:
        # Whoever read our output (head, less) has gone.
        sys.stderr.close()
        return 1


class _Version(argparse.Action):
    """Looks the version up only when it is asked for: that takes longer than the rest of the parser."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        parser.exit(message=f"cosim {version('motion-cosim')}\n")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cosim",
        description="Co-simulation of FMI 2.0 FMUs for precision motion.",
        epilog="Exit codes: 0 done, 1 a simulation failed, 2 a description is wrong, 130 interrupted.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    run = commands.add_parser(
        "run",
        help="run a system, or an FMU alone",
        description="Run a system and show what came out. An FMU runs alone, over the times that its file suggests.",
        epilog="Example: cosim run studies/shams2010/fsmc_5sin.toml --set plant.m=70 --output result.parquet, or "
        "cosim run Trajectory --set kind=quintic --plot move.png",
    )
    system_arguments(run)
    run.add_argument("--output", type=Path, metavar="FILE", help="write the record as .csv or .parquet")
    run.add_argument("--plot", type=Path, metavar="FILE", help="draw the run, such as run.png")
    run.add_argument("--json", action="store_true", help="print the summary as JSON, for scripts")
    run.add_argument("--debug", action="store_true", help="show everything the FMUs log, not only what went wrong")
    run.set_defaults(command=run_command)

    add_check(commands)
    add_export(commands)

    info = commands.add_parser(
        "info",
        help="show the variables of an FMU",
        description="Show what an FMU offers: variables with unit, start value and bounds, and its feedthrough.",
        epilog="Example: cosim info BallscrewStage",
    )
    info.add_argument("fmu", metavar="FMU", help="a name in the FMU folder, such as BallscrewStage, or an .fmu file")
    fmus_argument(info)
    info.set_defaults(command=info_command)

    listing = commands.add_parser(
        "list", help="list FMUs, systems and studies", description="List the FMUs found and the systems shipped."
    )
    fmus_argument(listing)
    listing.set_defaults(command=list_command)

    fmus = commands.add_parser(
        "fmus", help="hand FMUs out", description="Hand FMUs out; 'cosim list' shows which there are."
    ).add_subparsers(metavar="WHAT", required=True)
    copy = fmus.add_parser(
        "copy",
        help="copy FMUs into a folder, for other tools",
        description="Copy FMUs into a folder, for other tools. Files that are the same already stay as they are.",
        epilog="Example: cosim fmus copy my_fmus BallscrewStage FuzzySlidingMode Trajectory",
    )
    copy.add_argument("folder", type=Path, metavar="DIR", help="folder to copy to; it is made if it is not there")
    copy.add_argument("names", nargs="*", metavar="NAME", help="FMUs, such as BallscrewStage (default: all)")
    copy.add_argument("--force", action="store_true", help="replace files of the same name")
    fmus_argument(copy)
    copy.set_defaults(command=copy_command)

    study = commands.add_parser(
        "study",
        help="run a study and write its report",
        description="Run all systems of a study and write its report: what was published, what was measured.",
        epilog="Example: cosim study shams2010 --output results/shams2010",
    )
    study.add_argument("name", metavar="NAME", help="a study, such as shams2010; cosim list shows all")
    study.add_argument("--output", type=Path, metavar="DIR", help="folder of the report (default: results/NAME)")
    study.add_argument("--runs", default="*", metavar="PATTERN", help="only the runs that match, such as 'fsmc_*'")
    study.add_argument("--jobs", type=int, default=2, metavar="N", help="runs carried out at a time (default: 2)")
    fmus_argument(study)
    study.set_defaults(command=_study)

    add_verify(commands)
    add_commands(commands)
    return parser


def _study(options: argparse.Namespace) -> int:
    from ...cosim import study

    return study.main(options.name, options.output, runs=options.runs, jobs=options.jobs, fmus=options.fmus)


if __name__ == "__main__":
    sys.exit(main())
