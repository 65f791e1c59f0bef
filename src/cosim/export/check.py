"""Checks of a component's declaration before its equations are traced; they find all problems at once."""

from __future__ import annotations

import builtins
import dis
import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import MISSING, fields
from itertools import pairwise
from types import CodeType, FunctionType, ModuleType
from typing import Any, cast

from ..errors import DescriptionError
from ..model import (
    Choice,
    Component,
    Controller,
    Declaration,
    Plant,
    Record,
    Source,
    bound_problem,
    declarations,
)
from ..units import conversion, parse_unit
from .interface import variables_of
from .place import of_author, of_class, of_declaration, of_method, place

MAX_LENGTH = 100_000
"""Most elements of an array. In FMI 2.0 every element is a variable of its own, so a larger one makes a huge XML."""
KINDS: dict[type[Component], tuple[tuple[str, ...], tuple[str, ...]]] = {
    Plant: (("State", "Input", "Output"), ("derivative", "output", "update")),
    Controller: (("State", "Input", "Output"), ("output", "update")),
    Source: (("Output",), ("output",)),
}
"""For each kind of component: the names of its records and of its equations."""
IMPURE = {
    *("random", "secrets", "uuid", "time", "datetime", "os", "sys", "io", "pathlib", "socket", "threading", "warnings"),
    *(
        "numpy.random",
        "_io.open",
        "builtins.print",
        "builtins.hash",
        "builtins.id",
        "builtins.input",
        "builtins.eval",
        "builtins.exec",
    ),
}
"""Modules and functions whose results do not depend on their arguments alone, or that have side effects."""
ARRAYS = {"numpy", "scipy"}
"""Packages whose results differ from those of C in the last bits, by blocks of sums and functions of their own."""
EXCEPTIONS = "try or with"
"""What code is called that handles exceptions."""
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]*(\.[A-Za-z_][A-Za-z_0-9]*)*")


def check_component(kind: type[Component]) -> None:
    """Refuse a component whose declaration is wrong. Raises DescriptionError with file, line, rule and remedy."""
    problems = [*_structure(kind)]
    if not problems:
        for owner in (kind, *(getattr(kind, name) for name in ("State", "Input", "Output"))):
            problems += _declarations(kind, owner)
    if not problems:
        problems = [*_names(kind), *_purity(kind)]
    if not problems:
        problems = [*_rules_at_start(kind)]
    if problems:
        raise DescriptionError(list(dict.fromkeys(problems)))


def _structure(kind: type[Component]) -> Iterator[str]:
    """Kind, records, equations, experiment."""
    at, name = of_class(kind), kind.__name__
    bases = [base for base in KINDS if issubclass(kind, base)]
    if len(bases) != 1:
        yield f"{at}: {name} is none of Plant, Controller and Source, or several. Derive it from one of them."
        return
    records, methods = KINDS[bases[0]]
    if not (name.isascii() and name.isidentifier()):
        yield f"{at}: the name {name} is no C identifier, which FMI demands. Use letters, digits and _ of ASCII."
    for record in ("State", "Input", "Output"):
        value = getattr(kind, record)
        if not (isinstance(value, type) and issubclass(value, Record)):
            yield f"{at}: {name}.{record} is no Record. Write class {record}(Record)."
        elif record not in records and fields(cast(Any, value)):
            yield f"{of_class(value)}: {name} is a {bases[0].__name__}, which has no {record}. Take it out."
    if not all(
        isinstance(getattr(kind, record), type) and issubclass(getattr(kind, record), Record) for record in records
    ):
        return
    if kind.__post_init__ is not Component.__post_init__:
        at = of_method(kind, "__post_init__")
        yield f"{at}: {name} has __post_init__, which FMUs do not call. Use initial or rules."
    for method in ("derivative", "output", "update"):
        if method not in methods and hasattr(kind, method):
            kinds = " or a ".join(base.__name__ for base, (_, known) in KINDS.items() if method in known)
            found = of_method(kind, method)
            yield f"{found}: {name} has {method}, which is never called. Take it out, or make {name} a {kinds}."
    needed = ["output"] if fields(cast(Any, kind.Output)) else []
    if issubclass(kind, Plant) and any(not d.metadata.get("discrete") for d in fields(cast(Any, kind.State))):
        needed.append("derivative")
    sampled = any(issubclass(kind, Controller) or d.metadata.get("discrete") for d in fields(cast(Any, kind.State)))
    if sampled and not issubclass(kind, Source):
        needed.append("update")
    for method in needed:
        if getattr(kind, method) is getattr(bases[0], method):
            yield f"{at}: {name} has no {method}. Write def {method}(self, {_arguments(bases[0], method)})."
    at = of_class(kind)
    times = (kind.experiment.stop_time, kind.experiment.step_size)
    if not all(math.isfinite(value) and value > 0.0 for value in times):
        yield f"{at}: {name}.experiment has times {times[0]:g} s and {times[1]:g} s. Give positive numbers."


def _arguments(base: type[Component], method: str) -> str:
    return ", ".join(getattr(base, method).__code__.co_varnames[1 : getattr(base, method).__code__.co_argcount])


# ---- declaration lines ----


def _declarations(kind: type[Component], owner: type[Component] | type[Record]) -> Iterator[str]:
    label = kind.__name__ if owner is kind else f"{kind.__name__}.{owner.__name__}"
    reserved = {"experiment", "initial", "rules", "notes", "derivative", "output", "update", "State", "Input", "Output"}
    bare = [item for item in fields(cast(Any, owner)) if item.default is MISSING or "unit" not in item.metadata]
    for item in bare:
        at = f"{of_declaration(owner, item.name)}: {label}.{item.name}"
        yield f"{at} has no declaration. Write it with parameter(...) or variable(...)."
    for declaration, item in zip(() if bare else declarations(owner), fields(cast(Any, owner)), strict=False):
        at = f"{of_declaration(owner, item.name)}: {label}.{item.name}"
        if owner is kind and item.name in reserved:
            yield f"{at}: components have something else of this name. Take another name."
            continue
        problems = [*_types(declaration, owner, kind)]
        problems = problems or [*_annotation(declaration, item.type), *_numbers(declaration)]
        yield from (f"{at}: {problem}" for problem in problems)


def _types(declaration: Declaration, owner: type[Any], kind: type[Component]) -> Iterator[str]:
    """Problems of types and annotations; units, bounds and start values are checked only if there are none."""
    start: Any = declaration.start
    values = cast("tuple[Any, ...]", start) if isinstance(start, tuple) else (start,)
    plain = int | float
    if isinstance(start, tuple) and not 1 <= len(values) <= MAX_LENGTH:
        yield f"an array of {len(values)} elements. Give 1 to {MAX_LENGTH}."
    elif isinstance(start, tuple) and any(isinstance(v, bool) or not isinstance(v, plain) for v in values):
        yield f"start {start!r} is not of numbers only. Write a tuple of floats."
    elif not isinstance(start, tuple | Choice | int | float):
        yield f"start {start!r} is a {type(start).__name__}. Give a float, int, bool, Choice or tuple of floats."
    elif owner is not kind and isinstance(start, Choice):
        yield "a Choice can only be a parameter. Write a number, and compare it in the equations."
    elif owner is kind.State and issubclass(kind, Plant) and not declaration.discrete and not _real(start):
        yield f"start {start!r} is no float, and the state is integrated. Write a float, or discrete=True."
    for name in ("unit", "description"):
        if not isinstance(getattr(declaration, name), str):
            yield f"{name} {getattr(declaration, name)!r} is no text. The order is start, unit, description."
    if not declaration.description or not str(declaration.description).strip():
        yield "no description. Say what it means in a few words."
    for name in ("min", "max", "nominal"):
        value = getattr(declaration, name)
        if isinstance(value, bool) or not isinstance(value, plain) or math.isnan(value):
            yield f"{name} {value!r} is no number."
    if declaration.variability not in ("fixed", "tunable"):
        yield f"variability '{declaration.variability}': give fixed or tunable."
    if declaration.discrete and not (owner is kind.State and issubclass(kind, Plant)):
        yield "discrete=True is for states of a Plant only. Leave it out."


def _real(start: Any) -> bool:
    return isinstance(start, float | tuple)


def _annotation(declaration: Declaration, annotation: Any) -> Iterator[str]:
    """An annotation that contradicts the start value. The type of the start value decides the type in the FMU."""
    text = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", "")
    found = type(declaration.start).__name__
    if text in ("float", "int", "bool", "tuple") and text != found:
        remedy = f"write {float(declaration.start)!r}" if (text, found) == ("float", "int") else "make them agree"
        yield f"start {declaration.start!r} is of type {found}, its annotation says {text}: {remedy}."


def _numbers(declaration: Declaration) -> Iterator[str]:
    """Units, bounds and start values."""
    unit, shown = declaration.unit, declaration.display_unit
    try:
        parse_unit(unit)
        if shown is not None:
            conversion(unit, shown)
    except DescriptionError as error:
        yield f"{error}"
        return
    low, high = declaration.min, declaration.max
    if low > high:
        yield f"min {low:g} {unit} is above max {high:g} {unit}. Exchange them."
        return
    if not (math.isfinite(declaration.nominal) and declaration.nominal > 0.0):
        yield f"nominal {declaration.nominal:g} {unit}. Give a positive number, the order of magnitude."
    if isinstance(declaration.start, bool | Choice):
        return
    start: Any = declaration.start
    starts = cast("tuple[Any, ...]", start) if isinstance(start, tuple) else (start,)
    for name, start in zip(declaration.names, starts, strict=True):
        problem = bound_problem(start, declaration)
        if problem:
            yield f"start {name} = {start:g} {unit}: {problem}"
    if type(declaration.start) is int and not -(2**31) <= declaration.start < 2**31:
        yield f"start {declaration.start} does not fit into an Integer of 32 bits. Write a float."


def _rules_at_start(kind: type[Component]) -> Iterator[str]:
    """Rules that the start values break: an FMU with such start values would not start.

    A rule that raises an error is skipped here; the trace reports it.
    """
    try:
        kind()
    except DescriptionError as error:
        yield from (f"{of_method(kind, 'rules')}: with its start values, {problem}" for problem in error.problems)
    except Exception:  # the trace of the rules reports it, with its line
        return


# ---- names ----


def _names(kind: type[Component]) -> Iterator[str]:
    """Names that FMI does not allow, and names that two variables would share."""
    at = {
        declaration.name: of_declaration(owner, declaration.attribute)
        for owner in (kind, kind.State, kind.Input, kind.Output)
        for declaration in declarations(owner)
    }
    for name, line in at.items():
        if not (name.isascii() and _NAME.fullmatch(name)):
            yield f"{line}: {kind.__name__}: the name '{name}' is not of letters, digits and _ with dots. Change it."
    known = Counter(variable.name for variable in variables_of(kind))
    known["time"] += 1  # the independent variable of FMI 3.0
    for name, count in known.items():
        if count > 1:
            line = at.get(name) or at.get(name.partition("[")[0]) or of_class(kind)
            yield f"{line}: {kind.__name__}: {count} variables have the name '{name}'. Rename one, or give it name=..."


# ---- purity ----


def _purity(kind: type[Component]) -> Iterator[str]:
    """Equations that use clocks, files, random numbers, output, NumPy or exceptions."""
    for method in ("initial", "rules", "notes", "derivative", "output", "update"):
        function = getattr(kind, method, None)
        if isinstance(function, FunctionType) and of_author(function.__code__.co_filename):
            for at, used in dict.fromkeys(_used(function, set())):
                yield f"{at}: {kind.__name__}.{method} uses {used}. {_remedy(used)}"


def _remedy(used: str) -> str:
    if used == EXCEPTIONS:
        return "Compiled code raises no exceptions: write where(x == 0.0, ...) for the case that fails."
    if used in (*ARRAYS, "@"):
        return (
            "Sums and functions of NumPy round unlike compiled ones, so the native and the Python FMU would differ. "
            "Write sums and products out, take functions of cosim.model, and compute constants outside of the class."
        )
    return "An equation may depend on its arguments only: give what it needs as an input or a parameter."


def _used(function: FunctionType, seen: set[CodeType]) -> Iterator[tuple[str, str]]:
    """What a function uses of ``IMPURE`` and ``ARRAYS``, and exceptions, each after its place in the file.

    Functions of the author that it calls are searched, too.
    """
    codes = [function.__code__]
    while codes:
        code = codes.pop()
        if code in seen:
            continue
        seen.add(code)
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
        instructions = [each for each in dis.get_instructions(code) if each.opname != "CACHE"]
        line = code.co_firstlineno
        for instruction, following in pairwise([*instructions, instructions[-1]]):
            name = instruction.argval
            line = (instruction.positions and instruction.positions.lineno) or line
            at = place(code.co_filename, line)
            if instruction.opname == "PUSH_EXC_INFO":
                yield at, EXCEPTIONS
            elif instruction.opname == "BINARY_OP" and instruction.argrepr.startswith("@"):
                yield at, "@"
            elif instruction.opname == "IMPORT_NAME":
                used = {name, name.partition(".")[0]} & (IMPURE | ARRAYS)
                yield from ((at, each) for each in used)
            elif instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                value = function.__globals__.get(name, getattr(builtins, name, None))
                attribute = following.argval if following.opname in ("LOAD_ATTR", "LOAD_METHOD") else ""
                constant = isinstance(value, ModuleType) and isinstance(getattr(value, attribute, None), float)
                holder = type(getattr(value, "__self__", None)).__module__
                module = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
                origin = module or (type(value).__module__ if attribute else holder)
                if origin in IMPURE or f"{origin}.{name}" in IMPURE:
                    yield at, name
                elif origin.partition(".")[0] in ARRAYS and not constant:
                    yield at, origin.partition(".")[0]
                elif isinstance(value, FunctionType) and of_author(value.__code__.co_filename):
                    yield from _used(value, seen)
