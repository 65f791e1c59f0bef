"""clang-tidy over the C runtime as FMUs compile it: ``python -m tests.tidy``. Exit code 1 if it finds anything."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

from cosim.export.compile import RUNTIME
from cosim.export.contract import Fmi, header
from cosim.export.model_c import model_c
from cosim.export.trace import trace
from fmus.controllers.p_pi import PPi
from fmus.plant.ballscrew_stage import BallscrewStage
from fmus.sources.trajectory import Trajectory

ROOT = Path(__file__).resolve().parents[1]
KINDS = (PPi, BallscrewStage, Trajectory)
"""A controller, a plant with discrete states and a source: every branch of the runtime."""


def tidy(source: Path, *folders: Path) -> str:
    """What clang-tidy says of a source, or ''."""
    command = [str(Path(sys.executable).with_name("clang-tidy")), "--quiet", f"--config-file={ROOT / '.clang-tidy'}"]
    flags = ["--", "-std=c99", "-Wall", "-Wextra", *(f"-I{folder}" for folder in folders)]
    filters = ["--header-filter=.*/runtime/.*"]
    done = subprocess.run([*command, *filters, str(source), *flags], capture_output=True, text=True, check=False)
    return done.stdout if done.returncode else ""


def main() -> int:
    """The number of sources with findings, at most 1."""
    versions: tuple[Fmi, ...] = (2, 3)
    with TemporaryDirectory() as name:
        work: list[tuple[Path, ...]] = []
        for fmi in versions:
            for kind in KINDS:
                folder = Path(name) / f"{kind.__name__}{fmi}"
                folder.mkdir()
                (folder / "contract.h").write_text(header(fmi))
                (folder / "model.c").write_text(model_c(trace(kind), "{tidy}", fmi))
                work.append((folder / "model.c", folder, RUNTIME))
        work.append((RUNTIME.parent / "python" / "proxy.c", work[0][1], RUNTIME))
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            found = [text for text in pool.map(lambda parts: tidy(*parts), work) if text]
    sys.stdout.write(("\n".join(found) or f"clang-tidy: {len(work)} sources, nothing found") + "\n")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
