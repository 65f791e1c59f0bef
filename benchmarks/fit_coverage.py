"""How often the 95 % intervals of a fit hold the truth: ``python benchmarks/fit_coverage.py [SEEDS]`` (default 50).

The signals of the made-up stage of docs/examples/your_machine are solved once, by Radau from the plain equations. The
fit gets them without noise first, then with the noise, resolution and delay of the record and another seed each time.
"""

from __future__ import annotations

import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "docs" / "examples" / "your_machine"
sys.path.insert(0, str(EXAMPLE))

import make_records as made  # noqa: E402

from cosim.design.fit import Fitted, fit  # noqa: E402
from cosim.design.fit_file import make_fit  # noqa: E402

TRUTH = {
    **{f"plant.{name}": made.STAGE[name] for name in ("J_rot", "F_C", "F_S", "v_s", "sigma_0", "sigma_1", "sigma_2")},
    "position delay": made.STAGE["delay"],
}


def main(seeds: int) -> None:
    time = made.sampled(4.0)
    reference = made.stage_reference(time)
    clean = made.stage_signals(reference)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "stage.toml").write_text((EXAMPLE / "stage.toml").read_text())
        document = tomllib.loads((EXAMPLE / "stage_fit.toml").read_text())
        del document["records"]["other"]

        def fitted(signals: dict[str, made.Array], noise: dict[str, float]) -> Fitted:
            made.FOLDER = folder
            made.write(
                "stage.csv",
                {
                    "t": ("s", time),
                    "reference": ("m", reference),
                    "position": ("m", signals["position"]),
                    "command": ("V", signals["command"]),
                },
            )
            for output, deviation in noise.items():
                document["outputs"][output]["noise"] = deviation
            return fit(make_fit(document, folder=folder))

        exact = fitted(clean, {"position": 2e-8, "command": 5e-3})
        print("without noise, error of each value:")
        for estimate in exact.estimates:
            truth = TRUTH[estimate.name]
            print(f"  {estimate.name:16} {100.0 * (estimate.value / truth - 1.0):+.4f} %", flush=True)
        for output in document["outputs"].values():
            del output["noise"]
        inside = dict.fromkeys(TRUTH, 0)
        loops: list[int] = []
        for seed in range(seeds):
            rows = made.measured(clean, made.STAGE_NOISE, made.STAGE_RESOLUTION, seed)
            found = fitted(rows, {})
            loops.append(found.loops)
            for estimate in found.estimates:
                inside[estimate.name] += estimate.low <= TRUTH[estimate.name] <= estimate.high
            print(f"{seed + 1}: {found.message}, {found.loops} runs, {dict(inside)}", flush=True)
        print(f"truth inside its 95 % interval, of {seeds} seeds:")
        for value, count in inside.items():
            print(f"  {value:16} {count} = {100.0 * count / seeds:.0f} %")
        print(f"  all together {100.0 * sum(inside.values()) / (seeds * len(inside)):.1f} %")
        print(f"runs of a record a fit: {min(loops)} to {max(loops)}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
