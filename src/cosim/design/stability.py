"""Limits of stability of NCTF control: linear and sampled, practical by simulation, and maps of both.

The nominal object is K*alpha/(s*(s + alpha)), the compensator K_P + K_I*T*z/(z - 1) on alpha*e - v with v the backward
difference of the position, the command held over the sampling time T. With W = omega_n*T, a = alpha*T, E = exp(-a) and
c = 2*zeta*W, K_P = 2*zeta*omega_n/(alpha*K) and K_I = omega_n**2/(alpha*K), the characteristic polynomial is

    z*(z - 1)^2*(z - E) + ((c + W^2)*z - c)*((1 + a)*z - 1)*((a - 1 + E)*z + (1 - E - a*E))/a^2

For a -> 0 it is stable where W^2 < 4*kappa*(1 - kappa)/(1 + kappa), kappa = zeta*W.

Friction raises the limit: the practical one is where a step no longer comes to rest, found by simulation. The
practical damping ratio at an ultimate gain K_Pu is zeta = K_Pu*alpha*K*T/(2*W).

Source: Maeda & Sato, Practical control method for ultra-precision positioning using a ballscrew mechanism, Precision
Engineering 32, 2008, secs. 4 and 6; Jury's test as in Astrom & Wittenmark, Computer-Controlled Systems, 1997, sec. 3.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptionError
from ..fmu.places import shipped_file
from ..fmu.tables import read_table
from ..master.simulation import Simulation
from ..result.metrics import Array
from ..result.result import Result
from ..system.system import System, read_system
from .documents import MapData
from .identify import identify_nct
from .linearize import StateSpace
from .names import nctf_names
from .search import Limit, search_limit
from .workers import Limit as Timeout
from .workers import Loadable, Worker, WorkerError

SERIES_BELOW = 0.05
"""alpha*T below which the differences of nearly equal numbers are taken from their series."""
SWING = 50e-9
"""Smallest oscillation, peak to peak in m, that counts."""
KEPT = 0.8
"""Share of its size that an oscillation keeps from the third quarter of a run to the last."""
CROSSINGS = 8
"""Zero crossings of the last quarter that make it an oscillation and not a creep."""


# Linear


def jury_stable(coefficients: Sequence[float] | Array) -> bool:
    """Whether all roots of a polynomial, highest power first, lie inside the unit circle (Jury's test)."""
    row = np.asarray(coefficients, dtype=np.float64)
    if row.size == 0 or row[0] == 0.0:
        raise DescriptionError("the highest coefficient is 0.")
    while row.size > 1:
        ratio = row[-1] / row[0]
        if not abs(ratio) < 1.0:
            return False
        row = (row - ratio * row[::-1])[:-1]
    return True


def characteristic_polynomial(zeta: float, W: float, a: float) -> Array:
    """Coefficients, highest power first, of the sampled loop at damping ratio ``zeta``, W = omega_n*T, a = alpha*T."""
    c = 2.0 * zeta * W
    E = math.exp(-a)
    # (a - 1 + E)/a^2 and (1 - E - a*E)/a^2; both tend to 1/2.
    if a < SERIES_BELOW:
        ahead = math.fsum((-a) ** n / math.factorial(n + 2) for n in range(8))
        behind = math.fsum((-a) ** n * (n + 1) / math.factorial(n + 2) for n in range(8))
    else:
        ahead, behind = (a - 1.0 + E) / a**2, (1.0 - E - a * E) / a**2
    plant = np.convolve(np.convolve([1.0, 0.0], np.convolve([1.0, -1.0], [1.0, -1.0])), [1.0, -E])
    loop = np.convolve(np.convolve([c + W**2, -c], [1.0 + a, -1.0]), [ahead, behind])
    return np.asarray(plant + np.concatenate((np.zeros(plant.size - loop.size), loop)), dtype=np.float64)


def closed_form_limits(W: float) -> tuple[float, float]:
    """Smallest and largest stable damping ratio for alpha*T -> 0. NaN where none is, W > 2*sqrt(2) - 2."""
    root = (4.0 - W**2) ** 2 - 16.0 * W**2
    if root < 0.0 or W >= 2.0:
        return math.nan, math.nan
    return (4.0 - W**2 - math.sqrt(root)) / (8.0 * W), (4.0 - W**2 + math.sqrt(root)) / (8.0 * W)


def linear_limits(W: float, a: float) -> tuple[float, float]:
    """Smallest and largest stable damping ratio at W = omega_n*T and a = alpha*T by Jury's test. NaN where none is."""
    low, high = closed_form_limits(W)
    centres = [math.sqrt(low * high)] if math.isfinite(low) else []
    centres += [float(zeta) for zeta in np.geomspace(1e-3, 1e3, 400)]

    def stable(zeta: float) -> bool:
        return jury_stable(characteristic_polynomial(zeta, W, a))

    centre = next((zeta for zeta in centres if stable(zeta)), None)
    if centre is None:
        return math.nan, math.nan
    return _edge(stable, centre, 0.5), _edge(stable, centre, 2.0)


def _edge(stable: Callable[[float], bool], inside: float, factor: float) -> float:
    """Where ``stable`` ends on the way from ``inside`` by ``factor``; 0 or infinity if it does not."""
    outside = inside * factor
    while stable(outside):
        inside, outside = outside, outside * factor
        if not 1e-9 < outside < 1e9:
            return 0.0 if factor < 1.0 else math.inf
    while abs(outside - inside) > 1e-10 * inside:
        middle = 0.5 * (inside + outside)
        if stable(middle):
            inside = middle
        else:
            outside = middle
    return inside


def practical_zeta(gain: float, W: float, *, alpha: float, K: float, T_s: float) -> float:
    """Damping ratio that a gain K_P means; with the ultimate gain, the practical limit (eq. (5))."""
    return gain * alpha * K * T_s / (2.0 * W)


def nctf_spectral_radius(
    plant: StateSpace, *, K_P: float, K_I: float, alpha: float, T_s: float, delay: int = 0
) -> float:
    """Largest magnitude of the closed loop's eigenvalues: NCTF-PI in the linear part of its NCT on a linear plant.

    ``plant`` has one input, the command, and one output, the position; the loop is closed about rest on target.
    ``delay`` samples pass from measurement to command (0 or 1).
    """
    sampled = plant.held(T_s)
    F, g, C = sampled.A, sampled.B[:, 0], plant.C[0]
    n = F.shape[0]
    # State: x, last position, integral, last command. The loop's matrix is what it does to unit vectors.
    columns: list[Array] = []
    for unit in np.eye(n + 3):
        x, (last, integral, pending) = unit[:n], (float(value) for value in unit[n:])
        position = float(np.dot(C, x))
        rate_error = -alpha * position - (position - last) / T_s
        integral = integral + T_s * K_I * rate_error
        command = K_P * rate_error + integral
        moved = F @ x + g * (pending if delay else command)
        columns.append(np.append(moved, (position, integral, command)))
    return float(np.max(np.abs(np.linalg.eigvals(np.array(columns).T))))


def linear_gain_limit(plant: StateSpace, *, alpha: float, T_s: float, K_I: float = 0.0, delay: int = 0) -> float:
    """Largest stable K_P of NCTF control on a linear plant (see ``nctf_spectral_radius``).

    With K_I = 0 the integrator's own eigenvalue of 1 does not count.
    """
    bound = 1.0 + 1e-9

    def stable(gain: float) -> bool:
        return nctf_spectral_radius(plant, K_P=gain, K_I=K_I, alpha=alpha, T_s=T_s, delay=delay) <= bound

    inside = next((gain for gain in np.geomspace(1e-6, 1e6, 121) if stable(float(gain))), None)
    if inside is None:
        raise DescriptionError("no gain from 1e-6 to 1e6 is stable.")
    return _edge(stable, float(inside), 2.0)


# Practical


@dataclass(frozen=True)
class Oscillation:
    """What is left of a step response at its end."""

    size: float
    """Peak to peak over the last quarter, trend removed, in the unit of the signal."""
    frequency: float
    """Hz."""
    sustained: bool


def oscillation(time: Array, signal: Array, *, swing: float = SWING) -> Oscillation:
    """Whether a signal still oscillates at the end of the record.

    It does if, after removal of the linear trend, the last quarter swings by more than ``swing``, by at least 0.8 times
    as much as the quarter before, and crosses zero 8 times. A slow creep passes the first two conditions alone.
    """
    quarter = time.size // 4
    if quarter < 16:
        raise DescriptionError(f"{time.size} samples are too few to judge an oscillation.")

    def detrended(part: slice) -> Array:
        t, y = time[part] - time[part][0], signal[part]
        slope, offset = cast("tuple[float, float]", np.polyfit(t, y, 1))
        return y - (slope * t + offset)

    before, last = detrended(slice(-2 * quarter, -quarter)), detrended(slice(-quarter, None))
    size, earlier = float(np.ptp(last)), float(np.ptp(before))
    signs = np.signbit(last)
    crossings = int(np.count_nonzero(signs[1:] != signs[:-1]))
    frequency = 0.5 * crossings / (quarter * float(time[1] - time[0]))
    return Oscillation(size, frequency, size > swing and size >= KEPT * earlier and crossings >= CROSSINGS)


def practical_limit(
    source: str | Path | System | Simulation,
    overrides: Mapping[str, object] | None = None,
    *,
    gain: str | None = None,
    position: str | None = None,
    first: float = 300.0,
    last: float = 20000.0,
    swing: float = SWING,
    stop_time: float | str | None = "0.6",
    timeout: float | None = None,
    fmus: str | Path | None = None,
) -> Limit:
    """Largest ``gain`` at which the position of a system comes to rest, from ``first`` up to ``last``::

        limit = practical_limit("studies/maeda2008/gain.toml", {"trajectory.amplitude": 1e-5})

    ``overrides`` are start values of all runs, ``stop_time`` their end in s (None: the system's), ``timeout`` the limit
    for a run in s. Names are INSTANCE.VARIABLE (default: those of the study). A ``Simulation`` is run as it is, with
    the FMUs it has loaded. Raises DescriptionError, SimulationError, WorkerError for a run that crashes or hangs.
    """
    names = nctf_names()
    gain, position = gain or names.of_controller(names.controller.proportional), position or names.position
    if isinstance(source, Simulation):
        variant = source.system.changed(overrides)
        simulation = source
        return search_limit(
            lambda value: judge(simulation.run(variant.changed({gain: value})), position, swing).sustained, first, last
        )
    system = source if isinstance(source, System) else read_system(source, fmus=fmus)
    system = system.changed(stop_time=stop_time, record=[position])
    with Worker() as worker:
        trials = _Trials(system.changed(overrides), worker, Timeout(timeout), gain, position, swing)
        return search_limit(trials.oscillates({}), first, last)


@dataclass(frozen=True)
class _Trials:
    """Runs of a system at different gains."""

    system: System
    worker: Worker
    limit: Timeout
    gain: str
    position: str
    swing: float

    def oscillates(self, changes: Mapping[str, object]) -> Callable[[float], bool]:
        """Whether the position oscillates at a gain, with other start values."""
        loadable, look = Loadable.of(self.system), partial(judge, position=self.position, swing=self.swing)
        self.system.changed(changes)  # Wrong names are told before the first run.

        def found(value: float) -> bool:
            try:
                result = self.worker.evaluate(loadable, {**changes, self.gain: value}, look, self.limit)
            except WorkerError as error:
                raise WorkerError(f"{self.system.name} at {self.gain} = {value:g}: {error}") from None
            self.limit.learn(self.worker.seconds)
            return result.sustained

        return found


def judge(result: Result, position: str, swing: float = SWING) -> Oscillation:
    """``oscillation`` of a recorded position, without the last communication point."""
    return oscillation(result.time[:-1], result[position][:-1], swing=swing)


# Maps


@dataclass(frozen=True)
class Case:
    """One object of a map: what it changes of the system, and where its limits are sought."""

    name: str
    overrides: Mapping[str, object]
    W: Sequence[float]
    """Values of omega_n*T."""
    alpha: float
    """Inclination of the NCT in the gain formulas, 1/s."""
    first: float = 300.0
    """Gain at which its scan for the ultimate gain begins."""


@dataclass(frozen=True)
class MapPoint:
    """The limits of one object at one W = omega_n*T; damping ratios."""

    case: str
    W: float
    linear: float
    """Largest stable damping ratio of the sampled linear loop."""
    practical: float
    """That of the ultimate gain, eq. (5)."""
    found: float
    """That at which the loop with its integral gain oscillates; at a loop unstable from the first gain, that gain's."""
    starts_unstable: bool
    """Whether the loop oscillates at 0.4 of the ultimate gain already."""

    @property
    def deviation(self) -> float:
        """Relative deviation of ``practical`` from ``found``."""
        return (self.practical - self.found) / self.practical


@dataclass(frozen=True)
class LimitMap:
    """The limits of several objects over W = omega_n*T."""

    ultimate: Mapping[str, float]
    """Ultimate gain of each object, K_I = 0."""
    points: tuple[MapPoint, ...]
    runs: int

    @property
    def mean_deviation(self) -> float:
        """Mean magnitude of the points' deviations."""
        return float(np.mean([abs(point.deviation) for point in self.points]))


def limit_map(
    source: str | Path | System,
    cases: Sequence[Case],
    *,
    K: float,
    gain: str | None = None,
    integral: str | None = None,
    sampling: str | None = None,
    position: str | None = None,
    start_share: float = 0.4,
    swing: float = SWING,
    stop_time: float | str | None = "0.6",
    timeout: float | None = None,
    fmus: str | Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> LimitMap:
    """Ultimate gain of each case, then its limit of the damping ratio at each W with K_I = omega_n^2/(alpha*K).

    ``K`` in m/s a unit of command is that of the gain formulas. The scan of a loop begins at ``start_share`` of the
    case's ultimate gain. ``progress`` is told how many searches are done. Names, ``timeout`` and errors are as in
    ``practical_limit``.
    """
    names = nctf_names()
    gain = gain or names.of_controller(names.controller.proportional)
    integral = integral or names.of_controller(names.controller.integral)
    sampling = sampling or names.of_controller(names.controller.sampling_time)
    position = position or names.position
    system = source if isinstance(source, System) else read_system(source, fmus=fmus)
    system = system.changed(stop_time=stop_time, record=[position])
    name, _, variable = sampling.partition(".")
    given = system.instance(name).start.get(variable, system.variable(name, variable).start)
    T_s = float(given if given is not None else system.step_size)
    ultimate: dict[str, float] = {}
    points: list[MapPoint] = []
    runs, total = 0, sum(1 + len(case.W) for case in cases)
    with Worker() as worker:
        trials = _Trials(system, worker, Timeout(timeout), gain, position, swing)
        for case in cases:
            unstable = trials.oscillates({**case.overrides, integral: 0.0})
            limit = search_limit(unstable, case.first, 1e3 * case.first)
            if not math.isfinite(limit.value):
                raise DescriptionError(f"case {case.name}: no limit between {case.first:g} and {1e3 * case.first:g}.")
            ultimate[case.name] = limit.value
            runs += limit.runs
            progress(len(ultimate) + len(points), total)
            for w in case.W:
                unstable = trials.oscillates({**case.overrides, integral: (w / T_s) ** 2 / (case.alpha * K)})
                first = start_share * limit.value
                searched = search_limit(unstable, first, 4.0 * limit.value)
                runs += searched.runs

                def ratio(value: float, w: float = w, alpha: float = case.alpha) -> float:
                    return practical_zeta(value, w, alpha=alpha, K=K, T_s=T_s)

                at_once = math.isnan(searched.stable)
                points.append(
                    MapPoint(
                        case.name,
                        w,
                        linear_limits(w, case.alpha * T_s)[1],
                        ratio(limit.value),
                        ratio(first if at_once else searched.value),
                        at_once,
                    )
                )
                progress(len(ultimate) + len(points), total)
    return LimitMap(ultimate, tuple(points), runs)


@dataclass(frozen=True)
class MapFile:
    """What a map file asks for."""

    description: str
    system: System
    cases: tuple[Case, ...]
    K: float
    timeout: float | None = None
    """Limit for a run, s."""


def read_map(path: str | Path, *, fmus: str | Path | None = None) -> MapFile:
    """Read a map file, TOML::

        system = "../step.toml"              # relative to this file
        description = "Coulomb friction"
        alpha = 505.0                        # 1/s, of the gain formulas
        K = 32.3e-3                          # m/s a unit of command
        W = [0.02, 0.1, 0.25, 0.4]           # omega_n*T
        timeout = 60.0                       # s, limit for a run; optional, as in a sweep file
        pulse = "../pulse.toml"              # identifies the NCT of cases with nct = true
        [overrides]                          # start values of all cases
        "trajectory.amplitude" = 1e-5
        [cases.low]                          # any of these three may differ, and first, where the scan begins
        W = [0.02, 0.05]
        alpha = 250.0
        nct = true                           # give the controller the NCT of this alpha
        overrides = { "plant.F_C" = 0.023, "plant.F_S" = 0.023 }

    Raises DescriptionError.
    """
    path = shipped_file(path)
    data = read_table(path, MapData)
    system = read_system(path.parent / data.system, fmus=fmus)
    names = nctf_names().controller
    controller = data.controller or names.instance
    cases: list[Case] = []
    for name, case in data.cases.items():
        alpha = case.alpha or data.alpha
        overrides: dict[str, object] = {**data.overrides, **case.overrides}
        if case.nct and data.pulse is not None:
            error, rate = identify_nct(path.parent / data.pulse, alpha=alpha, fmus=fmus).nodes()
            overrides |= {f"{controller}.{names.nct_error}": list(error), f"{controller}.{names.nct_rate}": list(rate)}
        cases.append(Case(name, overrides, case.W or data.W, alpha, case.first))
    return MapFile(data.description, system, tuple(cases), data.K, data.timeout)


def plot_limit_map(found: LimitMap, path: Path) -> None:
    """The damping ratios over W: linear limit, practical limit and what the simulations found, one panel a case."""
    from ..result.plots import Panel, Series, plot_panels

    panels: list[Panel] = []
    for name, gain in found.ultimate.items():
        points = [point for point in found.points if point.case == name]
        w: NDArray[np.float64] = np.array([point.W for point in points])
        panels.append(
            Panel(
                "Damping ratio",
                "1",
                (
                    Series("simulated", w, np.array([point.found for point in points]), 0),
                    Series("practical", w, np.array([point.practical for point in points]), 1, dashed=True),
                    Series("linear", w, np.array([point.linear for point in points]), 2, dashed=True),
                ),
                log=True,
                heading=f"{name}: K_Pu = {gain:.4g}",
            )
        )
    plot_panels(
        path, panels, title="Limits of stability", x_quantity="Natural frequency times sampling time", x_unit="1"
    )
