"""Every component: its FMU computes what its Python equations say, and is a valid, reproducible file."""

from __future__ import annotations

import itertools
import random
import zipfile
from pathlib import Path
from typing import Any

import fmpy.validation
import pytest
from conftest import ROOT, WORKSPACE
from instances import Instance

from cosim.errors import DescriptionError, TraceError
from cosim.export import package
from cosim.export.compile import host_platform
from cosim.export.interface import choice_number, scalars, variables_of
from cosim.export.trace import trace
from cosim.export.workspace import Workspace
from cosim.model import Controller, Plant, Record, Source, declarations, parameter, unflatten, variable, where

COMPONENTS = sorted(WORKSPACE.components())


def random_component(kind: Any, chosen: tuple[Any, ...], dice: random.Random) -> Any:
    """A component with its discrete choices given and its numbers within 20 % of their start values."""
    for _ in range(100):
        values: dict[str, Any] = {}
        choices = iter(chosen)
        for d in declarations(kind):
            if d.is_discrete_choice:
                values[d.attribute] = next(choices)
            elif isinstance(d.start, float) and d.name not in ("T_s", "tolerance"):
                value = d.start * dice.uniform(0.8, 1.2)
                if d.start == 0.0 and dice.random() < 0.5:  # an option that is off by default
                    value = d.nominal * dice.uniform(0.01, 0.1)
                values[d.attribute] = min(max(value, d.min), d.max)
        try:
            return kind(**values)
        except DescriptionError:
            continue
    return kind(**{d.attribute: values[d.attribute] for d in declarations(kind) if d.is_discrete_choice})


def combinations(kind: Any) -> list[tuple[Any, ...]]:
    options = [
        (False, True) if isinstance(d.start, bool) else tuple(type(d.start))
        for d in declarations(kind)
        if d.is_discrete_choice
    ]
    return list(itertools.product(*options))


def parameter_values(component: Any) -> dict[str, float]:
    found: dict[str, float] = {}
    for d in declarations(type(component)):
        value = getattr(component, d.attribute)
        values = value if isinstance(value, tuple) else (value,)
        found |= {name: choice_number(v) for name, v in zip(d.names, values, strict=True)}
    return found


def random_input(kind: Any, dice: random.Random) -> Any:
    values = [dice.gauss(0.0, 1.0) * s.declaration.nominal for s in scalars(kind.Input)]
    return kind.Input(**unflatten(kind.Input, iter(values)))


def compare(names: list[str], got: list[float], expected: list[float], relative: float = 1e-9) -> None:
    for name, one, other in zip(names, got, expected, strict=True):
        assert one == pytest.approx(other, rel=relative, abs=1e-12 * max(1.0, abs(other))), name


@pytest.mark.parametrize("name", COMPONENTS)
def test_fmu_computes_what_python_says(native: Path, name: str) -> None:
    kind = WORKSPACE.component(name)
    dice = random.Random(name)
    with Instance(native / f"{name}.fmu") as fmu:
        outputs, inputs = fmu.names("output"), fmu.names("input")
        for chosen in combinations(kind):
            component = random_component(kind, chosen, dice)
            fmu.fmu.reset()
            fmu.initialize(parameter_values(component))
            check = {Plant: check_plant, Controller: check_controller, Source: check_source}
            base = next(base for base in check if issubclass(kind, base))
            check[base](fmu, component, inputs, outputs, dice)


def check_plant(fmu: Instance, plant: Any, inputs: list[str], outputs: list[str], dice: random.Random) -> None:
    kind = type(plant)
    rows = [v for v in variables_of(kind) if v.role == "state"]
    der = [v.name for v in variables_of(kind) if v.role == "derivative"]
    declared = [s.name for s in scalars(kind.State)]
    step = kind.experiment.step_size
    for k in range(20):
        u = random_input(kind, dice)
        fmu.set(dict(zip(inputs, u, strict=True)))
        x = dict(zip([s.name for s in trace_of(kind).states], fmu.get(v.name for v in rows), strict=True))
        state = kind.State(**unflatten(kind.State, iter([x[name] for name in declared])))
        if k == 0:
            compare(declared, list(state), list(plant.initial()))
        slopes = dict(zip(declared, plant.derivative(k * step, state, u), strict=True))
        expected = [slopes[s.name] for s in trace_of(kind).states[: len(der)]]
        compare(der, fmu.get(der), expected)
        compare(outputs, fmu.get(outputs), list(plant.output(k * step, state, u)))
        fmu.step(k * step, step)


def check_controller(
    fmu: Instance, controller: Any, inputs: list[str], outputs: list[str], dice: random.Random
) -> None:
    state = controller.initial()
    for k in range(20):
        t = k * controller.T_s
        u = random_input(type(controller), dice)
        fmu.set(dict(zip(inputs, u, strict=True)))
        y = controller.output(t, state, u)
        state = controller.update(t, state, u, y)
        compare(outputs, fmu.get(outputs), list(y))
        fmu.step(t, controller.T_s)
        compare(outputs, fmu.get(outputs), list(y))


def check_source(fmu: Instance, source: Any, _: list[str], outputs: list[str], dice: random.Random) -> None:
    time = 0.0
    for _k in range(50):
        compare(outputs, fmu.get(outputs), list(source.output(time)))
        step = dice.uniform(0.0, 0.4)
        fmu.step(time, step)
        time += step


TRACES: dict[Any, Any] = {}


def trace_of(kind: Any) -> Any:
    if kind not in TRACES:
        TRACES[kind] = trace(kind)
    return TRACES[kind]


@pytest.mark.parametrize("name", COMPONENTS)
def test_fmu_is_valid_and_complete(native: Path, name: str) -> None:
    path = native / f"{name}.fmu"
    assert fmpy.validation.validate_fmu(str(path)) == []
    description = fmpy.read_model_description(path)
    for v in description.modelVariables:
        assert v.description, v.name
        assert not v.description[0].islower(), v.name
        assert not v.description.endswith("."), v.name
        assert v.type != "Real" or v.unit, v.name
    outputs = [v.name for v in description.modelVariables if v.causality == "output"]
    assert [unknown.variable.name for unknown in description.outputs] == outputs
    with zipfile.ZipFile(path) as archive:
        members = archive.namelist()
    assert members[0] == "modelDescription.xml"
    for needed in ("documentation/index.html", "documentation/licenses/license.txt", "sources/model.c"):
        assert needed in members


@pytest.mark.parametrize("name", [name for name in COMPONENTS if name not in ("Trajectory", "MillingForce")])
def test_directional_derivatives_are_those_of_python(native: Path, name: str) -> None:
    kind = WORKSPACE.component(name)
    smooth = {d.attribute: 0.0 for d in declarations(kind) if "resolution" in d.name}  # a quantiser has slope 0
    component: Any = kind(**smooth)
    dice = random.Random(name)
    with Instance(native / f"{name}.fmu") as fmu:
        fmu.initialize(parameter_values(component))
        u = random_input(kind, dice)
        inputs, outputs = fmu.names("input"), fmu.names("output")
        fmu.set(dict(zip(inputs, u, strict=True)))
        x = component.initial()
        for k, known in enumerate(inputs):
            nominal = scalars(kind.Input)[k].declaration.nominal
            change = 1e-6 * nominal
            flat = list(u)
            sides: list[list[float]] = []
            for sign in (1.0, -1.0):
                moved = [*flat[:k], flat[k] + sign * change, *flat[k + 1 :]]
                sides.append(list(component.output(0.0, x, kind.Input(**unflatten(kind.Input, iter(moved))))))
            expected = [(a - b) / (2.0 * change) for a, b in zip(*sides, strict=True)]
            got = fmu.fmu.getDirectionalDerivative([fmu.reference(o) for o in outputs], [fmu.reference(known)], [1.0])
            for output, one, other in zip(outputs, got, expected, strict=True):
                assert one == pytest.approx(other, rel=1e-4, abs=1e-6 * max(1.0, abs(other))), (output, known)


def test_same_source_gives_same_bytes(tmp_path: Path) -> None:
    kind = WORKSPACE.component("NominalStage")
    one = package.build(kind, tmp_path / "one", tmp_path / "cache one")
    other = package.build(kind, tmp_path / "two", tmp_path / "cache two")
    assert one.read_bytes() == other.read_bytes()


def test_unchanged_component_is_not_rebuilt(tmp_path: Path) -> None:
    platforms = (host_platform(),)
    workspace = Workspace(ROOT, tmp_path / "cache")
    assert workspace.stale(["NominalStage"], tmp_path, platforms) == ["NominalStage"]
    assert [error for _, _, error in workspace.build(["NominalStage"], tmp_path, platforms)] == [None]
    assert workspace.stale(["NominalStage"], tmp_path, platforms) == []
    assert workspace.stale(["NominalStage"], tmp_path, ("win64",)) == ["NominalStage"]
    (tmp_path / "NominalStage.fmu").write_bytes(b"damaged")
    assert workspace.stale(["NominalStage"], tmp_path, platforms) == ["NominalStage"]


def test_unknown_component_is_named_with_a_suggestion() -> None:
    with pytest.raises(DescriptionError, match=r"no component 'BalscrewStage'\. Did you mean 'BallscrewStage'\?"):
        WORKSPACE.select(["BalscrewStage"])


class Broken(Plant):
    """Broken on purpose."""

    mode: float = parameter(1.0, "1", "Mode")

    class State(Record):
        x: float = variable(0.0, "m", "Position")

    class Input(Record):
        u: float = variable(0.0, "V", "Command")

    class Output(Record):
        y: float = variable(0.0, "m", "Position")

    def derivative(self, t: float, x: Any, u: Any) -> Any:
        return self.State(x=u.u)

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(y=x.x)


class IfOnValue(Broken):
    """Python if on a value."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(y=x.x if x.x > 0.0 else 0.0)


class MathOnValue(Broken):
    """Math on a value."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        import math

        return self.Output(y=math.exp(x.x))


class WrongRecord(Broken):
    """Returns the wrong record."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return x


class InfiniteBranch(Broken):
    """An infinite constant."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(y=where(x.x > 0.0, float("inf"), 0.0))


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (IfOnValue, r"IfOnValue\.output: .*Write where\(condition, a, b\) for if"),
        (MathOnValue, r"MathOnValue\.output: .*or a function of math\)\. Equations use .* exp, log"),
        (WrongRecord, r"WrongRecord\.output: returns .* Return a Broken\.Output"),
        (InfiniteBranch, r"Keep every branch finite"),
    ],
)
def test_equations_that_cannot_be_traced_say_what_to_write(kind: Any, text: str) -> None:
    with pytest.raises(TraceError, match=text):
        trace(kind)


def test_fmus_hold_no_path_of_the_machine(native: Path) -> None:
    for name in COMPONENTS:
        with zipfile.ZipFile(native / f"{name}.fmu") as archive:
            for member in archive.namelist():
                assert str(ROOT).encode() not in archive.read(member), (name, member)


def test_array_is_of_reals_whatever_its_numbers(native: Path) -> None:
    """A whole number among the start values of an array makes no Integer of that element."""
    variables = fmpy.read_model_description(native / "NctfPi.fmu").modelVariables
    assert {v.type for v in variables if v.name.startswith("nct.")} == {"Real"}


def test_a_damaged_binary_in_the_cache_is_compiled_again(tmp_path: Path) -> None:
    """Any bit: at the beginning, in the middle, at the end; or cut off."""
    from cosim.export.compile import compile_binary, host_platform

    sources = {"model.c": b"int answer(void) { return 42; }\n"}
    good = compile_binary(sources, host_platform(), tmp_path)
    (kept,) = (tmp_path / "binaries").iterdir()
    whole = kept.read_bytes()
    for position in (0, 40, len(whole) // 2, len(whole) - 1):
        damaged = bytearray(whole)
        damaged[position] ^= 4
        kept.write_bytes(damaged)
        assert compile_binary(sources, host_platform(), tmp_path) == good
        assert kept.read_bytes() == whole
    kept.write_bytes(whole[:-100])
    assert compile_binary(sources, host_platform(), tmp_path) == good
