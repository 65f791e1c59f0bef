"""The order in which instances are evaluated at a communication point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import cast

from .findings import Findings
from .parts import Connection, Instance, Order, sources

Sources = Mapping[tuple[str, str], tuple[tuple[str, str], ...]]
"""For each connected input, the outputs that feed it."""


def feedthrough(
    instances: Mapping[str, Instance], connected: Sources
) -> dict[tuple[str, str], tuple[tuple[str, str], ...]]:
    """For each output that depends directly on connected inputs, these inputs."""
    outputs: dict[tuple[str, str], tuple[tuple[str, str], ...]] = {}
    for name, instance in instances.items():
        for output, inputs in instance.fmu.dependencies.items():
            wired = tuple((name, i) for i in inputs if (name, i) in connected)
            if wired:
                outputs[name, output] = wired
    return outputs


def feedthrough_order(
    names: Sequence[str],
    outputs: Mapping[tuple[str, str], tuple[tuple[str, str], ...]],
    connected: Sources,
) -> tuple[str, ...]:
    """Instances in the order of their feedthrough. There must be no algebraic loop.

    An instance comes as soon as all its inputs are known. If two instances need each other through different
    variables, one of them comes twice: the first time for the outputs that it can already give.
    """
    pending = set(outputs)
    waiting = list(names)
    visits: list[str] = []

    def complete(name: str) -> bool:
        feeding = (source for target, ends in connected.items() if target[0] == name for source in ends)
        return not any(source in pending for source in feeding)

    def known(name: str) -> set[tuple[str, str]]:
        own = {output for output in pending if output[0] == name}
        return {
            output
            for output in own
            if not any(source in pending for needed in outputs[output] for source in connected[needed])
        }

    while waiting:
        name = next(filter(complete, waiting), None)
        if name is not None:
            waiting.remove(name)
        else:
            name = next(filter(known, waiting))
        pending -= known(name)
        visits.append(name)
    return tuple(visits)


def find_loop(instances: Mapping[str, Instance], connected: Sources) -> list[tuple[str, str]]:
    """An algebraic loop through inputs and outputs, empty if there is none."""
    graph = {**feedthrough(instances, connected), **connected}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return cast("list[tuple[str, str]]", error.args[1])
    return []


def evaluation_order(
    instances: Mapping[str, Instance], connections: Sequence[Connection], order: Order, findings: Findings
) -> tuple[str, ...]:
    """The order in which instances get their inputs and give their feedthrough outputs at a communication point."""
    connected = sources(connections)
    outputs = feedthrough(instances, connected)
    if isinstance(order, tuple):
        _late(instances, connections, outputs, order, findings)
        return order
    loop = find_loop(instances, connected)
    if not loop:
        return feedthrough_order(list(instances), outputs, connected)
    if order != "parallel":
        findings.problem(
            "connections",
            f"algebraic loop: {' -> '.join('.'.join(end) for end in loop)}. Each depends directly on the one before; "
            "put a component without feedthrough between, or name all instances in order = [...], or take "
            'order = "parallel" (one step of delay).',
        )
    return tuple(instances)


def _late(
    instances: Mapping[str, Instance],
    connections: Sequence[Connection],
    outputs: Mapping[tuple[str, str], tuple[tuple[str, str], ...]],
    order: Sequence[str],
    findings: Findings,
) -> None:
    """Note each connection that is delayed by one step because of a given order."""
    for connection in connections:
        source, target = connection.source, connection.target
        if source not in outputs or order.index(source[0]) < order.index(target[0]):
            continue
        where = f"connection {connection}"
        unstated = source[1] in instances[source[0]].fmu.unstated
        if source[0] == target[0]:
            silent = "its file does not say on which inputs its output depends"
            why = silent if unstated else "its output depends directly on it"
            findings.note(where, f"one step of delay: {source[0]} feeds itself, and {why}.")
        elif unstated:
            findings.note(
                where,
                f"one step of delay: {source[0]} comes after {target[0]} in the order, and its file does not say on "
                f"which inputs its output depends, so all count. Put {source[0]} before {target[0]}. If you know that "
                "the output depends directly on none, there is no delay.",
            )
        else:
            findings.note(
                where,
                f"one step of delay: {source[0]} comes after {target[0]} in the order, and its output depends "
                f"directly on its inputs. Put {source[0]} before {target[0]}.",
            )
