"""Whether a change keeps every result to the last bit: a digest of the rows of every shipped system.

Run it before and after the change: ``same_results.py before.json``, then ``same_results.py after.json --against
before.json``. ``--fmus FOLDER`` takes the FMUs from there. Long runs end after ``STEPS`` communication points.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from pathlib import Path
from typing import Any

from cosim import DescriptionError, SimulationError, read_system, simulate

ROOT = Path(__file__).resolve().parents[1]
STEPS = 20_000


def digest(path: Path, fmus: Path | None) -> dict[str, Any] | None:
    """Rows, columns and SHA-256 of times and rows of a system; None for a file that is no system."""
    try:
        system = read_system(path, fmus=fmus)
    except DescriptionError:
        return None
    stop = system.start_time + min(system.steps, STEPS) * system.step_size
    try:
        result = simulate(system, stop_time=stop)
        failed = ""
    except SimulationError as error:
        result, failed = error.result, str(error)  # type: ignore[attr-defined]
    content = result.time.tobytes() + result.rows.tobytes()
    sha256 = hashlib.sha256(content).hexdigest()
    return {"rows": result.rows.shape[0], "columns": result.rows.shape[1], "sha256": sha256, "failed": failed}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("output", type=Path, help="the file to write, such as before.json")
    parser.add_argument("--against", type=Path, metavar="FILE", help="an earlier file to compare with")
    parser.add_argument("--fmus", type=Path, metavar="FOLDER", help="the folder of the FMUs")
    options = parser.parse_args()
    paths = sorted((ROOT / "studies").rglob("*.toml"))
    names = [path.relative_to(ROOT / "studies").with_suffix("").as_posix() for path in paths]
    with ProcessPoolExecutor(2) as pool:
        entries = pool.map(digest, paths, repeat(options.fmus))
        found = {name: entry for name, entry in zip(names, entries, strict=True) if entry is not None}
    options.output.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    rows = sum(entry["rows"] for entry in found.values())
    values = sum(entry["rows"] * entry["columns"] for entry in found.values())
    failed = sum(bool(entry["failed"]) for entry in found.values())
    print(f"{len(found)} systems, {rows} rows, {values} values, {failed} failed; {len(paths) - len(found)} other files")
    if options.against is None:
        return 0
    before = json.loads(options.against.read_text(encoding="utf-8"))
    differing = [name for name in sorted({*before, *found}) if before.get(name) != found.get(name)]
    print(f"{len(found) - len(differing)} equal to {options.against}, {len(differing)} differ {' '.join(differing)}")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
