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
    proportional: Text
    integral: Text
    sampling_time: Text
    nct_error: Text
    nct_rate: Text


class NctfNames(Table):
    """Names in an NCTF loop: signals as INSTANCE.VARIABLE, and the controller."""

    position: Text
    velocity: Text
    command: Text
    controller: NctfControllerNames

    def of_controller(self, variable: str) -> str:
        """INSTANCE.VARIABLE of a variable of the controller."""
        return f"{self.controller.instance}.{variable}"


class TrajectoryNames(Table):
    """The trajectory of an axis, and the start values of a circle at constant speed."""

    instance: Text
    reference: Text
    radius: Text
    feed: Text
    phase: Text
    start: dict[str, Scalar]


class PulseNames(Table):
    """The source of pulses of an axis, and the start values for one pulse and for pulses from tables."""

    instance: Text
    amplitude: Text
    duration: Text
    rise_time: Text
    single: dict[str, Scalar]
    table: dict[str, Scalar]
    table_acceleration: Text
    table_amplitude: Text
    table_duration: Text


class ControllerNames(Table):
    """The controller of an axis."""

    instance: Text
    velocity: Text
    integral_start: Text
    lead: Text
    """Parameter with the travel per radian."""


class PlantNames(Table):
    """The plant of an axis, and the start values of steady friction."""

    instance: Text
    position: Text
    """Position that follows the reference, as ROLE.VARIABLE: an output of the plant or an input of the controller."""
    velocity: Text
    position_start: Text
    velocity_start: Text
    friction: Text
    """Output whose value, divided by ``lead``, becomes ``integral_start`` of the controller."""
    start: dict[str, Scalar]


class AxisNames(Table):
    """Names of one axis in a system."""

    trajectory: TrajectoryNames
    pulse: PulseNames
    controller: ControllerNames
    plant: PlantNames


@cache
def nctf_names() -> NctfNames:
    """The names in the loops of Maeda & Sato 2008."""
    return read_table(shipped_file(NCTF_FILE), NctfNames)


@cache
def axis_names() -> AxisNames:
    """The names in the loops of Feng 2015."""
    return read_table(shipped_file(PULSE_FILE), AxisNames)
