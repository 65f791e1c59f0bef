"""What is said and kept when an FMU fails: measured with an FMU that fails on purpose; and who does what, drawn."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cosim
from cosim.result.plots import COLOURS, save

from .markup import table

SOURCE = """
import os

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real, String


class Failing(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y, self.failure = 0.0, "none"
        self.register_variable(Real("y", causality=Fmi2Causality.output))
        self.register_variable(
            String("failure", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
        )

    def do_step(self, t, h):
        self.y = t + h
        if t >= 0.5:
            if self.failure == "exit":
                os._exit(0)
            if self.failure == "abort":
                os.abort()
            while self.failure == "loop":
                pass
            raise ValueError("a table ends at 0.5")
        return True
"""
"""PythonFMU makes an FMU of it: FMI code that nobody here wrote, failing in its fifth step."""
FAILURES = {
    "raise": "raises an exception, which PythonFMU turns into fmi2Fatal",
    "abort": "crashes (`abort`, as a failed assertion in C does)",
    "exit": "ends its process, with exit code 0",
    "loop": "never comes back; limit of a call: 1 s",
}


def measured(pictures: Path) -> dict[str, Any]:
    """A table of failures; draws processes.svg."""
    draw_processes(pictures / "processes.svg")
    rows: list[tuple[str, str, str]] = []
    with TemporaryDirectory() as text:
        folder = Path(text)
        (folder / "failing.py").write_text(SOURCE, encoding="utf-8")
        command = [sys.executable, "-m", "pythonfmu", "build", "-f", "failing.py"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        for failure, told in FAILURES.items():
            document = {
                "experiment": {"stop_time": 1.0, "step_size": 0.1},
                "instances": {"axis": {"fmu": "Failing.fmu", "start": {"failure": failure}}},
            }
            try:
                cosim.simulate(cosim.make_system(document, folder=folder), isolated=True, timeout=1.0)
            except cosim.RunError as error:
                kept = error.result
                assert kept is not None
                rows.append((told, str(error), f"{len(kept.time)}, up to {kept.time[-1]:g} s"))
            else:
                raise AssertionError(f"the FMU did not fail: {failure}")
    return {"failures": table(("The FMU, in the step from 0.5 s", "What is said", "Rows kept"), rows)}


def draw_processes(path: Path) -> None:
    """Two processes, the memory between them, and what goes over."""

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        axes.set(xlim=(0, 10), ylim=(0, 5.4))
        axes.axis("off")
        boxes = (
            (
                0.1,
                0.4,
                3.1,
                4.4,
                COLOURS[0],
                "Your process",
                "reads and checks the system\nwatches: ended? too long?\nCtrl-C, time limit\nwrites the output",
            ),
            (4.0, 1.7, 2.0, 3.1, COLOURS[6], "Shared memory", "rows\nstate of the loop\nthe present call"),
            (
                6.8,
                0.4,
                3.1,
                4.4,
                COLOURS[1],
                "Process of the FMUs",
                "loads the FMUs\ninitializes them\nsteps them (loop in C)\nfrees them",
            ),
        )
        for x, y, width, height, colour, head, text in boxes:
            from matplotlib.patches import FancyBboxPatch

            axes.add_patch(
                FancyBboxPatch(
                    (x, y), width, height, boxstyle="round,pad=0.05", edgecolor=colour, facecolor="none", linewidth=1.8
                )
            )
            axes.text(x + width / 2, y + height - 0.35, head, ha="center", va="center", weight="bold", color=colour)
            axes.text(x + width / 2, y + (height - 0.6) / 2, text, ha="center", va="center", linespacing=1.7)
        arrow = {"arrowstyle": "-|>", "color": "#333333", "linewidth": 1.4}
        for end, begin, text, y in (
            ((6.05, 3.3), (6.75, 3.3), "writes", 3.42),
            ((3.25, 3.3), (3.95, 3.3), "reads", 3.42),
        ):
            axes.annotate("", end, begin, arrowprops=arrow)
            axes.text((end[0] + begin[0]) / 2, y, text, ha="center", va="bottom", fontsize=8)
        axes.annotate("", (3.25, 1.1), (6.75, 1.1), arrowprops=arrow)
        axes.text(5.0, 1.18, "pipes: messages, printed text", ha="center", va="bottom", fontsize=8)
        axes.annotate("", (6.75, 0.6), (3.25, 0.6), arrowprops=arrow)
        axes.text(5.0, 0.52, "stop, or kill", ha="center", va="top", fontsize=8)

    save(path, draw, (7.6, 3.6))
