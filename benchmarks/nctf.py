"""One second of the NCTF loop at 5 kHz: time, integration steps, evaluations, and what the time goes to.

Every step of the study is run for 1 s of simulated time: trajectory, controller with an NCT of 128 nodes, compliant
ballscrew, three columns recorded. Printed is the fastest of 100 runs (the machine may be shared), its ratio to real
time and to the 8 ms a second that are asked for, and the integrator's counters for one sample. The last table runs
parts of the system, at 20 mm: what a part adds is its cost.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from cosim import read_system
from cosim.master.simulation import Simulation
from cosim.result.result import Result
from cosim.system.system import System, make_system

ROOT = Path(__file__).resolve().parents[1]
SYSTEM = ROOT / "studies" / "maeda2008" / "step.toml"
FMUS = ROOT / "build" / "fmus" / "native"
STEPS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 2e-2)
SAMPLES = 5000
REPEATS = 100
TARGET = 8e-3


def fastest(system: System) -> tuple[float, Result]:
    """Seconds of stepping of the fastest run, and the result of the last."""
    with Simulation(system) as simulation:
        results = [simulation.run() for _ in range(REPEATS)]
    return min(float(result.metadata["stepping_seconds"]) for result in results), results[-1]


def part(instances: tuple[str, ...], document: dict[str, Any]) -> System:
    """The system with some of its instances only."""
    kept = {name: document["instances"][name] for name in instances}
    connections = [
        text for text in document["connections"] if all(end.split(".")[0] in instances for end in text.split(" -> "))
    ]
    experiment = document["experiment"] | {"order": list(instances)}
    record = {"variables": [f"{name}.{'command' if name == 'controller' else 'position'}" for name in instances]}
    small = {"connections": connections, "experiment": experiment, "instances": kept, "record": record}
    return make_system(small, name="part", folder=SYSTEM.parent, fmus=FMUS)


def main() -> None:
    """Measure and print."""
    console = Console(width=100)
    table = Table(title=f"1 s of closed loop at 5 kHz, native FMUs (fastest of {REPEATS}; counts for one sample)")
    for head in (
        "step / m",
        "time / ms",
        "x real time",
        "of 8 ms",
        "steps",
        "rejected",
        "evaluations",
    ):
        table.add_column(head, justify="right")
    system = read_system(SYSTEM, fmus=FMUS)
    for amplitude in STEPS:
        seconds, result = fastest(system.changed({"trajectory.amplitude": amplitude}))
        solver = result.solver["plant"]
        table.add_row(
            f"{amplitude:g}",
            f"{1e3 * seconds:.2f}",
            f"{1.0 / seconds:.0f}",
            f"{seconds / TARGET:.2f}",
            *(f"{solver[name] / SAMPLES:.2f}" for name in ("steps", "rejected", "rhs_evaluations")),
        )
    console.print(table)

    document = dict(system.document)
    parts = (("trajectory",), ("trajectory", "controller"), ("trajectory", "controller", "plant"))
    table = Table(title="What the time goes to, step of 20 mm")
    for head in ("instances", "time / ms", "the last adds, ns a sample", "share"):
        table.add_column(head, justify="left" if head == "instances" else "right")
    times = [fastest(part(instances, document))[0] for instances in parts]
    for instances, seconds, before in zip(parts, times, [0.0, *times], strict=False):
        added = seconds - before
        table.add_row(
            ", ".join(instances), f"{1e3 * seconds:.2f}", f"{1e9 * added / SAMPLES:.0f}", f"{added / times[-1]:.0%}"
        )
    evaluations = result.solver["plant"]["rhs_evaluations"]
    table.caption = f"plant: {1e9 * (times[-1] - times[-2]) / evaluations:.0f} ns an evaluation of its derivatives"
    console.print(table)


if __name__ == "__main__":
    main()
