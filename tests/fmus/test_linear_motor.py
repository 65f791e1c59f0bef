"""Linear motor axis: closed forms, and the loop under the cutting force against an independent solver."""

from __future__ import annotations

import math

import numpy as np
import pytest
from motion_loops import Sampled, reference, rk4

from fmus.controllers.p_pi import PPi
from fmus.physics.milling import Side
from fmus.plant.linear_motor import LinearMotor


def test_held_command_gives_the_exact_solution():
    plant = LinearMotor(position_start=2e-6, velocity_start=5e-6)
    u = plant.Input(command=3e-4, disturbance_force=-0.01)
    x = rk4(plant, 0.0, plant.initial(), u, step=0.2, parts=400)
    force = 100.0 * 3e-4 - 0.01
    decay = math.exp(-25.0 * 0.2)
    steady = force / 250.0
    assert x.velocity == pytest.approx(steady + (5e-6 - steady) * decay, rel=1e-9)
    travel = steady * 0.2 + (5e-6 - steady) * (1.0 - decay) / 25.0
    assert x.position == pytest.approx(2e-6 + travel, rel=1e-9)


def test_amplifier_current_and_force():
    plant = LinearMotor()
    y = plant.output(0.0, plant.initial(), plant.Input(command=0.3))
    assert (y.current, y.motor_force, y.cutting_force) == (0.6, 30.0, 0.0)


def test_force_limit_holds_in_both_directions():
    plant = LinearMotor(force_max=20.0)
    for sense in (1.0, -1.0):
        u = plant.Input(command=sense * 5.0)
        y = plant.output(0.0, plant.initial(), u)
        assert (y.motor_force, y.current) == (sense * 20.0, sense * 0.4)
        assert plant.derivative(0.0, plant.initial(), u).velocity == sense * 2.0


def test_position_is_rounded_to_the_resolution_only_at_the_output():
    plant = LinearMotor(position_resolution=1e-8, position_start=1.2345678e-6)
    assert plant.output(0.0, plant.initial(), plant.Input()).position == pytest.approx(1.23e-6, abs=1e-18)
    assert plant.initial().position == 1.2345678e-6


def test_disturbance_and_cutting_force_push_like_the_command():
    # rest: with tool at 0.3 ms the force of the slot points to negative x, 0.1 N on 10 kg
    plant = LinearMotor(feed_per_tooth=1e-6)
    cutting = plant.output(3e-4, plant.initial(), plant.Input()).cutting_force
    assert cutting < -0.01
    assert plant.derivative(3e-4, plant.initial(), plant.Input()).velocity == pytest.approx(cutting / 10.0)
    table = LinearMotor(feed_per_tooth=1e-6, side=Side.table, start_time=1.0)
    assert table.output(3e-4, table.initial(), table.Input()).cutting_force == 0.0
    assert table.output(1.0 + 3e-4, table.initial(), table.Input()).cutting_force == pytest.approx(-cutting, rel=1e-6)
    assert plant.derivative(0.0, plant.initial(), plant.Input(disturbance_force=5.0)).velocity == 0.5


def test_energy_of_a_free_motion_never_grows():
    plant = LinearMotor(velocity_start=1e-3)
    x, last = plant.initial(), math.inf
    for k in range(50):
        energy = 0.5 * plant.m * x.velocity**2
        assert energy < last
        last = energy
        x = rk4(plant, k * 1e-3, x, plant.Input(), step=1e-3, parts=4)


def test_loop_under_the_cutting_force_follows_the_reference():
    plant = LinearMotor(feed_per_tooth=1e-6)
    controller = Sampled(PPi(K_p=5000.0))
    expected = reference("linear_motor")["milled"][:401]
    x, command = plant.initial(), 0.0
    found = np.zeros((len(expected), 4))
    for k in range(len(expected)):
        t = k * 1e-4
        y = plant.output(t, x, plant.Input(command=command))
        s, c = math.sin(3.0 * t), math.cos(3.0 * t)
        r = {"position_ref": 1e-6 * s, "velocity_ref": 3e-6 * c, "acceleration_ref": -9e-6 * s}
        sample = controller(position=y.position, **r)
        command = sample.command
        found[k] = x.position, x.velocity, sample.force, y.cutting_force
        x = rk4(plant, t, x, plant.Input(command=command), step=1e-4, parts=4)
    # Four steps of RK4 over a root-like rise of 0.1 N at each entry: some 1e-4 of a 0.02 um vibration.
    assert np.max(np.abs(found[:, 0] - expected[:, 0])) < 2e-11
    assert np.max(np.abs(found[:, 3] - expected[:, 3])) < 1e-9
    assert np.max(np.abs(expected[:, 0])) > 1e-8
