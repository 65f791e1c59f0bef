"""Limits of stability of NCTF control: of the sampled linear loop, practical ones by simulation, and maps of both.

The nominal object is K*alpha/(s*(s + alpha)). The compensator K_P + K_I*T*z/(z - 1) acts on alpha*e - v, where v is the
backward difference of the position. The command is held over the sampling time T. With W = omega_n*T, a = alpha*T,
E = exp(-a), c = 2*zeta*W, K_P = 2*zeta*omega_n/(alpha*K) and K_I = omega_n**2/(alpha*K), the characteristic polynomial
is

    z*(z - 1)^2*(z - E) + ((c + W^2)*z - c)*((1 + a)*z - 1)*((a - 1 + E)*z + (1 - E - a*E))/a^2

For a -> 0 the loop is stable if W^2 < 4*kappa*(1 - kappa)/(1 + kappa), kappa = zeta*W.

Friction raises the limit. The practical limit is the gain above which the response to a step no longer comes to rest;
it is found by simulation. The practical damping ratio at an ultimate gain K_Pu is zeta = K_Pu*alpha*K*T/(2*W).

Source: Maeda & Sato, Practical control method for ultra-precision positioning using a ballscrew mechanism, Precision
Engineering 32, 2008, secs. 4 and 6; Jury's test as in Astrom & Wittenmark, Computer-Controlled Systems, 1997, sec. 3.3.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..errors import CosimError, DescriptionError
from ..fmu.places import shipped_file
from ..fmu.tables import read_table
from ..master.failure import ProcessError
from ..master.simulation import Simulation
from ..public import public_names
from ..result.metrics import Array
from ..result.result import Result
from ..system.system import System, read_system
from .documents import MapData
from .identify import POSITIONS, identify_nct
from .linearize import StateSpace
from .names import nctf_names
from .quantities import gain_factor, si_factor
from .search import SWING, Limit, Oscillation, oscillation, search_limit
from .workers import Limit as Timeout
from .workers import Loadable, Worker

__dir__ = public_names(globals())

SERIES_BELOW = 0.05
"""Below this alpha*T, differences of nearly equal numbers are computed from their series to avoid cancellation."""

_log = logging.getLogger(__name__)


# Linear


def jury_stable(coefficients: Sequence[float] | Array) -> bool:
    """Whether all roots of a polynomial, highest power first, lie inside the unit circle (Jury's test).

    Raises DescriptionError if the highest coefficient is 0.
    """
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
        ahead, behind = (a - 1.0 + E) / (a * a), (1.0 - E - a * E) / (a * a)
    plant = np.convolve(np.convolve([1.0, 0.0], np.convolve([1.0, -1.0], [1.0, -1.0])), [1.0, -E])
    loop = np.convolve(np.convolve([c + W**2, -c], [1.0 + a, -1.0]), [ahead, behind])
    return np.asarray(plant + np.concatenate((np.zeros(plant.size - loop.size), loop)), dtype=np.float64)


def closed_form_limits(W: float) -> tuple[float, float]:
    """Smallest and largest stable damping ratio at ``W`` for alpha*T -> 0; NaN if W > 2*sqrt(2) - 2: none is stable."""
    root = (4.0 - W**2) ** 2 - 16.0 * W**2
    if root < 0.0 or W >= 2.0:
        return math.nan, math.nan
    return (4.0 - W**2 - math.sqrt(root)) / (8.0 * W), (4.0 - W**2 + math.sqrt(root)) / (8.0 * W)


def linear_limits(W: float, a: float) -> tuple[float, float]:
    """Smallest and largest stable damping ratio at W = omega_n*T and a = alpha*T by Jury's test; NaN without any.

    Raises DescriptionError for values that no sampled loop has.
    """
    if not (0.0 < W < math.pi and 0.0 < a < math.inf):
        raise DescriptionError(f"omega_n*T_s = {W:g}, alpha*T_s = {a:g}: must be above 0, and omega_n*T_s below pi.")
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
    """The edge of the stable range, searched from the stable value ``inside`` by steps of ``factor``.

    0 (for a factor below 1) or infinity if no step finds an unstable value.
    """
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
    """Damping ratio that corresponds to a gain K_P; the ultimate gain gives the practical limit (eq. (5)).

    ``W`` = omega_n*T_s, ``alpha`` in 1/s, ``K`` in m/s for a unit of command, ``T_s`` in s.
    """
    return gain * alpha * K * T_s / (2.0 * W)


def nctf_spectral_radius(
    plant: StateSpace, *, K_P: float, K_I: float, alpha: float, T_s: float, delay: int = 0
) -> float:
    """Largest magnitude of the eigenvalues of a closed loop: NCTF-PI in the linear part of its NCT with a linear plant.

    ``plant`` has one input, the command, and one output, the position; the loop is closed about rest on target.
    ``delay`` samples pass from measurement to command (0 or 1).
    """
    sampled = plant.held(T_s)
    F, g, C = sampled.A, sampled.B[:, 0], plant.C[0]
    n = F.shape[0]
    # State: x, last position, integral, last command. The columns of the loop's matrix are its images of unit vectors.
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

    With K_I = 0 the eigenvalue 1 of the unused integrator does not count. Raises DescriptionError if no K_P from 1e-6
    to 1e6 is stable.
    """
    bound = 1.0 + 1e-9

    def stable(gain: float) -> bool:
        return nctf_spectral_radius(plant, K_P=gain, K_I=K_I, alpha=alpha, T_s=T_s, delay=delay) <= bound

    inside = next((gain for gain in np.geomspace(1e-6, 1e6, 121) if stable(float(gain))), None)
    if inside is None:
        raise DescriptionError("no gain from 1e-6 to 1e6 is stable.")
    return _edge(stable, float(inside), 2.0)


# Practical


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

    ``overrides`` are start values of all runs, ``stop_time`` is their end in s (None: that of the system), ``timeout``
    the time limit of a run in s, ``swing`` the smallest oscillation in m. Names are INSTANCE.VARIABLE (default: those
    of the study). A ``Simulation`` is run with the FMUs that it has loaded. Raises DescriptionError for wrong names or
    values, SimulationError for a run that fails, ProcessError for a run that crashes or hangs.
    """
    names = nctf_names()
    gain, position = gain or names.of_controller(names.controller.proportional), position or names.position
    if isinstance(source, Simulation):
        swing /= si_factor(source.system, position, *POSITIONS)
        run, variant = source.run, source.system.changed(overrides)
        return search_limit(
            lambda value: judge(run(variant.changed({gain: value})), position, swing).sustained, first, last
        )
    system = source if isinstance(source, System) else read_system(source, fmus=fmus)
    system = system.changed(stop_time=stop_time, record=[position])
    swing /= si_factor(system, position, *POSITIONS)
    found: dict[str, float] = {}
    with Worker() as worker, _told_if_ended(found):
        trials = _Trials(system.changed(overrides), worker, Timeout(timeout), gain, position, swing, found)
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
    ends: dict[str, float]
    """Gets the last gain found stable and the last one found unstable."""

    def oscillates(self, changes: Mapping[str, object]) -> Callable[[float], bool]:
        """A function: gain -> whether the position oscillates, with the start values ``changes``."""
        loadable, look = Loadable.of(self.system), partial(judge, position=self.position, swing=self.swing)
        self.system.changed(changes)  # Wrong names raise before the first run.

        def found(value: float) -> bool:
            try:
                result = self.worker.evaluate(loadable, {**changes, self.gain: value}, look, self.limit)
            except ProcessError as error:
                raise error.of(f"{self.system.name} at {self.gain} = {value:g}") from None
            self.limit.learn(self.worker.seconds)
            self.ends[f"{self.gain} {'unstable' if result.sustained else 'stable'} at"] = value
            return result.sustained

        return found


def judge(result: Result, position: str, swing: float = SWING) -> Oscillation:
    """``oscillation`` of a recorded position, without the last communication point."""
    return oscillation(result.time[:-1], result[position][:-1], swing=swing)


# Maps


@dataclass(frozen=True)
class Case:
    """One object of a map: its changes of the system, and the points at which its limits are searched."""

    name: str
    overrides: Mapping[str, object]
    W: Sequence[float]
    """Values of omega_n*T."""
    alpha: float
    """Inclination of the NCT in the gain formulas, 1/s."""
    first: float = 300.0
    """Gain at which the scan for the ultimate gain begins."""


@dataclass(frozen=True)
class MapPoint:
    """The limits of one object at one W = omega_n*T; damping ratios."""

    case: str
    W: float
    linear: float
    """Largest stable damping ratio of the sampled linear loop."""
    practical: float
    """Damping ratio at the ultimate gain, eq. (5)."""
    found: float
    """Damping ratio at which the simulated loop with its integral gain begins to oscillate.

    If the loop oscillates at the first gain already, it is the damping ratio of that gain.
    """
    starts_unstable: bool
    """Whether the loop oscillates at the first gain already, which is 0.4 of the ultimate gain by default."""

    @property
    def deviation(self) -> float:
        """Relative deviation of ``practical`` from ``found``."""
        return (self.practical - self.found) / self.practical


@dataclass(frozen=True)
class LimitMap:
    """The limits of several objects over W = omega_n*T."""

    ultimate: Mapping[str, float]
    """Object -> its ultimate gain with K_I = 0."""
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
    """Ultimate gain of each case, and its limit of the damping ratio at each W with K_I = omega_n^2/(alpha*K).

    ``K`` in m/s for a unit of command is the constant of the gain formulas. The scan of a loop begins at
    ``start_share`` of the case's ultimate gain. ``progress`` gets the number of searches done and the total. Names,
    ``timeout`` and errors are as in ``practical_limit``. Raises DescriptionError, too, for a case without such a limit.
    """
    names = nctf_names()
    gain = gain or names.of_controller(names.controller.proportional)
    integral = integral or names.of_controller(names.controller.integral)
    sampling = sampling or names.of_controller(names.controller.sampling_time)
    position = position or names.position
    system = source if isinstance(source, System) else read_system(source, fmus=fmus)
    system = system.changed(stop_time=stop_time, record=[position])
    swing /= si_factor(system, position, *POSITIONS)
    name, _, variable = sampling.partition(".")
    given = system.instance(name).start.get(variable, system.variable(name, variable).start)
    T_s = float(system.step_size) if given is None else si_factor(system, sampling, "s") * float(given)
    # The formulas take gains of a position in m.
    per_metre = gain_factor(system, gain, names.command, "m/s")
    ultimate: dict[str, float] = {}
    points: list[MapPoint] = []
    runs, total = 0, sum(1 + len(case.W) for case in cases)
    integrals = _integral_gains(system, cases, integral, T_s, K * gain_factor(system, integral, names.command, "m"))
    found: dict[str, float] = {}
    with Worker() as worker, _told_if_ended(found):
        trials = _Trials(system, worker, Timeout(timeout), gain, position, swing, found)
        for case in cases:
            unstable = trials.oscillates({**case.overrides, integral: 0.0})
            limit = search_limit(unstable, case.first, 1e3 * case.first)
            if not math.isfinite(limit.value):
                raise DescriptionError(f"case {case.name}: no limit between {case.first:g} and {1e3 * case.first:g}.")
            ultimate[case.name] = found[f"ultimate gain of {case.name}"] = limit.value
            runs += limit.runs
            progress(len(ultimate) + len(points), total)
            for w, integral_gain in zip(case.W, integrals[case.name], strict=True):
                unstable = trials.oscillates({**case.overrides, integral: integral_gain})
                first = start_share * limit.value
                searched = search_limit(unstable, first, 4.0 * limit.value)
                runs += searched.runs
                points.append(_map_point(case, w, limit.value, first, searched, K=per_metre * K, T_s=T_s))
                found[f"damping ratio of {case.name} at W = {w:g}"] = points[-1].found
                progress(len(ultimate) + len(points), total)
    return LimitMap(ultimate, tuple(points), runs)


def _map_point(
    case: Case, w: float, ultimate: float, first: float, searched: Limit, *, K: float, T_s: float
) -> MapPoint:
    """The limits of a case at W = ``w``; ``first`` is the gain at which the search began."""
    at_once = math.isnan(searched.stable)
    practical, found = (
        practical_zeta(gain, w, alpha=case.alpha, K=K, T_s=T_s)
        for gain in (ultimate, first if at_once else searched.value)
    )
    return MapPoint(case.name, w, linear_limits(w, case.alpha * T_s)[1], practical, found, at_once)


@contextlib.contextmanager
def _told_if_ended(found: Mapping[str, float]) -> Generator[None]:
    """Log what was found so far if the search of limits ends early."""
    try:
        yield
    except (KeyboardInterrupt, CosimError):
        if told := "; ".join(f"{name} {value:.6g}" for name, value in found.items()):
            _log.warning("ended early. Found so far: %s", told)
        raise


def _integral_gains(
    system: System, cases: Sequence[Case], integral: str, T_s: float, K: float
) -> dict[str, list[float]]:
    """The integral gain of each case at each of its W.

    Raises DescriptionError, before the first run, for all start values of cases that are wrong.
    """
    gains: dict[str, list[float]] = {}
    problems: dict[str, None] = {}
    for case in cases:
        with np.errstate(all="ignore"):  # An infinite gain is a wrong start value.
            gains[case.name] = cast("list[float]", (np.square(np.divide(case.W, T_s)) / (case.alpha * K)).tolist())
        for gain in (0.0, *gains[case.name]):
            try:
                system.changed({**case.overrides, integral: gain})
            except DescriptionError as error:
                problems |= {f"case {case.name}: {problem}": None for problem in error.problems}
    if problems:
        raise DescriptionError(list(problems))
    return gains


@dataclass(frozen=True)
class MapFile:
    """The content of a map file."""

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

    Raises DescriptionError with every problem found.
    """
    path = shipped_file(path)
    data = read_table(path, MapData)
    system = read_system(shipped_file(data.system, path.parent), fmus=fmus)
    controller = data.controller or nctf_names().controller.instance
    cases: list[Case] = []
    for name, case in data.cases.items():
        alpha = case.alpha or data.alpha
        overrides: dict[str, object] = {**data.overrides, **case.overrides}
        if case.nct and data.pulse is not None:
            overrides |= identify_nct(path.parent / data.pulse, alpha=alpha, fmus=fmus).start_values(controller, system)
        cases.append(Case(name, overrides, case.W or data.W, alpha, case.first))
    return MapFile(data.description, system, tuple(cases), data.K, data.timeout)


def plot_limit_map(found: LimitMap, path: Path) -> None:
    """Draw the damping ratios over W, one panel for each case: linear limit, practical limit, limits by simulation.

    Raises DescriptionError for an unknown ending, FileError if the file cannot be written.
    """
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
