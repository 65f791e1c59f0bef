"""Runs a system: creates and frees its instances with FMPy, and holds the co-simulation algorithm.

Time is ``t_k = start_time + k*step_size`` with integer k. It is one multiplication in double, never a sum of steps.

Initialization: instances are created, start values are set, fmi2SetupExperiment is called, and initialization mode is
entered. Start values that an FMU has lost by then are set again. Then outputs are propagated along the connections, in
the order of feedthrough, until nothing changes. So a controller's output at the start is computed from the plant's
output at the start. Then initialization mode is left.

Sequential order, at each communication point t_k:

1. Each instance that is due gets its inputs from the current values, in order. An instance is due if k is a multiple of
   its step multiple n. If an output of the instance depends directly on inputs, its outputs are read at once, so that
   instances later in the order get them.
2. All recorded variables are stored as row k: values at t_k, and commands as they are applied from t_k on.
3. Each instance whose interval ends at t_k+1 steps over [t_k+1 - n*h, t_k+1] with the inputs latched at the beginning
   of the interval. Then its outputs are read. Outputs of a slower instance thus never appear early.

At the last point, inputs are set, feedthrough is evaluated and the row is stored as well.

Parallel order (Jacobi): in 1., all due instances get their inputs from the values after the last step. No outputs are
read until all instances have stepped. This delays a controller by one sample.

An FMU can ask to end the simulation (fmi2Discard with fmi2Terminated, terminateSimulation of fmi3DoStep). The run then
ends at the last communication point that this FMU has reached. The other FMUs step to the same point. This is not an
error.

After fmi2Warning, the run goes on; warnings are counted and logged. Any other status ends the run. The rows computed
so far are in the error's ``result``. All instances are freed. After Fatal, the standard forbids all further calls of
all instances of that FMU; their memory is left to the operating system. Another run of the same ``Simulation`` begins
with new instances.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError, SimulationError, suggest
from ..fmu.variables import Value, Variable
from ..result.result import Result
from ..system.system import System
from ..system.values import start_value
from .instance import CallError, FmuInstance
from .interrupts import Presses, counted
from .isolation import simulate_isolated
from .loading import loaded
from .program import Program, make_program, same_program
from .run import Progress, Run


def simulate(
    system: System,
    *,
    stop_time: float | None = None,
    step_size: float | None = None,
    order: str | list[str] | None = None,
    progress: Progress | None = None,
    debug: bool = False,
    keep_going: bool = False,
    isolated: bool = False,
    timeout: float | None = None,
) -> Result:
    """Run ``system`` once and return its result.

    ``stop_time`` and ``step_size`` (in s) and ``order`` replace entries of the system's experiment.
    ``debug``: the FMUs log everything, not only warnings and errors.
    ``keep_going``: the run goes on if a connection carries a value that is not finite or does not fit its input's type.
    ``isolated``: the FMUs run in another process. An FMU that crashes, exits or hangs then raises ProcessError.
    ``timeout``: with ``isolated``, the longest time of an FMI call in s.

    Raises DescriptionError before the run. During the run, raises CallError, SignalError or ProcessError, and
    Interrupted on Ctrl-C, SIGTERM and SIGHUP; each has a ``result`` with all complete rows.
    """
    if timeout is not None and not (isolated and timeout > 0.0):
        raise DescriptionError(f"timeout={timeout}: give a positive number of seconds, and isolated=True.")
    if stop_time is not None or step_size is not None or order is not None:
        system = system.changed(stop_time=stop_time, step_size=step_size, order=order)
    if isolated:
        return simulate_isolated(system, progress=progress, debug=debug, keep_going=keep_going, timeout=timeout)
    with Simulation(system, debug=debug, keep_going=keep_going) as simulation:
        return simulation.run(progress=progress)


class Simulation:
    """The loaded instances of a system, for one run or many::

        with Simulation(system) as simulation:
            for mass in (60.0, 70.0):
                result = simulation.run(system.changed({"plant.m": mass}))

    It is a context manager: the instances exist inside the ``with`` block.
    """

    def __init__(self, system: System, *, debug: bool = False, keep_going: bool = False) -> None:
        self.system = system
        self.debug = debug
        self.keep_going = keep_going
        self._slaves: list[FmuInstance] = []
        self._fresh = True
        self._program: tuple[System, Program] | None = None
        self._saved: list[tuple[FmuInstance, Any]] = []
        self._resources = contextlib.ExitStack()

    def __enter__(self) -> Self:
        self._slaves = self._resources.enter_context(loaded(self.system, debug=self.debug))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free all instances and delete the unpacked files. Checkpoints cannot be used any more."""
        self._free_saved(self._saved)
        self._slaves = []
        self._saved = []
        self._program = None
        self._resources.close()

    def run(self, system: System | None = None, *, progress: Progress | None = None) -> Result:
        """Run from the start. ``system`` is another variant of the system with the same instances of the same FMUs.

        Raises the same errors as ``simulate``, except ProcessError.
        """
        run = self._ready(self.system if system is None else system)
        with counted(most=1) as interrupted:
            return run.run(progress, interrupted)

    def initialize(self) -> Result:
        """Initialize all instances as a run does, without any step.

        The result has no rows, only the messages. Raises CallError.
        """
        return self._ready(self.system).run(None, Presses(), end=0)

    def pause(self, time: float, system: System | None = None) -> Checkpoint:
        """Run from the start to ``time`` in s and save the state of all instances for ``resume``.

        Needs FMUs that can save their state (fmi2GetFMUstate). Raises DescriptionError if ``time`` is not a
        communication point of the run, or if an FMU ended the simulation before. Raises CallError as ``run`` does.
        """
        system = self.system if system is None else system
        point = _point(system, time, least=0)
        run = self._ready(system)
        with counted(most=1) as interrupted:
            result = run.run(None, interrupted, end=point)
        if run.ended:
            raise DescriptionError(
                f"{system.name}: an FMU ended the simulation at {run.time():.9g} s, before {time:.9g} s."
            )
        saved: list[tuple[FmuInstance, Any]] = []
        try:
            for slave in self._slaves:
                saved.append((slave, slave.save()))
        except CallError:
            self._free_saved(saved)
            raise
        self._saved += saved
        program = run.program
        return Checkpoint(system, run.time(), result, point, saved, program.values.copy(), program.others.copy())

    def resume(
        self,
        checkpoint: Checkpoint,
        changes: Mapping[str, object] | None = None,
        *,
        stop_time: float | None = None,
        progress: Progress | None = None,
    ) -> Result:
        """Continue from a checkpoint of this simulation to ``stop_time`` in s (default: the system's stop time).

        The result has the rows from the checkpoint on. ``changes`` gives new values to tunable parameters and
        unconnected inputs (``{"plant.m": 70.0}``). Raises DescriptionError for wrong changes or times; else as ``run``.
        """
        system = checkpoint.system
        end = system.steps if stop_time is None else _point(system, stop_time)
        if end <= checkpoint.point:
            raise DescriptionError(f"stop time {stop_time} s is not after the checkpoint at {checkpoint.time:.9g} s.")
        values = _changes(system, changes or {})
        check = not self.keep_going
        run = Run(system, self._slaves, self._prepared(system), begin=checkpoint.point, end=end, check=check)
        self.restore(checkpoint)
        run.program.values[:] = checkpoint.values
        run.program.others[:] = checkpoint.others
        with counted(most=1) as interrupted:
            return run.resume(values, progress, interrupted)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Give every instance the state that it had at ``checkpoint``.

        Raises CallError, or DescriptionError if the simulation is closed.
        """
        if not self._slaves:
            raise DescriptionError("the simulation is closed. Use it in a with statement.")
        for slave, state in checkpoint.saved:
            slave.restore(state)
        self._fresh = False

    def release(self, checkpoint: Checkpoint) -> None:
        """Free the FMU states of a checkpoint before the simulation ends."""
        self._saved = [entry for entry in self._saved if entry not in checkpoint.saved]
        self._free_saved(checkpoint.saved)

    def partial_derivatives(self, instance: str, unknowns: Sequence[str], knowns: Sequence[str]) -> NDArray[np.float64]:
        """Partial derivatives of ``unknowns`` (rows) by ``knowns`` (columns) in the current state of an instance.

        The values are in the units of the variables. Needs an FMU with fmi2GetDirectionalDerivative; ``restore`` a
        checkpoint first. Raises CallError.
        """
        slave = self._slave(instance)
        variables = slave.fmu.variables
        rows = [variables[name] for name in unknowns]
        matrix = np.zeros((len(unknowns), len(knowns)))
        for column, name in enumerate(knowns):
            matrix[:, column] = slave.derivatives(rows, variables[name])
        return matrix

    def value(self, instance: str, variable: str) -> float:
        """The value of a numeric variable in the current state of its instance. Raises CallError."""
        slave = self._slave(instance)
        return slave.get(slave.fmu.variables[variable])

    def _slave(self, instance: str) -> FmuInstance:
        for slave in self._slaves:
            if slave.name == instance:
                return slave
        raise DescriptionError(f"no instance '{instance}'.{suggest(instance, (s.name for s in self._slaves))}")

    def _ready(self, system: System) -> Run:
        """A run from the start, on instances that are new or reset."""
        if not self._slaves:
            raise DescriptionError("the simulation is closed. Use it in a with statement.")
        if [(i.name, i.fmu.digest) for i in system.instances] != [(s.name, s.fmu.digest) for s in self._slaves]:
            raise DescriptionError(f"{system.name}: not the instances of {self.system.name}. Make a new Simulation.")
        if not self._fresh:
            self._renew()
        run = Run(system, self._slaves, self._prepared(system), check=not self.keep_going)
        self._fresh = False
        return run

    def _renew(self) -> None:
        """Reset all instances with fmi2Reset. If this fails, or after Fatal, create new instances.

        New instances are unpacked to another folder, so that their libraries are loaded anew. Older checkpoints can
        then not be used any more.
        """
        try:
            if any(slave.fatal for slave in self._slaves):
                raise SimulationError("an instance has ended.")
            for slave in self._slaves:
                slave.reset()
        except SimulationError:
            self.close()
            self._slaves = self._resources.enter_context(loaded(self.system, debug=self.debug))

    def _prepared(self, system: System) -> Program:
        """The program of ``system``. The program of the last run is used again if only start values or times differ."""
        if self._program is None or not same_program(self._program[0], system):
            self._program = system, make_program(system, self._slaves)
        self._program[1].reset(system)
        return self._program[1]

    @staticmethod
    def _free_saved(saved: Sequence[tuple[FmuInstance, Any]]) -> None:
        for slave, state in saved:
            with contextlib.suppress(CallError):
                slave.forget(state)


@dataclass(frozen=True)
class Checkpoint:
    """A run paused at a communication point. ``Simulation.resume`` can continue from it any number of times."""

    system: System
    time: float
    result: Result
    """The result with the rows before this point."""
    point: int
    saved: Sequence[tuple[FmuInstance, Any]]
    values: NDArray[np.float64]
    others: NDArray[np.uint64]


def _point(system: System, time: float, *, least: int = 1) -> int:
    """The number of the communication point at ``time`` in s, at least ``least``. Raises DescriptionError."""
    steps = (time - float(system.start_time)) / float(system.step_size)
    point = round(steps)
    if abs(steps - point) > 1e-6 or not least <= point <= system.steps:
        raise DescriptionError(
            f"{system.name}: {time:.9g} s is no communication point of this run from {system.start_time} s "
            f"to {system.stop_time} s. Take a whole number of steps of {system.step_size} s."
        )
    return point


def _changes(system: System, changes: Mapping[str, object]) -> list[tuple[int, Variable, Value]]:
    """The changes at a checkpoint, as instance number, variable and value. Raises DescriptionError for wrong ones."""
    problems: list[str] = []
    found: list[tuple[int, Variable, Value]] = []
    names = [instance.name for instance in system.instances]
    fed = {connection.target for connection in system.connections}
    for path, given in changes.items():
        name, _, variable_name = path.partition(".")
        variable = system.variable(name, variable_name)
        value, problem = start_value(variable, given)
        if variable.causality != "input" and variable.variability != "tunable":
            problems.append(f"{path}: a {variable.variability} {variable.causality} cannot change during a run.")
        elif (name, variable_name) in fed:
            problems.append(f"{path}: this input is connected; only unconnected ones can be changed.")
        elif problem or value is None:
            problems.append(f"{path}: {problem}")
        else:
            found.append((names.index(name), variable, value))
    if problems:
        raise DescriptionError(problems)
    return found
