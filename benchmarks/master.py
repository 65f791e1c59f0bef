"""Overhead of the master an instance and step, against a C program making the same calls and against other masters.

Two trivial FMUs (the probe of the tests), coupled y -> u both ways, both outputs recorded. All runs take turns, so
that a busy machine slows all alike; the figures are medians of 5 turns. A turn of the C program and of cosim is the
best of 5 runs.

``--install-peers`` makes an environment with the other masters in ``build/peers``; those missing are said to be.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.table import Table

from cosim import Simulation, make_system

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from figures import Kept, keep  # noqa: E402
from fmu_files import Variable, probe_library, write_fmu  # noqa: E402
from peers import PEERS  # noqa: E402
from programs import compile_c  # noqa: E402

ENVIRONMENT = ROOT / "build" / "peers"
PACKAGES = ("fmu-manipulation-toolbox", "ecospy", "cofmupy")
TURNS = 5
REPEATS = 5
STEPS = 1_000_000
PEER_STEPS = 100_000
VARIABLES = (
    Variable("u", "input", 0, start="0.0"),
    Variable("y", "output", 1),
    Variable("y_start", "parameter", 5, start="0.0"),
)


def peers_python() -> Path | None:
    """The interpreter that has the peers, None if there is none yet."""
    found = [ENVIRONMENT / "bin" / "python", ENVIRONMENT / "Scripts" / "python.exe"]
    return next((path for path in found if path.exists()), None)


def install_peers() -> None:
    """In an environment of their own: cofmupy pins old versions of what this project needs."""
    subprocess.run([sys.executable, "-m", "venv", str(ENVIRONMENT)], check=True)
    for package in PACKAGES:
        subprocess.run([str(peers_python()), "-m", "pip", "install", "--quiet", package], check=False)


def peer(name: str, folder: Path) -> tuple[float, str]:
    """Microseconds an instance and step, or why there is no figure."""
    python = peers_python()
    if python is None:
        return float("nan"), "not installed (--install-peers)"
    command = [str(python), str(Path(__file__).with_name("peers.py")), name, str(folder), str(PEER_STEPS)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = run.stdout.splitlines()
    answer = json.loads(lines[-1]) if run.returncode == 0 and lines else {"missing": run.stderr.strip()[-200:]}
    if "seconds" not in answer:
        return float("nan"), f"not installed: {answer['missing']}"
    return float(answer["seconds"]) / float(answer["steps"]) / 2.0 * 1e6, ""


def start_up(folder: Path) -> list[float]:
    """Processor time in seconds of a whole ``cosim run`` of one step, imports included."""
    system = folder / "one.toml"
    system.write_text(
        'connections = ["a.y -> b.u", "b.y -> a.u"]\n[experiment]\nstop_time = 0.1\nstep_size = 0.1\n'
        '[instances.a]\nfmu = "a.fmu"\n[instances.b]\nfmu = "b.fmu"\n',
        encoding="utf-8",
    )
    seconds: list[float] = []
    # Python keeps its bytecode, as it does for a user.
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, "-m", "cosim", "run", str(system)]
    for _ in range(TURNS + 1):
        before = os.times()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
        after = os.times()
        seconds.append(sum(after[2:4]) - sum(before[2:4]))
    return seconds[1:]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--install-peers", action="store_true", help="install the other masters in build/peers first")
    if parser.parse_args().install_peers:
        install_peers()
    figures: dict[str, list[float]] = {}
    remarks: dict[str, str] = {}
    with TemporaryDirectory() as place:
        folder = Path(place)
        library = probe_library()
        for name in "ab":
            write_fmu(folder / f"{name}.fmu", VARIABLES, binary=library.read_bytes())
        floor = compile_c(folder / "floor", str(Path(__file__).with_name("floor.c")), "-ldl")
        document = {
            "connections": ["a.y -> b.u", "b.y -> a.u"],
            "experiment": {"stop_time": STEPS // 10, "step_size": 0.1},
            "instances": {"a": {"fmu": "a.fmu", "start": {"y_start": 1.0}}, "b": {"fmu": "b.fmu"}},
        }
        with Simulation(make_system(document, folder=folder)) as simulation:
            for _ in range(TURNS):
                seconds: dict[str, list[float]] = {"C program, same calls": [], "cosim": []}
                for _ in range(REPEATS):
                    command = [str(floor), str(library), str(STEPS)]
                    run = subprocess.run(command, capture_output=True, text=True, check=True)
                    seconds["C program, same calls"].append(float(run.stdout))
                    result = simulation.run()
                    assert result.names == ("a.y", "b.y")
                    seconds["cosim"].append(result.metadata["stepping_seconds"])
                for name, values in seconds.items():
                    figures.setdefault(name, []).append(min(values) / STEPS / 2 * 1e6)
                for name in PEERS:
                    if name not in remarks:
                        value, remark = peer(name, folder)
                        figures.setdefault(name, []).append(value)
                        if remark:
                            remarks[name] = remark
        starts = start_up(folder)

    table = Table(title="Overhead of masters, two trivial FMUs")
    for heading in ("Master", "us an instance and step", "best", "times cosim", ""):
        table.add_column(heading, justify="left" if heading in ("Master", "") else "right")
    own = statistics.median(figures["cosim"])
    for name, values in figures.items():
        median = statistics.median(values)
        table.add_row(name, f"{median:.4f}", f"{min(values):.4f}", f"{median / own:.3g}", remarks.get(name, ""))
    console = Console(width=140)
    console.print(table)
    ratio = min(figures["cosim"]) / min(figures["C program, same calls"])
    turns = [a / b for a, b in zip(figures["cosim"], figures["C program, same calls"], strict=True)]
    console.print(f"cosim / C program: {ratio:.2f} (best), {statistics.median(turns):.2f} (median of turns); limit 1.2")
    console.print(
        f"cosim run of one step, warm, imports included: {statistics.median(starts):.2f} s processor; limit 0.3 s"
    )
    measured = {
        name: statistics.median(a / b for a, b in zip(values, figures["cosim"], strict=True))
        for name, values in figures.items()
        if name not in remarks
    }
    keep(
        "master",
        Kept(
            "Overhead of masters",
            "Two trivial FMUs, coupled both ways, both outputs recorded: what a master needs for an instance and a "
            "step, as a multiple of cosim. The C program makes the same FMI calls and nothing else. All take turns; "
            f"medians of {TURNS} turns.",
            ("Master", "Times cosim"),
            [(name, float(f"{value:.3g}")) for name, value in sorted(measured.items(), key=lambda entry: entry[1])],
            {"ratio_to_c": round(statistics.median(turns), 2), "start_up": round(statistics.median(starts), 2)},
        ),
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
