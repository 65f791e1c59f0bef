"""Functions of equations and numberings of a Choice: Python, native and Python FMU give the same."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import WORKSPACE
from instances import DISCARD, ERROR, Instance

from cosim import model
from cosim.export.package import build, build_python
from cosim.export.python.dual import Dual
from cosim.export.source_files import load_component
from cosim.export.symbol import Symbol, casadi

EDGES = (0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 1e300, 5e-324, 0.5, -0.5, 2.0, math.pi)

ONE: dict[str, Callable[[float], float]] = {
    "tan": math.tan,
    "asin": math.asin,
    "acos": math.acos,
    "atan": math.atan,
}
TWO: dict[str, Callable[[float, float], float]] = {
    "atan2": lambda y, x: math.atan2(y, x) if y or x else 0.0,
    "hypot": math.hypot,
    "mod": lambda x, y: x % y,
}


def traced(name: str, arguments: tuple[float, ...]) -> tuple[float, list[float]]:
    """Value and derivatives of the traced function."""
    symbols = [casadi.SX.sym("x") for _ in arguments]
    found = getattr(model, name)(*map(Symbol, symbols)).expression
    function = casadi.Function("f", symbols, [found, casadi.jacobian(found, casadi.vertcat(*symbols))])
    value, slopes = function(*arguments)
    return float(value), [float(slope) for slope in casadi.densify(slopes).elements()]


def dual(name: str, arguments: tuple[float, ...]) -> Dual:
    n = len(arguments)
    seeds = [tuple(1.0 if i == k else 0.0 for i in range(n)) for k in range(n)]
    return getattr(model, name)(*(Dual(x, seed) for x, seed in zip(arguments, seeds, strict=True)))


def points(name: str, dice: random.Random) -> list[tuple[float, ...]]:
    bound = 1.0 if name in ("asin", "acos") else 30.0
    if name in ONE:
        return [(x,) for x in EDGES if abs(x) <= bound] + [(dice.uniform(-bound, bound),) for _ in range(200)]
    found = [*itertools.product(EDGES, EDGES)]
    found += [(dice.uniform(-bound, bound), dice.uniform(-bound, bound)) for _ in range(200)]
    return [(x, y) for x, y in found if name != "mod" or y != 0.0]


@pytest.mark.parametrize("name", [*ONE, *TWO])
def test_values_are_those_of_math(name: str) -> None:
    expected: Callable[..., float] = ONE.get(name) or TWO[name]
    for arguments in points(name, random.Random(name)):
        value = getattr(model, name)(*arguments)
        assert value == expected(*arguments), arguments
        assert traced(name, arguments)[0] == pytest.approx(value, rel=4e-16, abs=0.0), arguments
        assert dual(name, arguments).value == value, arguments


@pytest.mark.parametrize("name", [*ONE, *TWO])
def test_derivatives_are_those_of_differences(name: str) -> None:
    dice = random.Random(name)
    for arguments in points(name, dice):
        if not all(1e-3 < abs(x) < 0.99 * (1.0 if name in ("asin", "acos") else 30.0) for x in arguments):
            continue
        if name == "tan" and abs(math.cos(arguments[0])) < 0.05:
            continue
        if name == "mod" and min(arguments[0] % abs(arguments[1]), -arguments[0] % abs(arguments[1])) < 1e-4:
            continue  # it jumps there
        slopes = traced(name, arguments)[1]
        assert list(dual(name, arguments).slopes) == pytest.approx(slopes, rel=1e-12, abs=1e-13)
        for k, x in enumerate(arguments):
            h = 1e-6 * max(abs(x), 1e-2)
            sides = [getattr(model, name)(*arguments[:k], x + s * h, *arguments[k + 1 :]) for s in (1.0, -1.0)]
            scale = max(abs(slopes[k]), abs(sides[0]), 1.0)
            assert (sides[0] - sides[1]) / (2.0 * h) == pytest.approx(slopes[k], abs=1e-5 * scale), arguments


@pytest.mark.parametrize("name", ["atan2", "hypot"])
def test_derivatives_at_the_origin_are_finite(name: str) -> None:
    """A plant at rest has hypot(0, 0): the integrator would stop at a derivative that is not finite."""
    value, slopes = traced(name, (0.0, 0.0))
    assert value == 0.0
    assert all(map(math.isfinite, slopes))
    assert list(dual(name, (0.0, 0.0)).slopes) == slopes


def test_an_infinite_slope_spoils_only_its_branch() -> None:
    """Both branches of where are evaluated; that of the root has an infinite slope at 0."""
    functions: tuple[Any, ...] = (model.sqrt, lambda x: x**0.5, lambda x: model.asin(x + 1.0))
    for function in functions:
        found: Any = model.where(False, function(Dual(0.0, (1.0,))), Dual(3.0, (2.0,)))
        assert (found.value, found.slopes) == (3.0, (2.0,))
        assert function(Dual(0.0, (1.0,))).slopes == (math.inf,)


def test_powers() -> None:
    for x, p in itertools.product((0.0, 0.5, 2.0), (0.0, 1.0, 2.0, 3.0, 0.5)):
        symbol = casadi.SX.sym("x")
        slope = float(casadi.Function("f", [symbol], [casadi.jacobian(symbol**p, symbol)])(x))
        assert (Dual(x, (1.0,)) ** p).slopes == pytest.approx((slope,)), (x, p)


@pytest.mark.parametrize("number", [2.0, -3.0])
@pytest.mark.parametrize("name", sorted(TWO))
def test_a_number_may_be_either_argument(name: str, number: float) -> None:
    function = getattr(model, name)
    for x in (0.7, -1.9):
        symbol = casadi.SX.sym("x")
        for given, expected in (
            (lambda v: function(v, number), function(x, number)),
            (lambda v: function(number, v), function(number, x)),
        ):
            traced_value = casadi.Function("f", [symbol], [given(Symbol(symbol)).expression])(x)
            assert float(traced_value) == pytest.approx(expected, rel=1e-15)
            assert given(Dual(x, (1.0,))).value == expected


_FUNCTIONS = '''\
"""All functions of equations."""

from cosim.model import *
from cosim.model import Record, Source, parameter, variable


class Functions(Source):
    """Every function of two parameters."""

    x: float = parameter(0.0, "1", "First argument")
    y: float = parameter(1.0, "1", "Second argument")

    class Output(Record):
        one: tuple[float, ...] = variable((0.0,) * 5, "1", "Of one argument")
        two: tuple[float, ...] = variable((0.0,) * 4, "1", "Of two arguments")

    def output(self, t: float) -> Output:
        x, y = self.x, self.y
        c = clip(x, -1.0, 1.0)
        return self.Output(
            one=(tan(x), asin(c), acos(c), atan(x), tanh(x)),
            two=(atan2(x, y), hypot(x, y), mod(x, where(y == 0.0, 1.0, y)), x % where(y == 0.0, 1.0, y)),
        )
'''


def three(folder: Path, text: str, name: str) -> tuple[Any, dict[str, Path]]:
    """A component from a file of its own, and its FMUs of all flavours."""
    path = folder / f"{name.lower()}.py"
    path.write_text(text)
    kind = load_component(path)
    assert kind.__name__ == name
    return kind, {
        "native": build(kind, folder / "native", WORKSPACE.cache),
        "python": build_python(kind, folder / "python", WORKSPACE.cache),
    }


def test_functions_in_fmus(tmp_path: Path) -> None:
    kind, fmus = three(tmp_path, _FUNCTIONS, "Functions")
    pairs = [*itertools.product((0.0, -0.0, 1.0, -1.0, 1e-300, 0.5), repeat=2)]
    pairs += [(random.Random(k).uniform(-9.0, 9.0), random.Random(-k).uniform(-9.0, 9.0)) for k in range(1, 40)]
    for flavour, path in fmus.items():
        with Instance(path) as fmu:
            for x, y in pairs:
                fmu.fmu.reset()
                fmu.initialize({"x": x, "y": y})
                expected = list(kind(x=x, y=y).output(0.0))
                assert fmu.get(fmu.names("output")) == pytest.approx(expected, rel=1e-15, abs=0.0), (flavour, x, y)


_CHOICE = '''\
"""A Choice with numbers of any kind."""

from cosim.model import Choice, Record, Source, parameter, variable


class Way(Choice):
    """Ways."""

{members}


class Chooser(Source):
    """The output tells the member."""

    way: Way = parameter(Way.{start}, "1", "Which way", variability="tunable")
    fast: bool = parameter(False, "1", "Twice as much")

    class Output(Record):
        value: float = variable(0.0, "1", "Value")

    def output(self, t: float) -> Output:
        values = {{{values}}}
        return self.Output(value=values[self.way] * (2.0 if self.fast else 1.0))
'''


@pytest.mark.parametrize("numbers", [(2, 1), (1, 3), (3, 1, 2), (-5, 7), (0, -1), (10, 20, 1000), (7,), (-3, -1, -2)])
def test_any_numbering_of_a_choice(tmp_path: Path, numbers: tuple[int, ...]) -> None:
    names = [f"member_{k}" for k in range(len(numbers))]
    text = _CHOICE.format(
        members="\n".join(f'    {name} = {number}, "A way"' for name, number in zip(names, numbers, strict=True)),
        start=names[-1],
        values=", ".join(f"Way.{name}: {k + 1.0}" for k, name in enumerate(names)),
    )
    _, fmus = three(tmp_path, text, "Chooser")
    for flavour, path in fmus.items():
        with Instance(path) as fmu:
            fmu.initialize()
            assert fmu.get(["value"]) == [float(len(numbers))], flavour
            for fast, (k, number) in itertools.product((False, True), enumerate(numbers)):
                fmu.fmu.reset()
                fmu.initialize({"way": number, "fast": fast})
                assert fmu.get(["value"]) == [(k + 1.0) * (2.0 if fast else 1.0)], (flavour, number)


@pytest.mark.parametrize("flavour", ["native", "python"])
def test_a_number_without_a_member_is_refused(tmp_path: Path, flavour: str) -> None:
    members = '    one = 1, "One"\n    three = 3, "Three"'
    text = _CHOICE.format(members=members, start="three", values="Way.one: 1.0, Way.three: 3.0")
    path = three(tmp_path, text, "Chooser")[1][flavour]
    with Instance(path) as fmu:
        assert fmu.set_status("way", 2) in (0, DISCARD)
        fmu.fmu.setupExperiment()
        fmu.fmu.enterInitializationMode()
        assert fmu.status("ExitInitializationMode") == ERROR
        assert "way has a number without a member. Give one of 1 (one), 3 (three)." in fmu.messages[-1]
    with Instance(path) as fmu:
        fmu.initialize()
        assert fmu.set_status("way", 2) == DISCARD
        assert fmu.get(["value"]) == [3.0]


def test_numbers_too_far_apart_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "far.py"
    members = '    one = 1, "One"\n    far = 1000000, "Far"'
    path.write_text(_CHOICE.format(members=members, start="far", values="Way.one: 1.0, Way.far: 3.0"))
    with pytest.raises(Exception, match=r"far\.py, line \d+: Chooser: .*Number the members 1, 2, 3"):
        build(load_component(path), tmp_path, WORKSPACE.cache)


_RULES = '''\
"""Rules that only one variant has."""

from cosim.model import Record, Rule, Source, parameter, variable


class Ruled(Source):
    """Two variants with different rules, one with a text that C must quote."""

    strict: bool = parameter(False, "1", "Whether the rule holds")
    low: float = parameter(0.0, "m", "Low")
    high: float = parameter(1.0, "m", "High")

    class Output(Record):
        value: float = variable(0.0, "m", "Value")

    def output(self, t: float) -> Output:
        return self.Output(value=self.low)

    def rules(self) -> tuple[Rule, ...]:
        if self.strict:
            return (Rule(self.low < self.high, 'low \\\\ "below" high??!. Exchange them.'),)
        return ()
'''


@pytest.mark.parametrize("flavour", ["native", "python"])
def test_a_rule_of_one_variant_reaches_the_fmu(tmp_path: Path, flavour: str) -> None:
    path = three(tmp_path, _RULES, "Ruled")[1][flavour]
    for strict, status in ((False, 0), (True, ERROR)):
        with Instance(path) as fmu:
            fmu.set({"strict": strict, "low": 2.0})
            fmu.fmu.setupExperiment()
            fmu.fmu.enterInitializationMode()
            assert fmu.status("ExitInitializationMode") == status
            assert not strict or 'low \\ "below" high??!. Exchange them.' in fmu.messages[-1]
