"""Linear models of instances and sampled loops at the states that they reach in a run.

A plant's state space comes from fmi2GetDirectionalDerivative: exact partial derivatives at the operating point. A
controller has no continuous states; its sampled model is realized from its response to a small step of one input,
exactly for a linear controller of low order (Ho & Kalman's realization of the impulse response). Both give the loop
transfer function of the sampled loop, with the command held over the sampling time, and its margins.

Source: Ho & Kalman, Effective construction of linear state-variable models from input/output functions,
Regelungstechnik 14, 1966; Astrom & Wittenmark, Computer-Controlled Systems, 1997, secs. 2.3 and 3.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..extras import import_extra
from ..fmu.places import find_system, has_ending
from ..master.simulation import Checkpoint, Simulation
from ..result.metrics import Array
from ..system.system import System, make_system, read_system
from .names import nctf_names

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
    """Linear model in SI units: der(x) = A*x + B*u, or x[k+1] = A*x[k] + B*u[k] with ``T_s``; y = C*x + D*u."""

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    T_s: float | None = None

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    @property
    def idle_inputs(self) -> tuple[str, ...]:
        """Inputs that change no state and no output at this point: they are saturated or switched off."""
        idle = ~np.any(np.vstack((self.B, self.D)) != 0.0, axis=0)
        return tuple(name for name, rests in zip(self.inputs, idle, strict=True) if rests)

    def held(self, T_s: float) -> StateSpace:
        """The sampled model with inputs held over ``T_s`` in s."""
        from scipy import linalg as _linalg

        linalg = cast(Any, _linalg)
        n, m = self.B.shape
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = self.A, self.B
        step: Array = linalg.expm(block * T_s)
        return StateSpace(step[:n, :n], step[:n, n:], self.C, self.D, self.states, self.inputs, self.outputs, T_s)

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
        return StateSpace(A, self.B[kept], self.C[:, kept], self.D, names, self.inputs, self.outputs, self.T_s)

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
    """The state space of an instance at a checkpoint."""
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
    return StateSpace(
        dynamics[:, :n], dynamics[:, n:], output[:, :n], output[:, n:], states, chosen["input"], chosen["output"]
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
    """The smallest sampled model whose impulse response is ``markov`` (h[0] direct), of order below half its length."""
    half = (markov.size - 1) // 2
    hankel = np.array([markov[i + 1 : i + 1 + half] for i in range(half)])
    left, values, right = np.linalg.svd(hankel)
    order = int(np.count_nonzero(values > RANK * max(float(values[0]), 1e-300)))
    root = np.sqrt(values[:order])
    observe, reach = left[:, :order] * root, root[:, None] * right[:order]
    A = np.linalg.pinv(observe[:-1]) @ observe[1:]
    return StateSpace(A, reach[:, :1], observe[:1], np.array([[markov[0]]]), T_s=T_s)


def sampled_controller(
    system: System,
    instance: str,
    *,
    at: float,
    input: str = "position",
    output: str = "command",
    step: float = 1e-9,
) -> StateSpace:
    """The sampled model of a controller from one input to one output, around its state at the time ``at`` in s.

    From this state the controller runs alone with ``step`` added to the input and all other inputs held. Choose
    ``step`` small against every nonlinearity, and set resolutions to 0. Raises DescriptionError if the controller is
    not linear there.
    """
    with Simulation(system) as simulation:
        simulation.restore(simulation.pause(at))
        fmu = system.instance(instance).fmu
        held_inputs = {name: simulation.value(instance, name) for name in fmu.inputs}
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
        responses = [
            simulation.resume(checkpoint, {f"{instance}.{input}": held_inputs[input] + share * step})[
                f"{instance}.{output}"
            ][1 : MARKOV + 2]  # after a step, the output is the value that was applied during it
            for share in (0.0, 0.5, 1.0)
        ]
    rest, half, whole = responses
    size = float(np.max(np.abs(whole - rest)))
    if size == 0.0 or float(np.max(np.abs(whole - 2.0 * half + rest))) > 1e-5 * size:
        raise DescriptionError(
            f"{instance}: {output} is not linear in {input} for a step of {step:g}. Take a smaller or larger step, "
            "switch resolutions off, or linearize where it does not saturate."
        )
    return realize(np.diff((whole - rest) / step, prepend=0.0), T_s)


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


def series(controller: StateSpace, plant: StateSpace) -> StateSpace:
    """The series connection plant*controller of two sampled models with one input and one output each."""
    n, m = controller.A.shape[0], plant.A.shape[0]
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[n:, n:], A[n:, :n] = controller.A, plant.A, plant.B @ controller.C
    B = np.vstack((controller.B, plant.B @ controller.D))
    C = np.hstack((plant.D @ controller.C, plant.C))
    return StateSpace(A, B, C, plant.D @ controller.D, T_s=plant.T_s)


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
    """Margins of the sampled loop L, closed with negative feedback."""
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
    position: str = "position",
    step: float = 1e-9,
    start: Mapping[str, object] | None = None,
    fmus: str | Path | None = None,
) -> tuple[StateSpace, Margins]:
    """Loop transfer function and margins of the position loop of a system, around its state at the time ``at`` in s.

    ``start`` gives start values (``{"controller.sensor_resolution": 0.0}``). The command acts from the sample at which
    its position is measured, and is held; the factor of the connection is included. Raises DescriptionError if the
    command moves nothing, for example at its limit.
    """
    system = source if isinstance(source, System) else read_system(source, fmus=fmus)
    system = system.changed(start)
    wired = [c for c in system.connections if c.source == (controller, command) and c.target == (plant, command)]
    if not wired:
        raise DescriptionError(f"{system.name}: {controller}.{command} does not feed {plant}.{command}.")
    model = linearize(system, instance=plant, at=at, inputs=[command], outputs=[position])
    if model.idle_inputs:
        raise DescriptionError(
            f"{plant}.{command} changes nothing at t = {at:g} s, so there is no loop and no margin. It is saturated "
            "there: linearize at another time, or raise the limit."
        )
    sampled = sampled_controller(system, controller, at=at, input=position, output=command, step=step)
    T_s = cast(float, sampled.T_s)
    factor = -wired[0].factor  # negative feedback: the controller sees the position, not the error
    scaled = StateSpace(sampled.A, sampled.B, factor * sampled.C, factor * sampled.D, T_s=T_s)
    loop = series(scaled, model.reduced().held(T_s))
    return loop, margins(loop)


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
    hertz = omega / (2.0 * math.pi)

    def draw(figure: Any) -> None:
        size, angle = figure.subplots(2, 1, sharex=True)
        size.loglog(hertz, np.abs(values))
        size.set_ylabel("Magnitude")
        size.set_title(title)
        angle.semilogx(hertz, np.degrees(np.unwrap(np.angle(values))))
        angle.set_ylabel("Phase [deg]")
        angle.set_xlabel("Frequency [Hz]")

    save(path, draw, (6.4, 4.6))
