"""Variables of a system in SI units, for procedures whose formulas are in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

from ..errors import DescriptionError
from ..system.system import System
from ..units import Unit, parse_unit


def si_factor(system: System, path: str, *wanted: str) -> float:
    """The factor from the unit of the variable INSTANCE.VARIABLE to the first of the units ``wanted`` that it fits.

    1 for a variable without a unit, or in 1. An array counts as its first element. Raises DescriptionError if the unit
    converts to none of ``wanted``, or only by an offset.
    """
    name, unit = _unit(system, path)
    if not name:
        return 1.0
    for each in wanted:
        found = None if unit is None else unit.conversion(parse_unit(each))
        if found is not None and found[1] == 0.0:
            return found[0]
    told = "nothing says what this unit is" if unit is None else f"it must be in {' or '.join(wanted)}, or a multiple"
    raise DescriptionError(f"{system.name}: {path} is in {name}: {told}.")


def si_factors(system: System, units: Mapping[str, str]) -> dict[str, float]:
    """``si_factor`` of variables, each with the SI unit that it must fit. Raises DescriptionError with all problems."""
    found: dict[str, float] = {}
    problems: list[str] = []
    for path, unit in units.items():
        try:
            found[path] = si_factor(system, path, unit)
        except DescriptionError as error:
            problems += error.problems
    if problems:
        raise DescriptionError(problems)
    return found


def quotient_factor(system: System, dividend: str, divisor: str, quotient: str) -> float:
    """The factor c with ``value of quotient = c * value of dividend / value of divisor``, each in its own unit.

    An angle counts as a number. 1 if one of the variables has no unit. Raises DescriptionError if the units do not fit.
    """
    units: list[Unit] = []
    names: list[str] = []
    for path in (dividend, divisor, quotient):
        name, unit = _unit(system, path)
        if not name:
            return 1.0
        if unit is None:
            raise DescriptionError(f"{system.name}: {path} is in {name}: nothing says what this unit is.")
        units.append(unit)
        names.append(f"{path} in {name}")
    over, under, result = units
    if tuple(a - b for a, b in zip(over.exponents[:-1], under.exponents[:-1], strict=True)) != result.exponents[:-1]:
        raise DescriptionError(f"{system.name}: {names[0]} divided by {names[1]} does not give {names[2]}.")
    return over.factor / under.factor / result.factor


def _unit(system: System, path: str) -> tuple[str, Unit | None]:
    """The unit of a variable, "" without one or for 1, and its meaning; None if nothing says what it means."""
    name, _, variable_name = path.partition(".")
    fmu = system.instance(name).fmu
    array = fmu.arrays.get(variable_name)
    variable = system.variable(name, variable_name if array is None else array.elements[0])
    if variable.unit is None or variable.unit in ("", "1"):
        return "", None
    return variable.unit, fmu.unit(variable.unit)


def gain_factor(system: System, gain: str, command: str, per: str) -> float:
    """The factor from the unit of a gain to the unit of ``command`` divided by the unit ``per``.

    1 if one of the variables has no unit, or if the gain is of another kind: it may count another command.
    """
    _, given = _unit(system, gain)
    _, over = _unit(system, command)
    if given is None or over is None:
        return 1.0
    found = given.conversion(over.times(parse_unit(per).power(Fraction(-1))))
    return 1.0 if found is None else found[0]
