"""CascadeP: its law sample by sample, the first sample, the limit, samples between steps."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from fmus.controllers.cascade_p import CascadeP


def commands(component: CascadeP, wanted: Sequence[float], positions: Sequence[float]) -> list[CascadeP.Output]:
    x, found = component.State(), list[CascadeP.Output]()
    for k, (reference, position) in enumerate(zip(wanted, positions, strict=True)):
        u = component.Input(position_ref=reference, position=position)
        y = component.output(k * component.T_s, x, u)
        x = component.update(k * component.T_s, x, u, y)
        found.append(y)
    return found


POSITIONS = (3e-3, 3.1e-3, 3.3e-3, 3.2e-3, 2.9e-3)


def test_the_velocity_is_the_difference_of_the_means_of_two_positions() -> None:
    component = CascadeP(T_s=1e-3, K_pos=160.0, K_vel=2.0, command_max=0.0)
    found = commands(component, [4e-3] * 5, POSITIONS)
    # Before the record the axis stood where it stands at its first sample.
    padded = [POSITIONS[0], POSITIONS[0], *POSITIONS]
    means = [0.5 * (a + b) for a, b in zip(padded[1:], padded[:-1], strict=True)]
    for k, y in enumerate(found):
        velocity = (means[k + 1] - means[k]) / 1e-3
        assert y.velocity_estimate == pytest.approx(velocity, abs=1e-12)
        assert y.command == pytest.approx(2.0 * (160.0 * (4e-3 - POSITIONS[k]) - velocity), abs=1e-12)


def test_the_first_sample_has_no_velocity() -> None:
    assert commands(CascadeP(), [0.1], [0.2])[0].velocity_estimate == 0.0


@pytest.mark.parametrize(("reference", "limit"), [(1.0, 10.0), (-1.0, -10.0)])
def test_the_command_is_limited(reference: float, limit: float) -> None:
    assert commands(CascadeP(), [reference], [0.0])[0].command == limit
