"""``cosim run --overlay``: compares a run with a record."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import CosimError, DescriptionError
from .compare import given_signals, open_record
from .console import print_error

if TYPE_CHECKING:
    from ..record.read import Record
    from ..result.compare import Comparison, Shift
    from ..result.result import Result
    from ..system.system import System


def overlay_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--overlay`` and the options that belong to it."""
    parser.add_argument(
        "--overlay",
        metavar="FILE",
        help="compare the run with a record (.csv, .tsv, .txt, .dat, .parquet, .mat): in the summary, picture, page",
    )
    parser.add_argument(
        "--signals",
        action="extend",
        nargs="+",
        metavar="NAME=COLUMN",
        help="variables of the run and columns of the record that belong together (default: those of one name)",
    )
    parser.add_argument(
        "--delay", metavar="SECONDS", help="seconds by which the run lags behind the record, or 'estimate' (default: 0)"
    )


class Overlay:
    """A record, read and checked before the run."""

    def __init__(self, options: argparse.Namespace, system: System) -> None:
        """Raises DescriptionError if the record cannot be read, or with all signals that do not fit the run."""
        import numpy as np

        from ..master.metadata import result_columns
        from ..result.align import Side, pair, side_of

        self._label = Path(options.overlay).name
        self._delay: Shift = _delay(options.delay)
        self._source: Result | Record = open_record(options.overlay, None, None, [])
        names = given_signals(options.signals)
        self._signals = None if names is None else {column: name for name, column in names.items()}
        columns = result_columns(system)
        nothing = np.empty(0)
        run = Side(system.name, nothing, {c.name: nothing for c in columns}, {c.name: c.unit for c in columns})
        pair(side_of(self._source, self._label), run, self._signals)

    def compare(self, result: Result) -> Comparison | None:
        """Compare the run with the record. If this is not possible, prints an error and returns None."""
        from ..result.compare import compare

        try:
            return compare(
                self._source,
                result,
                self._signals,
                delay=self._delay,
                labels=(self._label, str(result.metadata["system"])),
            )
        except CosimError as error:
            print_error(str(error))
            return None


def opened(options: argparse.Namespace, system: System) -> Overlay | None:
    """The record of ``--overlay``; None without this option. Raises DescriptionError."""
    if options.overlay is not None:
        return Overlay(options, system)
    if options.signals or options.delay is not None:
        raise DescriptionError("--signals and --delay belong to --overlay FILE. Name a record, or leave them out.")
    return None


def _delay(text: str | None) -> Shift:
    if text == "estimate":
        return "estimate"
    try:
        number = float(text or 0.0)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise DescriptionError(f"--delay {text}: give a number of seconds, or 'estimate'.")
    return number
