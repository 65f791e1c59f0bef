"""Declarations and equations that are refused when FMUs are built: file, line, rule, remedy."""

from __future__ import annotations

import contextlib
import random
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import WORKSPACE

from cosim.errors import CosimError, DescriptionError, TraceError
from cosim.export.trace import trace
from cosim.model import (
    FUNCTIONS,
    Choice,
    Component,
    Controller,
    Experiment,
    Plant,
    Record,
    Rule,
    Source,
    parameter,
    variable,
    where,
)


class Filter(Controller):
    """Two states and an output, nothing wrong."""

    gain: float = parameter(2.0, "m/V", "Gain", min=0.0)
    active: bool = parameter(True, "1", "Whether it works")

    class State(Record):
        first: float = variable(0.0, "m", "First state")
        second: float = variable(0.0, "m", "Second state")
        line: tuple[float, ...] = variable((0.0, 0.0, 0.0), "m", "Delay line")

    class Input(Record):
        command: float = variable(0.0, "V", "Command")

    class Output(Record):
        position: float = variable(0.0, "m", "Position")

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.second)

    def update(self, t: float, x: Any, u: Any, y: Any) -> Any:
        return self.State(first=self.gain * u.command, second=x.first, line=(x.second, *x.line[:2]))


class Mass(Plant):
    """A plant with a discrete state, nothing wrong."""

    m: float = parameter(1.0, "kg", "Mass", min=1e-3)

    class State(Record):
        position: float = variable(0.0, "m", "Position")
        velocity: float = variable(0.0, "m/s", "Velocity")
        stops: float = variable(0.0, "1", "Stops", discrete=True)

    class Input(Record):
        force: float = variable(0.0, "N", "Force")

    class Output(Record):
        position: float = variable(0.0, "m", "Position")

    def derivative(self, t: float, x: Any, u: Any) -> Any:
        return self.State(position=x.velocity, velocity=u.force / self.m)

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.position)

    def update(self, t: float, x: Any, u: Any) -> Any:
        return self.State(stops=where(x.velocity == 0.0, 1.0, 0.0))


@pytest.mark.parametrize("kind", [Filter, Mass])
def test_members_that_are_not_used_may_be_left_out(kind: type[Component]) -> None:
    """A plant's derivative needs no discrete states and its update no continuous ones."""
    assert trace(kind).kind is kind


def refused(kind: type[Component]) -> str:
    """The text of the refusal; file and line are in it."""
    with pytest.raises(CosimError) as caught:
        trace(kind)
    assert "test_declarations.py, line " in str(caught.value)
    return str(caught.value)


# ---- declaration lines ----


def declared(**fields: Any) -> type[Component]:
    """A filter with more parameters; annotations are those of the start values unless given as (type, field)."""
    names: dict[str, Any] = {"__annotations__": {}, "__module__": __name__, "__doc__": "More parameters."}
    for name, value in fields.items():
        annotation, field = value if isinstance(value, tuple) else (type(value.default).__name__, value)
        names["__annotations__"][name] = annotation
        names[name] = field
    return type("More", (Filter,), names)


@pytest.mark.parametrize(
    ("field", "text"),
    [
        (parameter(1.0, "m", "Length", min=2.0), r"start length = 1 m: below its minimum 2 m"),
        (parameter(1.0, "m", "Length", max=0.5), r"start length = 1 m: above its maximum 0\.5 m"),
        (parameter((0.0, 3.0), "m", "Lengths", max=1.0), r"start length\[2\] = 3 m: above its maximum 1 m"),
        (parameter(1.0, "m", "Length", min=3.0, max=2.0), r"min 3 m is above max 2 m"),
        (parameter(float("nan"), "m", "Length"), r"start length = nan m: must be finite"),
        (parameter(float("inf"), "m", "Length"), r"must be finite"),
        (parameter(1.0, "m", "Length", min=float("nan")), r"min nan is no number"),
        (parameter(1.0, "m", "Length", nominal=0.0), r"nominal 0 m\. Give a positive number"),
        (parameter(1.0, "metre", "Length"), r"unit 'metre': unknown symbol 'metre'"),
        (parameter(1.0, "m", "Length", display_unit="s"), r"unit 'm' cannot be converted to 's'"),
        (parameter(1.0, "m", ""), r"no description\. Say what it means"),
        (parameter(1.0, "m", " "), r"no description\. Say what it means"),
        (parameter(1.0, None, "Length"), r"unit None is no text"),  # type: ignore[arg-type]
        (parameter("1.0", "m", "Length"), r"start '1\.0' is a str\. Give a float"),
        (parameter(None, "m", "Length"), r"start None is a NoneType"),
        (parameter((), "m", "Lengths"), r"an array of 0 elements"),
        (parameter((1.0, "2"), "m", "Lengths"), r"is not of numbers only"),
        (parameter((1.0, True), "m", "Lengths"), r"is not of numbers only"),
        (("float", parameter(1, "m", "Length")), r"start 1 is of type int, its annotation says float: write 1\.0"),
        (("int", parameter(1.5, "1", "Count")), r"start 1\.5 is of type float, its annotation says int"),
        (parameter(2**31, "1", "Count"), r"does not fit into an Integer of 32 bits"),
        (parameter(1.0, "m", "Length", variability="free"), r"variability 'free': give fixed or tunable"),  # type: ignore[arg-type]
        (("float", 3.0), r"has no declaration\. Write it with parameter"),
    ],
)
def test_wrong_declaration_is_refused(field: Any, text: str) -> None:
    with pytest.raises(DescriptionError, match=r"More\.length: .*" + text if "declaration" not in text else text):
        trace(declared(length=field))


def test_every_problem_is_told_at_once() -> None:
    with pytest.raises(DescriptionError) as caught:
        trace(declared(a=parameter(1.0, "m", "Length", min=2.0), b=parameter(1.0, "metre", "Length")))
    assert len(caught.value.problems) == 2


class BadState(Filter):
    """The start of a state is out of its bounds."""

    class State(Filter.State):
        first: float = variable(0.0, "m", "First state", min=1.0)


class WholeState(Mass):
    """An integrated state is a whole number."""

    class State(Mass.State):
        position: int = variable(0, "m", "Position")  # type: ignore[assignment]


class DiscreteInput(Filter):
    """An input is marked discrete."""

    class Input(Record):
        command: float = variable(0.0, "V", "Command", discrete=True)


class Colour(Choice):
    """Two members, the larger number first."""

    red = 2, "Red"
    blue = 1, "Blue"


class ChoiceInput(Filter):
    """An input is a Choice."""

    class Input(Record):
        command: Colour = variable(Colour.red, "1", "Command")


class NameClash(Filter):
    """An input and an output of one name."""

    class Input(Record):
        position: float = variable(0.0, "m", "Position")


class ElementClash(Filter):
    """An element of an array and a parameter of one name."""

    first: tuple[float, ...] = parameter((1.0, 2.0), "m", "Table", name="table")
    other: float = parameter(1.0, "m", "Other", name="table[1]")


class TimeClash(Filter):
    """FMI 3.0 has a variable time."""

    delay: float = parameter(1.0, "s", "Time", name="time")


class BadName(Filter):
    """A name that FMI's structured names do not allow."""

    delay: float = parameter(1.0, "s", "Time", name="dead time")


class Größe(Filter):  # noqa: PLC2401
    """A name that is no C identifier."""


class StateOfSource(Source):
    """A source has no states."""

    class State(Record):
        x: float = variable(0.0, "m", "Position")

    class Output(Record):
        y: float = variable(0.0, "m", "Position")

    def output(self, t: float) -> Any:
        return self.Output(y=t)


class DerivativeOfController(Filter):
    """A controller has no derivative."""

    def derivative(self, t: float, x: Any, u: Any) -> Any:
        return x


class NoDerivative(Plant):
    """A state and no derivative."""

    class State(Record):
        x: float = variable(0.0, "m", "Position")

    class Output(Record):
        y: float = variable(0.0, "m", "Position")

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(y=x.x)


class NoUpdate(Controller):
    """A state that would stay as it is."""

    class State(Record):
        x: float = variable(0.0, "m", "Position")

    class Output(Record):
        y: float = variable(0.0, "m", "Position")

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(y=x.x)


class NoRecord(Filter):
    """State is a plain class."""

    class Output:  # type: ignore[assignment]
        position = 0.0


class NoTime(Filter):
    """Times of the default experiment that cannot be."""

    experiment = Experiment(stop_time=0.0, step_size=1e-3)


class OwnInit(Filter):
    """FMUs make no new component for new parameters."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "gain", 3.0)


class BrokenRule(Filter):
    """The start values break a rule."""

    def rules(self) -> tuple[Rule, ...]:
        return (Rule(self.gain > 2.0, "The gain is too small. Give more than 2."),)


class NoKind(Component):
    """None of plant, controller and source."""


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (BadState, r"BadState\.State\.first: start first = 0 m: below its minimum 1 m"),
        (WholeState, r"WholeState\.State\.position: start 0 is no float, and the state is integrated"),
        (DiscreteInput, r"discrete=True is for states of a Plant only"),
        (ChoiceInput, r"a Choice can only be a parameter"),
        (NameClash, r"2 variables have the name 'position'"),
        (ElementClash, r"'table\[1\]'"),
        (TimeClash, r"2 variables have the name 'time'"),
        (BadName, r"the name 'dead time' is not of letters"),
        (Größe, r"no C identifier"),
        (StateOfSource, r"is a Source, which has no State"),
        (DerivativeOfController, r"has derivative, which is never called"),
        (NoDerivative, r"has no derivative\. Write def derivative\(self, t, x, u\)"),
        (NoUpdate, r"has no update\. Write def update\(self, t, x, u, y\)"),
        (NoRecord, r"NoRecord\.Output is no Record\. Write class Output\(Record\)"),
        (NoTime, r"experiment has times 0 s and 0\.001 s"),
        (OwnInit, r"has __post_init__, which FMUs do not call"),
        (BrokenRule, r"with its start values, BrokenRule: The gain is too small"),
        (NoKind, r"none of Plant, Controller and Source"),
    ],
)
def test_wrong_structure_is_refused(kind: type[Component], text: str) -> None:
    with pytest.raises(DescriptionError, match=text):
        trace(kind)
    refused(kind)


@pytest.mark.parametrize(
    ("members", "text"),
    [
        ({"one": (1, "One"), "two": (1, "Two")}, r"two has the number 1 of one"),
        ({"one": (1, "One"), "two": (1, "One")}, r"two has the number 1 of one"),
        ({"one": (1.5, "One")}, r"1\.5 is no whole number"),
        ({"one": (True, "One")}, r"True is no whole number"),
        ({"one": (2**31, "One")}, r"no whole number of 32 bits"),
        ({"one": (1, "")}, r"one has no description"),
        ({"one": 1}, r"one has no description\. Write one = 1"),
    ],
)
def test_choice_is_refused_where_it_is_declared(members: dict[str, Any], text: str) -> None:
    with pytest.raises(DescriptionError, match=text):
        Choice("Wrong", members)


# ---- what equations return ----


class MissingInUpdate(Filter):
    """A member is left out of the next state."""

    def update(self, t: float, x: Any, u: Any, y: Any) -> Any:
        return self.State(first=x.second, line=x.line)


class MissingInOutput(Filter):
    """No member is given."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output()


class MissingInDerivative(Mass):
    """A member is left out of the derivative."""

    def derivative(self, t: float, x: Any, u: Any) -> Any:
        return self.State(position=x.velocity)


class MissingInPlantUpdate(Mass):
    """The discrete state is left out."""

    def update(self, t: float, x: Any, u: Any) -> Any:
        return self.State(position=x.position, velocity=x.velocity)


class ReplacedMember(Filter):
    """dataclasses.replace gives every member."""

    def update(self, t: float, x: Any, u: Any, y: Any) -> Any:
        return replace(x, first=u.command)


class UnknownMember(Filter):
    """A misspelt member."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.secnd)


class OtherRecord(Filter):
    """The state in place of the output."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return x


class NoReturn(Filter):
    """A return is forgotten."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        self.Output(position=x.first)


class ShortArray(Filter):
    """Two elements where three are declared."""

    def update(self, t: float, x: Any, u: Any, y: Any) -> Any:
        return self.State(first=x.first, second=x.second, line=(x.first, x.second))


class ScalarForArray(Filter):
    """A number where an array is declared."""

    def update(self, t: float, x: Any, u: Any, y: Any) -> Any:
        return self.State(first=x.first, second=x.second, line=x.first)


class ArrayForScalar(Filter):
    """An array where a number is declared."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.line)


class TextForNumber(Filter):
    """A text where a number is declared."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position="x")


class BareRules(Filter):
    """A condition without Rule."""

    def rules(self) -> Any:
        return (self.gain > 1.0,)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (MissingInUpdate, r"update: the State is given no second\. Give every member; .* second=x\.second"),
        (MissingInOutput, r"output: the Output is given no position"),
        (MissingInDerivative, r"derivative: the State is given no velocity"),
        (MissingInPlantUpdate, r"update: the State is given no stops"),
        (UnknownMember, r"no attribute 'secnd'.* Did you mean 'second'\?"),
        (OtherRecord, r"Return a Filter\.Output: self\.Output\(position=\.\.\.\)"),
        (NoReturn, r"returns None\. Return a Filter\.Output"),
        (ShortArray, r"State\.line is 2 elements\. Give a tuple of 3 numbers"),
        (ScalarForArray, r"Give a tuple of 3 numbers"),
        (ArrayForScalar, r"Output\.position is 3 elements\. Give a number"),
        (TextForNumber, r"'x' where a number is needed"),
        (BareRules, r"Return a tuple of Rule\(condition, text\)"),
    ],
)
def test_wrong_result_is_refused(kind: type[Component], text: str) -> None:
    with pytest.raises(TraceError, match=text):
        trace(kind)
    refused(kind)


def test_replace_gives_every_member() -> None:
    assert trace(ReplacedMember).kind is ReplacedMember


def test_the_line_is_the_one_that_makes_the_record() -> None:
    first = MissingInUpdate.update.__code__.co_firstlineno
    assert f"test_declarations.py, line {first + 1}: MissingInUpdate.update" in refused(MissingInUpdate)


# ---- impure equations ----

CALLS: list[float] = []


class RandomOutput(Filter):
    """A random number."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.first + random.random())


class ClockOutput(Filter):
    """A clock, two calls away."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.first + clock())


def clock() -> float:
    """The time of day."""
    return time.time()


class LocalImport(Filter):
    """A random number by an import within the method."""

    def update(self, t: float, x: Any, u: Any, y: Any) -> Any:
        from random import gauss

        return replace(x, first=gauss(0.0, 1.0))


class PrintingOutput(Filter):
    """It prints."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        print(t)  # noqa: T201
        return self.Output(position=x.first)


class CountingOutput(Filter):
    """It counts its calls."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        CALLS.append(1.0)
        return self.Output(position=x.first + sum(CALLS))


class CountingRules(Filter):
    """Another condition at each call."""

    def rules(self) -> tuple[Rule, ...]:
        CALLS.append(1.0)
        return (Rule(self.gain < sum(CALLS), "The gain is small."),)


class StatefulComponent(Filter):
    """It changes itself."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        self.gain = 1.0  # type: ignore[misc]
        return self.Output(position=x.first)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (RandomOutput, r"RandomOutput\.output uses random\. An equation may depend on its arguments only"),
        (ClockOutput, r"ClockOutput\.output uses time"),
        (LocalImport, r"LocalImport\.update uses random"),
        (PrintingOutput, r"PrintingOutput\.output uses print"),
        (CountingOutput, r"CountingOutput\.output gives another result when it is called again"),
        (CountingRules, r"CountingRules\.rules gives another result"),
        (StatefulComponent, r"StatefulComponent\.output: FrozenInstanceError.*Nothing is changed in place"),
    ],
)
def test_impure_equations_are_refused(kind: type[Component], text: str) -> None:
    assert text  # each has its own message
    with pytest.raises(CosimError, match=text):
        trace(kind)
    refused(kind)


class CatchesErrors(Filter):
    """Numbers of which one divides by zero; compiled code gives infinity there."""

    def update(self, t: float, x: Any, u: Any, y: Any) -> Any:
        try:
            first = 1.0 / u.command
        except ZeroDivisionError:
            first = 0.0
        return replace(x, first=first)


class SuppressesErrors(Filter):
    """The same with a context manager."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        with contextlib.suppress(ZeroDivisionError):
            return self.Output(position=1.0 / x.first)


GAINS = np.array([2.0, 3.0])


class ArrayProduct(Filter):
    """A sum of products that NumPy may round once, C twice."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=GAINS @ (x.first, x.second))


class ArrayMethod(Filter):
    """The same as a method of a constant."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=GAINS.dot((x.first, x.second)))


def _limited(value: Any) -> Any:
    return np.clip(value, -1.0, 1.0)


class ArrayFunction(Filter):
    """A function of NumPy, behind one of the author."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=_limited(x.first))


class ArrayConstants(Filter):
    """Constants of NumPy are numbers like others."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=np.pi * GAINS[1] * x.first)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (CatchesErrors, r"line \d+: CatchesErrors\.update uses try or with\. Compiled code raises no exceptions"),
        (SuppressesErrors, r"SuppressesErrors\.output uses try or with"),
        (ArrayProduct, r"ArrayProduct\.output uses @\. Sums and functions of NumPy round unlike compiled ones"),
        (ArrayMethod, r"ArrayMethod\.output uses numpy\."),
        (ArrayFunction, r"line \d+: ArrayFunction\.output uses numpy\."),
    ],
)
def test_what_compiled_code_does_in_another_way_is_refused(kind: type[Component], text: str) -> None:
    with pytest.raises(CosimError, match=text):
        trace(kind)


def test_constants_of_arrays_are_numbers() -> None:
    assert trace(ArrayConstants).outputs


class HashOutput(Filter):
    """A number that differs in each process."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.first + hash("position") % 7)


def test_numbers_of_a_process_are_refused() -> None:
    assert "HashOutput.output uses hash." in refused(HashOutput)


# ---- equations that treat numbers in another way ----


class AsksForFloats(Filter):
    """Numbers pass, symbols do not."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.second if isinstance(x.second, float) else 0.0)


class AsksForIdentity(Filter):
    """Two equal numbers may be one object; two symbols are not."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.first if type(self.gain) is float else x.second)


@pytest.mark.parametrize("kind", [AsksForFloats, AsksForIdentity])
def test_equations_that_differ_for_numbers_are_refused(kind: type[Component]) -> None:
    said = rf"{kind.__name__}\.output: gives \S+ for numbers, where its equations give \S+\. Take out what treats"
    with pytest.raises(TraceError, match=said):
        trace(kind)


class FailsForNumbers(Filter):
    """It divides by zero at some numbers: that decides nothing."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.first / where(x.second > 0.0, x.second, 0.0))


def test_numbers_at_which_equations_fail_decide_nothing() -> None:
    assert trace(FailsForNumbers).outputs


# ---- remarks for the author ----


class Forgetful(Filter):
    """A parameter and an input that nothing uses; a Choice of which all members do the same."""

    stiffness: float = parameter(1.0, "N/m", "Stiffness")
    table: tuple[float, ...] = parameter((1.0, 2.0), "1", "A table of which one element is used")

    class Input(Record):
        command: float = variable(0.0, "V", "Command")
        measured: float = variable(0.0, "m", "Measured position")

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.second * self.table[0])


class Keeps(Mass):
    """The derivative of one state is left as it was."""

    class State(Record):
        position: float = variable(0.0, "m", "Position")
        velocity: float = variable(0.0, "m/s", "Velocity")

    class Output(Record):
        position: float = variable(0.0, "m", "Position")

    def derivative(self, t: float, x: Any, u: Any) -> Any:
        return replace(x, velocity=u.force / self.m)

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.position)

    def update(self, t: float, x: Any, u: Any) -> Any:
        return x


def test_what_is_probably_a_mistake_is_a_remark() -> None:
    said = "Forgetful: no equation uses the {}. Take it out, or use it."
    members = ("parameter active", "parameter stiffness", "input measured")
    assert trace(Forgetful).remarks == tuple(said.format(member) for member in members)
    (remark,) = trace(Keeps).remarks
    assert remark.startswith("Keeps: the derivative of position is position itself, as replace(x, ...) leaves it")


@pytest.mark.parametrize("name", WORKSPACE.components())
def test_components_of_the_library_have_no_remarks(name: str) -> None:
    assert trace(WORKSPACE.component(name)).remarks == ()


# ---- equations that cannot be traced ----


class IntOfValue(Filter):
    """A whole number from a value."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=int(x.first))


class RoundOfValue(Filter):
    """A rounded value."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=round(x.first, 2))


class IndexByValue(Filter):
    """A table by a value."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=(1.0, 2.0)[x.first])


class FloorDivision(Filter):
    """Floor division."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.first // 2.0)


class TextOfValue(Filter):
    """A value as a key."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position={x.first: 1.0}[x.first])


class FormattedValue(Filter):
    """A value as text."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=float(f"{x.first:.3f}"))


class InfiniteValue(Filter):
    """Infinity."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=x.first * float("inf"))


class DividedByZero(Filter):
    """A division of constants."""

    def output(self, t: float, x: Any, u: Any) -> Any:
        return self.Output(position=1.0 / 0.0 * x.first)


@pytest.mark.parametrize(
    "kind",
    [IntOfValue, RoundOfValue, IndexByValue, FloorDivision, TextOfValue, FormattedValue, InfiniteValue, DividedByZero],
)
def test_what_cannot_be_traced_names_line_and_functions(kind: type[Component]) -> None:
    text = refused(kind)
    line = kind.output.__code__.co_firstlineno + 1  # type: ignore[attr-defined]
    assert f"test_declarations.py, line {line}: {kind.__name__}.output: " in text
    assert all(name in text for name in FUNCTIONS)


@pytest.mark.parametrize("name", sorted(WORKSPACE.components()))
def test_components_of_the_library_pass(name: str) -> None:
    assert trace(WORKSPACE.component(name)).variants
