"""Reads TOML files, checks them against a model and reports all problems at once. Writes TOML files.

A model is a pydantic class. A problem names the file, the key, what is wrong and what to write instead.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, TypeVar, Union, cast, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, WithJsonSchema
from pydantic_core import ErrorDetails, PydanticCustomError

from ..errors import DescriptionError, clipped, suggest
from ..files import write_file
from .text import FRACTION, read_toml

Model = TypeVar("Model", bound=BaseModel)


class Table(BaseModel):
    """A table of a file. A key without a field is reported as a problem."""

    model_config: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True
    )
    EXAMPLE: ClassVar[str] = ""
    """An example of such a table, shown when something is missing."""


def number(value: object) -> float:
    """A number of a file as a float; a validator that goes behind the bounds of the number."""
    if isinstance(value, bool) or not isinstance(value, int | float | Decimal):
        raise PydanticCustomError("not_a_number", "must be a number, not {value}", {"value": _shown(value)})
    try:
        return float(value)
    except OverflowError:
        return math.inf


def whole(value: object) -> Any:
    """``2.0`` as ``2``, which JSON Schema calls an integer, too; any other value as it is."""
    if isinstance(value, float | Decimal) and math.isfinite(float(value)) and value == int(value):
        return int(value)
    return value


def _scalar(value: object) -> bool | float | str:
    return value if isinstance(value, bool | str) else number(value)


def _seconds(value: object) -> Any:
    if not isinstance(value, str):
        number(value)
    elif not re.fullmatch(FRACTION, value):
        told = 'must be a number of seconds, or a quotient of two, such as "1/30", not {value}'
        raise PydanticCustomError("not_a_number", told, {"value": _shown(value)})
    return value


def _step(value: object) -> Any:
    if not isinstance(value, str) and not number(value) > 0.0:
        raise PydanticCustomError("not_a_number", "must be greater than 0, not {value}", {"value": _shown(value)})
    return _seconds(value)


_QUOTIENT = {"type": "string", "pattern": f"^{FRACTION}$"}


Text = Annotated[str, Field(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False), BeforeValidator(number)]
Positive = Annotated[float, Field(allow_inf_nan=False, gt=0.0), BeforeValidator(number)]
Count = Annotated[int, Field(ge=1), BeforeValidator(whole)]
Seed = Annotated[int, Field(ge=0), BeforeValidator(whole)]
Share = Annotated[float, Field(gt=0.0, lt=1.0), BeforeValidator(number)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
Scalar = Annotated[Any, BeforeValidator(_scalar), WithJsonSchema({"type": ["boolean", "number", "string"]})]
"""A start value: a number, a text, true or false."""
Seconds = Annotated[Any, BeforeValidator(_seconds), WithJsonSchema({"anyOf": [{"type": "number"}, _QUOTIENT]})]
"""A number as it is written in the file, or a quotient such as "1/30"."""
Step = Annotated[
    Any, BeforeValidator(_step), WithJsonSchema({"anyOf": [{"type": "number", "exclusiveMinimum": 0}, _QUOTIENT]})
]
"""A time above 0, as ``Seconds``."""


# ---- reading ----


def read_table(path: Path, model: type[Model]) -> Model:
    """Read the TOML file at ``path`` as a ``model``. Raises DescriptionError with all problems."""
    table, problems = checked(_floats(read_toml(path)), model, path.name)
    if problems or table is None:
        raise DescriptionError(problems)
    return table


def checked(document: Mapping[str, Any], model: type[Model], name: str) -> tuple[Model | None, list[str]]:
    """``document`` as a ``model`` (None if it has problems), and the problems. ``name`` is the file they name.

    Unknown keys are reported and removed, then the rest is checked again: an unknown key hides no other problem.
    """
    problems: list[str] = []
    for _ in range(2):
        try:
            return model.model_validate(document), problems
        except ValidationError as error:
            details = error.errors()
        told = [f"{name}: {_told(model, detail)}" for detail in details]
        problems = list(dict.fromkeys([*problems, *told]))
        unknown = [detail["loc"] for detail in details if detail["type"] == "extra_forbidden"]
        if len(unknown) < len(details):
            break
        for location in unknown:
            document = _without(document, _steps(model, location)[0])
    return None, problems


def _told(model: type[BaseModel], detail: ErrorDetails) -> str:
    """One problem as a sentence: the key and what is wrong with it."""
    kind, given = detail["type"], detail["input"]
    steps, known = _steps(model, detail["loc"])
    context = detail.get("ctx", {})
    if kind == "extra_forbidden":
        text = f"unknown key.{suggest(str(steps[-1]), known)}"
    elif kind == "missing" or given is None:
        example = _example(model, steps[:-1])
        text = f"missing: write {example}." if example else "missing."
    elif kind == "too_short":
        text = "none given."
    elif kind == "literal_error":
        allowed = [part.strip().strip("'") for part in str(context["expected"]).replace(" or ", ",").split(",")]
        text = f"{_shown(given)} is not one of the values allowed.{suggest(str(given), allowed)}"
    elif kind in _WORDS:
        example = _example(model, steps)
        text = f"must be {_WORDS[kind]}, not {_shown(given)}{f': write {example}' if example else ''}."
    elif kind == "value_error":
        text = f"{context['error']}."
    elif kind == "not_a_number":
        text = f"{detail['msg']}."
    else:
        text = f"{detail['msg'].replace('Input should be', 'must be')}, not {_shown(given)}."
    return f"{_place(steps)}: {text}" if steps else text


_WORDS = {
    "string_type": "a text",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "string_too_short": "a text that is not empty",
    "finite_number": "a finite number",
}


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list"
    return f"'{clipped(value)}'" if isinstance(value, str) else clipped(f"{value}")


def _place(steps: Sequence[str | int]) -> str:
    text = ""
    for step in steps:
        text += f"[{step + 1}]" if isinstance(step, int) else f".{step}" if text else step
    return text


def _steps(model: type[BaseModel], location: Sequence[str | int]) -> tuple[list[str | int], list[str]]:
    """The keys of ``location``, and the keys that the last table may have.

    pydantic's ``location`` also names the chosen members of unions. They are left out.
    """
    steps: list[str | int] = []
    known: list[str] = []
    kind: Any = model
    for part in location:
        kind, choices = _resolved(kind)
        if choices:
            # This part of the location names a member of a union.
            member = next((item for tag, item in choices if tag == part), None)
            if member is not None:
                kind = member
                continue
        steps.append(part)
        known = []
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            fields = {field.alias or name: field for name, field in kind.model_fields.items()}
            known = list(fields)
            kind = fields[part].annotation if part in fields else None
        elif get_origin(kind) in (dict, list, tuple, Mapping):
            kind = get_args(kind)[-1]
        else:
            kind = None
    return steps, known


def _resolved(kind: Any) -> tuple[Any, list[tuple[str, Any]]]:
    """A type without its annotations; and, if it is a union of tagged members, each tag with its type."""
    while get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    if get_origin(kind) not in (Union, UnionType):
        return kind, []
    members = [item for item in get_args(kind) if item is not type(None)]
    tagged = [
        (str(getattr(note, "tag", "")), get_args(item)[0])
        for item in members
        if get_origin(item) is Annotated
        for note in get_args(item)[1:]
    ]
    if not tagged and len(members) == 1:
        return _resolved(members[0])
    return kind, tagged


def _example(model: type[BaseModel], steps: Sequence[str | int]) -> str:
    """An example of the table at the place ``steps``; "" if its model has none."""
    kind: Any = model
    for step in steps:
        kind, choices = _resolved(kind)
        if choices:
            kind = next((item for tag, item in choices if tag == "table"), None)
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            kind = kind.model_fields[step].annotation if step in kind.model_fields else None
        else:
            kind = get_args(kind)[-1] if get_args(kind) else None
    kind, choices = _resolved(kind)
    kind = next((item for tag, item in choices if tag == "table"), kind)
    return kind.EXAMPLE if isinstance(kind, type) and issubclass(kind, Table) else ""


def _without(document: Mapping[str, Any], steps: Sequence[str | int]) -> dict[str, Any]:
    """A copy of ``document`` without the key at the end of ``steps``."""
    copy: Any = dict(document)
    top = copy
    for step in steps[:-1]:
        inner: Any = copy[step]
        copy[step] = (
            dict(cast("Mapping[str, Any]", inner)) if isinstance(inner, Mapping) else list(cast("list[Any]", inner))
        )
        copy = copy[step]
    del copy[steps[-1]]
    return top


def _floats(value: Any) -> Any:
    """``value`` with every Decimal in it converted to float."""
    if isinstance(value, Mapping):
        return {key: _floats(item) for key, item in cast("Mapping[str, Any]", value).items()}
    if isinstance(value, list):
        return [_floats(item) for item in cast("list[Any]", value)]
    return float(value) if isinstance(value, Decimal) else value


# ---- writing ----


def toml(document: Mapping[str, Any], comment: str = "") -> str:
    """``document`` as the text of a TOML file that begins with ``comment``."""
    import tomli_w

    heading = "".join(f"# {line}\n" for line in comment.splitlines())
    return heading + tomli_w.dumps(document)


def write_toml(path: Path, document: Mapping[str, Any], comment: str = "") -> Path:
    """Write a TOML file, whole or not at all. Raises FileError."""
    return write_file(path, toml(document, comment))


def write_start(
    path: Path, values: Mapping[str, Any], *, base: str | None = None, comment: str = "", digits: int = 12
) -> Path:
    """Write a system file with start values. The keys of ``values`` are INSTANCE.VARIABLE.

    ``base`` is the system file that the new file completes. Numbers get ``digits`` significant digits.
    Raises FileError.
    """
    instances: dict[str, dict[str, dict[str, Any]]] = {}
    for name, value in values.items():
        instance, _, variable = name.partition(".")
        instances.setdefault(instance, {"start": {}})["start"][variable] = _rounded(value, digits)
    document = {"instances": instances} if base is None else {"base": base, "instances": instances}
    return write_toml(path, document, comment)


def _rounded(value: Any, digits: int) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, list):
        return [_rounded(item, digits) for item in cast("list[Any]", value)]
    return value
