"""Linear models of instances at the states that they reach in a run.

The state space comes from fmi2GetDirectionalDerivative: exact partial derivatives at the operating point. ``margins``
makes the loop of a plant and its controller of it.

Source: Astrom & Wittenmark, Computer-Controlled Systems, 1997, sec. 2.3 (the model with held inputs).
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
from ..master.instance import CallError
from ..master.simulation import Checkpoint, Simulation
from ..public import public_names
from ..result.metrics import Array
from ..system.system import System, make_system, read_system
from .names import nctf_names

__dir__ = public_names(globals())

DEPENDENT = 1e-12
"""Singular values of normalized rows below this share of the largest count as 0: the rows come from one expression."""


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
        """The model without states that no input moves or that move no output, directly or through other states.

        Nor has it states that a linear relation ties to others, such as the bristle of a stage at rest to its angle.
        """

        def reached(from_: Array, through: Array) -> NDArray[np.bool_]:
            found = np.any(from_ != 0.0, axis=1)
            for _ in range(found.size):
                found = found | np.any(through[:, found] != 0.0, axis=1)
            return found

        kept = np.flatnonzero(reached(self.B, self.A) & reached(self.C.T, self.A.T))
        names = tuple(self.states[i] for i in kept) if self.states else ()
        less = replace(self, A=self.A[np.ix_(kept, kept)], B=self.B[kept], C=self.C[:, kept], states=names)
        return less._independent()

    def _independent(self) -> StateSpace:
        """The model without states that the others determine.

        If a combination w of the rows of (A, B) is 0, then w*x is constant, which is 0 for deviations from the point.
        """
        from scipy import linalg as _linalg

        linalg = cast(Any, _linalg)
        rows = np.hstack((self.A, self.B))
        sizes = np.linalg.norm(rows, axis=1, keepdims=True)
        if not len(rows) or not np.all(sizes):
            return self
        left, values, _ = np.linalg.svd(rows / sizes)
        rank = int(np.count_nonzero(values > DEPENDENT * values[0]))
        if rank == len(rows):
            return self
        relations: Array = left[:, rank:].T
        pivots: NDArray[np.int_] = linalg.qr(relations, mode="r", pivoting=True)[1]
        tied: list[int] = np.sort(pivots[: len(rows) - rank]).tolist()
        kept: list[int] = np.sort(pivots[len(rows) - rank :]).tolist()
        relations = relations / sizes.T
        by_others = -np.linalg.solve(relations[:, tied], relations[:, kept])
        return replace(
            self,
            A=self.A[np.ix_(kept, kept)] + self.A[np.ix_(kept, tied)] @ by_others,
            B=self.B[kept],
            C=self.C[:, kept] + self.C[:, tied] @ by_others,
            states=tuple(self.states[i] for i in kept) if self.states else (),
        )

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
    wrong names, and if the FMU does not give derivatives.
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
    try:
        if states:
            dynamics = simulation.partial_derivatives(instance, [rates[state] for state in states], knowns)
        output = simulation.partial_derivatives(instance, chosen["output"], knowns)
    except CallError as error:
        raise DescriptionError(
            f"{instance}: {fmu.name} gives no partial derivatives, which linear models need ({error}) Ask its maker "
            "for providesDirectionalDerivative, or fit a component of this library to one of its runs."
        ) from None
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
