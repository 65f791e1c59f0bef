"""Whole run of the reference loop: three FMUs under the master against two C programs.

The first makes the FMI calls of the same FMUs, written out (calls.c): what no master can do with fewer. The second
includes the sources of the FMUs and calls their traced functions and integrator directly: no FMI, no checks. Both
record the same columns; compiler, flags and target are those of the FMUs. Processor time, so that other work on the
machine counts little; all take turns, medians of 31.
"""

from __future__ import annotations

import statistics
import subprocess
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from figures import Kept, keep
from programs import compile_c, extract_sources
from rich.console import Console
from rich.table import Table

from cosim import Simulation, System, read_system, simulate

ROOT = Path(__file__).resolve().parents[1]
SYSTEM = ROOT / "studies" / "shams2010" / "fsmc_5sin.toml"
FMUS = ROOT / "build" / "fmus" / "native"
NAMES = ("Trajectory", "FuzzySlidingMode", "BallscrewStage")
REPEATS = 31

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
    """The C program without FMI, from the sources inside the FMUs."""
    units = ["main.c"]
    (folder / "main.c").write_text(MAIN)
    for name in NAMES:
        extract_sources(FMUS / f"{name}.fmu", folder / name)
        unit = f"{name}.c"
        body = STEPPER[name].format(start=START)
        (folder / unit).write_text(
            f'#define FMI2_EXPORT static\n#include "{name}/sources/model.c"\nstatic State s;\n{body}'
        )
        units.append(unit)
    return compile_c(folder / "program", *units, "-lm")


def compile_calls(folder: Path, system: System) -> list[str]:
    """The command that runs the C program with the FMI calls of the system."""
    fmus = {instance.name: instance.fmu for instance in system.instances}
    start = system.instance("trajectory").start

    def references(instance: str, *names: str) -> str:
        return ", ".join(str(fmus[instance].variables[name].reference) for name in names)

    def lines() -> Iterator[str]:
        for name, fmu in fmus.items():
            yield f'#define {name.upper()} "{fmu.guid}"'
        yield f"#define KIND {start['kind']}"
        yield f"#define START_OF_SHAPE {{{start['amplitude']!r}, {start['frequency']!r}}}"
        for array, instance, *names in (
            ("shape_references", "trajectory", "amplitude", "frequency"),
            ("trajectory_outputs", "trajectory", "position", "velocity", "acceleration"),
            ("plant_outputs", "plant", "position", "velocity"),
            (
                "controller_inputs",
                "controller",
                "position_ref",
                "velocity_ref",
                "acceleration_ref",
                "position",
                "velocity",
            ),
        ):
            yield f"static const fmi2ValueReference {array}[] = {{{references(instance, *names)}}};"
        for value, instance, name in (
            ("kind_reference", "trajectory", "kind"),
            ("sampling_reference", "controller", "T_s"),
            ("controller_output", "controller", "command"),
            ("plant_input", "plant", "command"),
        ):
            yield f"static const fmi2ValueReference {value} = {references(instance, name)};"

    (folder / "references.h").write_text("\n".join(lines()) + "\n")
    libraries: list[str] = []
    for name in ("trajectory", "controller", "plant"):
        library = fmus[name].library
        assert library is not None
        with zipfile.ZipFile(fmus[name].path) as archive:
            libraries.append(archive.extract(library, folder / name))
    program = compile_c(folder / "calls", str(Path(__file__).with_name("calls.c")), "-ldl")
    return [str(program), *libraries]


def turns(run: Callable[[], object], programs: Sequence[Sequence[str]]) -> tuple[list[list[float]], set[float]]:
    """Processor times in s of each turn, of ``run`` and of the programs, and the last positions in m of the latter."""
    times: list[list[float]] = []
    positions: set[float] = set()
    for _ in range(REPEATS):
        begin = time.process_time()
        run()
        turn = [time.process_time() - begin]
        for program in programs:
            printed = subprocess.run(program, capture_output=True, text=True, check=True).stdout.split()
            turn.append(float(printed[0]))
            positions.add(float(printed[1]))
        times.append(turn)
    return times, positions


def main() -> None:
    """Measure and print."""
    system = read_system(SYSTEM)
    stop = 10.0
    with TemporaryDirectory() as text:
        programs = (compile_calls(Path(text), system), [str(compile_program(Path(text)))])
        # Not in turn with each other: after the libraries of one run are freed, the memory of the next is fetched anew.
        with Simulation(system) as simulation:
            position = simulation.run()["plant.position"][-1]  # the first run loads the compiled loop
            loaded, positions = turns(simulation.run, programs)
        loading, _ = turns(lambda: simulate(system), programs)
    difference = max(abs(value - position) for value in positions)
    table = Table(title="FSMC 5 sin t, three FMUs, 10 s at 10 kHz, three columns in memory")
    heads = ("What runs", "Times the same FMI calls", "Times the C program without FMI", "Times real time")
    for head in heads:
        table.add_column(head, justify="left" if head == heads[0] else "right")
    rows: list[tuple[str | float, ...]] = []
    for name, times, which in (
        ("cosim, instances loaded", loaded, 0),
        ("cosim, loading the FMUs included", loading, 0),
        ("C program, same FMI calls", loaded, 1),
        ("C program, no FMI", loaded, 2),
    ):
        ratios = (statistics.median(turn[which] / turn[other] for turn in times) for other in (1, 2))
        speed = stop / statistics.median(turn[which] for turn in times)
        rows.append((name, *(round(ratio, 2) for ratio in ratios), round(speed)))
        table.add_row(*map(str, rows[-1]))
    Console().print(table)
    Console().print(f"last positions differ by {difference:.1e} m")
    keep(
        "whole_run",
        Kept(
            "A whole run of the reference loop",
            "The fuzzy sliding-mode loop of Shams and Safdari, 10 s at 10 kHz, three columns recorded, against a C "
            "program that makes the same FMI calls, and one without FMI that calls the same equations and the same "
            f"integrator. Processor time, medians of {REPEATS} turns.",
            heads,
            rows,
        ),
    )


if __name__ == "__main__":
    main()
