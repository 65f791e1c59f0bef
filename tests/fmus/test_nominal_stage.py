"""Nominal stage: the exact response to held inputs, options."""

from __future__ import annotations

import pytest
from motion_loops import rk4
from nctf_reference import reference

from fmus.plant.nominal_stage import NominalStage

State = NominalStage.State
Input = NominalStage.Input


def test_held_inputs_give_the_response_of_the_matrix_exponential():
    data, plant = reference("nominal_stage"), NominalStage()
    x = plant.initial()
    for k in range(200):
        u = Input(command=float(data["command"][k]), disturbance=float(data["disturbance"][k]))
        x = rk4(plant, 0.0, x, u, step=1e-3, parts=4)
        # Runge-Kutta at 0.25 ms: (alpha*h)^4/120 = 7e-8 of a change of velocity below 0.02 m/s.
        assert x.position == pytest.approx(data["states"][k + 1, 0], abs=1e-10)
        assert x.velocity == pytest.approx(data["states"][k + 1, 1], abs=2e-9)


def test_constant_command_ends_at_the_gain_and_disturbance_opposes():
    plant = NominalStage(velocity_start=5.672e-3 * 3.0)
    u = Input(command=3.0)
    assert plant.derivative(0.0, plant.initial(), u).velocity == pytest.approx(0.0, abs=1e-12)
    pushed = plant.derivative(0.0, plant.initial(), Input(command=3.0, disturbance=0.5))
    assert pushed.velocity == pytest.approx(-0.5, rel=1e-12)


def test_command_is_limited_and_position_rounded():
    plant = NominalStage(command_max=2.0, position_resolution=1e-6)
    at_limit = plant.derivative(0.0, State(), Input(command=50.0)).velocity
    assert at_limit == pytest.approx(215.2 * 5.672e-3 * 2.0, rel=1e-12)
    assert plant.output(0.0, State(position=2.4e-6), Input()).position == pytest.approx(2e-6, rel=1e-12)
