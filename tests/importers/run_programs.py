"""Programs built elsewhere, whose path is given: each function runs one job and gives its rows."""

from __future__ import annotations

import csv
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

Job = dict[str, Any]
Rows = list[list[float]]


def _run(command: list[str], folder: Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    said = done.stdout + done.stderr
    if done.returncode:
        raise RuntimeError(f"exit code {done.returncode}: {said[-300:]}")
    return said


def _table(path: Path) -> list[dict[str, float]]:
    with path.open(newline="") as file:
        return [
            {name.strip(): float(value) for name, value in row.items()} for row in csv.DictReader(file, strict=True)
        ]


def version(importer: str, program: str) -> str:
    """What the program says of its version."""
    option = {"fmu-check": "-v"}.get(importer, "--version")
    done = subprocess.run([program, option], capture_output=True, text=True, check=False)
    found = re.search(r"v?\d+\.\d+[^\s]*( \([0-9a-f]+\))?", done.stdout + done.stderr)
    return found[0] if found else ""


def fmusim(job: Job) -> Rows:
    """fmusim of the Reference FMUs, co-simulation; FMI 2.0 and 3.0."""
    return _fmusim(job, ["--interface-type", "cs"])


def fmusim_events(job: Job) -> Rows:
    """fmusim with the event mode of FMI 3.0."""
    return _fmusim(job, ["--interface-type", "cs", "--event-mode-used"])


def fmusim_exchange(job: Job) -> Rows:
    """fmusim, model exchange with CVode."""
    return _fmusim(job, ["--interface-type", "me", "--solver", "cvode", "--tolerance", "1e-8"])


def _fmusim(job: Job, options: list[str]) -> Rows:
    with tempfile.TemporaryDirectory() as name:
        command = [job["program"], *options, "--output-file", "result.csv", "--output-interval", repr(job["step"])]
        command += ["--stop-time", repr(job["steps"] * job["step"])]
        for variable, value in job["inputs"].items():
            command += ["--start-value", variable, repr(value)]
        for variable in job.get("variables", job["outputs"]):
            command += ["--output-variable", variable]
        _run([*command, job["path"]], Path(name))
        with Path(name, "result.csv").open(newline="") as file:
            table = [row for row in csv.reader(file, strict=True) if row]
    times = {round(float(row[0]) / job["step"]): row for row in table[1:]}
    # an array is one column, its elements set apart by blanks
    return [[float(text) for cell in times[k + 1][1:] for text in cell.split()] for k in range(job["steps"])]


def fmu_check(job: Job) -> Rows:
    """FMUComplianceChecker: runs co-simulation, and any warning or error of it or FMILibrary is an error."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stop = job["steps"] * job["step"]
        inputs = ",".join(["time", *job["inputs"]])
        held = ",".join(repr(value) for value in job["inputs"].values())
        lines = [f"{time!r},{held}" if held else repr(time) for time in (0.0, stop)]
        (folder / "inputs.csv").write_text("\n".join([inputs, *lines, ""]), encoding="utf-8")
        command = [job["program"], "-k", "xml", "-k", "cs", "-l", "4", "-h", repr(job["step"]), "-n", "0"]
        command += ["-s", repr(stop), "-o", "result.csv", "-e", "log.txt"]
        command += ["-i", "inputs.csv"] if held else []
        _run([*command, job["path"]], folder)
        log = (folder / "log.txt").read_text(encoding="utf-8", errors="replace").splitlines()
        # asked for the optional tolerance of DefaultExperiment, FMILibrary warns that there is none
        usual = "fmi2_xml_get_default_experiment_tolerance"
        wrong = [x for x in log if x.startswith(("[WARNING]", "[ERROR]", "[FATAL]")) and usual not in x]
        if wrong:
            raise RuntimeError("; ".join(wrong)[:300])
        table = _table(folder / "result.csv")
    times = {round(row["time"] / job["step"]): row for row in table}
    return [[times[k + 1][output] for output in job["outputs"]] for k in range(job["steps"])]


def omsimulator(job: Job) -> Rows:
    """OMSimulator's program with its fixed-step (Jacobi) master: one FMU, or a whole SSP; the values after inputs."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # it adds up times, and where their sum misses the end it makes a last step of 1e-19 s: end between two steps
        stop = (job["steps"] + 1.25) * job["step"]
        command = [job["program"], "--resultFile=result.csv", f"--stopTime={stop!r}", f"--stepSize={job['step']!r}"]
        command += [f"--intervals={job['steps']}", "--tolerance=5e-9", "--mode=cs"]
        said = _run([*command, job["path"]], folder)
        if "error:" in said:
            raise RuntimeError(next(line for line in said.splitlines() if "error:" in line))
        table = _table(folder / "result.csv")
    prefix = ""
    if job["kind"] == "system":
        first = job["outputs"][0]
        prefix = next(column for column in table[0] if column.endswith(f".system.{first}")).removesuffix(first)
    times = {round(row["time"] / job["step"]): row for row in table}
    return [[times[k + 1][prefix + output] for output in job["outputs"]] for k in range(job["steps"])]
