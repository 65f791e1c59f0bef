"""How a component is declared: parameters, records of variables, and the functions its equations may use.

A component is a class in one file. Its parameters are fields, its states, inputs and outputs nested
records, its equations pure methods. Everything else (FMUs, XML, documentation) is derived from it::

    class Lag(Plant):
        \"\"\"First-order lag.

            der(position) = (gain*command - position)/time_constant

        Source: any textbook.
        \"\"\"

        gain: float = parameter(2.0, "m/V", "Static gain")
        time_constant: float = parameter(0.1, "s", "Time constant", min=1e-6)

        class State(Record):
            position: float = variable(0.0, "m", "Position")

        class Input(Record):
            command: float = variable(0.0, "V", "Command")

        class Output(Record):
            position: float = variable(0.0, "m", "Position")

        def derivative(self, t: float, x: State, u: Input) -> State:
            return self.State(position=(self.gain * u.command - x.position) / self.time_constant)

        def output(self, t: float, x: State, u: Input) -> Output:
            return self.Output(position=x.position)

The methods run on plain numbers (the reference) and on symbols (the export), so on values they use only
arithmetic, comparisons and the functions of this module (``FUNCTIONS``): ``where`` for ``if``, ``both`` for ``and``,
``clip`` for ``min`` and ``max``. Parameters that are ``bool`` or a ``Choice`` are known when the equations are traced
(every combination is traced), so a plain ``if self.integral_surface:`` is right for them.

This module needs the standard library only: it travels inside Python FMUs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, field, fields
from enum import Enum
from typing import Any, ClassVar, Literal, TypeVar, cast, dataclass_transform

from .errors import DescriptionError

T = TypeVar("T")
Variability = Literal["fixed", "tunable"]


class Choice(Enum):
    """An enumeration parameter: ``name = number, "description"`` a member.

    Numbers are integers of 32 bits, as in FMI. Each is used once, in any order. Raises DescriptionError for others.
    """

    def __init__(self, number: int, description: str = "") -> None:
        self.number = number
        self.description = description
        member = f"{type(self).__name__}.{self.name}"
        if type(cast(object, number)) is not int or not -(2**31) <= number < 2**31:
            raise DescriptionError(
                f"{member}: {number!r} is no whole number of 32 bits. Write {self.name} = 1, 'What it means'."
            )
        if not isinstance(cast(object, description), str) or not description.strip():
            raise DescriptionError(f"{member} has no description. Write {self.name} = {number}, 'What it means'.")

    def __init_subclass__(cls) -> None:
        first: dict[int, str] = {}
        problems: list[str] = []
        for name, member in cls.__members__.items():
            if member.number in first:
                problems.append(
                    f"{cls.__name__}.{name} has the number {member.number} of {first[member.number]}. Give each member "
                    "a number of its own."
                )
            first.setdefault(member.number, name)
        if problems:
            raise DescriptionError(problems)


@dataclass(frozen=True)
class Declaration:
    """The declaration line of a parameter or variable. ``start`` is a tuple for an array."""

    name: str
    """Name in FMUs; elements of an array are ``name[1]``, ``name[2]`` ..."""
    attribute: str
    """Name in Python."""
    start: Any
    unit: str
    description: str
    min: float
    max: float
    nominal: float
    display_unit: str | None
    variability: Variability
    discrete: bool

    @property
    def length(self) -> int | None:
        """Number of elements of an array, None for a scalar."""
        start = cast("tuple[float, ...] | float", self.start)
        return len(start) if isinstance(start, tuple) else None

    @property
    def names(self) -> tuple[str, ...]:
        """The scalar names: one name, or one name for each element of an array."""
        if self.length is None:
            return (self.name,)
        return tuple(f"{self.name}[{i + 1}]" for i in range(self.length))

    @property
    def is_discrete_choice(self) -> bool:
        """Whether every value of this parameter is traced on its own (``bool`` or ``Choice``)."""
        return isinstance(self.start, bool | Choice)


def parameter(
    start: T,
    unit: str,
    description: str,
    *,
    min: float = -math.inf,
    max: float = math.inf,
    nominal: float = 1.0,
    display_unit: str | None = None,
    variability: Variability = "fixed",
    name: str | None = None,
) -> T:
    """Declare a parameter: start value, unit, description, bounds (in the same unit).

    ``start`` may be a float, int, bool, ``Choice`` member or tuple of floats (array of fixed length).
    ``tunable`` parameters may be changed during a run. ``name`` is the name in FMUs (default: name of the attribute).
    """
    metadata = {
        "unit": unit,
        "description": description,
        "min": min,
        "max": max,
        "nominal": nominal,
        "display_unit": display_unit,
    }
    metadata |= {"variability": variability, "name": name, "discrete": False}
    return field(default=start, metadata=metadata)


def variable(
    start: T,
    unit: str,
    description: str,
    *,
    min: float = -math.inf,
    max: float = math.inf,
    nominal: float = 1.0,
    display_unit: str | None = None,
    discrete: bool = False,
    name: str | None = None,
) -> T:
    """Declare a state, input or output of a ``Record``.

    ``nominal`` is the order of magnitude. The absolute tolerance of a state is the relative tolerance of the integrator
    times ``nominal``. ``discrete`` marks a state of a ``Plant`` that ``update`` sets and that is not integrated.
    """
    metadata = {
        "unit": unit,
        "description": description,
        "min": min,
        "max": max,
        "nominal": nominal,
        "display_unit": display_unit,
    }
    metadata |= {"variability": "fixed", "name": name, "discrete": discrete}
    return field(default=start, metadata=metadata)


def declarations(owner: type[Record] | type[Component]) -> tuple[Declaration, ...]:
    """The declaration lines of a record or of a component's parameters, in order."""
    found: list[Declaration] = []
    for item in fields(cast(Any, owner)):
        if item.default is MISSING or "unit" not in item.metadata:
            raise DescriptionError(f"{owner.__name__}.{item.name}: declare it with parameter(...) or variable(...).")
        metadata = dict(item.metadata)
        name = metadata.pop("name") or item.name
        found.append(Declaration(name=name, attribute=item.name, start=item.default, **metadata))
    return tuple(found)


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Record:
    """A frozen set of named values; subclasses list their members with ``variable``."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)

    def __iter__(self) -> Iterator[Any]:
        """The scalar values in order, arrays flattened."""
        for item in fields(cast(Any, self)):
            value = getattr(self, item.name)
            if isinstance(value, tuple):
                yield from cast(tuple[Any, ...], value)
            else:
                yield value


def unflatten(owner: type[Any], values: Iterator[Any]) -> dict[str, Any]:
    """Keyword arguments for ``owner`` taken from flat ``values``, arrays gathered; the inverse of iterating."""
    arguments: dict[str, Any] = {}
    for declaration in declarations(owner):
        if declaration.length is None:
            arguments[declaration.attribute] = next(values)
        else:
            arguments[declaration.attribute] = tuple(next(values) for _ in range(declaration.length))
    return arguments


class Empty(Record):
    """A record without members."""


@dataclass(frozen=True)
class Rule:
    """A condition between parameters; ``text`` says what must hold and what to do."""

    condition: bool
    text: str


@dataclass(frozen=True)
class Note:
    """A remark on something legal but suspicious. It is given while ``value`` is above ``limit``.

    Its wording is ``"<name> = <value> <unit> is above <limit_name> = <limit> <unit>: <text>"``. ``text`` says what the
    consequence is and what to do.
    """

    name: str
    value: float
    limit_name: str
    limit: float
    unit: str
    text: str


@dataclass(frozen=True)
class Experiment:
    """The default experiment of a component, in seconds."""

    stop_time: float
    step_size: float


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Component:
    """Base class of ``Plant``, ``Controller`` and ``Source``; it is not used directly.

    The constructor checks the parameters. Raises DescriptionError with all values out of bounds and all broken rules.
    """

    State: ClassVar[type[Record]] = Empty
    Input: ClassVar[type[Record]] = Empty
    Output: ClassVar[type[Record]] = Empty
    experiment: ClassVar[Experiment] = Experiment(stop_time=10.0, step_size=1e-4)

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)

    def __post_init__(self) -> None:
        problems = parameter_problems(self)
        if problems:
            raise DescriptionError(problems)

    def initial(self) -> Any:
        """The state at the start, from parameters; the declared start values unless overridden."""
        return self.State()

    def rules(self) -> tuple[Rule, ...]:
        """Conditions between parameters, checked when initialization ends; none unless overridden."""
        return ()

    def notes(self, x: Any) -> tuple[Note, ...]:
        """Remarks on legal but suspicious parameters and states ``x``; none unless overridden.

        They are evaluated at the end of initialization and at the end of a run. An FMU logs each note once, as a
        warning.
        """
        return ()


class Plant(Component):
    """A continuous-time component: ``derivative`` is integrated, inputs are held over a communication step."""

    tolerance: float = parameter(5e-9, "1", "Relative tolerance of the integrator", min=1e-12, max=1e-3, nominal=1e-9)
    """With the start value, closed loops of the studies differ from independent solvers by less than 1 nm. Above the
    maximum, the step size control cannot follow a break-away."""

    def derivative(self, t: float, x: Any, u: Any) -> Any:
        """Time derivatives as a ``State``; discrete members are ignored."""
        raise NotImplementedError

    def output(self, t: float, x: Any, u: Any) -> Any:
        """The ``Output`` at time ``t``."""
        raise NotImplementedError

    def update(self, t: float, x: Any, u: Any) -> Any:
        """The ``State`` whose discrete members replace those of ``x`` after each accepted integration step."""
        return x


class Controller(Component):
    """A sampled component: at each ``start + k*T_s`` first ``output``, then ``update``."""

    T_s: float = parameter(1e-4, "s", "Sampling time", min=1e-9, nominal=1e-4, display_unit="ms")

    def output(self, t: float, x: Any, u: Any) -> Any:
        """The ``Output`` of sample ``k`` from the state and the inputs at that sample."""
        raise NotImplementedError

    def update(self, t: float, x: Any, u: Any, y: Any) -> Any:
        """The ``State`` of sample ``k + 1``; ``y`` is the realised (saturated) output of sample ``k``."""
        return x


class Source(Component):
    """A function of time and parameters only."""

    def output(self, t: float) -> Any:
        """The ``Output`` at time ``t``."""
        raise NotImplementedError


def parameter_problems(component: Component) -> list[str]:
    """Every parameter of ``component`` that is not finite or out of its bounds, and every broken rule."""
    problems: list[str] = []
    kind = type(component).__name__
    for declaration in declarations(type(component)):
        value = getattr(component, declaration.attribute)
        values = cast(tuple[Any, ...], value) if isinstance(value, tuple) else (value,)
        for name, item in zip(declaration.names, values, strict=False):
            if isinstance(item, bool) or not isinstance(item, int | float):
                continue
            problem = bound_problem(item, declaration)
            if problem:
                problems.append(f"{kind}.{name} = {item:g} {declaration.unit}: {problem}")
        if declaration.length is not None and len(values) != declaration.length:
            problems.append(f"{kind}.{declaration.name} has {len(values)} elements: give {declaration.length}.")
    if not problems:
        problems += [f"{kind}: {rule.text}" for rule in component.rules() if rule.condition is False]
    return problems


def bound_problem(value: float, declaration: Declaration) -> str:
    """A sentence about what is wrong with ``value`` for ``declaration``; ``""`` if nothing is wrong."""
    unit = declaration.unit
    if not math.isfinite(value):
        return "must be finite. Give a number."
    if value < declaration.min:
        return f"below its minimum {declaration.min:g} {unit}. Give at least that."
    if value > declaration.max:
        return f"above its maximum {declaration.max:g} {unit}. Give at most that."
    return ""


# Functions for equations. For plain numbers they call ``math``. For symbols they call methods of the same names.

FUNCTIONS = (
    *("abs", "exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "tanh", "hypot"),
    *("floor", "mod", "sign", "where", "both", "either", "minimum", "maximum", "clip", "round_to", "interpolate"),
)
"""The functions that equations may call: Python's ``abs`` and the functions below."""


def _apply(function: Callable[[float], float], name: str, x: object) -> float:
    if isinstance(x, int | float):
        return function(x)
    return cast(float, getattr(x, name)())


def _apply_two(function: Callable[[float, float], float], name: str, one: object, other: object) -> float:
    """A function of two values; if the second alone is a symbol, its method named ``r`` + ``name`` takes the first."""
    if isinstance(one, int | float):
        if isinstance(other, int | float):
            return function(one, other)
        return cast(float, getattr(other, f"r{name}")(one))
    return cast(float, getattr(one, name)(other))


def exp(x: float) -> float:
    """e**x."""
    return _apply(math.exp, "exp", x)


def log(x: float) -> float:
    """Natural logarithm."""
    return _apply(math.log, "log", x)


def sqrt(x: float) -> float:
    """Square root."""
    return _apply(math.sqrt, "sqrt", x)


def sin(x: float) -> float:
    """Sine of an angle in rad."""
    return _apply(math.sin, "sin", x)


def cos(x: float) -> float:
    """Cosine of an angle in rad."""
    return _apply(math.cos, "cos", x)


def tan(x: float) -> float:
    """Tangent of an angle in rad."""
    return _apply(math.tan, "tan", x)


def asin(x: float) -> float:
    """Angle of -pi/2 ... pi/2 rad with the sine ``x``; its derivative is infinite at -1 and 1."""
    return _apply(math.asin, "asin", x)


def acos(x: float) -> float:
    """Angle of 0 ... pi rad with the cosine ``x``; its derivative is infinite at -1 and 1."""
    return _apply(math.acos, "acos", x)


def atan(x: float) -> float:
    """Angle of -pi/2 ... pi/2 rad with the tangent ``x``."""
    return _apply(math.atan, "atan", x)


def atan2(y: float, x: float) -> float:
    """Angle of the vector (x, y) in rad, -pi ... pi; 0 for (0, 0), where its derivatives are finite."""
    return _apply_two(lambda y, x: math.atan2(y, x) if y or x else 0.0, "atan2", y, x)


def tanh(x: float) -> float:
    """Hyperbolic tangent."""
    return _apply(math.tanh, "tanh", x)


def hypot(x: float, y: float) -> float:
    """Length of the vector (x, y), without overflow; its derivatives are 0 at (0, 0)."""
    return _apply_two(math.hypot, "hypot", x, y)


def floor(x: float) -> float:
    """Largest whole number not above x, as a float."""
    return _apply(lambda value: float(math.floor(value)), "floor", x)


def mod(x: float, y: float) -> float:
    """``x - y*floor(x/y)`` without rounding errors of the quotient: the remainder with the sign of ``y``."""
    return _apply_two(lambda x, y: float(x) % float(y), "mod", x, y)


def sign(x: float) -> float:
    """-1, 0 or 1."""
    return _apply(lambda value: float((value > 0) - (value < 0)), "sign", x)


def where(condition: bool, one: float, other: float) -> float:
    """``one`` where the condition holds, else ``other``. Both are evaluated: both must be finite."""
    if isinstance(cast(object, condition), bool):
        return one if condition else other
    return cast(float, cast(Any, condition).where(one, other))


def both(one: bool, other: bool) -> bool:
    """Logical and."""
    if isinstance(cast(object, one), bool) and isinstance(cast(object, other), bool):
        return one and other
    return one & other


def either(one: bool, other: bool) -> bool:
    """Logical or."""
    if isinstance(cast(object, one), bool) and isinstance(cast(object, other), bool):
        return one or other
    return one | other


def minimum(one: float, other: float) -> float:
    """The smaller of two values."""
    return where(one < other, one, other)


def maximum(one: float, other: float) -> float:
    """The larger of two values."""
    return where(one > other, one, other)


def clip(value: float, low: float, high: float) -> float:
    """``value`` limited to ``low`` ... ``high``."""
    return maximum(low, minimum(value, high))


def round_to(value: float, resolution: float) -> float:
    """``value`` rounded half up to a multiple of ``resolution``; unchanged where the resolution is 0."""
    return where(
        resolution > 0.0,
        resolution * floor(value / where(resolution > 0.0, resolution, 1.0) + 0.5),
        value,
    )


def interpolate(x: float, x_nodes: tuple[float, ...], y_nodes: tuple[float, ...]) -> float:
    """Piecewise linear through ascending nodes, the end values held outside; at least 2 nodes.

    The list of candidate nodes is halved by comparing ``x`` with its middle, until one interval is left. In traced C
    this takes about 2 selections for each node and one division. Equal neighbouring ``x_nodes`` are allowed: to use
    fewer nodes, repeat the last one.
    """
    xs, ys = list(x_nodes), list(y_nodes)
    while len(xs) > 2:
        middle = len(xs) // 2
        above = x >= xs[middle]
        xs = [where(above, high, low) for low, high in zip(xs[: middle + 1], xs[-middle - 1 :], strict=True)]
        ys = [where(above, high, low) for low, high in zip(ys[: middle + 1], ys[-middle - 1 :], strict=True)]
    width = xs[1] - xs[0]
    return ys[0] + (ys[1] - ys[0]) * clip(x - xs[0], 0.0, width) / where(width > 0.0, width, 1.0)
