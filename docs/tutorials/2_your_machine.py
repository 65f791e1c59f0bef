r"""Your machine: from a measured log to a fitted plant
===================================================

You have a log of a real axis: reference, position, command of the drive. At the end you have a plant that behaves like
your axis, the uncertainty of each value, and a record that was *not* fitted to judge it by. The way is the same for any
machine: **look** at the log, **compare** the log with a model, **fit**, **validate**.

The log here is made up, so that the truth is known and the result can be judged. Plain equations, written
down outside this library, were solved by another program: a ballscrew stage with LuGre friction in a position loop.
Then came noise, rounding, and a sensor that is 0.4 ms late.

**You need** motion-cosim with the extra ``tools``, and the files of the made-up machine in a folder ``your_machine``
beside this script: :download:`stage.csv </examples/your_machine/stage.csv>`,
:download:`stage_other.csv </examples/your_machine/stage_other.csv>`,
:download:`stage.toml </examples/your_machine/stage.toml>`,
:download:`stage_fit.toml </examples/your_machine/stage_fit.toml>`,
:download:`motor.csv </examples/your_machine/motor.csv>`,
:download:`motor.toml </examples/your_machine/motor.toml>`,
:download:`motor_fit.toml </examples/your_machine/motor_fit.toml>`. Put yours in their place.
"""

# %%
# A helper first: ``run`` starts a command as a terminal does, here in a temporary folder with copies of the files;
# ``show`` shows a picture that a command wrote.
import shlex
import shutil
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


# beside this script, or in a checkout
PLACES = (
    "your_machine",
    "../examples/your_machine",
    "docs/examples/your_machine",
)
places = [Path(place) for place in PLACES if Path(place).is_dir()]
if not places:
    raise FileNotFoundError(
        "There is no folder your_machine here. Put the files named above into one."
    )
shutil.copytree(places[0], FOLDER, dirs_exist_ok=True)

# %%
# Look at the log
# ---------------
#
# A log is a CSV, Parquet or MAT file: a column of time, columns with names, and a row of units if there is one
# (``position [mm]`` as a name is understood, too).
import cosim
import matplotlib.pyplot as plt
import numpy as np

record = cosim.read_record(FOLDER / "stage.csv")
columns = ", ".join(f"{name} [{unit}]" for name, unit in record.units.items())
print(f"{len(record.time)} samples, {record.step:g} s apart: {columns}")

reference, position = record.column("reference"), record.column("position")
figure, panels = plt.subplots(
    3, 1, figsize=(7.5, 5.4), sharex=True, layout="constrained"
)
panels[0].plot(record.time, 1e3 * position, color="#0072B2", label="position")
panels[0].plot(
    record.time, 1e3 * reference, "--", color="#D55E00", label="reference"
)
panels[0].set(title="The log", ylabel="Position in mm")
panels[0].legend()
panels[1].plot(record.time, 1e6 * position, color="#0072B2")
panels[1].plot(record.time, 1e6 * reference, "--", color="#D55E00")
panels[1].set(ylim=(-80.0, 80.0), ylabel="The same in um")
panels[2].plot(record.time, record.column("command"), color="#0072B2")
panels[2].set(ylabel="Command in V", xlabel="Time in s")
for panel in panels:
    panel.grid(color="#DDDDDD")
plt.show()

# %%
# **What to look at.** A log tells only what it excites. This one has four kinds of motion, each for other values:
#
# * small sines from rest (0 to 1 s, second panel): the bristles of the friction, their stiffness and damping;
# * slow motion (1 to 2 s): the falling part of the friction curve;
# * moves at several speeds (2 to 3.4 s): Coulomb and viscous friction;
# * fast sines (from 3.4 s): inertia.
#
# A log of one speed, or of one direction, cannot tell friction from an offset or from gravity.
#
# First values, without any model of the loop
# -------------------------------------------
#
# Force less inertia times acceleration is friction. One command looks at that in the log; the only thing you give is
# the factor from the command to a force at the table: 0.2 N.m/V of the drive over a lead of 10 mm a turn is 125.66
# N/V.
run(
    "cosim identify friction stage.csv --force command --factor 125.66"
    " --unit N --plot friction.png"
)

# %%
show("friction.png", "Friction over velocity, found in the log")

# %%
# **What to look at.** The points must form two branches which rise with speed (viscous friction), fall towards zero
# speed (Stribeck's effect) and are mirror images. A constant difference between the branches is an offset: gravity,
# or a bias of the current sensor. A value that the log does not excite says so in its last column.
#
# These are first guesses, but often good to some per cent: enough to start a fit.
#
# Compare: the log drives a model
# -------------------------------
#
# A system file wires the controller of the machine to the plant, and the *logged reference* drives both. The section
# ``[signals.log]`` names the file; what stands before ``->`` is a column of it.
print((FOLDER / "stage.toml").read_text())

# %%
# Masses and leads that you know stay what they are. Here the plant still has the start values of the FMU for friction,
# those of another machine, which it cannot fit:
system = cosim.read_system(FOLDER / "stage.toml")
before = cosim.simulate(system)
pairs = {"position": "plant.position", "command": "controller.command"}
off = cosim.compare(record, before, pairs)
print(
    f"position: {1e6 * off['position'].rms:.1f} um rms, "
    f"command: {off['command'].rms:.3f} V rms"
)

cosim.plot(
    [record, before], signals=pairs, labels=["log", "start values of the FMU"]
)

# %%
# With the first values of the log, turned to the screw by its lead of 10 mm a turn, it already looks right:
from math import pi

from cosim.design.friction import identify_friction

look = identify_friction(
    FOLDER / "stage.csv",
    position="position",
    force="command",
    factor=125.66,
    force_unit="N",
)
lead = 0.01 / (2 * pi)  # m/rad
first = {
    "plant.J_rot": (look.value("inertia").value - 60.0)
    * lead**2,  # 60 kg of the table are known
    "plant.F_C": look.value("Coulomb friction").value * lead,
    "plant.F_S": look.value("break-away friction").value * lead,
    "plant.sigma_2": look.value("viscous friction").value * lead**2,
    "plant.sigma_0": look.value("presliding stiffness").value * lead**2,
    "plant.sigma_1": 0.5,  # a guess
    "plant.v_s": 1.0,  # a guess
}
for name, value in first.items():
    print(f"{name:14} {value:.4g}")
guessed = cosim.simulate(system.changed(first))
off = cosim.compare(record, guessed, pairs)
print(
    f"position: {1e6 * off['position'].rms:.1f} um rms, "
    f"command: {off['command'].rms:.3f} V rms"
)

cosim.plot([record, guessed], signals=pairs, labels=["log", "first values"])

# %%
# A picture cannot tell more: the lines lie on each other. What is left is a number, and the fit works on it.
#
# What would a fit tell?
# ----------------------
#
# A fit file names the values that are free, with where to start; the outputs that are compared (the delay of the
# position sensor is free, too); and the records, one of which is kept for validation.
print((FOLDER / "stage_fit.toml").read_text())

# %%
# Before anything is fitted, ask what the records can tell. ``--dry-run`` moves each value by 1 % and looks at the
# outputs. A value that moves no output above the noise cannot be found, however long the fit runs.
run("cosim fit stage_fit.toml --dry-run")

# %%
# **What to look at.** Compare each row of *Change of the outputs* with its last row, the noise. The stiffness
# ``sigma_0`` moves the position by little more than the noise of one sample; but there are 4001 samples, so it will
# be told, to some tenths of a per cent.
#
# The fit
# -------
#
# In a terminal: ``cosim fit stage_fit.toml --output results --report results/fit.html``. The same in
# Python, for the pictures below:
from cosim.design.fit import fit

fitted = fit(FOLDER / "stage_fit.toml")
print(fitted.message)
for estimate in fitted.estimates:
    print(
        f"{estimate.name:15} {estimate.value:10.6g}  "
        f"{estimate.low:10.6g} to {estimate.high:10.6g} {estimate.unit}"
    )
assert fitted.converged
assert not fitted.weak

# %%
# The interval holds the true value with 95 % probability, if the model is right. Here the truth is known:
TRUTH = {
    "plant.J_rot": 2e-4,
    "plant.F_C": 0.5,
    "plant.F_S": 0.7,
    "plant.v_s": 2.0,
    "plant.sigma_0": 2000.0,
    "plant.sigma_1": 1.0,
    "plant.sigma_2": 0.012,
    "position delay": 0.4e-3,
}
figure, panel = plt.subplots(figsize=(7.5, 3.2), layout="constrained")
for row, estimate in enumerate(fitted.estimates):
    truth = TRUTH[estimate.name]
    assert abs(estimate.value / truth - 1.0) < 0.01, estimate.name
    ends = 100.0 * (
        np.array(
            [[estimate.value - estimate.low], [estimate.high - estimate.value]]
        )
        / truth
    )
    panel.errorbar(
        100.0 * (estimate.value / truth - 1.0),
        row,
        xerr=ends,
        fmt="o",
        color="#0072B2",
        capsize=4,
    )
panel.axvline(0.0, color="#D55E00", label="truth")
panel.set(
    title="Fitted values with their 95 % intervals",
    xlabel="Difference from the truth in %",
)
panel.set_yticks(
    range(len(fitted.estimates)),
    [estimate.name for estimate in fitted.estimates],
)
panel.invert_yaxis()
panel.grid(color="#DDDDDD")
panel.legend()
plt.show()

# %%
# **What to look at.** How wide an interval is: masses, friction and delay are known far better than stiffness and
# damping of the bristles, which act in the first second only. A log with more small motions would narrow them.
#
# On a real machine the model is never right, and the intervals say so only in part: they are widened where the
# residuals are not white. The next two pictures are the judges.
#
# Residuals: is anything left but noise?
# --------------------------------------
#
# The sensor has a noise of 20 nm and a resolution of 10 nm, together 20.2 nm rms.
from cosim.result.compare import spectrum

expected = (20e-9**2 + 10e-9**2 / 12) ** 0.5
figure, panels = plt.subplots(2, 2, figsize=(7.5, 4.6), layout="constrained")
for row, compared in enumerate(
    c for c in fitted.comparisons if c.output == "position"
):
    left = compared.measured - compared.expected
    what = "not fitted" if compared.validates else "fitted"
    print(
        f"record {compared.record} ({what}): {1e9 * compared.rms:.2f} nm rms, "
        f"{1e9 * expected:.2f} nm of the sensor"
    )
    assert abs(compared.rms / expected - 1.0) < 0.05
    panels[row, 0].plot(
        compared.time, 1e9 * left, color="#009E73", linewidth=0.4
    )
    panels[row, 0].set(
        title=f"Record {compared.record}, {what}", ylabel="Residual in nm"
    )
    density = spectrum(compared.time, left)
    white = expected / np.sqrt(density.frequency[-1])
    panels[row, 1].loglog(
        density.frequency[1:],
        1e9 * density.density[1:],
        color="#009E73",
        linewidth=0.6,
        label="left",
    )
    panels[row, 1].axhline(
        1e9 * white,
        color="#D55E00",
        linestyle="--",
        label="white noise of the sensor",
    )
    panels[row, 1].set(title="Its spectral density", ylabel="nm/√Hz")
    panels[row, 1].legend(loc="lower left", fontsize=8)
panels[1, 0].set_xlabel("Time in s")
panels[1, 1].set_xlabel("Frequency in Hz")
plt.show()

# %%
# **What to look at.** On the left, no motion may shine through: a burst where the machine reverses is friction that
# the model does not have; a slow wave is a lead error. On the right, a flat line at the level of the sensor is noise;
# a peak is a resonance or a ripple that the model lacks.
#
# Validation: a record that was not fitted
# ----------------------------------------
#
# A fit with many free values can fit anything *once*. The second record is another motion of the same machine, and took
# no part in the fit.
figure, panels = plt.subplots(
    2, 1, figsize=(7.5, 4.2), sharex=True, layout="constrained"
)
for panel, compared in zip(
    panels, (c for c in fitted.comparisons if c.validates), strict=True
):
    factor, unit = (1e3, "mm") if compared.output == "position" else (1.0, "V")
    panel.plot(
        compared.time, factor * compared.measured, color="#0072B2", label="log"
    )
    panel.plot(
        compared.time,
        factor * compared.expected,
        "--",
        color="#D55E00",
        label="fitted plant",
    )
    panel.set(
        title=f"{compared.output}: fit {compared.fit:.2f} %",
        ylabel=f"{compared.output.capitalize()} in {unit}",
    )
    panel.grid(color="#DDDDDD")
    panel.legend()
    assert compared.fit > 99.5
panels[-1].set_xlabel("Time in s")
plt.show()

# %%
# The fit in per cent is 100 (1 - rms of the difference / rms of the record about its mean): 100 is perfect, 0 is no
# better than the mean.
#
# The plant of your machine
# -------------------------
#
# ``start.toml`` completes ``stage.toml`` with the values that were found. It is a system like any other: run it,
# sweep it, tune a controller on it.
from cosim.design.fit import write_start

write_start(fitted, FOLDER / "start.toml", base="stage.toml")
print((FOLDER / "start.toml").read_text())

# %%
# The delay belongs to the sensor, not to the plant, so ``start.toml`` has none; the comparison takes it back.
run(
    "cosim run start.toml --overlay stage.csv"
    " --signals plant.position=position --delay -0.0004"
)

# %%
# (The delay lies between two samples, where the run is interpolated; that is why the rms is larger than above.)
#
# What can go wrong
# -----------------
#
# **Values that only act together.** A linear motor without a loop: mass, damping, and the force per volt. If all
# three are free, no log can tell them apart: twice the mass, twice the damping and twice the force move alike. The
# fit says so in place of printing numbers that mean nothing.
import tomllib

from cosim.design.fit_file import make_fit

document = tomllib.loads((FOLDER / "motor_fit.toml").read_text())
document["parameters"]["plant.K_a"] = {}
together = fit(make_fit(document, folder=FOLDER))
for sentence in together.findings:
    print(sentence)
assert [set(weak.names) for weak in together.weak] == [
    {"plant.m", "plant.b", "plant.K_a"}
]

# %%
# Remedy: give the one that you know. With the force constant of the data sheet (``motor_fit.toml`` as it is), mass and
# damping are found.
#
# **A log in which nothing moves**, a value that nothing depends on, a column with another unit: each is refused
# before the fit, with the reason.
#
# **A local minimum.** Start values that are wrong by a factor of ten may lead somewhere else. Take the first values of
# ``cosim identify friction``, and look at the overlay before you fit.
#
# Where to go from here
# ---------------------
#
# * ``cosim study emps --data DIR`` does all this on a **measured** ballscrew axis, a public benchmark that you
#   download.
# * :doc:`/results` says how runs and records are compared.
# * :doc:`/physics` says which friction model is for what.
#
# The last line deletes the temporary folder.
temporary.cleanup()
