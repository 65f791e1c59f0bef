"""Names of variables for the procedures of one paper; a file in the folder of its study gives them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from ..fmu.places import shipped_file
from ..fmu.tables import Scalar, Table, Text, read_table

NCTF_FILE = Path("maeda2008") / "names" / "nctf.toml"
PULSE_FILE = Path("feng2015") / "names" / "friction_pulse.toml"


class NctfControllerNames(Table):
    """The controller of an NCTF loop: its instance, and its variables."""

    instance: Text
    """Its instance."""
    proportional: Text
    """Parameter with the proportional gain K_P."""
    integral: Text
    """Parameter with the integral gain K_I."""
    sampling_time: Text
    """Parameter with the sampling time T_s."""
    nct_error: Text
    """Array parameter with the position errors of the NCT."""
    nct_rate: Text
    """Array parameter with the rates of the NCT."""


class NctfNames(Table):
    """Names in an NCTF loop: signals as INSTANCE.VARIABLE, and the controller."""

    position: Text
    """Position of the plant."""
    velocity: Text
    """Velocity of the plant."""
    command: Text
    """Input of the plant."""
    controller: NctfControllerNames
    """The controller of the loop."""

    def of_controller(self, variable: str) -> str:
        """INSTANCE.VARIABLE of a variable of the controller."""
        return f"{self.controller.instance}.{variable}"


class TrajectoryNames(Table):
    """The trajectory of an axis, and the start values of a circle at constant speed."""

    instance: Text
    """Its instance; for axis x, ``NAME_x``."""
    reference: Text
    """Output with the reference position."""
    radius: Text
    """Parameter with the radius of the circle."""
    feed: Text
    """Parameter with the feed along the circle."""
    phase: Text
    """Parameter with the phase of the axis."""
    start: dict[str, Scalar]
    """Start values of a circle at constant speed."""


class PulseNames(Table):
    """The source of pulses of an axis, and the start values for one pulse and for pulses from tables."""

    instance: Text
    """Its instance; for axis x, ``NAME_x``."""
    amplitude: Text
    """Parameter with the amplitude of the pulse."""
    duration: Text
    """Parameter with the duration of the pulse."""
    rise_time: Text
    """Parameter with the rise time of the pulse."""
    single: dict[str, Scalar]
    """Start values for one pulse of given amplitude and duration."""
    table: dict[str, Scalar]
    """Start values for pulses from the learned tables."""
    table_acceleration: Text
    """Array parameter with the reverse accelerations of the tables."""
    table_amplitude: Text
    """Array parameter with the amplitudes of the tables."""
    table_duration: Text
    """Array parameter with the durations of the tables."""


class ControllerNames(Table):
    """The controller of an axis."""

    instance: Text
    """Its instance; for axis x, ``NAME_x``."""
    velocity: Text
    """Input with the velocity."""
    integral_start: Text
    """Parameter with the start value of the integrator."""
    lead: Text
    """Parameter with the travel per radian."""


class PlantNames(Table):
    """The plant of an axis, and the start values of steady friction."""

    instance: Text
    """Its instance; for axis x, ``NAME_x``."""
    position: Text
    """Position that follows the reference, as ROLE.VARIABLE: an output of the plant or an input of the controller."""
    velocity: Text
    """Output with the velocity."""
    position_start: Text
    """Parameter with the position at the start."""
    velocity_start: Text
    """Parameter with the velocity at the start."""
    friction: Text
    """Output whose value, divided by ``lead``, becomes ``integral_start`` of the controller."""
    start: dict[str, Scalar]
    """Start values of steady friction."""


class AxisNames(Table):
    """Names of one axis in a system."""

    trajectory: TrajectoryNames
    """The trajectory of the axis."""
    pulse: PulseNames
    """The source of friction pulses."""
    controller: ControllerNames
    """The controller of the axis."""
    plant: PlantNames
    """The plant of the axis."""


@cache
def nctf_names() -> NctfNames:
    """The names in the loops of Maeda & Sato 2008."""
    return read_table(shipped_file(NCTF_FILE), NctfNames)


@cache
def axis_names() -> AxisNames:
    """The names in the loops of Feng 2015."""
    return read_table(shipped_file(PULSE_FILE), AxisNames)
