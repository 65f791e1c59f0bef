"""Loads the instances of a system together, and frees them together."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from pathlib import Path

from ..files import temporary_folder
from ..system.system import System
from .board import Board
from .fmi3 import Fmi3Instance
from .instance import FmuInstance


@contextlib.contextmanager
def loaded(system: System, *, debug: bool, folder: Path | None = None) -> Generator[list[FmuInstance]]:
    """The instances of ``system``, loaded for the ``with`` block and freed at its end.

    FMUs are unpacked into ``folder``, or into a temporary folder. Raises DescriptionError if an FMU cannot be unpacked,
    SimulationError if it cannot be loaded.
    """
    if Board.here is not None:
        Board.here.begin(system)
    instances: list[FmuInstance] = []
    with contextlib.ExitStack() as resources:
        place = folder or resources.enter_context(temporary_folder())
        unpacked: dict[str, tuple[Path, Path]] = {}
        try:
            for instance in system.instances:
                digest = instance.fmu.digest
                if digest not in unpacked:
                    target = place / str(len(unpacked))
                    target.mkdir()
                    unpacked[digest] = target, instance.fmu.extract(target)
                kind = Fmi3Instance if instance.fmu.fmi == 3 else FmuInstance
                made = kind(len(instances), instance, *unpacked[digest], debug=debug)
                instances.append(made)
                made.load()
            yield instances
        finally:
            # After Fatal, the standard forbids further calls of all instances of that FMU.
            lost = {made.fmu.digest for made in instances if made.fatal}
            for made in instances:
                made.fatal = made.fmu.digest in lost
                made.free()
