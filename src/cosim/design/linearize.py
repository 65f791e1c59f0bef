"""Linear models of instances and sampled loops at the states that they reach in a run.

A plant's state space comes from fmi2GetDirectionalDerivative: exact partial derivatives at the operating point. A
controller has no continuous states; its sampled model is realized from its responses to small steps of its inputs,
exactly for a linear controller of low order (Ho & Kalman's realization of the impulse response). Both give the loop
transfer function of the sampled loop, opened at the command, which is held over the sampling time, and its margins.

Source: Ho & Kalman, Effective construction of linear state-variable models from input/output functions,
Regelungstechnik 14, 1966; Astrom & Wittenmark, Computer-Controlled Systems, 1997, secs. 2.3 and 3.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..extras import import_extra
from ..fmu.places import find_system, has_ending
from ..master.simulation import Checkpoint, Simulation
from ..public import public_names
from ..result.metrics import Array
from ..system.parts import Connection
from ..system.system import System, make_system, read_system
from .names import nctf_names

__dir__ = public_names(globals())

MARKOV = 60
"""Number of samples of the step response from which a controller is realized: twice the largest possible order."""
RANK = 1e-8
"""Singular values below this share of the largest count as 0: they come from rounding of the responses."""
FREQUENCIES = 4000
"""Number of frequencies at which margins are searched, over four decades up to half of the sampling frequency.

Neighbours differ by 0.23 %; crossings are interpolated between them.
"""


@dataclass(frozen=True)
class StateSpace:
    """Linear model in the units of the FMU's variables.

    der(x) = A*x + B*u, or x[k+1] = A*x[k] + B*u[k] with ``T_s``; y = C*x + D*u.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    T_s: float | None = None
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    """Unit of each state, input and output by name."""

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    @property
    def idle_inputs(self) -> tuple[str, ...]:
        """Inputs that change no state and no output at this point: they are saturated or switched off."""
        idle = ~np.any(np.vstack((self.B, self.D)) != 0.0, axis=0)
        return tuple(name for name, rests in zip(self.inputs, idle, strict=True) if rests)

    @property
    def idle_outputs(self) -> tuple[str, ...]:
        """Outputs that no state and no input changes at this point: they are rounded or switched off."""
        idle = ~np.any(np.hstack((self.C, self.D)) != 0.0, axis=1)
        return tuple(name for name, rests in zip(self.outputs, idle, strict=True) if rests)

    def held(self, T_s: float) -> StateSpace:
        """The sampled model with inputs held over ``T_s`` in s."""
        from scipy import linalg as _linalg

        linalg = cast(Any, _linalg)
        n, m = self.B.shape
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = self.A, self.B
        step: Array = linalg.expm(block * T_s)
        return replace(self, A=step[:n, :n], B=step[:n, n:], T_s=T_s)

    def reduced(self) -> StateSpace:
        """The model without states that no input moves or that move no output, directly or through other states."""

        def reached(from_: Array, through: Array) -> NDArray[np.bool_]:
            found = np.any(from_ != 0.0, axis=1)
            for _ in range(found.size):
                found = found | np.any(through[:, found] != 0.0, axis=1)
            return found

        kept = np.flatnonzero(reached(self.B, self.A) & reached(self.C.T, self.A.T))
        names = tuple(self.states[i] for i in kept) if self.states else ()
        A = self.A[np.ix_(kept, kept)]
        return replace(self, A=A, B=self.B[kept], C=self.C[:, kept], states=names)

    def response(self, omega: Array) -> NDArray[np.complex128]:
        """Frequency response at ``omega`` rad/s, shape (frequencies, outputs, inputs)."""
        s = 1j * omega if self.T_s is None else np.exp(1j * omega * self.T_s)
        resolvent = s[:, None, None] * np.eye(self.A.shape[0]) - self.A
        return np.asarray(self.C @ np.linalg.solve(resolvent, self.B.astype(np.complex128)) + self.D)

    def to_control(self) -> Any:
        """The model as a ``control.StateSpace``. Raises DescriptionError if python-control is not installed."""
        control = import_extra("control", "to_control()")
        given = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        names = {key: list(value) for key, value in given.items() if value}
        return control.ss(self.A, self.B, self.C, self.D, *([] if self.T_s is None else [self.T_s]), **names)


def linearize(
    source: str | Path | System,
    *,
    instance: str | None = None,
    at: float = 0.0,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    start: Mapping[str, object] | None = None,
    fmus: str | Path | None = None,
) -> StateSpace:
    """The state space of an instance at the time ``at`` in s of a run, or of a single FMU at its start::

        linearize("studies/maeda2008/step.toml", instance="plant", at=0.01, inputs=["command"])
        linearize("build/fmus/native/LinearMotor.fmu", start={"velocity_start": 0.01})

    ``inputs`` and ``outputs`` choose variables and their order (default: all of type Real). Raises DescriptionError for
    wrong names, CallError if the FMU does not give derivatives.
    """
    if not isinstance(source, System):
        source = find_system(str(source), None if fmus is None else Path(fmus))
    if isinstance(source, Path) and has_ending(source, ".fmu"):
        system, instance = alone(source, start or {}), "fmu"
    else:
        system = source if isinstance(source, System) else read_system(source, fmus=fmus)
        system = system.changed({f"{instance}.{name}": value for name, value in (start or {}).items()})
        if instance is None:
            raise DescriptionError(f"{system.name}: name the instance to linearize, such as plant.")
    with Simulation(system) as simulation:
        return linearized(simulation, simulation.pause(at), instance, inputs, outputs)


def linearized(
    simulation: Simulation,
    checkpoint: Checkpoint,
    instance: str,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
) -> StateSpace:
    """The state space of an instance at a checkpoint.

    Raises DescriptionError for wrong names, CallError if the FMU does not give derivatives.
    """
    fmu = checkpoint.system.instance(instance).fmu
    rates = {v.derivative_of: v.name for v in fmu.variables.values() if v.derivative_of is not None}
    reals = {name for name, v in fmu.variables.items() if v.type == "Real"}
    chosen = {
        "input": tuple(inputs if inputs is not None else (name for name in fmu.inputs if name in reals)),
        "output": tuple(outputs if outputs is not None else (name for name in fmu.outputs if name in reals)),
    }
    for causality, names in chosen.items():
        for name in names:
            if checkpoint.system.variable(instance, name).causality != causality:
                raise DescriptionError(f"{instance}.{name} is no {causality}.")
    states = tuple(rates)
    simulation.restore(checkpoint)
    knowns = (*states, *chosen["input"])
    n = len(states)
    dynamics = np.zeros((0, len(knowns)))
    if states:
        dynamics = simulation.partial_derivatives(instance, [rates[state] for state in states], knowns)
    output = simulation.partial_derivatives(instance, chosen["output"], knowns)
    units = {name: fmu.variables[name].unit or "1" for name in (*knowns, *chosen["output"])}
    return StateSpace(
        *(dynamics[:, :n], dynamics[:, n:], output[:, :n], output[:, n:]),
        *(states, chosen["input"], chosen["output"]),
        units=units,
    )


def alone(fmu: Path, start: Mapping[str, object]) -> System:
    """A system of one FMU, called ``fmu``, with nothing connected."""
    document: dict[str, Any] = {
        "instances": {"fmu": {"fmu": str(fmu.resolve()), "start": dict(start)}},
        "experiment": {"stop_time": 1.0, "step_size": 1e-3},
    }
    if (sampling := nctf_names().controller.sampling_time) in start:
        document["experiment"] = {"stop_time": start[sampling], "step_size": start[sampling]}
    return make_system(document, name=fmu.name, folder=fmu.parent)


# Sampled controllers and loops


def realize(markov: Array, T_s: float) -> StateSpace:
    """The smallest sampled model of one output with the impulse responses ``markov``, of order below half its length.

    ``markov`` has the shape (samples, inputs), or (samples,) for one input; its first row acts directly.
    """
    responses = markov.reshape(markov.shape[0], -1)
    inputs = responses.shape[1]
    sizes = np.abs(responses).max(axis=0)
    sizes[sizes == 0.0] = 1.0
    scaled = responses / sizes  # so that the rank is judged alike for inputs in m and in m/s
    half = (len(scaled) - 1) // 2
    hankel = np.array([scaled[i + 1 : i + 1 + half].ravel() for i in range(half)])
    left, values, right = np.linalg.svd(hankel)
    order = int(np.count_nonzero(values > RANK * max(float(values[0]), 1e-300)))
    root = np.sqrt(values[:order])
    observe, reach = left[:, :order] * root, root[:, None] * right[:order]
    A = np.linalg.pinv(observe[:-1]) @ observe[1:]
    return StateSpace(A, reach[:, :inputs] * sizes, observe[:1], responses[:1], T_s=T_s)


def sampled_controller(
    system: System,
    instance: str,
    *,
    at: float,
    inputs: Sequence[str] = ("position",),
    output: str = "command",
    step: float = 1e-9,
) -> StateSpace:
    """The sampled model of a controller from its measurements to one output, around its state at the time ``at`` in s.

    From this state the controller runs alone with ``step`` added to one of ``inputs`` and all other inputs held. Choose
    ``step`` small against every nonlinearity, and set resolutions to 0. Raises DescriptionError if the controller is
    not linear there, or if none of the inputs moves the output.
    """
    with Simulation(system) as simulation:
        held_inputs = _inputs(simulation, simulation.pause(at), instance)
    return _sampled(system, instance, held_inputs, inputs=inputs, output=output, step=step)


def _inputs(simulation: Simulation, checkpoint: Checkpoint, instance: str) -> dict[str, float]:
    """The values of the inputs of an instance at a checkpoint."""
    simulation.restore(checkpoint)
    return {name: simulation.value(instance, name) for name in checkpoint.system.instance(instance).fmu.inputs}


def _sampled(
    system: System, instance: str, held_inputs: Mapping[str, float], *, inputs: Sequence[str], output: str, step: float
) -> StateSpace:
    """``sampled_controller`` with the values ``held_inputs`` at all inputs of the controller."""
    T_s = float(system.step_size) * system.instance(instance).step_multiple
    single = make_system(
        {
            "instances": {instance: dict(system.document["instances"][instance])},
            "experiment": {"stop_time": 2 * MARKOV * T_s, "step_size": T_s},
            "record": {"variables": [f"{instance}.{output}"]},
        },
        folder=system.folder,
        fmus=system.fmus,
    ).changed({f"{instance}.{name}": value for name, value in held_inputs.items()})
    with Simulation(single) as simulation:
        checkpoint = simulation.pause(MARKOV * T_s / 2)

        def response(added: Mapping[str, float]) -> Array:
            values = {f"{instance}.{name}": held_inputs[name] + value for name, value in added.items()}
            record = simulation.resume(checkpoint, values)[f"{instance}.{output}"]
            return record[1:]  # after a step, the output is the value that was applied during it

        rest = response({inputs[0]: 0.0})
        markov = np.zeros((len(rest), len(inputs)))
        for i, name in enumerate(inputs):
            half, whole = response({name: 0.5 * step}), response({name: step})
            size = float(np.max(np.abs(whole - rest)))
            if float(np.max(np.abs(whole - 2.0 * half + rest))) > 1e-5 * size:
                raise DescriptionError(
                    f"{instance}: {output} is not linear in {name} for a step of {step:g}. Take a smaller or larger "
                    "step, switch resolutions off, or linearize where it does not saturate."
                )
            markov[:, i] = np.diff((whole - rest) / step, prepend=0.0)
    if not np.any(markov):
        raise DescriptionError(
            f"{instance}: {output} does not change with {', '.join(inputs)} for a step of {step:g}. It is saturated or "
            "rounded there: linearize at another time, or switch resolutions off."
        )
    found = realize(markov[: MARKOV + 1], T_s)
    _check_realization(found, markov, f"{instance}: {output}")
    return found


def _check_realization(found: StateSpace, markov: Array, name: str) -> None:
    """Raise DescriptionError if the model does not continue ``markov`` after the samples that it was made from.

    Step responses are compared, where the rounding of the differences in ``markov`` does not add up.
    """
    state, ours = found.B, [found.D[0]]
    for _ in range(len(markov) - 1):
        ours.append((found.C @ state)[0])
        state = found.A @ state
    measured = np.cumsum(markov, axis=0)
    wrong = np.abs(np.cumsum(ours, axis=0) - measured).max(axis=0) > 1e-4 * np.abs(measured).max(axis=0)
    if np.any(wrong):
        raise DescriptionError(
            f"{name} answers a small step unlike a linear controller of an order below {MARKOV // 2}. Switch "
            "resolutions and limits off, or linearize at another time."
        )


@dataclass(frozen=True)
class Margins:
    """Margins of a sampled loop; NaN or infinity where the loop transfer function has no such crossing."""

    stable: bool
    spectral_radius: float
    """Largest magnitude of the closed loop's eigenvalues."""
    gain: float
    """Gain margin: the smallest factor above 1 on the loop gain that reaches the limit of stability."""
    gain_frequency: float
    """Frequency of the gain margin, rad/s."""
    phase: float
    """Phase margin, rad."""
    crossover: float
    """Frequency at which the loop gain falls through 1, rad/s."""
    delay: float
    """Delay margin: the additional delay that reaches the limit of stability, s."""
    sensitivity: float
    """Largest magnitude of 1/(1 + L)."""


def series(first: StateSpace, second: StateSpace) -> StateSpace:
    """The series connection second*first of two sampled models: the outputs of ``first`` go into ``second``."""
    n, m = first.A.shape[0], second.A.shape[0]
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[n:, n:], A[n:, :n] = first.A, second.A, second.B @ first.C
    B = np.vstack((first.B, second.B @ first.D))
    C = np.hstack((second.D @ first.C, second.C))
    return StateSpace(A, B, C, second.D @ first.D, T_s=second.T_s)


def spectral_radius(A: Array, B: Array, C: Array) -> float:
    """Largest magnitude of the eigenvalues of ``A``, without constants of motion.

    A constant of motion is an eigenvalue of magnitude 1 that ``B`` does not excite or ``C`` does not show. For
    instance, bristle, deflection and position of a stage at rest always obey the same linear relation.
    """
    from scipy import linalg as _linalg

    linalg: Any = _linalg
    values, left, right = linalg.eig(A, left=True)
    share = np.abs(C @ right).max(axis=0) * np.abs(left.conj().T @ B).max(axis=1)
    share /= np.abs((left.conj() * right).sum(axis=0))
    hidden = (share < 1e-9 * share.max()) & (np.abs(values) < 1.0 + 1e-9)
    return float(np.max(np.abs(values[~hidden])))


def margins(loop: StateSpace) -> Margins:
    """Margins of the sampled loop L, closed with negative feedback. Raises DescriptionError for a continuous model."""
    if loop.T_s is None:
        raise DescriptionError("margins of a sampled loop need a sampled model: give one with T_s.")
    closed = loop.A - loop.B @ loop.C / (1.0 + float(loop.D[0, 0]))
    radius = spectral_radius(closed, loop.B, loop.C)
    omega = np.geomspace(1e-4, 1.0, FREQUENCIES) * math.pi / loop.T_s
    L = loop.response(omega)[:, 0, 0]
    size, angle = np.abs(L), np.unwrap(np.angle(L))
    angle -= 2.0 * math.pi * round(float(angle[0] + 0.5 * math.pi) / (2.0 * math.pi))
    down = [int(i) for i in np.flatnonzero((size[:-1] >= 1.0) & (size[1:] < 1.0))]
    phase, crossover = math.inf, math.nan
    for i in down:
        share = math.log(size[i]) / math.log(size[i] / size[i + 1])
        found = float(angle[i] + share * (angle[i + 1] - angle[i])) + math.pi
        if found < phase:
            phase, crossover = found, float(omega[i] * (omega[i + 1] / omega[i]) ** share)
    gain, at = math.inf, math.nan
    turns = (angle + math.pi) / (2.0 * math.pi)
    for i in (int(i) for i in np.flatnonzero(np.floor(turns[:-1]) != np.floor(turns[1:]))):
        level = max(math.floor(turns[i]), math.floor(turns[i + 1]))
        share = (level - turns[i]) / (turns[i + 1] - turns[i])
        factor = 1.0 / math.exp((1.0 - share) * math.log(size[i]) + share * math.log(size[i + 1]))
        if 1.0 < factor < gain:
            gain, at = factor, float(omega[i] + share * (omega[i + 1] - omega[i]))
    if size[-1] > 0.0 and abs(abs(angle[-1] / math.pi) % 2.0 - 1.0) < 1e-6 and 1.0 < 1.0 / size[-1] < gain:
        gain, at = 1.0 / float(size[-1]), float(omega[-1])
    return Margins(
        stable=radius < 1.0,
        spectral_radius=radius,
        gain=gain,
        gain_frequency=at,
        phase=phase,
        crossover=crossover,
        delay=phase / crossover if math.isfinite(phase) else math.inf,
        sensitivity=float(np.max(1.0 / np.abs(1.0 + L))),
    )


def loop_margins(
    source: str | Path | System,
    *,
    at: float,
    controller: str = "controller",
    plant: str = "plant",
    command: str = "command",
    step: float = 1e-9,
    start: Mapping[str, object] | None = None,
    fmus: str | Path | None = None,
) -> tuple[StateSpace, Margins]:
    """Loop transfer function and margins of a system's loop, around its state at the time ``at`` in s.

    The loop is opened at the command. It closes through all outputs of the plant that the controller measures, with the
    factors of the connections; each is moved by ``step`` to find the controller's model. ``start`` gives start values
    (``{"controller.sensor_resolution": 0.0}``). The command acts from the sample at which the outputs are measured,
    and is held. Raises DescriptionError if the command moves nothing (at its limit), if a measured output is rounded,
    and if a third instance is part of the loop.
    """
    system = source if isinstance(source, System) else read_system(source, fmus=fmus)
    system = system.changed(start)
    wired = [c for c in system.connections if c.source == (controller, command) and c.target == (plant, command)]
    if not wired:
        raise DescriptionError(f"{system.name}: {controller}.{command} does not feed {plant}.{command}.")
    measured = _measured(system, controller, plant, wired[0])
    outputs = sorted({c.source[1] for c in measured})
    inputs = sorted({c.target[1] for c in measured})
    with Simulation(system) as simulation:
        checkpoint = simulation.pause(at)
        model = linearized(simulation, checkpoint, plant, [command], outputs)
        held_inputs = _inputs(simulation, checkpoint, controller)
    if model.idle_inputs:
        raise DescriptionError(
            f"{plant}.{command} changes nothing at t = {at:g} s, so there is no loop and no margin. It is saturated "
            "there: linearize at another time, or raise the limit."
        )
    if model.idle_outputs:
        raise DescriptionError(
            f"{plant}.{model.idle_outputs[0]} has no derivative at t = {at:g} s: it is rounded. Set the resolution of "
            f"{plant} to 0 for the margins."
        )
    sampled = _sampled(system, controller, held_inputs, inputs=inputs, output=command, step=step)
    T_s = cast(float, sampled.T_s)
    wires = np.zeros((len(inputs), len(outputs)))
    for connection in measured:
        wires[inputs.index(connection.target[1]), outputs.index(connection.source[1])] += connection.factor
    held = model.reduced().held(T_s)
    factor = -wired[0].factor  # negative feedback: the controller sees measurements, not errors
    loop = series(
        replace(held, C=wires @ held.C, D=wires @ held.D),
        replace(sampled, C=factor * sampled.C, D=factor * sampled.D),
    )
    return loop, margins(loop)


def _measured(system: System, controller: str, plant: str, command: Connection) -> list[Connection]:
    """The connections from plant to controller.

    Raises DescriptionError if there is none, or if the loop has other parts than them and the ``command``.
    """
    pairs = {(c.source[0], c.target[0]) for c in system.connections}
    loop = {controller, plant}

    def reached(backwards: bool) -> set[str]:
        found = set(loop)
        for _ in pairs:
            found |= {(a if backwards else b) for a, b in pairs if (b if backwards else a) in found}
        return found - loop

    others = sorted(reached(backwards=False) & reached(backwards=True))
    if others:
        raise DescriptionError(
            f"{system.name}: the loop of {controller} and {plant} also goes through {', '.join(others)}, which margins "
            "do not take into account. Disconnect it for the margins, or make it part of the controller."
        )
    inner = [c for c in system.connections if c.source[0] in loop and c.target[0] in loop and c is not command]
    measured = [c for c in inner if c.source[0] == plant and c.target[0] == controller]
    beside = [str(c) for c in inner if c not in measured]
    if beside:
        raise DescriptionError(
            f"{system.name}: beside {command}, {beside[0]} is part of the loop. Margins need one command."
        )
    if not measured:
        raise DescriptionError(f"{system.name}: no output of {plant} feeds {controller}, so there is no loop.")
    return measured


def plot_bode(
    path: Path, model: StateSpace, *, input: int = 0, output: int = 0, omega: Array | None = None, title: str = ""
) -> None:
    """Draw magnitude and phase over frequency from one input to one output; ``omega`` in rad/s.

    Raises DescriptionError for an unknown ending, FileError if the file cannot be written.
    """
    from ..result.plots import save

    if omega is None:
        poles = np.abs(model.poles)
        slow = poles[(poles > 1e-3) & (poles < 1e9)]
        top = math.pi / model.T_s if model.T_s is not None else 1e2 * float(np.max(slow, initial=10.0))
        low = 1e-3 * top if model.T_s is not None else 1e-2 * float(np.min(slow, initial=10.0))
        omega = np.geomspace(low, top, 600)
    values = model.response(omega)[:, output, input]
    ends = [
        model.units.get(name, "") for name in (*model.outputs[output : output + 1], *model.inputs[input : input + 1])
    ]
    unit = f"{ends[0]}/{ends[1]}" if len(ends) == 2 and all(ends) else ""
    hertz = omega / (2.0 * math.pi)

    def draw(figure: Any) -> None:
        size, angle = figure.subplots(2, 1, sharex=True)
        size.loglog(hertz, np.abs(values))
        size.set_ylabel(f"Magnitude [{unit}]" if unit else "Magnitude")
        size.set_title(title)
        angle.semilogx(hertz, np.degrees(np.unwrap(np.angle(values))))
        angle.set_ylabel("Phase [deg]")
        angle.set_xlabel("Frequency [Hz]")

    save(path, draw, (6.4, 4.6))
