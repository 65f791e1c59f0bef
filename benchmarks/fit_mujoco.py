"""MuJoCo as a peer of ``cosim fit`` on the made-up stage: steps for the same accuracy, and its sysid on the record.

    python -m venv peer && peer/bin/pip install "mujoco[sysid]"
    peer/bin/python benchmarks/fit_mujoco.py accuracy          # against Radau, over step sizes
    peer/bin/python benchmarks/fit_mujoco.py fit 2e-5          # the fit, with this step

MuJoCo has the same LuGre law with the same parameters (``lugre`` of its DC motor: stiffness, damping, Coulomb, static,
Stribeck velocity); its motor here turns a control of 1 into a force of 1. It runs with the values at the table, and the
position loop stands in Python around it, at 1 kHz. The fit starts where ``stage_fit.toml`` does.
"""

from __future__ import annotations

import sys
import time as clock
from pathlib import Path

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "docs" / "examples" / "your_machine"))
import make_records as made

L_P = made.STAGE["l_p"]
TRUTH = {
    "inertia": made.STAGE["m"] + made.STAGE["J_rot"] / L_P**2,
    "F_C": made.STAGE["F_C"] / L_P,
    "F_S": made.STAGE["F_S"] / L_P,
    "v_s": made.STAGE["v_s"] * L_P,
    "sigma_0": made.STAGE["sigma_0"] / L_P**2,
    "sigma_1": made.STAGE["sigma_1"] / L_P**2,
    "sigma_2": made.STAGE["sigma_2"] / L_P**2,
}
START = {
    "inertia": made.STAGE["m"] + 2.1e-4 / L_P**2,
    "F_C": 0.5 / L_P,
    "F_S": 0.75 / L_P,
    "v_s": 1.0 * L_P,
    "sigma_0": 2100.0 / L_P**2,
    "sigma_1": 0.5 / L_P**2,
    "sigma_2": 0.0119 / L_P**2,
}
NOISE = {"position": 2.1e-8, "command": 5.1e-3}
MODEL = """
<mujoco>
  <option timestep="{step!r}" gravity="0 0 0" integrator="{integrator}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody><body>
    <joint name="table" type="slide" axis="1 0 0" damping="{sigma_2!r}"/>
    <geom type="sphere" size="0.1" mass="{inertia!r}"/>
  </body></worldbody>
  <actuator>
    <dcmotor joint="table" motorconst="1e-6" resistance="1e-6"
             lugre="{sigma_0!r} {sigma_1!r} {F_C!r} {F_S!r} {v_s!r}"/>
  </actuator>
</mujoco>
"""


def loop(
    values: dict[str, float], reference: made.Array, step: float, integrator: str = "Euler"
) -> tuple[made.Array, made.Array]:
    """Position and command of the closed loop."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(step=step, integrator=integrator, **values))
    data = mujoco.MjData(model)
    steps = round(made.T_S / step)
    position, command = np.empty(len(reference)), np.empty(len(reference))
    before = last = 0.0
    for k, wanted in enumerate(reference):
        x = float(data.qpos[0])
        velocity = (x - before) / (2.0 * made.T_S) if k else 0.0
        position[k] = x
        command[k] = made.STAGE["K_vel"] * (made.STAGE["K_pos"] * (wanted - x) - velocity)
        before, last = (last, x) if k else (x, x)
        data.ctrl[0] = made.STAGE["torque"] / L_P * command[k]
        mujoco.mj_step(model, data, steps)
    return position, command


def accuracy() -> None:
    """Errors against Radau over step sizes."""
    reference = made.stage_reference(made.sampled(4.0))
    exact = made.stage_signals(reference, {**made.STAGE, "delay": 0.0})["position"]
    for integrator in ("Euler", "implicitfast", "RK4"):
        for step in (2e-4, 1e-4, 2e-5, 1e-5, 2e-6):
            begun = clock.perf_counter()
            off = loop(TRUTH, reference, step, integrator)[0] - exact
            seconds = clock.perf_counter() - begun
            rms = 1e9 * float(np.sqrt(np.mean(off**2)))
            print(f"{integrator:13} {step:g} s: {4.0 / step:.3g} steps, {rms:.4g} nm rms, {seconds:.3g} s", flush=True)


def fit(step: float) -> None:
    """The fit of mujoco.sysid: values over their truth, intervals, runs, time."""
    from mujoco import sysid

    rows = np.genfromtxt(made.FOLDER / "stage.csv", delimiter=",", skip_header=2)
    time, reference, measured, commanded = rows.T
    runs = 0

    def residual(x: made.Array) -> made.Array:
        nonlocal runs
        runs += 1
        values = {name: START[name] * float(np.exp(z)) for name, z in zip(START, x, strict=False)}
        position, command = loop(values, reference, step)
        late = CubicSpline(time, position)(np.maximum(time - 1e-3 * float(x[-1]), 0.0))
        return np.concatenate([(measured - late)[2:] / NOISE["position"], (commanded - command)[2:] / NOISE["command"]])

    def residuals(x: made.Array, _: object) -> tuple[list[made.Array], None, None]:
        columns = np.asarray(x)
        if columns.ndim == 1:
            return [residual(columns)], None, None
        return [np.stack([residual(column) for column in columns.T], axis=1)], None, None

    parameters = sysid.ParameterDict()
    for name in START:
        parameters.add(sysid.Parameter(name, 0.0, -3.0, 3.0))  # logarithm of the value over its start
    parameters.add(sysid.Parameter("delay", 0.1, 0.0, 2.0))  # ms
    begun = clock.perf_counter()
    found, ended = sysid.optimize(parameters, residuals, verbose=False, max_iters=60)
    seconds = clock.perf_counter() - begun
    x = found.as_vector()
    intervals = sysid.calculate_intervals(residuals(x, None)[0], ended.jac)[1]
    for i, name in enumerate(START):
        off = float(x[i] + np.log(START[name] / TRUTH[name]))
        inside = "inside" if abs(off) <= intervals[i] else "outside"
        print(f"{name:8} {100.0 * off:+.3f} %, half of its interval {100.0 * intervals[i]:.3f} %: {inside}")
    print(f"delay    {x[-1]:.5f} ms, truth {1e3 * made.STAGE['delay']:g} ms")
    print(f"{runs} runs, {seconds:.0f} s, rms {np.sqrt(np.mean(residual(x) ** 2)):.3f} x noise")


if __name__ == "__main__":
    if sys.argv[1:2] == ["accuracy"]:
        accuracy()
    else:
        fit(float(sys.argv[2]))
