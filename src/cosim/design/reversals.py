"""Runs of an axis through one reversal on a circle. They start from a saved state at the reversal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

from ..errors import DescriptionError
from ..master.failure import ProcessError
from ..master.simulation import Checkpoint
from ..result.metrics import Array, rms
from ..system.system import System, make_system
from ..system.written import connection_entries
from .names import AxisNames, axis_names
from .quantities import quotient_factor, si_factors
from .workers import Limit, Loadable, Pool, Worker, check_workers, simulation_of

LEAD_IN, LEAD_OUT = 0.6, 0.5
"""Time in s before the reversal at which a run starts, and time after it within which the error has its peak."""

Pulse = tuple[float, float]
"""Amplitude in m/s, duration in s."""
Job = tuple[float, Sequence[Pulse], float]
"""Reverse acceleration in m/s2, the pulses to try, and the time in s after the reversal that is evaluated."""


@dataclass(frozen=True)
class Axis:
    """Instances of one axis in a system, and the names of their variables."""

    trajectory: str
    pulse: str
    controller: str
    plant: str
    position: str = ""
    """The position that follows the reference, plant.VARIABLE or controller.VARIABLE; "" takes it from the names."""
    names: AxisNames = field(default_factory=axis_names)

    @classmethod
    def named(cls, suffix: str, *, position: str = "", names: AxisNames | None = None) -> Axis:
        """The axis whose instances end in ``_suffix``: trajectory_x, pulse_x ...; ``""`` for names without suffix.

        ``names`` are needed for components other than those of the study.
        """
        names = names or axis_names()
        end = f"_{suffix}" if suffix else ""
        instances = (f"{role.instance}{end}" for role in (names.trajectory, names.pulse, names.controller, names.plant))
        return cls(*instances, position=position, names=names)

    @property
    def recorded(self) -> list[str]:
        """Reference and position, INSTANCE.VARIABLE."""
        position = self.position or self.names.plant.position
        role, _, variable = position.partition(".")
        instances = {"plant": self.plant, "controller": self.controller}
        if role not in instances:
            raise DescriptionError(f"position '{position}': write plant.VARIABLE or controller.VARIABLE.")
        return [f"{self.trajectory}.{self.names.trajectory.reference}", f"{instances[role]}.{variable}"]

    @property
    def units(self) -> dict[str, str]:
        """The SI unit of each variable that the learning reads or sets, by INSTANCE.VARIABLE."""
        reference, position = self.recorded
        trajectory, pulse, plant = self.names.trajectory, self.names.pulse, self.names.plant
        return {
            reference: "m",
            position: "m",
            f"{self.trajectory}.{trajectory.radius}": "m",
            f"{self.trajectory}.{trajectory.feed}": "m/s",
            f"{self.trajectory}.{trajectory.phase}": "rad",
            f"{self.plant}.{plant.position_start}": "m",
            f"{self.plant}.{plant.velocity_start}": "m/s",
            f"{self.pulse}.{pulse.amplitude}": "m/s",
            f"{self.pulse}.{pulse.duration}": "s",
            f"{self.pulse}.{pulse.rise_time}": "s",
            f"{self.pulse}.{pulse.table_acceleration}": "m/s2",
            f"{self.pulse}.{pulse.table_amplitude}": "m/s",
            f"{self.pulse}.{pulse.table_duration}": "s",
        }

    def one_pulse(self, amplitude: float, duration: float) -> dict[str, float]:
        """Values of the source of pulses for one pulse; ``amplitude`` in m/s, ``duration`` in s."""
        names = self.names.pulse
        return {f"{self.pulse}.{names.amplitude}": amplitude, f"{self.pulse}.{names.duration}": duration}

    @property
    def begin(self) -> dict[str, object]:
        """Start values, as the names give them, for a circle at constant speed with steady friction."""
        trajectory, plant = self.names.trajectory, self.names.plant
        return {
            **{f"{self.trajectory}.{name}": value for name, value in trajectory.start.items()},
            **{f"{self.plant}.{name}": value for name, value in plant.start.items()},
        }

    def circle(self, radius: float, acceleration: float) -> dict[str, float]:
        """Start values in SI units for a run that begins ``LEAD_IN`` before a reversal, on a circle at constant speed.

        ``radius`` is in m, the reverse ``acceleration`` in m/s2.
        """
        trajectory, plant = self.names.trajectory, self.names.plant
        rate = math.sqrt(acceleration / radius)  # rad/s on the circle
        angle = math.pi - rate * LEAD_IN
        return {
            f"{self.trajectory}.{trajectory.radius}": radius,
            f"{self.trajectory}.{trajectory.feed}": rate * radius,
            f"{self.trajectory}.{trajectory.phase}": angle,
            f"{self.plant}.{plant.position_start}": radius * math.cos(angle),
            f"{self.plant}.{plant.velocity_start}": -radius * rate * math.sin(angle),
        }


def axis_system(system: System, axis: Axis) -> System:
    """The part of a system that is connected with the axis, with the plant's velocity connected to its controller."""
    document = system.document
    records = {signal.name for signal in system.signals}
    ends = [(c.source[0], c.target[0]) for c in system.connections if c.source[0] not in records]
    members = {axis.pulse}
    grown = True
    while grown:
        more = {name for pair in ends if members & set(pair) for name in pair} - members
        members |= more
        grown = bool(more)
    for name in (axis.trajectory, axis.controller, axis.plant):
        system.instance(name)
        if name not in members:
            raise DescriptionError(f"{system.name}: {name} is not connected with {axis.pulse}.")
    wires: list[Any] = list(connection_entries([c for c in system.connections if c.target[0] in members]))
    measured, velocity = axis.names.controller.velocity, axis.names.plant.velocity
    if not any(c.target == (axis.controller, measured) for c in system.connections):
        wires.append(f"{axis.plant}.{velocity} -> {axis.controller}.{measured}")
    experiment = dict(cast("Mapping[str, Any]", document["experiment"]))
    if not isinstance(system.order, str):
        experiment["order"] = [name for name in system.order if name in members]
    part = {
        "connections": wires,
        "experiment": {**experiment, "stop_time": LEAD_IN + 2.0 * LEAD_OUT},
        "instances": {name: table for name, table in document["instances"].items() if name in members},
        **({"signals": document["signals"]} if records else {}),
        "record": {"variables": axis.recorded},
    }
    return make_system(part, name=system.name, folder=system.folder, fmus=system.fmus)


@dataclass(frozen=True)
class Reversals:
    """The data that a process needs for runs through reversals."""

    system: Loadable
    axis: Axis
    radius: float
    """In m."""
    factors: Mapping[str, float]
    """Factor to SI units of each variable that has an SI unit in ``Axis.units``."""
    friction: float
    """Factor from friction divided by lead to the start of the integrator, each in its own unit."""

    @classmethod
    def of(cls, system: System, axis: Axis, radius: float) -> Reversals:
        """The data for a system. Raises DescriptionError for variables whose units do not fit."""
        plant, controller = axis.names.plant, axis.names.controller
        friction = quotient_factor(
            system,
            f"{axis.plant}.{plant.friction}",
            f"{axis.controller}.{controller.lead}",
            f"{axis.controller}.{controller.integral_start}",
        )
        return cls(Loadable.of(system), axis, radius, si_factors(system, axis.units), friction)

    def in_units(self, values: Mapping[str, float]) -> dict[str, object]:
        """Values in SI units as values in the units of their variables."""
        return {path: value / self.factors[path] for path, value in values.items()}


def reversal_errors(given: Reversals, job: Job) -> list[Array]:
    """Position errors in m after a reversal, one array for each pulse of a job. The process keeps the FMUs loaded."""
    acceleration, pulses, seconds = job
    simulation, axis = simulation_of(given.system), given.axis
    checkpoint = reversal(given, acceleration)
    step = float(simulation.system.step_size)
    # The run stops at the communication point after a whole number of samples.
    stop = checkpoint.time + max(1, round(seconds / step)) * step
    found: list[Array] = []
    reference, position = (given.factors[name] for name in axis.recorded)
    for amplitude, duration in pulses:
        values = given.in_units(axis.one_pulse(amplitude, duration))
        result = simulation.resume(checkpoint, values, stop_time=stop)
        found.append(reference * result.rows[:, 0] - position * result.rows[:, 1])
    return found


_checkpoints: dict[tuple[int, float, float], Checkpoint] = {}
"""Saved reversals of this process: (simulation, radius, acceleration) -> the state of the loop at the reversal."""


def reversal(given: Reversals, acceleration: float) -> Checkpoint:
    """The state of the loop at the reversal with this acceleration in m/s2."""
    simulation, axis = simulation_of(given.system), given.axis
    key = id(simulation), given.radius, acceleration
    if key not in _checkpoints:
        plant, controller = axis.names.plant, axis.names.controller
        start = {**axis.begin, **given.in_units(axis.circle(given.radius, acceleration))}
        system = simulation.system.changed(start)
        # The integrator of the controller starts at the friction that the plant has at the start.
        begin = simulation.pause(float(system.start_time), system)
        torque, lead = simulation.value(axis.plant, plant.friction), simulation.value(axis.controller, controller.lead)
        friction = given.friction * torque / lead
        simulation.release(begin)
        system = system.changed({f"{axis.controller}.{controller.integral_start}": friction})
        _checkpoints[key] = simulation.pause(float(system.start_time) + LEAD_IN, system)
    return _checkpoints[key]


class AxisRuns:
    """Closed-loop runs of an axis through a reversal; a context manager that keeps one worker for each thread.

    A job that takes longer than ``timeout`` seconds times the number of its runs ends the learning.
    """

    def __init__(
        self, system: System, axis: Axis, *, radius: float = 0.05, workers: int = 1, timeout: float | None = None
    ) -> None:
        check_workers(workers)
        names = axis.names.pulse
        single = {f"{axis.pulse}.{name}": value for name, value in names.single.items()}
        self.system = axis_system(system, axis).changed(single)
        self.given = Reversals.of(self.system, axis, radius)
        self.T_s = float(self.system.step_size)
        self.count = 0
        self._longest = Limit(timeout)
        self._pool = Pool(workers)

    def __enter__(self) -> AxisRuns:
        return self

    def __exit__(self, *error: object) -> None:
        self._pool.stop()

    def errors(self, jobs: Sequence[Job]) -> list[list[Array]]:
        """Position errors in m after the reversal, one array for each pulse of each job.

        Raises ProcessError if a run crashes or takes too long.
        """
        found = self._pool.map(self._errors, jobs)
        self.count += sum(len(pulses) for _, pulses, _ in jobs)
        return found

    def costs(self, jobs: Sequence[Job]) -> list[list[float]]:
        """J in m of every pulse of every job."""
        return [[rms(error) for error in errors] for errors in self.errors(jobs)]

    def _errors(self, worker: Worker, job: Job) -> list[Array]:
        """The errors of a job; its time limit is that of its runs and of one more run up to the reversal."""
        acceleration, pulses, _ = job
        count = len(pulses) + 1
        limit = Limit(self._longest.seconds * count, f"{count} runs")
        try:
            found = worker.run(self.given.system, reversal_errors, self.given, job, limit=limit)
        except ProcessError as error:
            raise error.of(f"{self.system.name} at the reversal of {acceleration:g} m/s2") from None
        self._longest.learn(worker.seconds / count)
        return found
