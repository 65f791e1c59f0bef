r"""A foreign FMU in the fast master
================================

A supplier sends you an FMU of an axis. You have never seen its code. You want to know what it needs, put a controller
in front of it, be sure that the numbers are right, and lose nothing when it crashes. At the end the loop is an SSP file
that other tools read.

**You need** the wheel of motion-cosim, and PythonFMU (``pip install pythonfmu``), which plays the supplier here: it
makes FMUs from Python, and has nothing to do with this project.
"""

# %%
# A helper first: ``run`` starts a command as a terminal does, here in a temporary folder. In a terminal, type what
# stands behind ``$``.
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

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


def show(name, title):
    """A picture that a command wrote."""
    return SimpleNamespace(_repr_png_=(FOLDER / name).read_bytes, title=title)


# %%
# The supplier
# ------------
#
# This is the supplier's work; read it as if you could not. Like many FMUs in the field it is in the units of a data
# sheet (mN.m, mm, rpm), and does not say so where a program could read it. It can also be told to fail, for later.
(FOLDER / "axis.py").write_text(
    """
import math
import os

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real, String

LEAD, INERTIA, FRICTION = 10.0, 2e-4, 0.05  # mm a turn, kg.m2, N.m


class SupplierAxis(Fmi2Slave):
    author = "A supplier"
    description = "Servo axis: torque in mN.m, position in mm, speed in rpm"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.torque = self.position = self.speed = 0.0
        self.fail_at, self.failure = 1e9, "none"
        parameter = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
        self.register_variable(Real("torque", causality=Fmi2Causality.input))
        self.register_variable(Real("position", causality=Fmi2Causality.output))
        self.register_variable(Real("speed", causality=Fmi2Causality.output))
        self.register_variable(Real("fail_at", **parameter))
        self.register_variable(String("failure", **parameter))

    def do_step(self, t, h):
        if t >= self.fail_at:
            if self.failure == "crash":
                os.abort()
            while self.failure == "hang":
                pass
            raise ZeroDivisionError("in the look-up table of the supplier")
        omega = self.speed * math.pi / 30.0
        omega += h * (1e-3 * self.torque - FRICTION * math.tanh(omega / 0.1)) / INERTIA
        self.speed = omega * 30.0 / math.pi
        self.position += h * omega * LEAD / (2.0 * math.pi)
        return True
"""
)
run("pythonfmu build -f axis.py")

# %%
# What is in it?
# --------------
#
# ``info`` reads the file and starts nothing, so it is safe with any FMU.
run("cosim info SupplierAxis.fmu")

# %%
# **What to look at**, in any foreign FMU:
#
# * *Unit* is empty. The master cannot convert what has no unit. The data sheet must tell, or the text at the top.
# * *Range* is empty: the FMU promises nothing about the values that it takes.
# * *Outputs and the inputs they depend on directly*: this FMU states nothing, so everything must be assumed to depend
#   on everything. It matters below.
#
# Run it alone first, with a question whose answer you know: 100 mN.m less the friction of 50 mN.m turn 2e-4 kg.m2 for
# 0.2 s, which makes 50 rad/s.
run(
    "cosim run SupplierAxis.fmu --set torque=100 --stop-time 0.2 --step-size 1e-3 --output alone.csv"
)

# %%
# The note says that this FMU carries no program of its own: it needs an installed Python. ``check`` and ``run`` tell
# such things once, and go on.
import math

import cosim

alone = cosim.read_result(FOLDER / "alone.csv")
print(
    f"speed after 0.2 s: {alone['SupplierAxis.speed'][-1] * math.pi / 30.0:.2f} rad/s"
)
assert abs(alone["SupplierAxis.speed"][-1] * math.pi / 30.0 - 50.0) < 0.5

# %%
# The same in FMPy, the reference among importers. Two masters, one FMU, the same 200 steps:
import fmpy

other = fmpy.simulate_fmu(
    str(FOLDER / "SupplierAxis.fmu"),
    start_values={"torque": 100.0},
    stop_time=0.2,
    output_interval=1e-3,
    output=["position", "speed"],
)
difference = abs(other["position"] - alone["SupplierAxis.position"]).max()
print(
    f"{len(other)} rows each, largest difference of the position: {difference:.0e} mm of {other['position'][-1]:.3f} mm"
)
assert difference < 1e-12

# %%
# A difference in the last bits is no error: one master adds up the time step by step, the other multiplies.
#
# The loop
# --------
#
# A cascade controller of the package drives the axis over 8 mm. Wires between FMUs that state units are converted by
# themselves. Here one end states none, so the factor is yours: mm to m, and N.m to mN.m.
(FOLDER / "loop.toml").write_text(
    """\
description = "A supplier's axis under a cascade controller"
connections = [
    "trajectory.position -> controller.position_ref",
    "trajectory.position_next -> controller.position_next",
    { from = "axis.position", to = "controller.position", factor = 1e-3 },         # mm to m
    { from = "axis.position", to = "controller.motor_position", factor = 1e-3 },
    { from = "controller.command", to = "axis.torque", factor = 1e3 },              # N.m to mN.m
]

[experiment]
stop_time = 0.4
step_size = 1e-3
order = ["trajectory", "controller", "axis"]

[instances.trajectory]
fmu = "Trajectory"
start = { kind = "quintic", amplitude = 8e-3, T_s = 1e-3 }

[instances.controller]
fmu = "CascadePid"
start = { T_s = 1e-3, l_p = 1.59155e-3, M = 79.0, K_pos = 60.0, omega_v = 200.0, T_i = 0.02 }

[instances.axis]
fmu = "SupplierAxis.fmu"

[record]
variables = ["trajectory.position", "controller.error", "controller.command", "axis.position", "axis.speed"]
"""
)
run("cosim check loop.toml")

# %%
# What the notes mean
# -------------------
#
# A note is legal, but you should know it. Read each; there is no way to switch them off, and no need to.
#
# * *runs only where the tool that made it is installed*: see above.
# * *one step of delay*: **this one is worth a thought.** The FMU does not say that its position does not jump with the
#   torque. So the master must assume that it does, and then the position that the controller gets would be late. You
#   know better: torque changes speed, speed changes position, so nothing is late.
# * *unconnected inputs*: these inputs keep their start values. Here that is what we want: the controller takes velocity
#   from the difference of positions. In another loop it is the wire that was forgotten.
#
# Believe nobody, not even this tutorial: compute the loop by hand, in the order *read all, set the controller, read its
# command, set the axis, step all*, with FMPy, and compare.


def load(path, integers=(), **parameters):
    """An FMU in FMPy, initialized, and the numbers (value references) of its variables."""
    description = fmpy.read_model_description(path)
    number = {
        variable.name: variable.valueReference
        for variable in description.modelVariables
    }
    fmu = fmpy.instantiate_fmu(
        fmpy.extract(path, FOLDER / f"{path.stem}_extracted"),
        description,
        "CoSimulation",
    )
    for name, value in parameters.items():
        (fmu.setInteger if name in integers else fmu.setReal)(
            [number[name]], [value]
        )
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    return fmu, number


run("cosim fmus copy fmus Trajectory CascadePid")
trajectory, t = load(
    FOLDER / "fmus/Trajectory.fmu", ("kind",), kind=5, amplitude=8e-3, T_s=1e-3
)  # 5: quintic
controller, c = load(
    FOLDER / "fmus/CascadePid.fmu",
    T_s=1e-3,
    l_p=1.59155e-3,
    M=79.0,
    K_pos=60.0,
    omega_v=200.0,
    T_i=0.02,
)
axis, a = load(FOLDER / "SupplierAxis.fmu")
by_hand = []
for k in range(400):
    wanted = trajectory.getReal([t["position"], t["position_next"]])
    (position,) = axis.getReal([a["position"]])
    measured = [1e-3 * position, 1e-3 * position]
    controller.setReal(
        [
            c["position_ref"],
            c["position_next"],
            c["position"],
            c["motor_position"],
        ],
        [*wanted, *measured],
    )
    (command,) = controller.getReal([c["command"]])
    axis.setReal([a["torque"]], [1e3 * command])
    by_hand.append(position)
    for fmu in (trajectory, controller, axis):
        fmu.doStep(k * 1e-3, 1e-3)
for fmu in (trajectory, controller, axis):
    fmu.terminate()
    fmu.freeInstance()

result = cosim.simulate(cosim.read_system(FOLDER / "loop.toml"), isolated=True)
difference = max(
    abs(one - other)
    for one, other in zip(by_hand, result["axis.position"], strict=False)
)
print(
    f"{len(by_hand)} steps, largest difference of the position: {difference:.0e} mm"
)
assert difference < 1e-12

# %%
# So the loop has no delay. (``kind = 5`` shows another thing that the master does for you: it knows the names of
# enumerations.)
#
# And this is the loop. The figures of the position error are in the unit of the axis, which is mm:
run("cosim run loop.toml")

# %%
cosim.plot(result)

# %%
# The wrong factor
# ----------------
#
# What would a forgotten factor look like? The position would be a thousand times too large for the controller. Nothing
# forbids it, and the run ends well, with nonsense:
import matplotlib.pyplot as plt

text = (FOLDER / "loop.toml").read_text().replace(", factor = 1e-3", "")
(FOLDER / "forgotten.toml").write_text(text)
forgotten = cosim.simulate(
    cosim.read_system(FOLDER / "forgotten.toml"), isolated=True
)
figure, panel = plt.subplots(figsize=(7.5, 2.8), layout="constrained")
panel.plot(
    result.time,
    1e3 * result["trajectory.position"],
    color="#999999",
    linewidth=3,
    label="reference",
)
panel.plot(
    result.time,
    result["axis.position"],
    color="#0072B2",
    label="with the factor",
)
panel.plot(
    forgotten.time,
    forgotten["axis.position"],
    color="#D55E00",
    label="factor forgotten",
)
panel.set(
    xlabel="Time in s",
    ylabel="Position in mm",
    title="A supplier's axis under a cascade controller",
)
panel.grid(color="#DDDDDD")
panel.legend()
plt.show()
print(
    f"with the factor {result['axis.position'][-1]:.3f} mm, without {forgotten['axis.position'][-1]:.3f} mm"
)
assert abs(result["axis.position"][-1] - 8.0) < 0.02
assert abs(forgotten["axis.position"][-1] - 8.0) > 4.0

# %%
# Had the FMU declared ``mm`` for its position, the wire alone would have been enough, and a wire from mm to rad would
# have been refused. Ask your supplier for units; it is one line a variable.
#
# When it fails
# -------------
#
# Foreign code throws exceptions, crashes and hangs. ``cosim run`` steps the FMUs in a process of their own, so all that
# can be lost is that process. Three ways to fail, all at 0.2 s of 0.4 s; ``--timeout`` limits each call of an FMU:


def fails(failure):
    """Run the loop with an axis that fails."""
    try:
        how = f"--set axis.fail_at=0.2 --set axis.failure={failure}"
        run(f"cosim run loop.toml {how} --timeout 1 --output {failure}.csv")
    except subprocess.CalledProcessError as error:
        print("exit code", error.returncode)
    else:
        raise AssertionError("it did not fail")


fails("exception")

# %%
fails("crash")

# %%
fails("hang")

# %%
# Each time the last lines say which instance, which function and when, and the exit code is 1, so that a script sees
# it. Everything that was computed before is in the file:
for failure in ("exception", "crash", "hang"):
    kept = cosim.read_result(FOLDER / f"{failure}.csv")
    print(f"{failure:10} {len(kept.time)} rows, up to {kept.time[-1]:g} s")
    assert (
        kept["axis.position"] == result["axis.position"][: len(kept.time)]
    ).all()
    assert len(kept.time) == 201

# %%
# In Python the same is an exception that holds the result so far. Without ``isolated`` the FMU runs in *your* process,
# and takes it along when it crashes: notebooks, beware.
try:
    cosim.simulate(
        cosim.read_system(
            FOLDER / "loop.toml", {"axis.fail_at": 0.2, "axis.failure": "crash"}
        ),
        isolated=True,
    )
except cosim.ProcessError as error:
    print(error)
    print(len(error.result.time), "rows kept")

# %%
# The loop for other tools: SSP
# -----------------------------
#
# An SSP package holds FMUs, wires with factors, and start values. ``export`` writes it, any command reads it:
run("cosim export loop.toml -o loop.ssp")
run("cosim run loop.ssp")

# %%
# The figures are those from above. Inside, a factor is a ``LinearTransformation``; tools that ignore it (there are
# some, see :doc:`/importers`) get the loop of the orange line.
import zipfile
from xml.etree import ElementTree

with zipfile.ZipFile(FOLDER / "loop.ssp") as archive:
    print(*sorted(archive.namelist()), sep="\n")
    structure = ElementTree.fromstring(archive.read("SystemStructure.ssd"))
for wire in structure.findall(".//{*}Connection"):
    factor = wire.find("{*}LinearTransformation")
    source, target = (
        f"{wire.get(end + 'Element')}.{wire.get(end + 'Connector')}"
        for end in ("start", "end")
    )
    print(
        f"{source} -> {target}",
        "" if factor is None else f"times {factor.get('factor')}",
    )

# %%
# The other way round, a package from another tool is a system like any other: ``cosim check theirs.ssp`` says what it
# holds and which parts of SSP are not read; ``cosim export theirs.ssp -o theirs.toml`` makes a system file of it, with
# the FMUs beside, which is easier to change.
#
# What can go wrong
# -----------------
#
# * **No binary for this machine.** ``info`` lists the platforms. Ask for another, or for the sources.
# * **An FMU for model exchange only**: it brings no integrator. cosim runs co-simulation.
# * **Parameters that may not be set at any time.** ``check`` initializes the FMUs in a process of their own, so what an
#   FMU refuses is told before the run.
# * **An FMU without reference results** cannot prove that it computes here what it computed there: ``cosim verify``
#   says so. Ask the supplier for a CSV file of one run, and use ``cosim compare``.
#
# Where to go from here
# ---------------------
#
# * :doc:`/explanations/containment`: which process does what, and what is kept.
# * :doc:`/explanations/time-and-sampling`: orders and delays, with a picture.
# * :doc:`/systems`: all keys of a system file.
temporary.cleanup()
