"""The rest of a loop: everything from the outputs of a plant back to its command, as a sampled linear model.

Controllers have no continuous states, and foreign ones do not tell their states at all. So the model is realized from
responses. The system runs once; the outputs of the plant and all other signals that come from outside are kept. Then
the rest of the loop runs alone on these signals, and again from the same state with a small pulse on one output of the
plant. From the operating point on, all that comes from outside is steady: positions move on at the speed that they
have there, all other signals hold. At the start of the run nothing moves yet: there positions hold, too.

The responses of a linear rest of low order are realized exactly (Ho & Kalman's realization of the impulse response).
The order is the lowest that explains the responses; singular values alone would count rounding as states.

Source: Ho & Kalman, Effective construction of linear state-variable models from input/output functions,
Regelungstechnik 14, 1966.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DescriptionError
from ..files import temporary_folder
from ..master.simulation import Checkpoint, Simulation, simulate
from ..record.header import is_unit
from ..result.metrics import Array
from ..system.order import feedthrough
from ..system.parts import Connection, sources
from ..system.samples import sampling_time
from ..system.system import System, make_system
from ..units import parse_unit, resolve_unit
from .linearize import StateSpace

MARKOV = 60
"""Number of samples of the response from which the rest is realized."""
LARGEST_ORDER = 12
"""A rest of the loop has a few states: integrators, filters, delays. A higher order would explain rounding."""
RESPONSE = 3 * MARKOV // 2
"""Number of samples of a response. Those beyond ``MARKOV`` check the model."""
LATER = 8
"""Samples between two pulses, which tell how the response changes along the run."""
WHEN = ("now", "later")
"""The two pulses."""
SECOND_ORDER = 0.1
"""Share of the correction for the change along the run that may be left: the correction is of first order."""
DRIFT = 0.2
"""Largest correction for the change along the run, as a share of the response."""
SETTLING = MARKOV // 2
"""Number of samples before the step at the start of a run: controllers initialize estimates at their first samples."""
PULSES = tuple(10.0**exponent for exponent in range(-12, -6))
"""Sizes of the pulse that are tried, as shares of the output or in its unit, whichever is larger.

Smaller ones drown in rounding; larger ones, such as 1 um, see more than the operating point.
"""
PULSE = "pulse_"
"""Name of the signal with the pulses, to which no instance of a system has a claim."""
LINEAR = 1e-5
"""Largest difference from a linear response, as a share of it."""
EXPLAINED = 1e-4
"""Largest error of the realized step responses, as a share of the response."""
EXACT = 1e-7
"""An error of this share is rounding: a higher order explains nothing more."""


@dataclass(frozen=True)
class RestOfLoop:
    """The rest of the loop of a plant."""

    system: System
    plant: str
    members: tuple[str, ...]
    """The instances from the outputs of the plant back to its command."""
    measured: tuple[str, ...]
    """The outputs of the plant that they get."""
    commands: tuple[Connection, ...]
    """The connections from them to the command of the plant."""
    late: frozenset[Connection]
    """Those of them that the order of evaluation makes one step late."""
    samples: int
    """Communication steps in a sample."""

    @property
    def T_s(self) -> float:
        """Sampling time in s."""
        return float(self.system.step_size) * self.samples

    def linear(self, at: float, step: float | None = None) -> StateSpace:
        """The sampled model from the measured outputs to the command, around the state at ``at`` in s.

        ``step``: as in ``loop_margins``. Raises DescriptionError if it is not linear there, or if nothing moves it.
        """
        with temporary_folder() as folder:
            alone, moment = self._alone(at, folder)
            with Simulation(alone) as simulation:
                checkpoint = simulation.pause(moment)
                responses = _Responses(self, simulation, checkpoint)
                columns: list[Array] = []
                drift = 0.0
                signal = next(signal for signal in alone.signals if signal.name == self.plant)
                for name in self.measured:
                    size = max(1.0, float(np.max(np.abs(signal.columns[name]))))
                    pulses = (step,) if step else [size * pulse for pulse in PULSES]
                    response, changed = responses.response(name, pulses, steady=moment != at)
                    columns.append(response)
                    drift = max(drift, changed)
        markov = np.column_stack(columns)
        if not np.any(markov):
            raise DescriptionError(
                f"{self.name}: {self.commands[0].source[1]} does not change with {' and '.join(self.measured)} of "
                f"{self.plant}. It is saturated or rounded there: linearize at another time, or switch resolutions off."
            )
        return realize(markov, self.T_s, self.name, drift=drift)

    @property
    def name(self) -> str:
        """The instances of the rest, for messages."""
        return ", ".join(self.members)

    def _alone(self, at: float, folder: Path) -> tuple[System, float]:
        """The rest as a system on recorded signals, and the time of its operating point in s."""
        wires = [c for c in self.system.connections if c.target[0] in self.members]
        outside = sorted({c.source for c in wires if c.source[0] not in self.members})
        begin, step = float(self.system.start_time), float(self.system.step_size)
        still = at < begin + 0.5 * step
        moment = begin + SETTLING * self.T_s if still else at
        run = self.system.changed(
            stop_time=self._point(max(at, begin + step)), record=[".".join(source) for source in outside], decimation=1
        )
        result = simulate(run)
        beyond = np.arange(1, (RESPONSE + LATER) * self.samples + 1)
        time = result.time[:1] if still else np.concatenate((result.time, at + step * beyond))
        signals: dict[str, dict[str, Any]] = {}
        columns: dict[str, list[Array]] = {}
        for source in outside:
            unit, values = self.system.variable(*source).unit or "", result[".".join(source)]
            speed = float(values[-1] - values[-2]) if _is_position(unit) else 0.0
            later: Array = values[-1] + speed * beyond
            values = values[:1] if still else np.concatenate((values, later))
            kept = columns.setdefault(source[0], [np.asarray(time, dtype=np.float64)])
            entry = signals.setdefault(source[0], {"file": f"{source[0]}.csv", "extend": "hold", "columns": {}})
            entry["columns"][source[1]] = {"column": f"c{len(kept)}"} | ({"unit": unit} if is_unit(unit) else {})
            kept.append(values)
        for name, kept in columns.items():
            header = ",".join(("t", *(f"c{number}" for number in range(1, len(kept)))))
            table = np.column_stack(kept)
            np.savetxt(folder / f"{name}.csv", table, fmt="%.17g", delimiter=",", header=header, comments="")
        starts = (begin - step, *(moment + i * self.T_s for i in (0, 1, LATER, LATER + 1)))
        pulses = "".join(f"{t!r},{now},{later}\n" for t, now, later in zip(starts, "01000", "00010", strict=True))
        (folder / f"{PULSE}.csv").write_text(f"t,now,later\n{pulses}")
        shapes = {f"{when}.{name}": {"column": when, "factor": 0.0} for name in self.measured for when in WHEN}
        signals[PULSE] = {"file": f"{PULSE}.csv", "extend": "hold", "columns": shapes}
        document = {
            "instances": {name: self.system.document["instances"][name] for name in self.members},
            "signals": signals,
            "connections": self._entries(wires),
            "experiment": {
                "start_time": self.system.start_time,
                "stop_time": self._point(moment + (RESPONSE + LATER) * self.T_s),
                "step_size": self.system.step_size,
                "order": self._order(),
            },
            "record": {"variables": sorted({".".join(c.source) for c in self.commands})},
        }
        return make_system(document, name=self.system.name, folder=folder, fmus=self.system.fmus), moment

    def _entries(self, connections: Sequence[Connection]) -> list[dict[str, Any]]:
        """Connections with their factors as numbers, without noise, and with the pulses added to measured outputs."""
        targets: dict[tuple[str, str], list[Connection]] = {}
        for connection in connections:
            targets.setdefault(connection.target, []).append(connection)
        entries: list[dict[str, Any]] = []
        for target, wires in targets.items():
            ends = [wire.source for wire in wires]
            factors = [wire.factor for wire in wires]
            for wire in wires:
                if wire.source[0] == self.plant:
                    ends += [(PULSE, f"{when}.{wire.source[1]}") for when in WHEN]
                    factors += [wire.factor] * len(WHEN)
            entry: dict[str, Any] = {"to": ".".join(target), "offset": sum(wire.offset for wire in wires)}
            names = [".".join(end) for end in ends]
            entry |= {"from": names, "factors": factors} if len(ends) > 1 else {"from": names[0], "factor": factors[0]}
            entries.append(entry | {"units": "suppress"})
        return entries

    def _point(self, time: float) -> Decimal:
        """The communication point nearest to ``time``."""
        system = self.system
        return system.start_time + system.step_size * round((time - float(system.start_time)) / float(system.step_size))

    def _order(self) -> str | list[str]:
        order = self.system.order
        return order if isinstance(order, str) else [name for name in order if name in self.members]

    def command(self, simulation: Simulation, checkpoint: Checkpoint, output: str = "", pulse: float = 0.0) -> Array:
        """The command of the plant in the samples from a checkpoint on, with a ``pulse`` on an output of the plant."""
        changes = {f"{PULSE}.columns.{output}.factor": pulse} if output else {}
        changed = replace(checkpoint, system=checkpoint.system.changed(changes))
        result = simulation.resume(changed)
        command = np.zeros(len(result.time))
        for wire in self.commands:
            values = wire.factor * result[".".join(wire.source)]
            if wire in self.late:
                values = np.concatenate(([0.0], values[:-1]))  # the pulse does not reach the first one
            command += values
        return command[:: self.samples]


def rest_of_loop(system: System, plant: str, command: str, controller: str) -> RestOfLoop:
    """The rest of the loop of ``plant``, opened at its input ``command``.

    Raises DescriptionError if there is no such loop, if ``controller`` is no part of it, or if it acts on the plant in
    another way, too.
    """
    pairs = {(c.source[0], c.target[0]) for c in system.connections}

    def reached(backwards: bool) -> set[str]:
        found: set[str] = set()
        for _ in pairs:
            found |= {(a if backwards else b) for a, b in pairs if (b if backwards else a) in (*found, plant)}
        return found - {plant}

    inside = reached(backwards=False) & reached(backwards=True)
    system.instance(controller)
    if controller not in inside:
        raise DescriptionError(
            f"{system.name}: {controller} is no part of a loop with {plant}: no way leads from the outputs of {plant} "
            "through it and back."
        )
    acting = [c for c in system.connections if c.target[0] == plant and c.source[0] in (*inside, plant)]
    commands = tuple(c for c in acting if c.target[1] == command)
    if not commands:
        raise DescriptionError(f"{system.name}: no instance of the loop feeds {plant}.{command}.")
    if beside := [c for c in acting if c not in commands]:
        raise DescriptionError(
            f"{system.name}: beside {plant}.{command}, {beside[0]} is part of the loop. Margins need one command."
        )
    measured = sorted({c.source[1] for c in system.connections if c.source[0] == plant and c.target[0] in inside})
    members = tuple(instance.name for instance in system.instances if instance.name in inside)
    direct = feedthrough({i.name: i for i in system.instances}, sources(system.connections))
    order = system.order
    late = frozenset(
        wire
        for wire in commands
        if isinstance(order, tuple) and wire.source in direct and order.index(wire.source[0]) > order.index(plant)
    )
    samples = _samples(system, members)
    if samples > 1 and (late or system.parallel):
        raise DescriptionError(
            f"{system.name}: a sample of {members[0]} takes {samples} communication steps, and the command is one step "
            "late. Margins need a step_size of one sample there."
        )
    return RestOfLoop(system, plant, members, tuple(measured), commands, late, samples)


def _samples(system: System, members: Sequence[str]) -> int:
    """Communication steps in a sample of the instances ``members``. Raises DescriptionError if they differ."""
    found: dict[str, int] = {}
    for name in members:
        instance = system.instance(name)
        ratio = Fraction(sampling_time(instance) or system.step_size) / Fraction(system.step_size)
        found[name] = max(int(ratio), 1, instance.step_multiple)
    if len(set(found.values())) > 1:
        times = ", ".join(f"{name} every {float(system.step_size) * n:g} s" for name, n in found.items())
        raise DescriptionError(f"{system.name}: margins need one sampling time in the loop: {times}.")
    return next(iter(found.values()))


def _is_position(unit: str) -> bool:
    """Whether a signal of this unit moves on while the speed is constant: a length or an angle."""
    meaning = resolve_unit(unit) if unit else None
    return meaning is not None and any(meaning.conversion(parse_unit(each)) for each in ("m", "rad"))


@dataclass(frozen=True)
class _Responses:
    """Responses of the rest of a loop from its operating point."""

    rest: RestOfLoop
    simulation: Simulation
    checkpoint: Checkpoint

    def response(self, output: str, pulses: Sequence[float], *, steady: bool) -> tuple[Array, float]:
        """The response to a pulse of 1 on ``output`` of the plant, of the rest as it is at the operating point.

        Also the share of it that corrects the change along the run.

        If it is not ``steady``, the rest changes along the run. A response after i samples belongs to the middle of
        this time; a later pulse tells how it changes, and so the response of which the middle is the operating point.
        """
        now, pulse = self._most_linear(output, pulses)
        if steady or not pulse:
            return now[:RESPONSE], 0.0
        up, down = (self._of(f"later.{output}", sign * pulse) for sign in (1.0, -1.0))
        later = ((up - down) / (2.0 * pulse))[LATER : LATER + RESPONSE]
        change = (later - now[:RESPONSE]) * np.arange(RESPONSE) / (2.0 * LATER)
        drift = float(np.max(np.abs(change))) / float(np.max(np.abs(now)))
        if drift > DRIFT:
            raise DescriptionError(
                f"{self.rest.name}: the response of {self.rest.commands[0].source[1]} to {output} of {self.rest.plant} "
                f"changes within {RESPONSE} samples of the run by more than {100.0 * DRIFT:.0f} %, so there is no "
                "linear model there. Linearize at another time, or on a slower motion."
            )
        return now[:RESPONSE] - change, drift

    def _most_linear(self, output: str, pulses: Sequence[float]) -> tuple[Array, float]:
        """The response to a pulse of 1, from the pulse at which it is most linear, and this pulse; 0 if none acts.

        A linear response to a pulse is the opposite of that to the opposite pulse, and twice that to half of it.
        """
        rest = self._of()
        best, least, chosen = np.zeros_like(rest), np.inf, 0.0
        for pulse in pulses:
            up, down, half = (self._of(f"now.{output}", share * pulse) - rest for share in (1.0, -1.0, 0.5))
            size = float(np.max(np.abs(up)))
            if size == 0.0:
                continue
            wrong = max(float(np.max(np.abs(up + down))), float(np.max(np.abs(up - 2.0 * half)))) / size
            if wrong < least:
                best, least, chosen = (up - down) / (2.0 * pulse), wrong, pulse
        if chosen and least > LINEAR:
            raise DescriptionError(
                f"{self.rest.name}: {self.rest.commands[0].source[1]} is not linear in {output} of {self.rest.plant}: "
                f"{100.0 * least:.2g} % of the response to a small change of it is no part of a linear response. "
                "Linearize at another time, or switch resolutions and switching functions off."
            )
        return best, chosen

    def _of(self, column: str = "", pulse: float = 0.0) -> Array:
        return self.rest.command(self.simulation, self.checkpoint, column, pulse)


def realize(markov: Array, T_s: float, name: str = "the response", *, drift: float = 0.0) -> StateSpace:
    """The smallest sampled model of one output with the impulse responses ``markov``.

    Its order is at most ``LARGEST_ORDER``.

    ``markov`` has the shape (samples, inputs), or (samples,) for one input; its first row acts directly. The model is
    made from its first ``MARKOV`` rows, and must explain the step responses of all rows. ``drift`` is the share of
    them that corrected a change along the run; what it left must not be explained. Raises DescriptionError, which
    begins with ``name``, if no model does.
    """
    responses = markov.reshape(markov.shape[0], -1)
    inputs = responses.shape[1]
    sizes = np.abs(responses).max(axis=0)
    sizes[sizes == 0.0] = 1.0
    scaled = responses / sizes  # so that the rank is judged alike for inputs in m and in m/s
    half = (min(len(scaled), MARKOV + 1) - 1) // 2
    hankel = np.array([scaled[i + 1 : i + 1 + half].ravel() for i in range(half)])
    left, values, right = np.linalg.svd(hankel)
    best, least = None, np.inf
    for order in range(min(int(np.count_nonzero(values)), LARGEST_ORDER) + 1):
        root = np.sqrt(values[:order])
        observe, reach = left[:, :order] * root, root[:, None] * right[:order]
        A = np.linalg.pinv(observe[:-1]) @ observe[1:]
        model = StateSpace(A, reach[:, :inputs] * sizes, observe[:1], responses[:1], T_s=T_s)
        wrong = _unexplained(model, responses)
        if wrong < 0.1 * least:  # ten times better: more than chance
            best, least = model, wrong
        if least < max(EXACT, min(drift, EXPLAINED)):
            break
    if best is None or least > max(EXPLAINED, SECOND_ORDER * drift):
        raise DescriptionError(
            f"{name}: the answer to a small step is unlike that of a linear controller of an order up to "
            f"{LARGEST_ORDER}. Switch resolutions and limits off, or linearize at another time."
        )
    return best


def _unexplained(model: StateSpace, markov: Array) -> float:
    """The largest error of the model's step responses, as a share of each.

    Step responses are compared, where the rounding of the differences in ``markov`` does not add up.
    """
    state, ours = model.B, [model.D[0]]
    for _ in range(len(markov) - 1):
        ours.append((model.C @ state)[0])
        state = model.A @ state
    measured = np.cumsum(markov, axis=0)
    size = np.abs(measured).max(axis=0)
    size[size == 0.0] = 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        wrong = np.abs(np.cumsum(ours, axis=0) - measured).max(axis=0) / size
    return float(np.max(np.nan_to_num(wrong, nan=np.inf)))
