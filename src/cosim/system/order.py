"""The order in which instances are evaluated at a communication point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .parts import Instance


def feedthrough(
    instances: Mapping[str, Instance], connected: Mapping[tuple[str, str], tuple[str, str]]
) -> dict[tuple[str, str], tuple[tuple[str, str], ...]]:
    """The outputs that depend directly on connected inputs, with these inputs."""
    outputs: dict[tuple[str, str], tuple[tuple[str, str], ...]] = {}
    for name, instance in instances.items():
        for output, inputs in instance.fmu.dependencies.items():
            wired = tuple((name, i) for i in inputs if (name, i) in connected)
            if wired:
                outputs[name, output] = wired
    return outputs


def evaluation_order(
    names: Sequence[str],
    outputs: Mapping[tuple[str, str], tuple[tuple[str, str], ...]],
    connected: Mapping[tuple[str, str], tuple[str, str]],
) -> tuple[str, ...]:
    """Instances in the order of their feedthrough, which has no loop.

    An instance comes once all its inputs are known. Where two instances need each other through different
    variables, one comes twice: first for the outputs it can give.
    """
    pending = set(outputs)
    waiting = list(names)
    visits: list[str] = []

    def complete(name: str) -> bool:
        return not any(target[0] == name and source in pending for target, source in connected.items())

    def known(name: str) -> set[tuple[str, str]]:
        own = {output for output in pending if output[0] == name}
        return {output for output in own if not any(connected[needed] in pending for needed in outputs[output])}

    while waiting:
        name = next(filter(complete, waiting), None)
        if name is not None:
            waiting.remove(name)
        else:
            name = next(filter(known, waiting))
        pending -= known(name)
        visits.append(name)
    return tuple(visits)
