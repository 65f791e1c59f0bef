"""Whole run of the reference loop: three FMUs under the master against a C program without FMI.

The C program includes the sources of the same FMUs, calls their traced functions and integrator directly (no FMI, no
checks) and records the same columns. Compiler, flags and target are those of the FMUs. Processor time, so that other
work on the machine counts little; medians of 5.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

from figures import Kept, keep
from rich.console import Console
from rich.table import Table

from cosim import Simulation, read_system, simulate
from cosim.export.compile import FLAGS, TARGETS, host_platform

ROOT = Path(__file__).resolve().parents[1]
SYSTEM = ROOT / "studies" / "shams2010" / "fsmc_5sin.toml"
FMUS = ROOT / "build" / "fmus" / "native"
NAMES = ("Trajectory", "FuzzySlidingMode", "BallscrewStage")
REPEATS = 5

STEPPER = {
    "Trajectory": """
void trajectory_start(void) {{ {start} }}
const double *trajectory_at(double t) {{
    variant(&s)->output(t, states(&s), inputs(&s), parameters(&s), s.c, outputs(&s));
    return outputs(&s);
}}
""",
    "FuzzySlidingMode": """
void controller_start(void) {{ {start} }}
double controller_at(double t, const double *u) {{
    memcpy(inputs(&s), u, sizeof(double) * N_INPUTS);
    variant(&s)->sample(t, states(&s), inputs(&s), parameters(&s), s.c, outputs(&s), s.next);
    memcpy(states(&s), s.next, sizeof(double) * N_STATES);
    return outputs(&s)[0];
}}
""",
    "BallscrewStage": """
void plant_start(void) {{ {start} }}
const double *plant_at(double t, double end, double command) {{
    Problem problem = {{variant(&s)->derivative, variant(&s)->jacobian, variant(&s)->update, inputs(&s), parameters(&s),
                       s.c, nominals, s.v[PARAMETER_TOLERANCE], MAX_ATTEMPTS}};
    inputs(&s)[0] = command;
    if (end > t && integrate(&problem, &s.integrator, t, end, states(&s))) abort();
    variant(&s)->output(end, states(&s), inputs(&s), parameters(&s), s.c, outputs(&s));
    return outputs(&s);
}}
""",
}
START = "set_start_values(&s); s.phase = INITIALIZATION; refresh_parameters(&s);"

MAIN = """
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
void trajectory_start(void); void controller_start(void); void plant_start(void);
const double *trajectory_at(double t);
double controller_at(double t, const double *u);
const double *plant_at(double t, double end, double command);
int main(void) {
    const int n = 100000;
    double *rows = malloc(sizeof(double) * 3 * (n + 1));
    const clock_t a = clock();
    trajectory_start(); controller_start(); plant_start();
    const double *y = plant_at(0.0, 0.0, 0.0);
    for (int k = 0; k <= n; k++) {
        const double *r = trajectory_at(k * 1e-4);
        const double u[] = {r[0], r[1], r[2], y[0], y[1]};
        const double command = controller_at(k * 1e-4, u);
        rows[3 * k] = r[0]; rows[3 * k + 1] = y[0]; rows[3 * k + 2] = command;
        if (k < n) y = plant_at(k * 1e-4, (k + 1) * 1e-4, command);
    }
    printf("%.9f %.17g\\n", (double)(clock() - a) / CLOCKS_PER_SEC, rows[3 * n + 1]);
    return 0;
}
"""


def compile_program(folder: Path) -> Path:
    """The C program, from the sources inside the FMUs."""
    units = ["main.c"]
    (folder / "main.c").write_text(MAIN)
    for name in NAMES:
        with zipfile.ZipFile(FMUS / f"{name}.fmu") as archive:
            for member in archive.namelist():
                if member.startswith("sources/"):
                    archive.extract(member, folder / name)
        unit = f"{name}.c"
        body = STEPPER[name].format(start=START)
        (folder / unit).write_text(
            f'#define FMI2_EXPORT static\n#include "{name}/sources/model.c"\nstatic State s;\n{body}'
        )
        units.append(unit)
    program = folder / "program"
    flags = [flag for flag in FLAGS if flag not in ("-shared", "-fPIC", "-Wall", "-Wextra", "-Werror", "-s")]
    # the processor of the FMUs: without a target, the compiler would use all that this machine has
    target = TARGETS[host_platform()][0][0]
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-target",
        target,
        *flags,
        "-w",
        *units,
        "-o",
        str(program),
        "-lm",
    ]
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": str(ROOT / "build" / "cache" / "zig")}
    subprocess.run(command, cwd=folder, check=True, env=environment)
    return program


def main() -> None:
    """Measure and print."""
    system = read_system(SYSTEM)
    stop = 10.0
    with TemporaryDirectory() as text:
        program = compile_program(Path(text))
        loaded, whole, bare = [], [], []
        with Simulation(system) as simulation:
            simulation.run()  # loads the compiled loop
            for _ in range(REPEATS):
                begin = time.process_time()
                result = simulation.run()
                loaded.append(time.process_time() - begin)
                begin = time.process_time()
                simulate(system)
                whole.append(time.process_time() - begin)
                printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
                bare.append(float(printed[0]))
    difference = abs(float(printed[1]) - result["plant.position"][-1])
    table = Table(title="FSMC 5 sin t, three FMUs, 10 s at 10 kHz, three columns in memory")
    for head in ("", "processor time / s", "x real time", "ratio to C"):
        table.add_column(head, justify="right" if head else "left")
    floor = statistics.median(bare)
    rows: list[tuple[str, float, float]] = []
    for name, times in (
        ("cosim, instances loaded", loaded),
        ("cosim, loading the FMUs included", whole),
        ("C program, no FMI", bare),
    ):
        seconds = statistics.median(times)
        table.add_row(name, f"{seconds:.3f}", f"{stop / seconds:.0f}", f"{seconds / floor:.2f}")
        rows.append((name, round(seconds / floor, 2), round(stop / seconds)))
    Console().print(table)
    Console().print(f"last positions differ by {difference:.1e} m")
    keep(
        "whole_run",
        Kept(
            "A whole run of the reference loop",
            "The fuzzy sliding-mode loop of Shams and Safdari, 10 s at 10 kHz, three columns recorded, against a C "
            "program without FMI that calls the same equations and the same integrator. Processor time, medians of "
            f"{REPEATS} turns.",
            ("What runs", "Times the C program", "Times real time"),
            rows,
        ),
    )


if __name__ == "__main__":
    main()
