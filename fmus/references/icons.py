"""Pictograms of all components; ``build_fmus.py --references`` draws them as icons."""

# matplotlib leaves the types of its keyword arguments open:
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Polygon, Rectangle
from PIL import Image

DARK, STEEL, PALE, ORANGE, WHITE = "#16324F", "#5B7C99", "#DCE6EF", "#D55E00", "#FFFFFF"
SIZE = 256
"""Width and height of an icon in pixels; drawings use coordinates 0 ... 100."""


def draw(name: str, target: Path) -> None:
    """Write the icon of a component as PNG."""
    figure = Figure(figsize=(SIZE / 100, SIZE / 100), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 100)
    axes.set_aspect("equal")
    ICONS[name](axes)
    figure.savefig(target, metadata={"Software": None})
    with Image.open(target) as picture:
        reduced = picture.convert("RGB").quantize(32, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    reduced.save(target, optimize=True)


def box(axes: Axes, x: float, y: float, width: float, height: float, colour: str = PALE, edge: str = DARK) -> None:
    """A rectangle with an outline."""
    axes.add_patch(Rectangle((x, y), width, height, facecolor=colour, edgecolor=edge, linewidth=2.5, zorder=2))


def disc(axes: Axes, x: float, y: float, radius: float, colour: str = PALE, width: float = 2.5) -> None:
    """A circle with an outline."""
    axes.add_patch(Circle((x, y), radius, facecolor=colour, edgecolor=DARK, linewidth=width, zorder=3))


def shape(axes: Axes, points: Sequence[tuple[float, float]], colour: str, edge: str = DARK) -> None:
    """A polygon with an outline."""
    axes.add_patch(Polygon(np.array(points), facecolor=colour, edgecolor=edge, linewidth=2.5, zorder=2))


def line(axes: Axes, x: Any, y: Any, colour: str = DARK, width: float = 3.0, style: str = "-") -> None:
    """A line through points."""
    axes.plot(x, y, color=colour, linewidth=width, linestyle=style, solid_capstyle="round", solid_joinstyle="round")


def arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str = ORANGE, width: float = 4.0
) -> None:
    """An arrow from ``start`` to ``end``."""
    head = f"-|>,head_length={1.2 * width},head_width={0.8 * width}"
    axes.add_patch(
        FancyArrowPatch(
            start,
            end,
            arrowstyle=head,
            color=colour,
            linewidth=width,
            shrinkA=0,
            shrinkB=0,
            mutation_scale=1.0,
            zorder=2,
        )
    )


def word(axes: Axes, x: float, y: float, text: str, size: float = 20.0, colour: str = DARK) -> None:
    """A word about a point."""
    axes.text(x, y, text, ha="center", va="center", fontsize=size, color=colour, fontweight="bold", zorder=4)


def ground(axes: Axes, y: float) -> None:
    """A hatched bed with its surface at ``y``."""
    line(axes, (6.0, 94.0), (y, y), width=3.5)
    for x in np.arange(8.0, 94.0, 8.0):
        line(axes, (x, x - 5.0), (y, y - 6.0), STEEL, 1.8)


def block(axes: Axes) -> None:
    """The frame of a controller with the axes of its curve."""
    axes.add_patch(
        FancyBboxPatch(
            (8, 8), 84, 84, boxstyle="round,pad=0,rounding_size=8", facecolor=WHITE, edgecolor=DARK, linewidth=4.0
        )
    )
    line(axes, (16, 84), (50, 50), STEEL, 1.5)
    line(axes, (50, 50), (16, 84), STEEL, 1.5)


def screw(axes: Axes, y: float, left: float, right: float) -> None:
    """A ballscrew along ``y``."""
    box(axes, left, y - 5, right - left, 10, WHITE)
    for x in np.arange(left + 5.0, right - 2.0, 6.0):
        line(axes, (x - 3.0, x + 2.0), (y - 5.0, y + 5.0), DARK, 2.0)


# Plants


def ballscrew_stage(axes: Axes) -> None:
    """Motor, screw and table."""
    ground(axes, 18)
    screw(axes, 36, 28, 90)
    box(axes, 6, 24, 22, 24, STEEL)
    box(axes, 88, 20, 6, 32, STEEL)
    box(axes, 46, 26, 24, 20)
    box(axes, 36, 46, 44, 16)
    arrow(axes, (36, 78), (82, 78))


def ballscrew_stage_elasto_plastic(axes: Axes) -> None:
    """The stage with a bristle that bends, then slips."""
    ballscrew_stage(axes)
    box(axes, 2, 70, 96, 28, WHITE, WHITE)
    line(axes, (24, 24), (68, 96), STEEL, 1.5)
    line(axes, (20, 84), (70, 70), STEEL, 1.5)
    x = np.linspace(0.0, 1.0, 40)
    rise = np.where(x < 0.35, 2.0 * x, 0.7 + 0.3 * np.tanh((x - 0.35) / 0.15))
    line(axes, 24 + 56 * x, 70 + 22 * rise, ORANGE, 4.0)


def ballscrew_stage_maxwell_slip(axes: Axes) -> None:
    """The stage with a closed loop of friction over position."""
    ballscrew_stage(axes)
    box(axes, 2, 68, 96, 30, WHITE, WHITE)
    up = ((24, 70), (34, 84), (46, 92), (76, 97))
    down = ((76, 97), (66, 83), (54, 75), (24, 70))
    for path in (up, down):
        line(axes, [x for x, _ in path], [y for _, y in path], ORANGE, 4.0)


def ripple(axes: Axes) -> None:
    """Two harmonics over the travel."""
    x = np.linspace(12.0, 90.0, 120)
    line(axes, x, 90 + 4 * np.sin(0.5 * x) + 1.5 * np.sin(1.0 * x), ORANGE, 2.5)


def ballscrew_axis(axes: Axes) -> None:
    """The stage with a ripple over its travel and an encoder scale."""
    ballscrew_stage(axes)
    for x in np.arange(10.0, 92.0, 5.0):
        line(axes, (x, x), (6, 10), STEEL, 1.8)
    ripple(axes)


def compliant_ballscrew(axes: Axes) -> None:
    """Two inertias, a spring between them."""
    ground(axes, 18)
    screw(axes, 40, 26, 50)
    box(axes, 6, 28, 20, 24, STEEL)
    box(axes, 48, 28, 9, 24)
    line(axes, (57, 60, 62, 66, 70, 74, 76, 79), (40, 40, 49, 31, 49, 31, 40, 40), ORANGE, 3.0)
    box(axes, 77, 18, 18, 44)
    arrow(axes, (18, 76), (42, 76), DARK)
    arrow(axes, (64, 76), (92, 76))


def linear_motor(axes: Axes) -> None:
    """A forcer with coils over a track of magnets, with a tool."""
    for i, x in enumerate(np.arange(6.0, 90.0, 14.666)):
        box(axes, float(x), 16, 14.666, 16, ORANGE if i % 2 else STEEL)
        word(axes, float(x) + 7.3, 24, "SN"[i % 2], 12, WHITE)
    box(axes, 26, 37, 48, 24)
    for x in (35, 50, 65):
        disc(axes, x, 49, 5.5, WHITE)
        disc(axes, x, 49, 1.2, DARK)
    arrow(axes, (28, 78), (76, 78))


def compliant_ballscrew_axis(axes: Axes) -> None:
    """Two inertias with a spring, and a ripple over the travel."""
    compliant_ballscrew(axes)
    ripple(axes)


def linear_motor_axis(axes: Axes) -> None:
    """The linear motor with a ripple over its travel."""
    linear_motor(axes)
    ripple(axes)


def nominal_stage(axes: Axes) -> None:
    """A mass on rollers."""
    ground(axes, 20)
    disc(axes, 36, 27, 7, WHITE)
    disc(axes, 66, 27, 7, WHITE)
    box(axes, 22, 34, 58, 34)
    word(axes, 51, 51, "m", 30)
    arrow(axes, (4, 51), (20, 51))
    arrow(axes, (34, 80), (74, 80), DARK)


# Controllers


def sliding_mode(axes: Axes) -> None:
    """A trajectory that meets the sliding surface and slides along it."""
    block(axes)
    line(axes, (20, 80), (80, 20), DARK, 3.5)
    y = np.linspace(80.0, 28.0, 40)
    line(axes, 72 + 10 * np.sin(np.pi * (80 - y) / 60), y, ORANGE, 4.0)
    arrow(axes, (76, 24), (54, 46))


def complementary_sliding_mode(axes: Axes) -> None:
    """Two surfaces that cross at the origin, and the boundary layer about one."""
    block(axes)
    shape(axes, ((16, 76), (24, 84), (84, 24), (76, 16)), PALE, PALE)
    line(axes, (20, 80), (80, 20), DARK, 3.5)
    line(axes, (32, 68), (16, 84), DARK, 3.5, "--")
    angle = np.linspace(0.05, 1.25, 40)
    line(axes, 50 + 33 * np.cos(angle), 50 + 33 * np.sin(angle) * (1.0 - 0.35 * angle), ORANGE, 4.0)
    arrow(axes, (60, 68), (51.5, 53))


def fuzzy_sliding_mode(axes: Axes) -> None:
    """Five fuzzy sets over the sliding surface."""
    block(axes)
    for centre, colour in ((33, DARK), (67, DARK), (50, ORANGE)):
        line(axes, (centre - 17, centre, centre + 17), (56, 82, 56), colour, 3.0)
    line(axes, (16, 33), (82, 56), STEEL)
    line(axes, (67, 84), (56, 82), STEEL)
    line(axes, (24, 76), (43, 17), DARK, 3.5)
    arrow(axes, (78, 42), (52, 31))


def nct(axes: Axes) -> None:
    """A nominal characteristic trajectory: velocity over error."""
    x = np.linspace(-1.0, 1.0, 81)
    line(axes, 50 + 32 * x, 50 + 28 * np.sign(x) * np.abs(x) ** 0.5, ORANGE, 4.5)


def nctf_pi(axes: Axes) -> None:
    """The NCT with a PI compensator."""
    block(axes)
    nct(axes)
    word(axes, 69, 30, "PI", 24)


def nctf_fuzzy(axes: Axes) -> None:
    """The NCT with fuzzy sets."""
    block(axes)
    nct(axes)
    for centre, colour in ((62, STEEL), (70, DARK), (78, STEEL)):
        line(axes, (centre - 8, centre, centre + 8), (20, 38, 20), colour, 2.5)


def stage(axes: Axes, x: float, text: str, y: float = 50.0, width: float = 24.0) -> None:
    """A block of a cascade with its name."""
    box(axes, x, y - 12, width, 24)
    word(axes, x + width / 2, y, text, 17)


def p_pi(axes: Axes) -> None:
    """P, then PI."""
    arrow(axes, (2, 58), (14, 58), DARK, 2.5)
    stage(axes, 14, "P", 58)
    arrow(axes, (38, 58), (52, 58), DARK, 2.5)
    stage(axes, 52, "PI", 58, 28)
    arrow(axes, (80, 58), (97, 58))
    line(axes, (89, 89, 8, 8), (58, 24, 24, 50), STEEL, 2.5)
    line(axes, (45, 45), (24, 50), STEEL, 2.5)


def super_twisting(axes: Axes) -> None:
    """A trajectory that twists into the origin."""
    block(axes)
    angle = np.linspace(0.0, 5.2 * np.pi, 240)
    radius = 34 * np.exp(-0.17 * angle)
    line(axes, 50 + radius * np.cos(angle), 50 - 0.9 * radius * np.sin(angle), ORANGE, 3.5)
    disc(axes, 50, 50, 3.0, DARK, 1.0)


def disturbance_observer(axes: Axes) -> None:
    """A disturbance that enters a sum, and its filtered estimate."""
    arrow(axes, (50, 97), (50, 78))
    word(axes, 62, 90, "d", 22, ORANGE)
    arrow(axes, (4, 70), (42, 70), DARK, 2.5)
    arrow(axes, (58, 70), (97, 70), DARK, 2.5)
    disc(axes, 50, 70, 8, WHITE)
    word(axes, 50, 70, "+", 20)
    box(axes, 30, 12, 40, 34)
    x = np.linspace(0.0, 1.0, 40)
    line(axes, 34 + 32 * x, 18 + 20 / (1 + (x / 0.45) ** 6), ORANGE, 3.5)
    line(axes, (84, 84), (70, 29), STEEL, 2.5)
    arrow(axes, (84, 29), (70, 29), STEEL, 2.5)
    arrow(axes, (30, 29), (8, 29))


def cascade_pid(axes: Axes) -> None:
    """Position loop around velocity loop, and feed-forward over them."""
    arrow(axes, (2, 52), (12, 52), DARK, 2.5)
    stage(axes, 12, "P", 52, 22)
    arrow(axes, (34, 52), (44, 52), DARK, 2.5)
    stage(axes, 44, "PI", 52, 26)
    disc(axes, 81, 52, 5, WHITE)
    arrow(axes, (70, 52), (76, 52), DARK, 2.5)
    arrow(axes, (86, 52), (98, 52))
    line(axes, (6, 6, 81), (52, 84, 84), ORANGE, 3.0)
    arrow(axes, (81, 84), (81, 57), ORANGE, 3.0)
    word(axes, 45, 91, "FF", 15, ORANGE)
    line(axes, (92, 92, 6, 6), (52, 14, 14, 44), STEEL, 2.5)
    line(axes, (72, 72, 39, 39), (52, 28, 28, 44), STEEL, 2.5)


def cascade_p(axes: Axes) -> None:
    """Position loop around velocity loop."""
    arrow(axes, (2, 60), (14, 60), DARK, 2.5)
    stage(axes, 14, "P", 60, 24)
    arrow(axes, (38, 60), (52, 60), DARK, 2.5)
    stage(axes, 52, "P", 60, 24)
    arrow(axes, (76, 60), (98, 60))
    line(axes, (88, 88, 7, 7), (60, 18, 18, 52), STEEL, 2.5)
    line(axes, (82, 82, 45, 45), (60, 34, 34, 52), STEEL, 2.5)


def friction_pulse(axes: Axes) -> None:
    """The pulse at a reversal."""
    block(axes)
    x = np.linspace(-1.0, 1.0, 60)
    shape(axes, ((50, 50), (55, 80), (70, 80), (75, 50)), ORANGE, DARK)
    line(axes, 50 + 33 * x, 50 + 26 * np.sin(1.5 * x), DARK, 3.0)


def friction_feedforward(axes: Axes) -> None:
    """The friction curve, and the sum into which it goes."""
    arrow(axes, (2, 24), (68, 24), DARK, 2.5)
    disc(axes, 74, 24, 6, WHITE)
    arrow(axes, (80, 24), (98, 24))
    box(axes, 12, 46, 50, 46, PALE)
    line(axes, (37, 37), (50, 88), STEEL, 2.0)
    line(axes, (16, 58), (69, 69), STEEL, 2.0)
    s = np.linspace(0.0, 1.0, 40)
    level = 8 + 8 * np.exp(-8 * s) + 4 * s
    line(axes, np.concatenate([37 - 20 * s[::-1], 37 + 20 * s]), np.concatenate([69 - level[::-1], 69 + level]), ORANGE)
    line(axes, (62, 74), (69, 69), ORANGE, 3.0)
    arrow(axes, (74, 69), (74, 30), ORANGE, 3.0)


# Sources


def trajectory(axes: Axes) -> None:
    """A move: position and velocity over time."""
    arrow(axes, (10, 10), (10, 94), STEEL, 2.5)
    arrow(axes, (10, 10), (96, 10), STEEL, 2.5)
    s = np.linspace(0.0, 1.0, 60)
    path = s**3 * (10 - s * (15 - 6 * s))
    line(axes, np.concatenate([[14], 20 + 56 * s, [88]]), 16 + 66 * np.concatenate([[0], path, [1]]), ORANGE, 5.0)
    line(axes, 20 + 56 * s, 16 + 34 * 16 * (s * (1 - s)) ** 2, DARK, 3.0, "--")


def milling_force(axes: Axes) -> None:
    """A mill with two teeth in a slot, and the force on it."""
    box(axes, 6, 10, 88, 38, PALE)
    axes.add_patch(Circle((48, 48), 25, facecolor=WHITE, edgecolor=WHITE, zorder=2))
    line(axes, 48 + 25 * np.cos(np.linspace(np.pi, 2 * np.pi, 60)), 48 + 25 * np.sin(np.linspace(np.pi, 2 * np.pi, 60)))
    disc(axes, 48, 48, 15, STEEL)
    for turn in (1.0, -1.0):
        shape(
            axes,
            ((48 + turn * 6, 48 - turn * 14), (48 + turn * 12, 48 - turn * 22), (48 - turn * 6, 48 - turn * 14)),
            DARK,
        )
    arrow(axes, (48, 48), (84, 78))
    angle = np.linspace(0.35 * np.pi, 0.95 * np.pi, 30)
    line(axes, 48 + 34 * np.cos(angle), 48 + 34 * np.sin(angle), DARK, 2.5)
    arrow(axes, (16, 60), (14.2, 52), DARK, 2.5)


ICONS: dict[str, Callable[[Axes], None]] = {
    "BallscrewStage": ballscrew_stage,
    "BallscrewStageElastoPlastic": ballscrew_stage_elasto_plastic,
    "BallscrewStageMaxwellSlip": ballscrew_stage_maxwell_slip,
    "BallscrewAxis": ballscrew_axis,
    "CompliantBallscrew": compliant_ballscrew,
    "CompliantBallscrewAxis": compliant_ballscrew_axis,
    "LinearMotor": linear_motor,
    "LinearMotorAxis": linear_motor_axis,
    "NominalStage": nominal_stage,
    "SlidingMode": sliding_mode,
    "ComplementarySlidingMode": complementary_sliding_mode,
    "FuzzySlidingMode": fuzzy_sliding_mode,
    "NctfPi": nctf_pi,
    "NctfFuzzy": nctf_fuzzy,
    "PPi": p_pi,
    "SuperTwisting": super_twisting,
    "DisturbanceObserver": disturbance_observer,
    "CascadePid": cascade_pid,
    "CascadeP": cascade_p,
    "FrictionPulse": friction_pulse,
    "FrictionFeedforward": friction_feedforward,
    "Trajectory": trajectory,
    "MillingForce": milling_force,
}
"""Component -> the function that draws its icon."""


def drawer(name: str) -> Callable[[Path], None] | None:
    """The function that writes the icon of a component to a file; None for a component without icon."""
    return partial(draw, name) if name in ICONS else None
