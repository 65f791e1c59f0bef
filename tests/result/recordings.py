"""Results made by hand: what a run would have given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.record.description import Column
from cosim.result.result import Message, Result

Array = NDArray[np.float64]

METADATA: Mapping[str, Any] = {
    "system": "stage.toml",
    "description": "A stage <b>on</b> a table",
    "system_digest": "c0ffee" * 10,
    "start_time": 0.0,
    "stop_time": 1.0,
    "step_size": 1e-3,
    "order": ["t", "c", "p"],
    "evaluation_order": ["t", "c", "p"],
    "decimation": 1,
    "steps": 1000,
    "connections": ["t.position -> c.position_ref", "p.position -> c.position", "c.command -> p.command"],
    "wires": [
        {"from": ["t", "position"], "to": ["c", "position_ref"], "units": ["m", "m"], "factor": 1.0},
        {"from": ["p", "angle"], "to": ["c", "position"], "units": ["rad", "m"], "factor": 0.0016},
        {"from": ["c", "command"], "to": ["p", "command"], "units": ["N.m", "N.m"], "factor": 1.0},
    ],
    "fmus": {
        name: {"fmu": fmu, "digest": name * 64, "fmi": 2, "version": "0.1", "description": f"{fmu} & more"}
        for name, fmu in (("t", "Trajectory"), ("c", "Fuzzy"), ("p", "Stage"))
    },
    "start_values": {
        "p.m": {"value": 70.0, "fmu": 62.4, "unit": "kg"},
        "t.kind": {"value": "sine", "fmu": "step", "unit": ""},
        **{f"p.error[{i}]": {"value": 1e-6 * i, "fmu": 0.0, "unit": "m"} for i in range(1, 11)},
    },
    "notes": ["p.load is not connected"],
    "versions": {"motion-cosim": "0.1.0"},
}


def result(
    time: Array, columns: Mapping[str, tuple[Array, str]], *, messages: Sequence[Message] = (), **more: Any
) -> Result:
    """The result of a run with these columns: name -> (values, unit); ``more`` goes into its metadata."""
    return Result(
        time,
        np.column_stack([values for values, _ in columns.values()]),
        tuple(Column(name, unit, f"Text of {name}", unit) for name, (_, unit) in columns.items()),
        partial=False,
        messages=tuple(messages),
        dropped_messages=0,
        solver={"p": {"steps": 1100.0, "rejected": 3.0}},
        metadata={**METADATA, **more},
    )


def stage(rows: int = 1001, stop: float = 1.0) -> Result:
    """A loop with an error of 1 um and a command."""
    time = np.linspace(0.0, stop, rows)
    reference = 5e-3 * np.sin(2.0 * np.pi * time / stop)
    error = 1e-6 * np.cos(20.0 * np.pi * time / stop)
    return result(
        time,
        {
            "t.position": (reference, "m"),
            "p.position": (reference + error, "m"),
            "c.command": (np.sign(np.cos(2.0 * np.pi * time / stop)), "N.m"),
        },
    )
