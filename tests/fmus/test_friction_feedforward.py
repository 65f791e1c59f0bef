"""FrictionFeedforward: the Stribeck curve at steady speed, the share, the friction of a sliding-mode controller."""

from __future__ import annotations

import math

import pytest

from fmus.controllers.friction_feedforward import FrictionFeedforward
from fmus.controllers.sliding_mode import SlidingMode

LEAD = 1.5923e-3


def last_output(component: FrictionFeedforward, speeds: list[float], force: float = 0.0) -> FrictionFeedforward.Output:
    x = component.State()
    y = component.Output()
    for k, speed in enumerate(speeds):
        u = component.Input(force=force, velocity_ref=speed)
        y = component.output(k * component.T_s, x, u)
        x = component.update(k * component.T_s, x, u, y)
    return y


@pytest.mark.parametrize("speed", [1e-4, -1e-3, 2e-3, 0.05])
def test_steady_speed_gives_the_stribeck_curve(speed: float) -> None:
    component = FrictionFeedforward(T_s=1e-4, sigma_1_hat=2e4, sigma_2_hat=400.0)
    level = 90.0 + 25.0 * math.exp(-((speed / 2e-3) ** 2))
    wanted = math.copysign(level, speed) + 400.0 * speed
    for samples in (1, 50):
        assert last_output(component, [speed] * samples).friction_hat == pytest.approx(wanted, rel=1e-12)


def test_the_share_is_added_to_the_force() -> None:
    speeds = [1e-3 * math.sin(0.1 * k) for k in range(100)]
    whole = last_output(FrictionFeedforward(T_s=1e-4), speeds, 12.0)
    assert whole.command == 12.0 + whole.friction_hat
    half = last_output(FrictionFeedforward(T_s=1e-4, share=0.5), speeds, 12.0)
    assert half.command == 12.0 + 0.5 * whole.friction_hat
    assert last_output(FrictionFeedforward(T_s=1e-4, share=0.0), speeds, 12.0).command == 12.0


def test_it_is_the_friction_model_of_the_sliding_mode_controllers() -> None:
    inside = SlidingMode(T_s=1e-4, l_p=LEAD)
    outside = FrictionFeedforward(
        T_s=1e-4,
        sigma_0_hat=inside.sigma_0_hat / LEAD**2,
        sigma_1_hat=inside.sigma_1_hat / LEAD**2,
        sigma_2_hat=inside.sigma_2_hat / LEAD**2,
        F_C_hat=inside.F_C_hat / LEAD,
        F_S_hat=inside.F_S_hat / LEAD,
        v_s_hat=inside.v_s_hat * LEAD,
    )
    x, speeds = inside.State(), [5e-5 * math.cos(0.2 * k) for k in range(60)]
    for k, speed in enumerate(speeds):
        u = inside.Input(velocity_ref=speed)
        torque = inside.friction_hat(x, u)
        force = last_output(outside, speeds[: k + 1]).friction_hat
        assert force * LEAD == pytest.approx(torque, rel=1e-9)
        x = inside.update(k * inside.T_s, x, u, inside.output(k * inside.T_s, x, u))
