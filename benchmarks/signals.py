"""What a record costs: a run of 1e6 steps whose reference is a record of 1e6 rows, and the same fed by an FMU.

A loop of controller and ballscrew stage follows a sine. First the source is the FMU Trajectory, and the run is written
as CSV; then the record replaces the source, held or interpolated, without and with noise on the measured position. The
kinds of run take turns; the figures are medians of processor time. ``share`` is the part of the run that is spent on
filling the table of values. The record held gives the same bits as the FMU, which is checked. Reading the file is timed
apart: it is done once a process, for all runs.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from cosim import Simulation, make_system
from cosim.master.tables import Tables
from cosim.record.read import read_record

TURNS = 5
LOOP = ["plant.position -> controller.position", "controller.command -> plant.command"]
DIRECT = ["source.position -> controller.position_ref", "source.velocity -> controller.velocity_ref", *LOOP]
FED = ["log.position -> controller.position_ref", "log.velocity -> controller.velocity_ref", *LOOP]
NOISE = {"from": "plant.position", "to": "controller.position", "noise": {"rms": 2e-9, "seed": 1}}
KINDS: dict[str, tuple[list[Any], str]] = {
    "FMU as source": (DIRECT, ""),
    "record, hold": (FED, "hold"),
    "record, linear": (FED, "linear"),
    "record, hold, and noise": ([*FED[:2], NOISE, LOOP[1]], "hold"),
}
INSTANCES = {
    "source": {"fmu": "Trajectory"},
    "controller": {"fmu": "CascadePid", "start": {"T_s": "1/10000"}},
    "plant": {"fmu": "BallscrewStage"},
}
COLUMNS = {name: {"column": f"source.{name}", "unit": unit} for name, unit in (("position", "m"), ("velocity", "m/s"))}


def document(kind: str, rows: int) -> dict[str, Any]:
    connections, interpolation = KINDS[kind]
    used = INSTANCES if not interpolation else {name: INSTANCES[name] for name in ("controller", "plant")}
    log = {"file": "log.csv", "interpolation": interpolation, "columns": COLUMNS}
    return {
        "connections": connections,
        "experiment": {"stop_time": f"{rows - 1}/10000", "step_size": "1/10000"},
        "instances": used,
        "record": {"variables": ["plant.position"]},
        **({"signals": {"log": log}} if interpolation else {}),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    rows = parser.parse_args().rows
    spent = 0.0
    fill = Tables.fill

    def timed(tables: Tables, first: int, last: int) -> None:
        nonlocal spent
        begun = time.process_time()
        fill(tables, first, last)
        spent += time.process_time() - begun

    Tables.fill = timed  # pyright: ignore[reportAttributeAccessIssue]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        direct = make_system(document("FMU as source", rows), folder=folder)
        with Simulation(direct) as simulation:
            simulation.run(direct.changed(record=["source.position", "source.velocity"])).save(path)
        begun = time.perf_counter()
        read_record(path)
        reading = time.perf_counter() - begun
        systems = {kind: make_system(document(kind, rows), folder=folder) for kind in KINDS}
        seconds: dict[str, list[float]] = {kind: [] for kind in KINDS}
        shares: dict[str, list[float]] = {kind: [] for kind in KINDS}
        positions: dict[str, bytes] = {}
        for _ in range(TURNS):
            for kind, system in systems.items():
                with Simulation(system) as simulation:
                    spent = 0.0
                    begun = time.process_time()
                    result = simulation.run()
                    seconds[kind].append(time.process_time() - begun)
                shares[kind].append(spent / seconds[kind][-1])
                positions[kind] = np.ascontiguousarray(result["plant.position"]).tobytes()
    assert positions["record, hold"] == positions["FMU as source"]
    table = Table("run", "s", "us a step", "ratio", "share", title=f"{rows} steps; reading the file {reading:.2f} s")
    plain = statistics.median(seconds["FMU as source"])
    for kind, found in seconds.items():
        middle, share = statistics.median(found), statistics.median(shares[kind])
        table.add_row(kind, f"{middle:.3f}", f"{1e6 * middle / rows:.2f}", f"{middle / plain:.3f}", f"{share:.1%}")
    Console().print(table)


if __name__ == "__main__":
    main()
