"""Contour error of paths whose distance from a point has a closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from test_figures import Recording

from cosim.errors import DescriptionError
from cosim.result.metrics import contour_error
from cosim.result.summary import summary

Array = NDArray[np.float64]
RADIUS = 25e-3
ANGLE = np.linspace(0.0, 2.0 * math.pi, 20_001)
SAGITTA = RADIUS * (ANGLE[1] - ANGLE[0]) ** 2 / 8.0
"""By which the polygon through the reference is off the circle: R*(1 - cos(step/2))."""


@pytest.mark.parametrize("lag", [0.0, 0.02, -0.3])
def test_circle_of_another_radius_that_lags(lag: float) -> None:
    """A point at radius r is r - R off the circle, wherever the reference is meanwhile."""
    radius = RADIUS + 3e-6 * np.sin(5.0 * ANGLE)
    turn = ANGLE - lag
    inside = (turn > 0.0) & (turn < 2.0 * math.pi)
    error = contour_error(radius * np.cos(turn), radius * np.sin(turn), RADIUS * np.cos(ANGLE), RADIUS * np.sin(ANGLE))
    # Counter-clockwise the outside is on the right, so negative.
    assert error[inside] == pytest.approx((RADIUS - radius)[inside], abs=1.01 * SAGITTA)


def test_line_in_any_direction_has_the_component_across() -> None:
    way, across, direction = np.linspace(0.0, 0.1, 5001), 1e-6 * np.sin(np.arange(5001) * 0.01), 0.7
    c, s = math.cos(direction), math.sin(direction)
    lagging = way * 0.9 + 0.001
    error = contour_error(lagging * c - across * s, lagging * s + across * c, way * c, way * s)
    assert error == pytest.approx(across, abs=1e-15)


def test_points_moved_along_the_normals_of_an_ellipse() -> None:
    """The point of an ellipse that is nearest to one on its normal is the foot, within the radius of curvature."""
    a, b = 0.04, 0.01
    x, y = a * np.cos(ANGLE), b * np.sin(ANGLE)
    normal = np.column_stack((b * np.cos(ANGLE), a * np.sin(ANGLE)))
    normal /= np.hypot(normal[:, 0], normal[:, 1])[:, np.newaxis]
    away = 1e-4 * np.cos(3.0 * ANGLE)
    # The commanded point runs 100 samples ahead.
    behind = np.maximum(np.arange(ANGLE.size) - 100, 0)
    error = contour_error((x + away * normal[:, 0])[behind], (y + away * normal[:, 1])[behind], x, y)
    smallest_curvature_radius = b * b / a
    sagitta = (a * (ANGLE[1] - ANGLE[0])) ** 2 / (8.0 * smallest_curvature_radius)
    assert error == pytest.approx(-away[behind], abs=sagitta)


def test_corner_is_cut_by_the_bisector() -> None:
    """A point on the bisector inside of a right corner at (d, d) is d off both sides."""
    way = np.linspace(0.0, 1.0, 101)
    x_ref, y_ref = np.concatenate((way, np.ones(100))), np.concatenate((np.zeros(101), way[1:]))
    x, y = x_ref.copy(), y_ref.copy()
    x[100], y[100] = 0.9, 0.1
    error = contour_error(x, y, x_ref, y_ref)
    assert error[100] == pytest.approx(0.1)
    # Outside the corner itself is nearest.
    x[100], y[100] = 1.3, -0.4
    assert contour_error(x, y, x_ref, y_ref)[100] == pytest.approx(-0.5)


def test_a_path_that_crosses_itself_is_measured_at_the_branch_that_is_commanded() -> None:
    """Lemniscate: near the crossing the other branch is nearer than the own one."""
    x_ref, y_ref = np.sin(ANGLE), np.sin(2.0 * ANGLE)
    own = int(np.searchsorted(ANGLE, math.pi))
    x, y = x_ref.copy(), y_ref.copy()
    # At the crossing the branch goes along (-1, 2)/sqrt(5); 0.05 to its left lies nearer to the other, along (1, 2).
    x[own], y[own] = -0.05 * 2.0 / math.sqrt(5.0), -0.05 / math.sqrt(5.0)
    error = contour_error(x, y, x_ref, y_ref)
    assert error[own] == pytest.approx(0.05, rel=1e-3)
    assert np.max(np.abs(np.delete(error, own))) < 1e-12


def test_rests_of_the_reference_do_no_harm() -> None:
    x_ref = np.concatenate((np.zeros(50), np.linspace(0.0, 1.0, 50), np.ones(50)))
    error = contour_error(x_ref, np.full(150, 0.25), x_ref, np.zeros(150))
    assert error == pytest.approx(np.full(150, 0.25))


def test_a_reference_at_rest_has_no_path() -> None:
    with pytest.raises(DescriptionError, match="does not move"):
        contour_error(np.ones(3), np.ones(3), np.zeros(3), np.zeros(3))


def _two_axes(y_ref: Array, y: Array, *, same: bool = False) -> Recording:
    time = np.linspace(0.0, 1.0, ANGLE.size)
    columns = {"tx.position": RADIUS * np.cos(ANGLE), "px.position": (RADIUS + 2e-6) * np.cos(ANGLE)}
    columns |= {"ty.position": y_ref, "py.position": y}
    source = "tx" if same else "ty"
    connections = (
        *("tx.position -> cx.position_ref", "px.position -> cx.position"),
        *(f"{source}.position -> cy.position_ref", "py.position -> cy.position"),
    )
    return Recording(time, columns, dict.fromkeys(columns, "m"), connections)


def test_table_of_a_run_of_two_axes_has_the_contour_error() -> None:
    rows = {row.name: row for row in summary(_two_axes(RADIUS * np.sin(ANGLE), (RADIUS + 2e-6) * np.sin(ANGLE)))}
    row = rows["Contour error, rms from 0.5 s"]
    assert (row.value, row.unit) == (pytest.approx(2.0, rel=1e-3), "um")
    assert rows["Contour error, maximum of the whole run"].value == pytest.approx(2.0, rel=1e-2)


def test_two_loops_of_one_reference_are_no_path() -> None:
    rows = summary(_two_axes(RADIUS * np.sin(ANGLE), RADIUS * np.cos(ANGLE), same=True))
    assert not [row for row in rows if row.name.startswith("Contour")]
