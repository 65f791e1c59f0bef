"""Units of connections: what the files say decides, and what a connection does with it survives every export."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from fmu_files import write_gain

from cosim.errors import DescriptionError
from cosim.master.simulation import simulate
from cosim.system.ssp_write import write_ssp
from cosim.system.system import System, make_system, read_system
from cosim.system.toml_write import write_system
from cosim.units import parse_unit, resolve_unit

RPM = {"rpm": 'rad="1" s="-1" factor="0.10471975511965977"'}
RAD_PER_S = {"rad/s": 'rad="1" s="-1"'}
CELSIUS = {"degC": 'K="1" offset="273.15"'}
FAHRENHEIT = {"degF": 'K="1" factor="0.5555555555555556" offset="255.3722222222222"'}
KELVIN = {"K": 'K="1"'}
LITRE = {"lpm": 'm="3" s="-1" factor="1.6666666666666667e-05"'}
CUBIC = {"m3/s": 'm="3" s="-1"'}


def pair(
    folder: Path, one: Mapping[str, str], other: Mapping[str, str], connection: object = None, u: float = 2.0
) -> System:
    """a.z -> b.u, where the files state the units ``one`` and ``other`` (name: attributes of BaseUnit)."""
    (unit,), (other_unit,) = one, other
    write_gain(folder, "A", unit, unit, base_units={k: v for k, v in one.items() if v})
    write_gain(folder, "B", other_unit, other_unit, base_units={k: v for k, v in other.items() if v})
    document: dict[str, Any] = {
        "connections": ["a.z -> b.u" if connection is None else connection],
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {"a": {"fmu": "./A.fmu", "start": {"u": u}}, "b": {"fmu": "./B.fmu"}},
    }
    return make_system(document, name="pair.toml", folder=folder)


CONVERT = {"from": "a.z", "to": "b.u", "units": "convert"}


# What the files say decides


@pytest.mark.parametrize(
    ("one", "other", "received"),
    [
        (RPM, RAD_PER_S, 2.0 * 0.10471975511965977),
        (CELSIUS, KELVIN, 275.15),
        (KELVIN, CELSIUS, 2.0 - 273.15),
        (FAHRENHEIT, CELSIUS, (2.0 - 32.0) * 5.0 / 9.0),
        (CELSIUS, FAHRENHEIT, 2.0 * 9.0 / 5.0 + 32.0),
        (LITRE, CUBIC, 2.0 / 60000.0),
        ({"deg": 'rad="1" factor="0.017453292519943295"'}, {"rad": 'rad="1"'}, 2.0 * 0.017453292519943295),
        # the files know better than our table: an angle of 400 to the turn called deg
        ({"deg": 'rad="1" factor="0.015707963267948967"'}, {"rad": 'rad="1"'}, 2.0 * 0.015707963267948967),
        # one name, two scales
        ({"h": 's="1" factor="3600"'}, {"h": 's="1" factor="60"'}, 120.0),
        # no BaseUnit in either file: our table
        ({"mm": ""}, {"m": ""}, 2e-3),
        ({"degC": ""}, {"K": ""}, 275.15),
        ({"l/min": ""}, {"m3/s": ""}, 2.0 / 60000.0),
    ],
)
def test_values_are_converted(
    tmp_path: Path, one: Mapping[str, str], other: Mapping[str, str], received: float
) -> None:
    system = pair(tmp_path, one, other, CONVERT)
    assert system.connections[0].units == "converted"
    # the zero of a temperature scale is stated with 16 digits
    assert float(simulate(system)["b.z"][0]) == pytest.approx(received, rel=1e-13)


@pytest.mark.parametrize(
    ("one", "other", "text"),
    [
        ({"h": 'm="1" factor="1e-3"'}, {"h": 's="1" factor="3600"'}, "unit h (0.001 m) does not match h (3600 s)."),
        (
            {"g": 'm="1" s="-2" factor="9.80665"'},
            {"g": 'kg="1" factor="1e-3"'},
            "unit g (9.80665 m/s2) does not match g (0.001 kg).",
        ),
        # one file states what the other leaves to the table
        ({"h": 'm="1" factor="1e-3"'}, {"h": ""}, "unit h (0.001 m) does not match h (3600 s)."),
        ({"N": ""}, {"m": ""}, "unit N does not match m."),
        ({"furlong": ""}, {"m": ""}, "unit furlong does not match m. Nothing says what furlong is."),
        # 1/s may count turns or radians
        ({"Hz": 's="-1"'}, RAD_PER_S, "unit Hz does not match rad/s."),
    ],
)
@pytest.mark.parametrize("connection", ["a.z -> b.u", CONVERT])
def test_kinds_that_differ_are_refused(
    tmp_path: Path, one: Mapping[str, str], other: Mapping[str, str], text: str, connection: object
) -> None:
    with pytest.raises(DescriptionError) as caught:
        pair(tmp_path, one, other, connection)
    assert text in caught.value.problems[0]
    assert "factor = ... (" in caught.value.problems[0]


@pytest.mark.parametrize(
    ("one", "other", "advice"),
    [
        (CELSIUS, KELVIN, "factor = 1.0, offset = 273.15 }."),
        (KELVIN, CELSIUS, "factor = 1.0, offset = -273.15 }."),
        (RPM, RAD_PER_S, "factor = 0.10471975511965977 }."),
        (CUBIC, {"l/min": ""}, "factor = 60000.0 }."),
    ],
)
def test_the_advice_does_what_convert_does(
    tmp_path: Path, one: Mapping[str, str], other: Mapping[str, str], advice: str
) -> None:
    with pytest.raises(DescriptionError) as caught:
        pair(tmp_path, one, other)
    assert advice in caught.value.problems[0]
    assert 'units = "convert"' in caught.value.problems[0]
    numbers = advice.removesuffix(" }.").split(", ")
    written = {key: float(value) for key, _, value in (number.partition(" = ") for number in numbers)}
    given = simulate(pair(tmp_path, one, other, {"from": "a.z", "to": "b.u", **written}))
    assert given["b.z"].tolist() == simulate(pair(tmp_path, one, other, CONVERT))["b.z"].tolist()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"rad/s": 'rad="1" s="-1"'}, {"rad/s": 's="-1"'}),  # whether an angle has a unit is a matter of taste
        ({"N.m": 'kg="1" m="2" s="-2"'}, {"J": 'kg="1" m="2" s="-2"'}),
        ({"widget": ""}, {"widget": ""}),
        ({"widget": 'kg="1"'}, {"widget": ""}),
    ],
)
def test_units_that_mean_the_same_need_nothing(
    tmp_path: Path, one: Mapping[str, str], other: Mapping[str, str]
) -> None:
    for connection in (None, CONVERT):
        found = pair(tmp_path, one, other, connection).connections[0]
        assert (found.units, found.factor, found.offset) == ("same", 1.0, 0.0)


def test_what_is_stated_acts_after_the_conversion(tmp_path: Path) -> None:
    found = pair(tmp_path, CELSIUS, KELVIN, {**CONVERT, "factor": 2.0, "offset": 5.0}).connections[0]
    assert (found.factor, found.offset) == (2.0, 2.0 * 273.15 + 5.0)


def test_unknown_treatment_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match='number 1, units: "ignore": give "convert" or "suppress"'):
        pair(tmp_path, RPM, RAD_PER_S, {**CONVERT, "units": "ignore"})


# Differences


def temperatures(folder: Path, one: tuple[str, bool], other: tuple[str, bool], connection: object = None) -> System:
    """a.z -> b.u between temperatures, or differences of temperatures, in these units. The source gives 10."""
    for name, (unit, relative) in (("A", one), ("B", other)):
        base = {**CELSIUS, **KELVIN, **FAHRENHEIT}[unit]
        write_gain(folder, name, unit, unit, base_units={unit: base}, relative=relative)
    document: dict[str, Any] = {
        "connections": ["a.z -> b.u" if connection is None else connection],
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {"a": {"fmu": "./A.fmu", "start": {"u": 10.0}}, "b": {"fmu": "./B.fmu"}},
    }
    return make_system(document, name="pair.toml", folder=folder)


@pytest.mark.parametrize(
    ("one", "other", "received"),
    [
        (("degC", True), ("K", True), 10.0),
        (("K", True), ("degC", True), 10.0),
        (("degC", True), ("degF", True), 18.0),
        (("degF", True), ("K", False), 10.0 * 5.0 / 9.0),  # K has no zero of its own: a difference or not
    ],
)
def test_offsets_do_not_count_for_differences(
    tmp_path: Path, one: tuple[str, bool], other: tuple[str, bool], received: float
) -> None:
    system = temperatures(tmp_path, one, other, CONVERT)
    assert float(simulate(system)["b.z"][0]) == pytest.approx(received, rel=1e-13)
    packed = read_system(write_ssp(system, tmp_path / "s.ssp"))
    assert packed.digest == system.digest


@pytest.mark.parametrize("connection", ["a.z -> b.u", CONVERT])
def test_a_temperature_is_no_difference(tmp_path: Path, connection: object) -> None:
    for one, other in ((True, False), (False, True)):
        with pytest.raises(DescriptionError, match=r"unit degC .* does not match degC .* factor = \.\.\."):
            temperatures(tmp_path, ("degC", one), ("degC", other), connection)


# Numbers beside a conversion


@pytest.mark.parametrize(
    ("one", "other", "numbers", "text"),
    [
        (RPM, RAD_PER_S, {"factor": 0.1}, "factor = 0.1 is all that is done from rpm to rad/s; the units alone conver"),
        ({"mm": ""}, {"m": ""}, {"factor": 1.0}, "the units alone convert by factor = 0.001. If the numbers are"),
        (CELSIUS, KELVIN, {"factor": 1.0}, "the units alone convert by factor = 1, offset = 273.15."),
        (CELSIUS, KELVIN, {"factor": 1.0, "offset": 273.0}, "factor = 1, offset = 273 is all that is done"),
        (RPM, RAD_PER_S, {"factor": 0.1047}, ""),
        (RPM, RAD_PER_S, {"factor": -0.10472, "offset": 3.0}, ""),
        (RPM, RAD_PER_S, {"factor": 0.1, "units": "convert"}, ""),
        (CELSIUS, KELVIN, {"factor": 1.0, "offset": 273.15}, ""),
        ({"V": ""}, {"N": ""}, {"factor": 0.1}, ""),  # a gain between different quantities
        ({"m": ""}, {"m": ""}, {"factor": 0.1}, ""),
        ({"Hz": ""}, RAD_PER_S, {"factor": 6.2832}, ""),
    ],
)
def test_a_factor_that_the_units_do_not_explain_is_noted(
    tmp_path: Path, one: Mapping[str, str], other: Mapping[str, str], numbers: Mapping[str, object], text: str
) -> None:
    notes = pair(tmp_path, one, other, {"from": "a.z", "to": "b.u", **numbers}).notes
    if not text:
        assert notes == ()
        return
    (note,) = notes
    assert text in note
    assert note.endswith('add units = "convert".')


def test_weights_of_a_sum_in_other_units_are_noted(tmp_path: Path) -> None:
    write_gain(tmp_path, "A", "mm", "mm")
    write_gain(tmp_path, "B", "m", "m")
    document: dict[str, Any] = {
        "connections": [{"from": ["a.z", "c.z"], "to": "b.u", "factors": [0.5, 0.5]}],
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {"a": {"fmu": "./A.fmu"}, "b": {"fmu": "./B.fmu"}, "c": {"fmu": "./B.fmu"}},
    }
    (note,) = make_system(document, name="sum.toml", folder=tmp_path).notes
    assert note.startswith("connection a.z -> b.u: factor = 0.5 is all that is done from mm to m;")


# Units that are missing


@pytest.mark.parametrize("connection", ["a.z -> b.u", CONVERT])
@pytest.mark.parametrize(
    ("one", "other", "shown"),
    [(None, "mm", "no unit -> mm"), ("mm", None, "mm -> no unit"), (None, None, ""), (None, "1", "")],
)
def test_a_unit_at_one_end_only_is_noted(
    tmp_path: Path, one: str | None, other: str | None, shown: str, connection: object
) -> None:
    write_gain(tmp_path, "A", one, one)
    write_gain(tmp_path, "B", other, other)
    document: dict[str, Any] = {
        "connections": [connection],
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {"a": {"fmu": "./A.fmu"}, "b": {"fmu": "./B.fmu"}},
    }
    said = "connections: the FMU states no unit at one end, so values are passed on as they are: a.z -> b.u"
    notes = make_system(document, name="bare.toml", folder=tmp_path).notes
    assert notes == ((f"{said} ({shown}).",) if shown else ())


# There and back


TREATMENTS: dict[str, dict[str, object]] = {
    "converted": {"units": "convert"},
    "converted and transformed": {"units": "convert", "factor": 3.0, "offset": -0.5},
    "given": {"factor": 0.3, "offset": 0.1},
    "given as 1": {"factor": 1.0},
    "suppressed": {"units": "suppress"},
    "suppressed with offset": {"units": "suppress", "offset": 0.25},
}


@pytest.mark.parametrize("case", TREATMENTS)
@pytest.mark.parametrize(("one", "other"), [(RPM, RAD_PER_S), (FAHRENHEIT, KELVIN), ({"mm": ""}, {"m": ""})])
def test_an_exported_system_is_the_same_system(
    tmp_path: Path, case: str, one: Mapping[str, str], other: Mapping[str, str]
) -> None:
    system = pair(tmp_path, one, other, {"from": "a.z", "to": "b.u", **TREATMENTS[case]}, u=1.0 / 3.0)
    packed = read_system(write_ssp(system, tmp_path / "s.ssp"))
    written = read_system(write_system(packed, tmp_path / "s.toml"))
    again = read_system(write_ssp(written, tmp_path / "t.ssp"))
    expected = simulate(system)
    for read in (packed, written, again):
        assert read.digest == system.digest
        assert (read.connections[0].units, read.connections[0].stated) == (
            system.connections[0].units,
            system.connections[0].stated,
        )
        assert simulate(read)["b.z"].tolist() == expected["b.z"].tolist()


def test_same_units_with_an_offset_survive(tmp_path: Path) -> None:
    system = pair(tmp_path, {"m": ""}, {"m": ""}, {"from": "a.z", "to": "b.u", "offset": 0.1})
    read = read_system(write_system(read_system(write_ssp(system, tmp_path / "s.ssp")), tmp_path / "s.toml"))
    assert read.connections == system.connections


def test_an_edited_transformation_counts(tmp_path: Path) -> None:
    """The annotation that keeps a conversion holds only while the transformation is that conversion."""
    path = write_ssp(pair(tmp_path, RPM, RAD_PER_S, CONVERT), tmp_path / "s.ssp")
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    text = members["SystemStructure.ssd"].decode()
    assert text.count('offset="0.0" factor="0.10471975511965977"') == 1
    edited = text.replace('offset="0.0" factor="0.10471975511965977"', 'offset="0.0" factor="7.0"')
    with zipfile.ZipFile(tmp_path / "e.ssp", "w") as archive:
        for name, content in {**members, "SystemStructure.ssd": edited.encode()}.items():
            archive.writestr(name, content)
    found = read_system(tmp_path / "e.ssp").connections[0]
    assert (found.factor, found.units) == (7.0, "given")


# The table


@pytest.mark.parametrize(
    ("one", "other"), [("Hz/s", "rad/s2"), ("1/s2", "rad/s2"), ("V/Hz", "V.s/rad"), ("kHz", "rpm"), ("1/min", "rpm")]
)
def test_what_may_count_turns_or_radians_is_not_converted(one: str, other: str) -> None:
    assert parse_unit(one).conversion(parse_unit(other)) is None
    assert parse_unit(other).conversion(parse_unit(one)) is None


@pytest.mark.parametrize(
    ("one", "other", "factor"),
    [("Hz/s", "1/s2", 1.0), ("V/Hz", "V.s", 1.0), ("1/min", "Hz", 1.0 / 60.0), ("V.s", "V.s/rad", 1.0)],
)
def test_cycles_are_counted_alike_where_no_angle_is_named(one: str, other: str, factor: float) -> None:
    assert parse_unit(one).conversion(parse_unit(other)) == pytest.approx((factor, 0.0))


def test_temperatures_have_a_zero_only_alone() -> None:
    assert parse_unit("degC").offset == 273.15
    assert parse_unit("J/degC").offset == 0.0
    assert parse_unit("degC2").offset == 0.0


def test_definitions_come_before_the_table() -> None:
    own = parse_unit("mm")
    assert resolve_unit("h", {"h": own}) is own
    assert resolve_unit("h", {}, {"h": own}) is own
    assert resolve_unit("h", {}) == parse_unit("h")
    assert resolve_unit("furlong") is None


@pytest.mark.parametrize(
    ("text", "shown"),
    [("h", "3600 s"), ("m/s2", "m/s2"), ("degC", "K + 273.15"), ("V", "kg.m2/(s3.A)"), ("%", "0.01 1"), ("Hz", "1/s")],
)
def test_units_are_shown_by_their_meaning(text: str, shown: str) -> None:
    assert str(parse_unit(text)) == shown


@pytest.mark.parametrize(
    ("word", "unit"), [("micron", "um"), ("Metres/s", "m"), ("N.seconds", "s"), ("degrees", "deg")]
)
def test_a_word_for_a_unit_is_answered_with_its_symbol(word: str, unit: str) -> None:
    with pytest.raises(DescriptionError, match=f"Did you mean '{unit}'"):
        parse_unit(word)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("Nm", "N.m"),
        ("kgm2", "kg.m2"),
        ("kg*m^2", "kg.m2"),
        ("m/s²", "m/s2"),
        ("µm", "um"),
        ("Nm/A", "N.m/A"),
        ("V s/m", "V.s/m"),
        ("00:00:01", None),
        ("m**", "m"),
        ("€^2", None),
    ],
)
def test_a_unit_in_another_spelling_is_answered(text: str, meant: str | None) -> None:
    with pytest.raises(DescriptionError) as caught:
        parse_unit(text)
    assert ("Did you mean" in str(caught.value)) is (meant is not None)
    assert meant is None or f"Did you mean '{meant}'?" in str(caught.value)
