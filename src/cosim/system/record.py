"""The table ``[record]``: which variables are recorded, and how often."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from ..errors import suggest
from ..fmu.description import Fmu
from ..fmu.variables import suggest_variable
from .findings import Findings
from .parts import Connection, Ports
from .values import is_numeric, show_value


def recorded_variables(
    document: Mapping[str, Any], ports: Mapping[str, Ports], connections: Sequence[Connection], findings: Findings
) -> tuple[tuple[tuple[str, str], ...], int]:
    """The variables to record, as (instance or signal, variable), and the decimation.

    By default these are all outputs of FMUs, and the columns of records that feed an input.
    """
    table = findings.table(document, "record")
    findings.known_keys("record", table, ("variables", "decimation"))
    decimation = findings.count("record.decimation", table.get("decimation", 1))
    patterns = table.get("variables")
    if patterns is None:
        feeding = {connection.source for connection in connections}
        chosen = [
            (name, v)
            for name, port in ports.items()
            for v in port.outputs
            if is_numeric(port.variables[v]) and (isinstance(port, Fmu) or (name, v) in feeding)
        ]
        return tuple(chosen), decimation
    if isinstance(patterns, str) or not isinstance(patterns, Sequence):
        findings.problem("record.variables", 'must be a list, such as ["plant.position", "controller.*"].')
        return (), decimation
    declared = {**findings.table(document, "instances"), **findings.table(document, "signals")}
    result: dict[tuple[str, str], None] = {}
    for pattern in cast("Sequence[object]", patterns):
        for entry in _recorded(pattern, ports, declared, findings):
            result[entry] = None
    return tuple(result), decimation


def _recorded(
    pattern: object, ports: Mapping[str, Ports], declared: Mapping[str, Any], findings: Findings
) -> Iterator[tuple[str, str]]:
    where = "record.variables"
    if not isinstance(pattern, str):
        findings.problem(where, f"{show_value(pattern)} is not a text.")
        return
    name, _, variable = pattern.partition(".")
    # An exact name that contains * or ? goes before a pattern.
    exact = name in ports and variable in ports[name].variables
    if not exact and ("*" in pattern or "?" in pattern):
        matching = list(_matching(pattern, ports))
        if not matching and ports:
            findings.problem(where, f"'{pattern}' matches no input, output or local variable.")
        yield from matching
    elif name not in ports:
        if name not in declared:
            findings.problem(where, f"'{pattern}': no instance '{name}'.{suggest(name, declared)}")
    elif not exact and variable in ports[name].arrays:
        for element in ports[name].arrays[variable].elements:
            yield from _recorded(f"{name}.{element}", ports, declared, findings)
    elif not exact:
        port = ports[name]
        hint = suggest_variable(variable, port.variables.values(), port.arrays)
        findings.problem(where, f"'{pattern}': {port.name} has no variable '{variable}'.{hint}")
    elif not is_numeric(ports[name].variables[variable]):
        kind = ports[name].variables[variable].type
        findings.problem(where, f"'{pattern}' is a {kind}; only numbers are recorded.")
    else:
        yield name, variable


def _matching(pattern: str, ports: Mapping[str, Ports]) -> Iterator[tuple[str, str]]:
    """All numeric inputs, outputs and local variables that can change and match a pattern with * and ?."""
    expression = re.compile(re.escape(pattern).replace(r"\*", ".*").replace(r"\?", "."), re.DOTALL)
    for name, port in ports.items():
        for variable in port.variables.values():
            varies = variable.causality in ("input", "output", "local") and variable.variability != "constant"
            if varies and is_numeric(variable) and expression.fullmatch(f"{name}.{variable.name}"):
                yield name, variable.name
