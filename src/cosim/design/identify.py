"""The nominal characteristic trajectory (NCT) of a stage, identified from an open-loop pulse.

A command u_r is applied for a time t_r, then the command is 0 and the stage coasts until it rests. During coasting, the
velocity over the remaining distance is the NCT. Signals are in SI units, u in the unit of the command.

The origin of the position error is the point where the velocity first becomes 0, not the final rest position. Friction
springs back a little; with the final rest as origin, the slope near the target would depend on this motion. With
Coulomb friction the slope grows without bound towards the origin, so the linear part needs a choice: its slope alpha,
or the error e_lin at which it ends. Without a choice e_lin is the amplitude of the spring-back.

Source: Maeda & Sato, Practical control method for ultra-precision positioning using a ballscrew mechanism, Precision
Engineering 32, 2008, sec. 3.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..files import write_file
from ..fmu import tables
from ..fmu.places import has_ending
from ..master.simulation import simulate
from ..public import public_names
from ..record.read import read_record
from ..result.metrics import Array
from ..system.system import System, read_system
from ..units import conversion
from .fit_statistics import fast_noise
from .names import nctf_names
from .quantities import gain_factor, si_factor

__dir__ = public_names(globals())

POSITIONS, VELOCITIES = ("m", "rad"), ("m/s", "rad/s")
"""SI units of the positions and velocities from which an NCT is identified."""
NODES = 128
"""Number of nodes of the NCT in the controllers of this library."""
POINTS = 400
"""Number of points of the identified curve above its linear part; ``reduce_nodes`` takes the nodes from them."""
MAX_WINDOW = 51
"""Longest window for the velocity in samples: a long window flattens the curve."""
NOISE_SHARE = 0.02
"""The velocity is smoothed until its noise is below this share of the velocity lost during half a window."""


@dataclass(frozen=True)
class Nct:
    """An identified NCT; SI units, K in m/s a unit of command."""

    alpha: float
    """Slope of the linear part, 1/s."""
    e_lin: float
    """Position error at which the linear part ends, m."""
    K: float
    """Rest position divided by u_r*t_r: displacement for one unit of command during one second."""
    u_r: float
    t_r: float
    rest: float
    """Final rest position, measured from the start, m."""
    stop: float
    """Position at which the velocity first was 0, measured from the start, m."""
    h_max: float
    """Largest velocity after the pulse, m/s."""
    reach: float
    """Position error of the largest velocity, m; beyond it the NCT is h_max."""
    error: Array
    """Position errors of the points of the curve, ascending from 0, m."""
    rate: Array
    """Velocities at these points, m/s."""
    measured_error: Array
    """Position errors of the samples from which the curve was made, m."""
    measured_rate: Array

    @property
    def spring_back(self) -> float:
        """Distance in m that the stage moves back after its velocity first was 0 (stop minus rest)."""
        return self.stop - self.rest

    def nodes(self, count: int = NODES) -> tuple[Array, Array]:
        """The curve with ``count`` nodes: errors in m and rates in m/s, both of shape (count,)."""
        return reduce_nodes(self.error, self.rate, count)

    def start_values(self, controller: str, system: System | None = None) -> dict[str, list[float]]:
        """The nodes as start values of the instance ``controller``: in its units in ``system``, or else in SI units.

        Raises DescriptionError if the units do not fit.
        """
        names = nctf_names().controller
        values: dict[str, list[float]] = {}
        for name, units, nodes in zip(
            (names.nct_error, names.nct_rate), (POSITIONS, VELOCITIES), self.nodes(), strict=True
        ):
            path = f"{controller}.{name}"
            values[path] = (nodes if system is None else nodes / si_factor(system, path, *units)).tolist()
        return values

    def gains(self, omega_n: float, zeta: float) -> tuple[float, float]:
        """K_P and K_I of the PI compensator for a natural frequency in rad/s and a damping ratio."""
        return pi_gains(self.alpha, self.K, omega_n=omega_n, zeta=zeta)


def pi_gains(alpha: float, K: float, *, omega_n: float, zeta: float) -> tuple[float, float]:
    """K_P and K_I of the PI compensator for the nominal object K*alpha/(s*(s + alpha)), eqs. (3a) and (3b)."""
    return 2.0 * zeta * omega_n / (alpha * K), omega_n**2 / (alpha * K)


def identify_nct(
    source: str | Path | System,
    *,
    alpha: float | None = None,
    e_lin: float | None = None,
    position: str | None = None,
    velocity: str | None = None,
    command: str | None = None,
    differentiate: bool = False,
    timeout: float | None = None,
    fmus: str | Path | None = None,
) -> Nct:
    """Identify from a system that drives its plant with a pulse, or from a .csv with columns t, u, x (and v)::

        nct = identify_nct("studies/maeda2008/pulse.toml", alpha=505.0)

    ``alpha`` in 1/s or ``e_lin`` in m fixes the linear part. The signals are INSTANCE.VARIABLE (default: the names of
    the study); ``differentiate`` takes the velocity from the position. ``timeout`` in s is the limit for an FMI call.
    Raises DescriptionError for signals from which no NCT can be identified, SimulationError if the run fails.
    """
    if isinstance(source, str | Path) and has_ending(source, ".csv"):
        time, drive, place, rate = read_signals(Path(source))
    else:
        system = source if isinstance(source, System) else read_system(source, fmus=fmus)
        names = nctf_names()
        position, command = position or names.position, command or names.command
        velocity = None if differentiate else velocity or names.velocity
        recorded = system.changed(record=[name for name in (position, velocity, command) if name is not None])
        result = simulate(recorded, isolated=True, timeout=timeout)
        time, drive = result.time, result[command]
        place = in_si(result[position], result.unit(position), POSITIONS, position)
        rate = None if velocity is None else in_si(result[velocity], result.unit(velocity), VELOCITIES, velocity)
    return nct_from_signals(time, drive, place, rate, alpha=alpha, e_lin=e_lin)


def read_signals(path: Path) -> tuple[Array, Array, Array, Array | None]:
    """The columns t, u, x and v of a record in SI units; None for a missing v.

    Columns without a unit are in SI units. Raises DescriptionError if the record cannot be read, or for other units.
    """
    record = read_record(path)
    if not {"u", "x"} <= set(record.columns):
        raise DescriptionError(
            f"{path}: columns beside the time are {', '.join(record.columns)}. Give t in s, u in the unit of the "
            "command, x in m, and v in m/s if it was measured."
        )
    place, rate = record.columns["x"], record.columns.get("v")
    place = in_si(place, record.units["x"], POSITIONS, f"{path}: column x")
    rate = None if rate is None else in_si(rate, record.units["v"], VELOCITIES, f"{path}: column v")
    return record.time, record.columns["u"], place, rate


def in_si(values: Array, unit: str, wanted: Sequence[str], name: str) -> Array:
    """Values of ``unit`` in the first of the units ``wanted`` to which it converts; as they are without one, or in 1.

    ``name`` is what the message names. Raises DescriptionError if the unit converts to none of them.
    """
    if unit in ("", "1"):
        return values
    for each in wanted:
        with contextlib.suppress(DescriptionError):
            factor = conversion(unit, each)
            return values if factor == 1.0 else values * factor
    raise DescriptionError(f"{name} is in {unit}. Give a signal in {' or '.join(wanted)}, or in a multiple of it.")


def _driven_samples(signals: Mapping[str, Array]) -> NDArray[np.intp]:
    """The indices of the samples of the pulse. Raises DescriptionError for signals that are no record of one pulse."""
    for name, signal in signals.items():
        if not np.all(np.isfinite(signal)):
            first = int(np.argmin(np.isfinite(signal)))
            raise DescriptionError(f"{name} is not finite everywhere; the first such sample is number {first + 1}.")
    time, command = signals["time"], signals["command"]
    if time.size < 8 or np.ptp(np.diff(time)) > 1e-3 * (time[1] - time[0]):
        raise DescriptionError("the samples are not equally spaced, or too few: record at one sampling time.")
    driven = np.flatnonzero(command[:-1])
    if driven.size == 0 or command[driven[-1] + 1] != 0.0:
        raise DescriptionError("there is no pulse: the command must be u_r for a time and then 0 to the end.")
    if np.any(command[driven] != command[driven[0]]):
        raise DescriptionError("the command has more than one value beside 0: apply one u_r.")
    return driven


def nct_from_signals(
    time: Array,
    command: Array,
    position: Array,
    velocity: Array | None = None,
    *,
    alpha: float | None = None,
    e_lin: float | None = None,
) -> Nct:
    """The NCT of a recorded pulse. Signals have shape (samples,), equal time steps, and SI units.

    Without ``velocity``, it is the slope of ``position``. Raises DescriptionError for signals without a pulse that ends
    in coasting.
    """
    if alpha is not None and e_lin is not None:
        raise DescriptionError("both alpha and e_lin are given. Give one; the other follows.")
    signals = {"time": time, "command": command, "position": position}
    driven = _driven_samples(signals if velocity is None else {**signals, "velocity": velocity})
    step = float(time[-1] - time[0]) / (time.size - 1)
    u_r, t_r = float(command[driven[0]]), driven.size * step
    direction = math.copysign(1.0, u_r)
    place = direction * (position - position[driven[0]])
    end = int(driven[-1]) + 1  # the first sample without command
    tail = place[-max(2, (time.size - end) // 20) :]
    rest, noise = float(np.mean(tail)), fast_noise(place[end:])
    rate = direction * velocity if velocity is not None else smooth_slope(place, step, end, noise)
    if abs(float(rate[-1])) > 1e-2 * float(np.max(rate[end:])):
        raise DescriptionError("the stage still moves at the end of the record. Record until it rests.")
    top, last, stop = _coasting(place, rate, end)
    errors = (stop - place[top:last])[::-1]
    kept = errors > max(1e-8, 3.0 * noise)
    errors, rates = errors[kept], rate[top:last][::-1][kept]
    order = np.argsort(errors, kind="stable")
    errors, rates = errors[order], monotone(rates[order])
    alpha, e_lin = linear_part(errors, rates, alpha=alpha, e_lin=e_lin, spring_back=stop - rest)
    h_max, reach = float(rates[-1]), float(errors[-1])
    curve = np.geomspace(e_lin, reach, POINTS + 1)
    return Nct(
        alpha=alpha,
        e_lin=e_lin,
        K=rest / (abs(u_r) * t_r),
        u_r=u_r,
        t_r=t_r,
        rest=rest,
        stop=stop,
        h_max=h_max,
        reach=reach,
        error=np.concatenate(([0.0], curve)),
        rate=np.concatenate(([0.0, alpha * e_lin], np.interp(curve[1:], errors, rates))),
        measured_error=errors,
        measured_rate=rates,
    )


def _coasting(place: Array, rate: Array, end: int) -> tuple[int, int, float]:
    """The sample of the largest velocity after the pulse, the first sample at rest, and the position at that rest."""
    top = end + int(np.argmax(rate[end:]))
    stopped = np.flatnonzero(rate[top:] <= 0.0)
    last = top + int(stopped[0]) if stopped.size else rate.size - 1
    if last - top < 8:
        raise DescriptionError(f"only {last - top} samples between the largest velocity and rest: sample faster.")
    share = float(rate[last - 1] / (rate[last - 1] - rate[last]))
    return top, last, float(place[last - 1] + share * (place[last] - place[last - 1]))


def linear_part(
    error: Array, rate: Array, *, alpha: float | None, e_lin: float | None, spring_back: float
) -> tuple[float, float]:
    """Slope in 1/s and end in m of the linear part of a curve. One of them is given, or the spring-back is the end.

    ``error`` in m and ``rate`` in m/s have the shape (points,). Raises DescriptionError if it is not on the curve.
    """
    low, high = float(error[0]), float(error[-1])
    if alpha is not None:
        above = np.flatnonzero(rate >= alpha * error)
        if alpha <= 0.0 or above.size == 0 or above[-1] + 1 == error.size:
            least, most = float(np.min(rate / error)), float(np.max(rate / error))
            raise DescriptionError(
                f"alpha = {alpha:g} 1/s is not on the curve: rate over error is {least:.4g} to {most:.4g} 1/s there."
            )
        i = int(above[-1])
        one, two = float(rate[i] - alpha * error[i]), float(rate[i + 1] - alpha * error[i + 1])
        return alpha, float(error[i]) + one / (one - two) * float(error[i + 1] - error[i])
    end = e_lin if e_lin is not None else spring_back
    if not low <= end < high:
        hint = "" if e_lin is not None else " The stage hardly springs back: give alpha or e_lin."
        raise DescriptionError(f"e_lin = {end:.4g} m is not on the curve, {low:.4g} to {high:.4g} m.{hint}")
    return float(np.interp(end, error, rate)) / end, end


def monotone(values: Array) -> Array:
    """The nearest values that never fall (isotonic least squares, by pooling of neighbours)."""
    if np.all(np.diff(values) >= 0.0):
        return values
    means: list[float] = []
    counts: list[int] = []
    for value in values:
        mean, count = float(value), 1
        while means and means[-1] > mean:
            mean = (mean * count + means[-1] * counts[-1]) / (count + counts[-1])
            count += counts[-1]
            means.pop()
            counts.pop()
        means.append(mean)
        counts.append(count)
    return np.repeat(np.array(means), counts)


def smooth_slope(position: Array, step: float, end: int, noise: float) -> Array:
    """Time derivative by local quadratic fits, over windows as short as the noise allows.

    ``end`` is the sample at which coasting begins. The shortest window is the central difference.
    """
    # Mean loss of velocity in a sample while coasting.
    central = np.gradient(position, step)
    top = end + int(np.argmax(central[end:]))
    stopped = np.flatnonzero(central[top:] <= 0.0)
    samples = int(stopped[0]) if stopped.size else position.size - top
    lost = float(central[top]) / max(samples, 1)
    half = 1
    while 2 * half + 1 < min(MAX_WINDOW, samples // 8):
        spread = noise / step / math.sqrt(half * (half + 1) * (2 * half + 1) / 3.0)
        if spread <= NOISE_SHARE * lost * half:
            break
        half += 1
    if half == 1:
        return central
    weights = np.arange(-half, half + 1) / (half * (half + 1) * (2 * half + 1) / 3.0 * step)
    inner = np.correlate(position, weights, mode="valid")
    central[half:-half] = inner
    # A window must not look across the end of the pulse, where the acceleration jumps.
    central[end : end + half] = central[end + half]
    return central


def reduce_nodes(error: Array, rate: Array, count: int = NODES) -> tuple[Array, Array]:
    """The ``count`` points of the curve whose polyline has the smallest relative distance from all points.

    The first two points are kept. If the curve has fewer points, the last one is repeated.
    """
    if error.size <= count:
        fill = count - error.size
        return np.pad(error, (0, fill), mode="edge"), np.pad(rate, (0, fill), mode="edge")

    def chosen(tolerance: float) -> list[int]:
        nodes = [0, 1]
        while nodes[-1] < error.size - 1 and len(nodes) <= count:
            first = nodes[-1]
            # The range of slopes from the node whose lines pass all points so far within the tolerance.
            ahead = slice(first + 1, None)
            span = error[ahead] - error[first]
            low = np.maximum.accumulate((rate[ahead] * (1.0 - tolerance) - rate[first]) / span)
            high = np.minimum.accumulate((rate[ahead] * (1.0 + tolerance) - rate[first]) / span)
            slope = (rate[ahead] - rate[first]) / span
            fits = np.flatnonzero((slope >= low) & (slope <= high))
            crossed = np.flatnonzero(low > high)
            if crossed.size:
                fits = fits[fits < crossed[0]]
            nodes.append(first + 1 + int(fits[-1]))
        return nodes

    low, high = 0.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        if len(chosen(middle)) <= count:
            high = middle
        else:
            low = middle
    nodes = chosen(high)
    while len(nodes) < count:
        gaps = np.diff(nodes)
        widest = int(np.argmax(gaps))
        nodes.insert(widest + 1, nodes[widest] + int(gaps[widest]) // 2)
    return error[nodes], rate[nodes]


# Files


def write_nct(nct: Nct, path: Path) -> None:
    """Write the curve as CSV with the columns error_m and rate_m_per_s. Raises FileError."""
    rows = "".join(f"{e:.10g},{v:.10g}\n" for e, v in zip(nct.error, nct.rate, strict=True))
    write_file(path, "error_m,rate_m_per_s\n" + rows)


def write_start(
    nct: Nct,
    path: Path,
    *,
    controller: str | None = None,
    gains: tuple[float, float] | None = None,
    base: str | None = None,
    system: System | None = None,
) -> None:
    """Write a system file that gives ``controller`` the NCT, and both gains if given; it extends the file ``base``.

    Values are in the units of the controller in ``system``, or in SI units without it. Raises FileError, and
    DescriptionError if the units do not fit.
    """
    names = nctf_names()
    instance = controller or names.controller.instance
    values: dict[str, Any] = {}
    kinds = {names.controller.proportional: "m/s", names.controller.integral: "m"}
    for (name, per), gain in () if gains is None else zip(kinds.items(), gains, strict=True):
        factor = 1.0 if system is None else gain_factor(system, f"{instance}.{name}", names.command, per)
        values[f"{instance}.{name}"] = gain / factor
    values |= nct.start_values(instance, system)
    comment = (
        f"NCT of {nct.u_r:g} for {nct.t_r:g} s: alpha = {nct.alpha:.6g} 1/s, e_lin = {nct.e_lin:.6g} m, "
        f"K = {nct.K:.6g} m/s a unit of command."
    )
    tables.write_start(path, values, base=base, comment=comment, digits=10)


def plot_nct(nct: Nct, path: Path) -> None:
    """Draw the phase plane with the samples and the nodes of the NCT. Raises DescriptionError or FileError."""
    from ..result.plots import Series, plot_phase_plane

    error, rate = nct.nodes()
    series = (
        Series("measured", nct.measured_error[::-1], nct.measured_rate[::-1], 0),
        Series(f"NCT, {error.size} nodes", error, rate, 1, dashed=True),
    )
    plot_phase_plane(path, series, y=("Velocity", "m/s"), title=f"alpha = {nct.alpha:.4g} 1/s, K = {nct.K:.4g}")
