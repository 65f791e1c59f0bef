"""The parser of ``cosim`` and of its commands: argparse, with examples and exit codes at the end of the help."""

from __future__ import annotations

import argparse
import contextlib
import math
import re
import shutil
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NoReturn, cast

from ..errors import suggest

EXIT_CODES: Mapping[int, str] = {
    0: "done",
    1: "a simulation failed or a file could not be written",
    2: "a file, a name, a value or an option is wrong",
    129: "ended by SIGHUP",
    130: "interrupted (Ctrl-C)",
    143: "ended by SIGTERM",
}
"""Exit code -> its meaning, for every command that says nothing else."""
LEAST_WIDTH = 20
"""Smallest width in characters of the help, however narrow the terminal is."""
LONGEST_LINE = 78
"""Longest line of an example in characters. A longer command goes on in the next line, after a backslash."""


def number(text: str) -> float:
    """The value of an option that is a finite number."""
    with contextlib.suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise argparse.ArgumentTypeError(f"must be a finite number, not '{text}'")


def positive(text: str) -> float:
    """The value of an option that is a finite number above 0."""
    with contextlib.suppress(argparse.ArgumentTypeError):
        if (value := number(text)) > 0.0:
            return value
    raise argparse.ArgumentTypeError(f"must be a finite number above 0, not '{text}'")


def count(text: str) -> int:
    """The value of an option that is a whole number of at least 1."""
    with contextlib.suppress(ValueError):
        if (value := int(text)) >= 1:
            return value
    raise argparse.ArgumentTypeError(f"must be a whole number of at least 1, not '{text}'")


def timeout_argument(
    parser: argparse.ArgumentParser,
    of: str = "a call of an FMU",
    default: str = "none",
    *,
    kind: Callable[[str], float] = positive,
) -> None:
    """Add ``--timeout``, the limit in s for a call of an FMU, or ``of`` something else; ``kind`` reads its value."""
    text = f"longest time of {of}, such as 30; what takes longer is ended (default: {default})"
    parser.add_argument("--timeout", type=kind, metavar="SECONDS", help=text)


RUN_LIMIT = "20 times the longest run so far, at least 10"
"""The limit of a run without ``--timeout``, for ``timeout_argument``."""


class Parser(argparse.ArgumentParser):
    """A parser whose help ends with examples and exit codes. The reference page of a command shows the same texts."""

    examples: Sequence[str] = ()
    """Complete commands. Each runs with what comes with cosim, or in the folder of the source tree."""
    exit_codes: Mapping[int, str] = EXIT_CODES

    def format_help(self) -> str:
        """The help as argparse writes it, then the examples and the exit codes."""
        width = max(shutil.get_terminal_size().columns - 2, LEAST_WIDTH)
        lines: list[str] = []
        if self.examples:
            lines += ["", "examples:"]
            lines += [f"  {line}" for example in self.examples for line in broken(example).splitlines()]
        lines += ["", "exit codes:"]
        for code, meaning in self.exit_codes.items():
            lines += textwrap.wrap(f"{code:<5}{meaning}", width, initial_indent="  ", subsequent_indent=" " * 7)
        return super().format_help() + "\n".join(lines) + "\n"

    def error(self, message: str) -> NoReturn:
        """End with usage and message; a word that is not known is answered with the nearest one."""
        super().error(message + self._hint(message))

    def _hint(self, message: str) -> str:
        """The hint "Did you mean" for a choice or an option that is not known; else ""."""
        if found := re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message, re.DOTALL):
            name, known = found[1], re.findall(r"[\w.-]+", found[2])
        elif found := re.search(r"unrecognized arguments: (?:.* )?(--[\w-]+)", message):
            name, known = found[1], [*_options(self)]
        else:
            return ""
        near = suggest(name, known)
        return near if near.startswith(" Did") else ""


def _options(parser: argparse.ArgumentParser) -> Iterator[str]:
    """The options of a parser and of its commands."""
    for action in parser._actions:  # pyright: ignore[reportPrivateUsage] - argparse has no other list
        yield from action.option_strings
        if isinstance(action, argparse._SubParsersAction):  # pyright: ignore[reportPrivateUsage]
            for other in cast("Mapping[str, argparse.ArgumentParser]", action.choices).values():  # pyright: ignore[reportUnknownMemberType]
                yield from _options(other)


def broken(command: str) -> str:
    """A command for a shell in lines of at most ``LONGEST_LINE`` characters; a line ends before an option."""
    first, *parts = re.split(r" (?=-)", command)
    lines = [first]
    for part in parts:
        if len(lines[-1]) + len(part) + 3 <= LONGEST_LINE:
            lines[-1] += f" {part}"
        else:
            lines.append(f"    {part}")
    return " \\\n".join(lines)
