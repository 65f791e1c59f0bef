"""The command line: one module a command, their errors and exit codes.

Exit codes: 0 done, 1 a simulation failed, 2 a description is wrong, 130 interrupted. Nothing heavy is imported before
a command runs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ..errors import CosimError, DescriptionError
from . import (
    check,
    export,
    fmus,
    identify,
    info,
    learn,
    linearize,
    list,
    run,
    stability,
    study,
    sweep,
    tune,
    verify,
)
from .console import print_error

COMMANDS = (
    *(run, check, export, info, list, fmus, study, verify),
    *(sweep, identify, stability, learn, tune, linearize),
)
"""The commands in the order in which the help shows them."""
TOOLS = ("control", "dask", "distributed", "pyarrow", "scipy")
"""Packages of the extra ``tools``, which design tools need."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        return options.command(options)
    except DescriptionError as error:
        problems = error.problems
        if len(problems) > 1:
            print_error(f"{len(problems)} problems:")
        for problem in problems:
            print_error(problem)
        return 2
    except CosimError as error:
        print_error(str(error))
        return 1
    except ModuleNotFoundError as error:
        if error.name not in TOOLS:
            raise
        print_error(f"{error.name} is not installed, and this command needs it: install motion-cosim[tools].")
        return 2
    except KeyboardInterrupt:
        print_error("Interrupted.")
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
        description="Co-simulation of FMUs for precision motion.",
        epilog="Exit codes: 0 done, 1 a simulation failed, 2 a description is wrong, 130 interrupted.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    return parser
