"""The command line: collects the commands (one module each), prints their errors and returns exit codes.

Module ``parser`` has the exit codes. Large packages are imported only when a command runs.
"""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

from ..errors import CosimError, DescriptionError
from ..extras import EXTRAS, missing
from ..master.interrupts import Ended, ending_by_exception
from ..version import VERSION
from .console import log_on_standard_error, print_error
from .parser import Parser
from .surroundings import check_working_folder, explain, keep_to_one_thread, prepare_streams, replace_missing_home

COMMANDS = (
    *("run", "compare", "check", "export", "info", "list", "fmus", "study", "verify", "build"),
    *("sweep", "identify", "fit", "stability", "learn", "tune", "linearize"),
)
"""The commands in the order in which the help shows them; each is a module of this folder."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    prepare_streams()
    keep_to_one_thread()
    replace_missing_home()
    # Shells replace ~ at the beginning of an argument, not behind the = of an option.
    home = re.compile(r"(--[\w-]+=)(~.*)", re.DOTALL)
    given = [
        found[1] + os.path.expanduser(found[2]) if (found := home.fullmatch(argument)) else argument
        for argument in (sys.argv[1:] if arguments is None else arguments)
    ]
    parser = make_parser(*given[:1])
    if not given:
        parser.print_help(sys.stderr)
        return 2
    options = parser.parse_args(given)
    return exit_code(lambda: options.command(options))


def exit_code(command: Callable[[], int]) -> int:
    """Run a command and return its exit code. An expected error is printed and gives an exit code."""
    with ending_by_exception(), log_on_standard_error():
        return _guarded(command)


def _guarded(command: Callable[[], int]) -> int:
    """Run a command and print its errors; returns the exit code."""
    try:
        check_working_folder()
        return command()
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
        if error.name is None or error.name not in EXTRAS:
            raise
        print_error(missing(error.name, "this command"))
        return 2
    except KeyboardInterrupt as interruption:
        print_error("Interrupted.")
        return 128 + (interruption.number if isinstance(interruption, Ended) else signal.SIGINT)
    except BrokenPipeError:
        # The program that read the output (head, less) has ended.
        sys.stderr.close()
        return 1
    except OSError as error:
        print_error(explain(error))
        return 1


def make_parser(first: str = "") -> Parser:
    """The parser of all commands; the reference pages of the commands are made from it.

    If ``first`` is a command, it is the parser of this command only: making the others would take a tenth of the time
    of a short run.
    """
    parser = Parser(prog="cosim", description="Co-simulation of FMUs for precision motion.")
    parser.examples = ("cosim list", "cosim run shams2010/fsmc_5sin --plot run.png")
    parser.add_argument("--version", action="version", version=f"cosim {VERSION}", help="show the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in (first,) if first in COMMANDS else COMMANDS:
        import_module(f".{command}", __package__).add(commands)
    return parser
