"""The table ``[record]``: which variables are recorded, and how often."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from ..errors import suggest
from .findings import Findings
from .parts import Instance
from .values import is_numeric, show_value


def recorded_variables(
    document: Mapping[str, Any], instances: Mapping[str, Instance], findings: Findings
) -> tuple[tuple[tuple[str, str], ...], int]:
    """The variables to record, as (instance, variable), and the decimation."""
    table = findings.table(document, "record")
    findings.known_keys("record", table, ("variables", "decimation"))
    decimation = findings.count("record.decimation", table.get("decimation", 1))
    patterns = table.get("variables")
    if patterns is None:
        chosen = [(i.name, v) for i in instances.values() for v in i.fmu.outputs if is_numeric(i.fmu.variables[v])]
        return tuple(chosen), decimation
    if isinstance(patterns, str) or not isinstance(patterns, Sequence):
        findings.problem("record.variables", 'must be a list, such as ["plant.position", "controller.*"].')
        return (), decimation
    declared = findings.table(document, "instances")
    result: dict[tuple[str, str], None] = {}
    for pattern in cast("Sequence[object]", patterns):
        for entry in _recorded(pattern, instances, declared, findings):
            result[entry] = None
    return tuple(result), decimation


def _recorded(
    pattern: object, instances: Mapping[str, Instance], declared: Mapping[str, Any], findings: Findings
) -> Iterator[tuple[str, str]]:
    where = "record.variables"
    if not isinstance(pattern, str):
        findings.problem(where, f"{show_value(pattern)} is not a text.")
        return
    name, _, variable = pattern.partition(".")
    # A variable whose own name holds a * or ? is meant before a pattern is.
    exact = name in instances and variable in instances[name].fmu.variables
    if not exact and ("*" in pattern or "?" in pattern):
        matching = list(_matching(pattern, instances))
        if not matching and instances:
            findings.problem(where, f"'{pattern}' matches no input, output or local variable.")
        yield from matching
    elif name not in instances:
        if name not in declared:
            findings.problem(where, f"'{pattern}': no instance '{name}'.{suggest(name, declared)}")
    elif not exact and variable in instances[name].fmu.arrays:
        for element in instances[name].fmu.arrays[variable].elements:
            yield from _recorded(f"{name}.{element}", instances, declared, findings)
    elif not exact:
        fmu = instances[name].fmu
        known = [v for v in fmu.variables if not v.endswith("]")]
        findings.problem(where, f"'{pattern}': {fmu.name} has no variable '{variable}'.{suggest(variable, known)}")
    elif not is_numeric(instances[name].fmu.variables[variable]):
        kind = instances[name].fmu.variables[variable].type
        findings.problem(where, f"'{pattern}' is a {kind}; only numbers are recorded.")
    else:
        yield name, variable


def _matching(pattern: str, instances: Mapping[str, Instance]) -> Iterator[tuple[str, str]]:
    """Everything that varies and whose name matches a pattern with * and ?."""
    expression = re.compile(re.escape(pattern).replace(r"\*", ".*").replace(r"\?", "."), re.DOTALL)
    for name, instance in instances.items():
        for variable in instance.fmu.variables.values():
            varies = variable.causality in ("input", "output", "local") and variable.variability != "constant"
            if varies and is_numeric(variable) and expression.fullmatch(f"{name}.{variable.name}"):
                yield name, variable.name
