r"""Your own controller: build, check, test, tune and rank it
=========================================================

You have an idea for a position controller. This tutorial goes from a Python file with its equations to an FMU, tests
it against a closed form, runs it against a ballscrew stage with friction, tunes it, and compares it with the
controllers of this library under equal conditions.

The controller is PID by pole placement with feed-forward: for a plant of mass :math:`M` and damping :math:`B`, you
choose three poles, and the gains follow.

**You need** motion-cosim with the extras ``build`` (the compiler) and ``tools`` (tuning), and pytest.
"""

# %%
# A helper first: ``run`` starts a command as a terminal does, here in a temporary folder.
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


def write(name, text):
    """Write a file of this tutorial."""
    (FOLDER / name).write_text(text, encoding="utf-8")


# %%
# Write the equations
# -------------------
#
# With the error :math:`e = x_r - x` of position, the error :math:`v_r - v` of velocity, and the acceleration
# :math:`w_r` of the reference, the force
#
# .. math::
#
#     F = M \left(w_r + a_1 e + a_0 \int e \, dt\right) + (M a_2 - B) (v_r - v) + B v_r
#
# makes the error of a mass with damping obey :math:`e''' + a_2 e'' + a_1 e' + a_0 e = 0`. The coefficients follow from
# the poles: :math:`a_2 = p_1 + p_2 + p_3`, :math:`a_1 = p_1 p_2 + p_2 p_3 + p_3 p_1`, :math:`a_0 = p_1 p_2 p_3`.
#
# A component is one class in one file. What it needs:
#
# * ``parameter`` and ``variable`` lines, each with start value, **unit** and description: they become
#   ``modelDescription.xml``. Bounds are checked by the FMU.
# * ``output``: the command from the state and the inputs *of this sample*. ``update``: the state of the next sample. It
#   gets the output that was really given, after the limit; so the integrator can be held while the command is limited.
# * ``where`` in place of ``if``, because the equations are translated to C.
# * ``rules``: what must hold between parameters, else the FMU refuses to start.
#
# Measured velocity, limit and hold of the integrator exist already in ``fmus.physics.sampling``.
write(
    "pole_pid.py",
    '''"""PID position control by pole placement."""

from cosim.model import Controller, Record, Rule, parameter, variable, where
from fmus.physics.sampling import (
    VelocitySource,
    measured_velocity,
    saturate,
    winds_up,
)


class PolePid(Controller):
    """PID position control by pole placement, with feed-forward.

        error = position_ref - position
        a_2 = pole_1 + pole_2 + pole_3
        a_1 = pole_1*pole_2 + pole_2*pole_3 + pole_3*pole_1
        a_0 = pole_1*pole_2*pole_3
        command = M*(acceleration_ref + a_1*error + integral)
                  + (M*a_2 - B)*(velocity_ref - velocity) + B*velocity_ref
        integral[k+1] = integral + a_0*error*T_s

    The command is limited to command_max. The integral is held while the
    command is at its limit and the error drives it on.

    A positive command drives towards positive position.

    Source: own work; pole placement as in Astrom & Murray, Feedback Systems,
    Princeton University Press, 2008, ch. 6.
    """

    pole_1: float = parameter(
        1500.0, "1/s", "First pole, its distance from 0", min=0.0, nominal=100.0
    )
    pole_2: float = parameter(
        300.0, "1/s", "Second pole", min=0.0, nominal=100.0
    )
    pole_3: float = parameter(
        100.0, "1/s", "Third pole", min=0.0, nominal=100.0
    )
    M: float = parameter(1.0, "kg", "Moving mass", min=1e-6)
    B: float = parameter(0.0, "N.s/m", "Viscous damping", min=0.0)
    command_max: float = parameter(
        0.0, "N", "Largest force (0 = no limit)", min=0.0
    )
    velocity_source: VelocitySource = parameter(
        VelocitySource.difference, "1", "Origin of the velocity"
    )
    velocity_filter_time: float = parameter(
        5e-4, "s", "Time constant of the velocity filter", min=0.0
    )

    class State(Record):
        integral: float = variable(0.0, "m/s2", "Integral part", nominal=1.0)
        started: float = variable(0.0, "1", "1 after the first sample")
        position_last: float = variable(
            0.0, "m", "Position of the sample before", nominal=1e-3
        )
        velocity_last: float = variable(
            0.0, "m/s", "Velocity estimate of the sample before", nominal=1e-2
        )

    class Input(Record):
        position_ref: float = variable(
            0.0, "m", "Reference position", nominal=1e-3
        )
        velocity_ref: float = variable(
            0.0, "m/s", "Reference velocity", nominal=1e-2
        )
        acceleration_ref: float = variable(
            0.0, "m/s2", "Reference acceleration"
        )
        position: float = variable(0.0, "m", "Measured position", nominal=1e-3)
        velocity: float = variable(
            0.0,
            "m/s",
            "Measured velocity, for velocity_source = input",
            nominal=1e-2,
        )

    class Output(Record):
        command: float = variable(0.0, "N", "Force")
        error: float = variable(
            0.0, "m", "Reference minus position", nominal=1e-6
        )
        velocity_estimate: float = variable(
            0.0, "m/s", "Measured velocity", nominal=1e-2
        )

    def rules(self):
        poles = self.pole_1 + self.pole_2 + self.pole_3
        return (
            Rule(
                self.M * poles >= self.B,
                "M*(pole_1 + pole_2 + pole_3) must be at least B. Take faster poles.",
            ),
        )

    def output(self, t, x, u):
        a_2 = self.pole_1 + self.pole_2 + self.pole_3
        a_1 = (
            self.pole_1 * self.pole_2
            + self.pole_2 * self.pole_3
            + self.pole_3 * self.pole_1
        )
        velocity = measured_velocity(self, x, u)
        error = u.position_ref - u.position
        force = (
            self.M * (u.acceleration_ref + a_1 * error + x.integral)
            + (self.M * a_2 - self.B) * (u.velocity_ref - velocity)
            + self.B * u.velocity_ref
        )
        return self.Output(
            command=saturate(force, self.command_max),
            error=error,
            velocity_estimate=velocity,
        )

    def update(self, t, x, u, y):
        increment = self.pole_1 * self.pole_2 * self.pole_3 * y.error * self.T_s
        held = winds_up(y.command, self.command_max, y.error)
        return self.State(
            integral=x.integral + where(held, 0.0, increment),
            started=1.0,
            position_last=u.position,
            velocity_last=y.velocity_estimate,
        )
''',
)

# %%
# Build and look
# --------------
#
# One command traces the equations, writes C, compiles it, and makes the FMU. What cannot be translated is told with its
# line and what to write in its place.
run("cosim build pole_pid.py -o fmus")

# %%
# Any tool, and ``cosim info``, sees it now as it sees every FMU:
run("cosim info fmus/PolePid.fmu")

# %%
# **What to look at.** The unit of each line, and the last lines: the command depends directly on the inputs, so a
# master must set the inputs first (see :doc:`1_fmus_in_your_tool`).
#
# Test it before you believe it
# -----------------------------
#
# A test of a controller needs a truth that does not come from the controller's own code. Three kinds serve:
#
# 1. **A closed form.** On a linear motor (mass and damping, no friction) all poles at :math:`p`: a force :math:`F` that
#    acts from the start must move the table by :math:`x(t) = \frac{F}{2M} t^2 e^{-pt}`.
# 2. **The same law, written down again** in plain numpy, on recorded inputs.
# 3. **The equations called directly**, at a limit that you know. A component is a Python class, too.
write(
    "test_pole_pid.py",
    '''"""Tests of the controller of pole_pid.py, as an FMU and as equations."""

import numpy as np
import pytest
from pole_pid import PolePid

import cosim

P, T_S = 100.0, 1e-5
LOOP = {
    "connections": [
        "plant.position -> controller.position",
        "plant.velocity -> controller.velocity",
        {"from": "controller.command", "to": "plant.command", "factor": 0.01},
    ],
    "experiment": {
        "stop_time": 0.1,
        "step_size": T_S,
        "order": ["controller", "plant"],
    },
    "instances": {
        "controller": {
            "fmu": "fmus/PolePid.fmu",
            "start": {
                "T_s": T_S,
                "M": 10.0,
                "B": 250.0,
                "pole_1": P,
                "pole_2": P,
                "pole_3": P,
            }
            | {"velocity_source": "input"},
        },
        "plant": {"fmu": "LinearMotor", "start": {"disturbance_force": 10.0}},
    },
    "record": {
        "variables": ["plant.position", "plant.velocity", "controller.command"]
    },
}


@pytest.fixture(scope="module")
def result():
    return cosim.simulate(cosim.make_system(LOOP, folder="."))


def test_a_force_moves_the_table_as_the_closed_form_says(result):
    t = result.time
    expected = 10.0 / (2.0 * 10.0) * t**2 * np.exp(-P * t)
    # The sampled controller holds its command: its answer is half a sample late, P*T_S/2 of the response.
    assert np.max(
        np.abs(result["plant.position"] - expected)
    ) < 2.0 * P * T_S * np.max(expected)


def test_the_command_is_that_of_the_law_written_down_again(result):
    error, velocity = -result["plant.position"], result["plant.velocity"]
    integral = P**3 * T_S * np.concatenate([[0.0], np.cumsum(error)[:-1]])
    command = (
        10.0 * (3.0 * P**2 * error + integral)
        - (10.0 * 3.0 * P - 250.0) * velocity
    )
    assert result["controller.command"] == pytest.approx(
        command, rel=1e-9, abs=1e-9
    )


def test_the_command_is_limited_and_the_integrator_held():
    controller = PolePid(command_max=5.0)
    x, u = PolePid.State(integral=0.2), PolePid.Input(position_ref=1.0)
    y = controller.output(0.0, x, u)
    assert y.command == 5.0
    assert controller.update(0.0, x, u, y).integral == 0.2
    free = PolePid.Input(position_ref=1e-9)
    assert (
        controller.update(
            0.0, x, free, controller.output(0.0, x, free)
        ).integral
        > 0.2
    )
''',
)
run("pytest -q -p no:cacheprovider test_pole_pid.py")

# %%
# The loop: stage, friction, one sample of delay
# ----------------------------------------------
#
# Now the real thing: the ballscrew stage of Shams and Safdari (LuGre friction of 6.2 N.m at the screw, 3.9 kN at the
# table). The controller works in newtons at the table, the stage takes a torque at the screw: the last wire has the
# lead as its factor. Friction compensation need not be written again: the component ``FrictionFeedforward`` adds the
# friction of a model at the *reference* velocity. Its model has 0.8 of the true dry friction, as a model is never
# perfect, and ``share`` switches it.
write(
    "loop.toml",
    """
description = "My controller on the ballscrew stage, 2 mm at 1 Hz"
connections = [
    "trajectory.position -> controller.position_ref",
    "trajectory.velocity -> controller.velocity_ref",
    "trajectory.acceleration -> controller.acceleration_ref",
    "plant.position -> controller.position",
    "controller.command -> friction.force",
    "trajectory.velocity -> friction.velocity_ref",
    { from = "friction.command", to = "plant.command", factor = 0.0015923 },
]

[experiment]
stop_time = 1.4
step_size = 1e-4
order = ["trajectory", "controller", "friction", "plant"]

[instances.trajectory]
fmu = "Trajectory"
start = { kind = "sine", amplitude = 2e-3, frequency = 1.0, soft_start = 0.4 }

[instances.controller]
fmu = "fmus/PolePid.fmu"
[instances.controller.start]
M = 146.0
B = 157.8e3
command_max = 56e3
pole_1 = 1500.0
pole_2 = 300.0
pole_3 = 100.0

[instances.friction]
fmu = "FrictionFeedforward"
[instances.friction.start]
share = 0.0
sigma_0_hat = 3.944e10
sigma_1_hat = 1.247e8
F_C_hat = 3135.0
F_S_hat = 4703.0
v_s_hat = 1.592e-6

[instances.plant]
fmu = "BallscrewStage"

[record]
variables = [
    "trajectory.position",
    "plant.position",
    "controller.error",
    "friction.command",
]
""",
)

# %%
# ``check`` initializes all FMUs and says how the loop will run, before it runs.
run("cosim check loop.toml")

# %%
import cosim

system = cosim.read_system(FOLDER / "loop.toml")
without = cosim.simulate(system)
compensated = cosim.simulate(system.changed({"friction.share": 1.0}))


def rms(result, start=0.5):
    """The tracking error in um from ``start`` seconds on."""
    part = cosim.metrics.window(result.time, start)
    return 1e6 * cosim.metrics.rms(
        (result["trajectory.position"] - result["plant.position"])[part]
    )


print(
    f"rms error without friction model: {rms(without):.3f} um, "
    f"with it: {rms(compensated):.3f} um"
)
part = cosim.metrics.window(compensated.time, 0.5)
activity = cosim.metrics.total_variation(
    compensated.time[part], compensated["friction.command"][part]
)
print(f"total variation of the force, with it: {activity:.3g} N/s")
assert rms(compensated) < rms(without)

cosim.plot(
    [without, compensated],
    signals=["plant.position", "controller.error", "friction.command"],
    labels=["without friction model", "with friction model"],
)

# %%
# **What to look at.** The error has a peak at each reversal, where the friction changes its sign and the integrator
# must follow. The friction model takes most of it away, with the same poles.
#
# A rule that is broken is told before the run, with what to do:
try:
    cosim.simulate(system.changed({"controller.pole_1": 500.0}))
except cosim.CosimError as error:
    print(error)
else:
    raise AssertionError("poles that are too slow were taken")

# %%
# Tune it
# -------
#
# Faster poles give a smaller error, until the delay, the velocity filter and the limit of the drive answer. A tuning
# file says what shall be small (the objective), what must not be exceeded (limits), and which values are free. The
# search runs with all commands one sample late (``order = "parallel"``), as real controllers are, so that it keeps away
# from the edge. The limit on the total variation of the force keeps the command quiet: 4e5 N/s is some
# ten times what the loop above needs.
#
# The system to tune is the one above with the friction model; a file that completes another one names it as its base.
write(
    "model.toml",
    """
base = "loop.toml"

[instances.friction.start]
share = 1.0
""",
)
write(
    "tune.toml",
    """
system = "model.toml"
objective = "error"
generations = 3
population = 5

[parameters]
"controller.pole_1" = { from = 1100.0, to = 4000.0, log = true }
"controller.pole_2" = { from = 100.0, to = 1000.0, log = true }
"controller.pole_3" = { from = 100.0, to = 1000.0, log = true }

[limits]
activity = 4e5

[experiment]
order = "parallel"

[metrics]
window = [0.5, 1.4]
error = { of = "rms", signal = "controller.error" }
activity = { of = "total_variation", signal = "friction.command" }
""",
)
assert 8.0 < 4e5 / activity < 13.0
run("cosim tune tune.toml --start tuned.toml")

# %%
# How near is that to the edge? All poles times a factor tells, with the command one sample late and without delay:
import tomllib

import matplotlib.pyplot as plt
import numpy as np

write(
    "late.toml",
    """
base = "model.toml"

[experiment]
order = "parallel"
""",
)
document = tomllib.loads((FOLDER / "tuned.toml").read_text())
found = document["instances"]["controller"]["start"]
best = {f"controller.{name}": value for name, value in found.items()}
factors = np.array([0.6, 0.8, 1.0, 1.25, 1.5, 2.0])
errors = {}
for name in ("late", "model"):
    loop = cosim.read_system(FOLDER / f"{name}.toml")
    scaled = [
        {pole: factor * value for pole, value in best.items()}
        for factor in factors
    ]
    errors[name] = [
        rms(cosim.simulate(loop.changed(poles))) for poles in scaled
    ]
    print(name, ", ".join(f"{error:.3f}" for error in errors[name]))

figure, panel = plt.subplots(figsize=(7.5, 3.2), layout="constrained")
panel.loglog(
    factors,
    errors["late"],
    "o-",
    color="#D55E00",
    label="command late (parallel)",
)
panel.loglog(
    factors,
    errors["model"],
    "o-",
    color="#0072B2",
    label="no delay (sequential)",
)
panel.axvline(0.8, color="#999999", linestyle="--", label="taken: 0.8")
panel.set_xticks(factors, [f"{factor:g}" for factor in factors])
panel.minorticks_off()
panel.set(
    title="How near is the edge?",
    xlabel="Factor of all poles",
    ylabel="rms error in um",
)
panel.grid(color="#DDDDDD")
panel.legend()
plt.show()
assert errors["late"][-1] > 10.0 * errors["late"][2]
assert errors["model"][-1] < errors["model"][2]

# %%
# **What to look at.** Without delay, faster is better on the whole picture. With the command late, the same loop
# falls into a limit cycle, a step to the right of the best point. A tuning without delay would have chosen poles that
# no real controller survives. So take 0.8 of each pole:
poles = {name: 0.8 * value for name, value in best.items()}
print({name: round(value, 1) for name, value in poles.items()})
tuned = cosim.simulate(system.changed({"friction.share": 1.0} | poles))
print(
    f"rms error before: {rms(compensated):.3f} um, tuned: {rms(tuned):.3f} um"
)
assert rms(tuned) < 0.5 * rms(compensated)

cosim.plot(
    [compensated, tuned],
    signals=["controller.error", "friction.command"],
    labels=["first poles", "tuned poles"],
)

# %%
# **What to look at.** The error is smaller everywhere, and the force is the same: no ripple came with the faster
# poles. If the lower panel shows a band in place of a line, the limit on the activity is too generous.
#
# Rank it against the controllers of this library
# -----------------------------------------------
#
# The study ``ranking`` compares controllers under equal conditions: the same plants, the same friction model, the same
# measured velocity, the same limit of the force, the same number of simulations to find the gains. A controller enters
# it with one file that says which FMU it is, what its inputs are, and how its parameters follow from a plant and three
# frequencies:
import importlib.util
import shutil

from cosim.fmu.places import shipped_studies

shutil.copytree(shipped_studies()["ranking"], FOLDER / "ranking")
write(
    "ranking/controllers/pole_pid.py",
    '''"""PID by pole placement: its poles are the frequencies."""

TITLE = "Pole PID (mine)"
FMU = "../../fmus/PolePid.fmu"  # seen from the folder systems
INPUTS = {
    "position_ref": "trajectory.position",
    "velocity_ref": "trajectory.velocity",
    "acceleration_ref": "trajectory.acceleration",
    "position": "plant.position",
}


def start(plant, gains, model):
    return {
        "pole_1": gains.fast,
        "pole_2": gains.position,
        "pole_3": gains.integral,
        "M": plant.M,
        "B": plant.B,
        "command_max": plant.force_max,
    }
''',
)

# %%
# In a checkout, the whole ranking is then two commands: ``python studies/ranking/tune.py --controllers pole_pid``
# searches the gains on five plants with two seeds, and ``cosim study ranking`` judges. That takes minutes. Here is
# the part for this stage: the script of the study makes the system of my controller, with the poles found above; the
# others have the systems of the study. All follow two references that no search has seen. (The search above took
# about as many runs as the study gives to each controller, but on another sine: equal enough for a first look.)
specification = importlib.util.spec_from_file_location(
    "ranking_tune", FOLDER / "ranking/tune.py"
)
ranking = importlib.util.module_from_spec(specification)
sys.modules[specification.name] = ranking
specification.loader.exec_module(ranking)

entries, stage = ranking.controllers(), ranking.PLANTS["shams"]
gains = ranking.Gains(*poles.values())
REFERENCES = {
    "1 mm at 2 Hz": {"trajectory.amplitude": 1e-3, "trajectory.frequency": 2.0},
    "0.5 mm at 0.25 Hz": {
        "trajectory.amplitude": 5e-4,
        "trajectory.frequency": 0.25,
    },
}
ranked = {}
for name, entry in entries.items():
    if name == "pole_pid":
        document = ranking.document(entry, stage, gains, True)
        contender = cosim.make_system(
            document, folder=FOLDER / "ranking/systems"
        )
    else:
        contender = cosim.read_system(
            FOLDER
            / f"ranking/systems/{ranking.system_name(name, 'shams', True)}.toml"
        )
    results = (
        cosim.simulate(contender.changed(values))
        for values in REFERENCES.values()
    )
    ranked[entry.TITLE] = [rms(result, start=1.0) for result in results]
for title in sorted(ranked, key=ranked.get):
    print(
        f"{title:20} "
        + ", ".join(f"{error:6.3f} um" for error in ranked[title])
    )

# %%
titles = sorted(ranked, key=ranked.get, reverse=True)
figure, panel = plt.subplots(figsize=(7.5, 4.4), layout="constrained")
for shift, reference, colour, column in zip(
    (0.2, -0.2), REFERENCES, ("#0072B2", "#E69F00"), (0, 1), strict=True
):
    places = [row + shift for row in range(len(titles))]
    panel.barh(
        places,
        [ranked[title][column] for title in titles],
        height=0.4,
        color=colour,
        label=reference,
    )
panel.set_yticks(range(len(titles)), titles)
for label in panel.get_yticklabels():
    label.set_fontweight("bold" if "mine" in label.get_text() else "normal")
panel.set(
    xscale="log",
    xlabel="rms error in um",
    title="Controllers on one stage, with the same friction model",
)
panel.grid(axis="x", color="#DDDDDD")
panel.legend()
plt.show()

# %%
# **What to look at.** The scale is logarithmic. Differences of some per cent between neighbours mean little: another
# seed of the search moves them. What counts is the factor to the best, whether the order holds on the second
# reference, and what else would have gained as much. Here the friction model did:
leading = sorted(errors[0] for errors in ranked.values())[:6]
print(f"best to sixth: a factor of {leading[-1] / leading[0]:.2f}")
print(
    f"friction model, with the first poles: "
    f"a factor of {rms(without) / rms(compensated):.2f}"
)
assert rms(without) / rms(compensated) > 2.0 * leading[-1] / leading[0]

# %%
# What can go wrong
# -----------------
#
# * **A plain if on a signal.** It cannot be translated to C, and ``cosim build`` names the line. Write ``where``.
# * **A unit that is not SI.** The FMU has SI units at its border; a factor belongs into the wire.
# * **An algebraic loop.** If plant and controller both depend directly on their inputs, ``cosim check`` says so.
# * **Tuned on one machine.** Poles at the edge are lost first when the mass or the friction is another. Tutorial
#   :doc:`5_sweep_tune_robustness` asks how robust a loop is.
#
# Where to go from here
# ---------------------
#
# * :doc:`/systems` has all keys of a system file.
# * :doc:`/architecture` shows how components become FMUs.
# * :doc:`/explanations/time-and-sampling` says when a controller samples, and where a sample of delay comes from.
#
# The last line deletes the temporary folder.
temporary.cleanup()
