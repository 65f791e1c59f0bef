r"""Use the FMUs in your own tool
=============================

You have a tool that imports FMUs: Simulink, Dymola, OpenModelica, OMSimulator, or a program of your own. This
tutorial takes three FMUs out of the package, looks at them, couples them to a closed loop with another program (some
20 lines of FMPy), and shows the figure that tells whether the coupling is right. The loop is a reference position, a
fuzzy sliding-mode controller and a ballscrew stage with LuGre friction, sampled at 10 kHz.

**You need** the wheel of motion-cosim, nothing else. FMPy comes with it; cosim itself is used for the comparison only.
"""

# %%
# A helper first: ``run`` starts a command as a terminal does, here in a temporary folder. In a terminal, type what
# stands behind ``$``.
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

temporary = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
FOLDER = Path(temporary.name)  # Path("my_folder") keeps the files


def run(command):
    """Run a command as in a terminal, and print what it says."""
    print("$", command)
    called = [sys.executable, "-m", *shlex.split(command)]
    ended = subprocess.run(
        called, cwd=FOLDER, capture_output=True, check=False, text=True
    )
    print(ended.stdout + ended.stderr)
    ended.check_returncode()


# %%
# Take the FMUs
# -------------
#
# The package holds compiled FMUs; no compiler is needed. ``cosim list`` names all of them.
run("cosim fmus copy fmus Trajectory FuzzySlidingMode BallscrewStage")

# %%
# An FMU is a zip file. It needs nothing but a C library: no Python, no licence. Beside the code it holds a page about
# the model (``documentation/index.html``: equations, parameters, source), the C sources, and reference results that
# your tool can replay (``extra``).
import zipfile

with zipfile.ZipFile(FOLDER / "fmus/BallscrewStage.fmu") as archive:
    folders = sorted({name.split("/")[0] for name in archive.namelist()})
print(", ".join(folders))

# %%
# What is inside, seen by another tool
# ------------------------------------
#
# From here on FMPy does the work, in place of your tool. Every tool shows the same list, for it comes from
# ``modelDescription.xml``: inputs, outputs, and parameters with unit and start value.
#
# * **All values are in SI units at the border**: m, rad, N, N.m, V, s. The unit stands at each variable. A tool that
#   converts display units shows mm, but ``getReal`` and ``setReal`` are in m.
# * A range is a promise: the FMU refuses values outside.
import textwrap

import fmpy

stage = fmpy.read_model_description(FOLDER / "fmus/BallscrewStage.fmu")
shown = ("m", "J_rot", "l_p", "F_C", "F_S", "sigma_0", "sigma_1", "sigma_2")
for kind in ("input", "output", "parameter"):
    print(f"{kind}s")
    for variable in stage.modelVariables:
        if variable.causality != kind:
            continue
        if kind == "parameter" and variable.name not in shown:
            continue
        start = f"{float(variable.start):g}" if variable.start else ""
        text = textwrap.shorten(variable.description, 44, placeholder=" ...")
        print(f"  {variable.name:15} {start:>9} {variable.unit:9} {text}")

# %%
# One FMU alone: does it do what you know?
# ----------------------------------------
#
# Before you couple anything, ask the plant a question whose answer you know. With ``F_S`` set to the Coulomb friction
# ``F_C`` of 6.24 N.m, a torque :math:`T` below it must wind up the screw on the bristles of the friction, and hold: the
# LuGre model then gives the angle :math:`-F_C/\sigma_0 \ln(1 - T/F_C)`. A torque above must move the table for good.
import matplotlib.pyplot as plt
import numpy as np


def step_response(torque):
    """Time in s and position in m of the stage under a constant torque in N.m."""
    found = fmpy.simulate_fmu(
        str(FOLDER / "fmus/BallscrewStage.fmu"),
        fmi_type="CoSimulation",
        stop_time=0.05,
        output_interval=1e-4,
        start_values={"command": torque, "F_S": 6.24},
        output=["position"],
    )
    return found["time"], found["position"]


figure, (left, right) = plt.subplots(
    1, 2, figsize=(7.5, 2.9), layout="constrained"
)
# lead for one radian times the angle, in nm
wind_up = -1e9 * 0.0015923 * 6.24 / 1e5 * np.log(1.0 - 5.0 / 6.24)
time, position = step_response(5.0)
left.plot(1e3 * time, 1e9 * position, color="#0072B2", label="FMU")
left.axhline(wind_up, color="#D55E00", linestyle="--", label="closed form")
left.set(title="5 N.m: holds", xlabel="Time in ms", ylabel="Position in nm")
left.legend()
print(f"5 N.m:  {1e9 * position[-1]:.2f} nm, expected {wind_up:.2f} nm")
assert abs(1e9 * position[-1] - wind_up) < 0.01 * wind_up

time, position = step_response(12.0)
right.plot(1e3 * time, 1e3 * position, color="#0072B2")
right.set(
    title="12 N.m: breaks away", xlabel="Time in ms", ylabel="Position in mm"
)
print(f"12 N.m: {1e3 * position[-1]:.2f} mm")
assert position[-1] > 1e-4
plt.show()

# %%
# The closed loop
# ---------------
#
# Six wires make the loop; each joins signals of the same unit:
#
# * ``position``, ``velocity``, ``acceleration`` of the trajectory go to ``position_ref``, ``velocity_ref``,
#   ``acceleration_ref`` of the controller;
# * ``position``, ``velocity`` of the stage go to the controller, its ``command`` goes to the stage.
#
# Two parameters are set: the sampling time ``T_s`` of the controller, which must be the step of your tool (or a
# multiple of it), and the amplitude of the reference, 10 mm in place of 5 mm, to see that parameters arrive.
#
# Parameters are set **before** initialization. This is all that a tool does with an FMU:


def load(name, **parameters):
    """An initialized FMU, and the value references of its variables."""
    folder = fmpy.extract(FOLDER / f"fmus/{name}.fmu", FOLDER / name)
    description = fmpy.read_model_description(folder)
    number = {
        variable.name: variable.valueReference
        for variable in description.modelVariables
    }
    fmu = fmpy.instantiate_fmu(folder, description, "CoSimulation")
    fmu.setReal(
        [number[parameter] for parameter in parameters],
        list(parameters.values()),
    )
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    return fmu, number


# %%
# And this is the loop. In each step of 0.1 ms it gets outputs, sets inputs, and lets all three step. ``order`` is the
# only choice; the three ways below are those that tools have.


def loop(order, steps=10000, h=1e-4, amplitude=0.01):
    """Reference and position in m, command in N.m, at the start of each step."""
    trajectory, t = load("Trajectory", amplitude=amplitude)
    controller, c = load("FuzzySlidingMode", T_s=h)
    plant, p = load("BallscrewStage")
    wanted = [t["position"], t["velocity"], t["acceleration"]]
    measured = [p["position"], p["velocity"]]
    sampled = [
        c[f"{name}_ref"] for name in ("position", "velocity", "acceleration")
    ]
    sampled += [c["position"], c["velocity"]]
    rows = []
    for k in range(steps):
        reference, state = trajectory.getReal(wanted), plant.getReal(measured)
        if order == "sequential":
            controller.setReal(sampled, reference + state)
        if order != "reference first":
            command = controller.getReal([c["command"]])
        trajectory.doStep(k * h, h)
        if order == "reference first":
            controller.setReal(sampled, trajectory.getReal(wanted) + state)
            command = controller.getReal([c["command"]])
        if order == "parallel":
            controller.setReal(sampled, reference + state)
        plant.setReal([p["command"]], command)
        controller.doStep(k * h, h)
        plant.doStep(k * h, h)
        rows.append((reference[0], state[0], command[0]))
    for fmu in (trajectory, controller, plant):
        fmu.terminate()
        fmu.freeInstance()
    return np.array(rows).T


# %%
# Is it right?
# ------------
#
# One number tells: the root mean square of reference minus position from 0.5 s to 1 s.


def rms(run):
    """The tracking error in um over the second half of a run."""
    reference, position, _ = run
    half = len(reference) // 2
    return 1e6 * np.sqrt(np.mean((reference - position)[half:] ** 2))


runs = {
    order: loop(order)
    for order in ("sequential", "parallel", "reference first")
}
for order, signals in runs.items():
    print(f"{order:16} {rms(signals):.4f} um")

# %%
# ``cosim run`` couples the same FMUs with its own master, in sequential order unless you say otherwise:
run(
    "cosim run shams2010/fsmc_5sin --stop-time 1 --set trajectory.amplitude=0.01"
)

# %%
run(
    "cosim run shams2010/fsmc_5sin --stop-time 1"
    " --set trajectory.amplitude=0.01 --order parallel"
)

# %%
# The line *Position error, rms from 0.5 s* of the first run is the figure of the FMPy loop in *sequential* order: two
# programs, one number. The second run comes close to *parallel*; there the loop swings in a limit cycle, and the last
# digits differ from tool to tool.
#
# (The warning says that the bristles of this paper's friction model are damped too much for fast motion. It concerns
# the model, not the coupling.)
assert abs(rms(runs["sequential"]) - 0.0391) < 0.0001
assert abs(rms(runs["parallel"]) - 0.0645) < 0.01 * 0.0645
assert abs(rms(runs["reference first"]) - 0.69) < 0.005

figure, panels = plt.subplots(
    3, 1, figsize=(7.5, 5.2), sharex=True, layout="constrained"
)
for panel, (order, signals) in zip(panels, runs.items(), strict=True):
    seconds = 1e-4 * np.arange(len(signals[0]))
    panel.plot(
        seconds[5000:],
        1e6 * (signals[0] - signals[1])[5000:],
        color="#0072B2",
        linewidth=0.8,
    )
    panel.set(title=f"{order}: rms {rms(signals):.4f} um", ylabel="Error in um")
    panel.grid(color="#DDDDDD")
panels[-1].set_xlabel("Time in s")
plt.show()

# %%
# **What to look at.** The scale of each panel. *Sequential* is a small, smooth error: what friction leaves.
# *Parallel* is the same plus a fast oscillation: the loop has one sample of delay, and a controller with a high gain
# answers with a limit cycle. *Reference first* is large and smooth: the stage follows a reference that is one sample
# ahead, so its error is that of *sequential* less velocity times 0.1 ms:
sequential, ahead = runs["sequential"], runs["reference first"]
shift = 1e-4 * np.gradient(sequential[0], 1e-4)
explained = 1e6 * np.sqrt(
    np.mean((sequential[0] - sequential[1] - shift)[5000:] ** 2)
)
print(f"explained: {explained:.4f} um, measured: {rms(ahead):.4f} um")
assert abs(explained - rms(ahead)) < 0.002 * explained

# %%
# The order of calls, and the sample of delay
# -------------------------------------------
#
# The picture shows which values a step uses. A bar is a step of an FMU; an arrow carries a value.


def draw(axes, delay):
    """Steps as bars, values as arrows: which command the stage gets in a step."""
    for lane, name in enumerate(("stage", "controller")):
        for k in range(4):
            axes.barh(
                lane,
                0.9,
                left=k + 0.05,
                height=0.34,
                color=("#56B4E9", "#E69F00")[lane],
                alpha=0.6,
            )
            axes.text(
                k + 0.5, lane, f"step {k}", ha="center", va="center", fontsize=8
            )
        axes.text(-0.08, lane, name, ha="right", va="center")
    arrow = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "linewidth": 1.4}
    for k in range(4 - delay):
        axes.annotate(
            "",
            (k + 0.02, 0.83),
            (k + 0.02, 0.17),
            arrowprops=arrow | {"color": "#0072B2"},
        )
        begin, end = (
            (k + 0.08, k + 0.08) if delay == 0 else (k + 0.95, k + 1.08)
        )
        axes.annotate(
            "",
            (end, 0.17),
            (begin, 0.83),
            arrowprops=arrow | {"color": "#D55E00"},
        )
    axes.text(
        0.12,
        0.5,
        "position at $t_0$ up,\ncommand down"
        if delay == 0
        else "position at $t_0$ up",
        fontsize=8,
    )
    if delay:
        axes.text(1.2, 0.5, "command that\nbelongs to $t_0$", fontsize=8)
    axes.set(
        xlim=(-0.1, 4),
        ylim=(-0.3, 1.3),
        yticks=[],
        xticks=range(5),
        xticklabels=[f"$t_{k}$" for k in range(5)],
    )
    axes.spines[["left", "right", "top"]].set_visible(False)
    axes.set_title(
        "parallel: one sample late" if delay else "sequential: no delay",
        loc="left",
    )


figure, (top, bottom) = plt.subplots(
    2, 1, figsize=(7.5, 3.9), layout="constrained"
)
draw(top, delay=0)
draw(bottom, delay=1)
plt.show()

# %%
# **Sequential**: the controller's inputs are set, *then* its command is read, then all step. The controller's command
# depends directly on its inputs, and ``modelDescription.xml`` says so. The plant's position does not depend directly on
# its command, so there is no algebraic loop. A tool that follows the declared dependencies finds this order alone.
#
# **Parallel** (Jacobi): all outputs are read first, all inputs are set, all step. The command in step 1 is the one that
# belongs to the position at the start of step 0.
#
# The first commands of both runs show it. The stage gets the same first command, one sample later:
count = 8
figure, panel = plt.subplots(figsize=(7.5, 2.8), layout="constrained")
for order, colour in (("sequential", "#0072B2"), ("parallel", "#D55E00")):
    command = runs[order][2][: count + 1]
    panel.step(
        0.1 * np.arange(count + 1),
        command,
        where="post",
        color=colour,
        label=order,
    )
panel.set(
    title="The first commands", xlabel="Time in ms", ylabel="Command in N.m"
)
panel.grid(color="#DDDDDD")
panel.legend()
print("sequential:", np.round(runs["sequential"][2][:4], 3))
print("parallel:  ", np.round(runs["parallel"][2][:4], 3))
assert runs["parallel"][2][0] == 0.0
assert runs["parallel"][2][1] == runs["sequential"][2][0]
plt.show()

# %%
# :doc:`/explanations/time-and-sampling` says more about orders, steps and sampling times.
#
# Published figures refer to no delay. A real controller that needs one sample to compute has that delay, too: then
# *parallel* is the order that you want.
#
# What can go wrong
# -----------------
#
# **A parameter that does not arrive.** Without the amplitude the reference keeps its 5 mm, and the number is another
# one:
forgotten = loop("sequential", amplitude=0.005)
print(f"amplitude ignored, sequential: {rms(forgotten):.4f} um")
assert rms(forgotten) < 0.5 * rms(runs["sequential"])

# %%
# **A value outside its range** is refused, with a message that says what is kept. The message reaches you only if the
# tool has logging switched on; a tool that goes on without a word has hidden it.
try:
    fmpy.simulate_fmu(
        str(FOLDER / "fmus/BallscrewStage.fmu"),
        start_values={"m": -62.4},
        stop_time=0.01,
        debug_logging=True,
    )
except Exception as error:
    print(type(error).__name__, error)
else:
    raise AssertionError("a negative mass was taken")

# %%
# **A value that is legal, but suspicious** is taken, with a warning:
found = fmpy.simulate_fmu(
    str(FOLDER / "fmus/BallscrewStage.fmu"),
    start_values={"F_C": 12.0},
    stop_time=0.01,
    debug_logging=True,
)

# %%
# **The wrong sampling time.** ``T_s`` is a parameter of the controller. If your tool steps at 1 ms and ``T_s`` says
# 0.1 ms, the controller samples ten times in a step, with the inputs of its start.
#
# Does the FMU compute here what it computed where it was made?
# -------------------------------------------------------------
#
# Each FMU carries experiments with results that were solved by another program (scipy's Radau, relative tolerance
# 1e-10, or sample by sample for controllers). ``cosim verify`` replays them in this machine, through the binary of
# this machine:
run("cosim verify fmus")

# %%
# *Share* is the largest difference as a part of what is allowed. Your tool can replay them, too: the files below
# ``extra/org.fmi-standard.fmi-ls-ref`` are CSV, and :doc:`/references` describes them.
#
# The whole loop as one file: SSP
# -------------------------------
#
# If your tool reads SSP 1.0 (System Structure and Parameterization), do not wire by hand. One command writes the FMUs,
# the wires and the parameters:
run(
    "cosim export shams2010/fsmc_5sin --stop-time 1"
    " --set trajectory.amplitude=0.01 -o loop.ssp"
)
with zipfile.ZipFile(FOLDER / "loop.ssp") as archive:
    print(*sorted(archive.namelist()), sep="\n")

# %%
# SSP has no order of calls. Each tool chooses one, so look at the number again: 0.0391 um or 0.0645 um. ``cosim run
# loop.ssp`` reads it back.
run("cosim run loop.ssp")

# %%
# Where to go from here
# ---------------------
#
# * :doc:`/use-in-your-tool` builds this loop in ecos, libcosim, PathSim, OMSimulator, OpenModelica, Simulink and
#   Dymola, with the number that each should give.
# * :doc:`/importers` says in which tools all FMUs were run, how far the results differ, and which bugs were met.
# * :doc:`/fmi3` says what differs in FMI 3.0.
#
# The last line deletes the temporary folder.
temporary.cleanup()
