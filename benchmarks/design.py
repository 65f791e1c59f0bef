"""Design tools: learning of an axis, an 18-point map of stability limits, a large sweep on one and two workers.

    python benchmarks/design.py [--runs 10000]

Needs the FMUs in build/fmus/native. Targets: learning of one axis (782 runs) within 6 s on one core, the map within
3 s; in a sweep of a 0.6 s loop two workers do at least 1.8 times the runs of one, what is not spent in runs is at
most 5 % a worker, and memory does not grow.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import psutil

from cosim.design.plan import make_sweep
from cosim.design.pulse import MONITORED, learn_friction_pulse, log_interpolated
from cosim.design.reversals import LEAD_IN
from cosim.design.stability import limit_map, read_map
from cosim.design.sweep import SweepProgress, sweep

STUDIES = Path(__file__).parents[1] / "studies"


def learning() -> None:
    """Two axes one after the other on one thread, then on two."""
    for workers in (1, 2):
        for axis in "xy":
            begun, busy = time.perf_counter(), time.process_time()
            learned = learn_friction_pulse(STUDIES / "feng2015" / "circle.toml", axis, workers=workers)
            seconds, busy = time.perf_counter() - begun, time.process_time() - busy
            steps = sum(
                count * (LEAD_IN + MONITORED * log_interpolated(a, learned.t_c)) / 2.5e-4
                for a, count in ((float(a), 11) for a in learned.accelerations)
            )
            runs = sum(learned.runs.values())
            print(
                f"learning, axis {axis}, {workers} threads: {runs} runs in {seconds:.2f} s, "
                f"{busy:.2f} s of processor (target 6 s on one core); {steps:.3g} control steps would be the 275 fine "
                "runs alone if each began at its start"
            )


def limits() -> None:
    """The 18 points of the friction map."""
    file = read_map(STUDIES / "maeda2008" / "limits" / "friction.toml")
    begun, busy = time.perf_counter(), time.process_time()
    found = limit_map(file.system, file.cases, K=file.K)
    seconds, busy = time.perf_counter() - begun, time.process_time() - busy
    print(
        f"map: {len(found.points)} points, {found.runs} runs of 0.6 s in {seconds:.2f} s, {busy:.2f} s of processor "
        "(target 3 s)"
    )


def processor_seconds() -> float:
    """Of this process and its children."""
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return sum(sum(process.cpu_times()[:2]) for process in processes)


class Memory:
    """Resident memory of the workers, MB, at a quarter of the sweep and at its end."""

    def __init__(self) -> None:
        self.readings: dict[str, float] = {}
        self.started: tuple[float, int] | None = None

    def __call__(self, progress: SweepProgress) -> None:
        if progress.done and self.started is None:
            self.started = time.perf_counter(), progress.done
        for name, share in (("quarter", 0.25), ("end", 0.97)):
            if progress.done >= share * progress.total and name not in self.readings:
                children = psutil.Process().children(recursive=True)
                self.readings[name] = sum(child.memory_info().rss for child in children) / 1e6


def sweeps(runs: int) -> None:
    """The same sweep on one worker and on two; start-up of the cluster is not counted, it is told."""
    rates: dict[int, float] = {}
    effort: dict[int, float] = {}
    for workers in (1, 2):
        document = {
            "system": "gain.toml",
            "method": "sobol",
            "count": runs,
            "parameters": {
                "controller.K_P": {"from": 400.0, "to": 2000.0},
                "plant.sigma_1": {"from": 0.05, "to": 0.1},
            },
            "metrics": {"swing": {"of": "peak_to_peak", "signal": "plant.position"}},
        }
        plan = make_sweep(document, folder=STUDIES / "maeda2008")
        memory = Memory()
        with tempfile.TemporaryDirectory() as folder:
            begun = time.perf_counter()
            ends: list[tuple[float, int, float]] = []

            def seen(
                progress: SweepProgress, memory: Memory = memory, ends: list[tuple[float, int, float]] = ends
            ) -> None:
                memory(progress)
                ends.append((time.perf_counter(), progress.done, processor_seconds()))

            outcome = sweep(plan, Path(folder) / "data", workers=workers, progress=seen)
        assert memory.started is not None
        first, done = memory.started
        last = ends[-1][0]
        begin = next(busy for _, count, busy in ends if count)
        effort[workers] = (ends[-1][2] - begin) / (runs - done)
        rates[workers] = (runs - done) / (last - first)
        share = outcome.run_seconds * (runs - done) / runs / workers / (last - first)
        print(
            f"sweep, {workers} workers: {runs} runs of 0.6 s, {rates[workers]:.0f} runs/s, "
            f"{100.0 * (1.0 - share):.1f} % not spent in runs (target 5 %), start-up {first - begun:.1f} s, "
            f"memory of the workers {memory.readings.get('quarter', 0.0):.0f} MB at a quarter, "
            f"{memory.readings.get('end', 0.0):.0f} MB at the end"
        )
    print(
        f"sweep: two workers do {rates[2] / rates[1]:.2f} times the runs of one (target 1.8, both cores free); a run "
        f"costs {1e3 * effort[1]:.2f} ms of processor with one worker, {1e3 * effort[2]:.2f} ms with two"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--runs", type=int, default=10000)
    options = parser.parse_args()
    learning()
    limits()
    sweeps(options.runs)
