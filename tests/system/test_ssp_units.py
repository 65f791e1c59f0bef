"""Units in SSP packages of other tools: parameter sets, unit definitions, suppressed conversions."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from fmu_files import write_gain

from cosim.errors import DescriptionError
from cosim.master.simulation import simulate
from cosim.system.ssp_write import write_ssp
from cosim.system.system import System, read_system

SSD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="foreign"
    xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
    xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
    xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
  <ssd:System name="top">
    {system}
    <ssd:Elements>
      <ssd:Component name="a" source="resources/A.fmu"><ssd:Connectors>
        <ssd:Connector name="z" kind="output"><ssc:Real {z}/></ssd:Connector>{more}
      </ssd:Connectors>{component}</ssd:Component>
      <ssd:Component name="b" source="resources/B.fmu"><ssd:Connectors>
        <ssd:Connector name="u" kind="input"><ssc:Real {u}/></ssd:Connector>
      </ssd:Connectors></ssd:Component>
    </ssd:Elements>
    <ssd:Connections>
      <ssd:Connection startElement="a" startConnector="z" endElement="b" endConnector="u" {attributes}
        >{transformation}</ssd:Connection>
    </ssd:Connections>
  </ssd:System>
  {units}
  <ssd:DefaultExperiment startTime="0" stopTime="1"/>
</ssd:SystemStructureDescription>
"""

SET = (
    '<ssv:ParameterSet version="1.0" name="v" xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" '
    'xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"><ssv:Parameters><ssv:Parameter name="{name}">'
    '<ssv:Real value="5" {unit}/></ssv:Parameter></ssv:Parameters>{units}</ssv:ParameterSet>'
)


def binding(content: str) -> str:
    return f"<ssd:ParameterBindings><ssd:ParameterBinding {content}</ssd:ParameterBinding></ssd:ParameterBindings>"


def package(
    folder: Path, *, a: tuple[str | None, str] = ("m", ""), b: tuple[str | None, str] = ("m", ""), **parts: str
) -> System:
    """``a`` and ``b`` are unit and BaseUnit of the FMUs; ``parts`` are those of the SSD, ``ssv`` a file beside it."""
    ssv = parts.pop("ssv", "")
    texts = {
        "system": "",
        "z": "",
        "u": "",
        "component": "",
        "attributes": "",
        "transformation": "",
        "units": "",
        "more": "",
    }
    relative = parts.pop("relative", "")
    for name, (unit, base) in (("A", a), ("B", b)):
        write_gain(
            folder, name, unit, unit, base_units={unit: base} if unit and base else {}, relative=name == relative
        )
    path = folder / "foreign.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", SSD.format(**{**texts, **parts}))
        if ssv:
            archive.writestr("resources/values.ssv", ssv)
        for name in ("A", "B"):
            archive.write(folder / f"{name}.fmu", f"resources/{name}.fmu")
    return read_system(path, step_size="1")


def units(element: str, name: str, base: str) -> str:
    return f'<{element}><ssc:Unit name="{name}"><ssc:BaseUnit {base}/></ssc:Unit></{element}>'


# Values


@pytest.mark.parametrize("where", ["inline", "external", "inline at the system", "external at the system"])
@pytest.mark.parametrize(
    ("unit", "defined", "value"),
    [
        ('unit="mm"', "", 0.005),
        ('unit="m"', "", 5.0),
        ("", "", 5.0),
        ('unit="inch"', units("ssv:Units", "inch", 'm="1" factor="0.0254"'), 0.127),
        # what the set itself says of a name comes before what others say
        ('unit="mm"', units("ssv:Units", "mm", 'm="1" factor="0.25"'), 1.25),
    ],
)
def test_values_reach_the_unit_of_their_variable(
    tmp_path: Path, where: str, unit: str, defined: str, value: float
) -> None:
    at_system = where.endswith("system")
    text = SET.format(name="a.u" if at_system else "u", unit=unit, units=defined)
    external = where.startswith("external")
    bound = 'source="resources/values.ssv">' if external else f"><ssd:ParameterValues>{text}</ssd:ParameterValues>"
    parts = {"system" if at_system else "component": binding(bound), "ssv": text if external else ""}
    system = package(tmp_path, **parts)
    assert system.instance("a").start == {"u": value}


def test_a_value_given_twice_is_noted(tmp_path: Path) -> None:
    more = '<ssv:Parameter name="u"><ssv:Real value="7"/></ssv:Parameter></ssv:Parameters>'
    text = SET.format(name="u", unit="", units="").replace("</ssv:Parameters>", more)
    system = package(tmp_path, component=binding(f"><ssd:ParameterValues>{text}</ssd:ParameterValues>"))
    assert system.instance("a").start == {"u": 7.0}
    assert "parameter values of 'a': 'u' has more than one value; the last counts." in system.notes


def test_offsets_count_for_values_too(tmp_path: Path) -> None:
    text = SET.format(name="u", unit='unit="degC"', units="")
    bound = binding(f"><ssd:ParameterValues>{text}</ssd:ParameterValues>")
    system = package(tmp_path, a=("K", 'K="1"'), b=("K", ""), component=bound)
    assert system.instance("a").start == {"u": 278.15}


def test_a_difference_takes_values_without_offset(tmp_path: Path) -> None:
    text = SET.format(name="u", unit='unit="degC"', units="")
    bound = binding(f"><ssd:ParameterValues>{text}</ssd:ParameterValues>")
    for unit, base in (("K", 'K="1"'), ("degC", 'K="1" offset="273.15"')):
        system = package(tmp_path, a=(unit, base), b=("K", ""), component=bound, relative="A")
        assert system.instance("a").start == {"u": 5.0}


def test_a_set_and_an_fmu_may_mean_different_things_by_one_name(tmp_path: Path) -> None:
    text = SET.format(name="u", unit='unit="mm"', units=units("ssv:Units", "mm", 'm="1" factor="0.25"'))
    bound = binding(f"><ssd:ParameterValues>{text}</ssd:ParameterValues>")
    system = package(tmp_path, a=("mm", 'm="1" factor="1e-3"'), component=bound)
    assert system.instance("a").start == {"u": 1250.0}


def test_units_of_the_description_serve_values(tmp_path: Path) -> None:
    text = SET.format(name="u", unit='unit="inch"', units="")
    bound = binding(f"><ssd:ParameterValues>{text}</ssd:ParameterValues>")
    defined = units("ssd:Units", "inch", 'm="1" factor="0.0254"')
    assert package(tmp_path, component=bound, units=defined).instance("a").start == {"u": 0.127}


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ('unit="N"', "parameter 'a.u': unit 'N' cannot be converted to 'm'."),
        ('unit="inch"', "parameter 'a.u': nothing says what unit 'inch' is. Define it in Units."),
    ],
)
def test_values_of_another_kind_are_refused(tmp_path: Path, unit: str, text: str) -> None:
    values = SET.format(name="u", unit=unit, units="")
    with pytest.raises(DescriptionError) as caught:
        package(tmp_path, component=binding(f"><ssd:ParameterValues>{values}</ssd:ParameterValues>"))
    assert text in caught.value.problems[0]


@pytest.mark.parametrize("where", ["component", "system"])
@pytest.mark.parametrize(
    ("own", "stated", "unit", "value"),
    [
        ("m", 'unit="mm"', 'unit="m"', 5000.0),
        ("m", 'unit="mm"', 'unit="mm"', 5.0),
        ("m", 'unit="mm"', "", 5.0),
        ("m", 'unit="inch"', 'unit="mm"', 5e-3 / 0.0254),
        ("rad/s", 'unit="rpm"', 'unit="rad/s"', 5.0 * 60.0 / (2.0 * 3.141592653589793)),
        ("K", 'unit="degC"', 'unit="K"', 5.0 - 273.15),
        (None, 'unit="mm"', 'unit="m"', 5000.0),
        ("m", "", 'unit="mm"', 0.005),
    ],
)
def test_values_reach_the_unit_of_their_connector(  # noqa: PLR0917
    tmp_path: Path, where: str, own: str | None, stated: str, unit: str, value: float
) -> None:
    """SSP 1.0 and 2.0, Real: the connector gives the unit of the variable; if it gives none, the FMU does."""
    text = SET.format(name="a.u" if where == "system" else "u", unit=unit, units="")
    bound = binding(f"><ssd:ParameterValues>{text}</ssd:ParameterValues>")
    connector = f'<ssd:Connector name="u" kind="input"><ssc:Real {stated}/></ssd:Connector>'
    defined = units("ssd:Units", "inch", 'm="1" factor="0.0254"')
    b = ("m", "") if own is None else (own, "")
    parts = {where: bound, "more": connector, "units": defined}
    system = package(tmp_path, a=(own, ""), b=b, attributes='suppressUnitConversion="true"', **parts)
    assert system.instance("a").start["u"] == pytest.approx(value, rel=1e-14)
    told = "the description states another unit than the FMU for a.u: the description counts."
    assert (told in system.notes) == (own is not None and bool(stated))
    again = read_system(write_ssp(system, tmp_path / "again.ssp"))
    assert again.instance("a").start["u"] == system.instance("a").start["u"]


def test_a_value_of_another_kind_than_its_connector_is_refused(tmp_path: Path) -> None:
    text = SET.format(name="u", unit='unit="m"', units="")
    bound = binding(f"><ssd:ParameterValues>{text}</ssd:ParameterValues>")
    connector = '<ssd:Connector name="u" kind="input"><ssc:Real unit="N"/></ssd:Connector>'
    with pytest.raises(DescriptionError) as caught:
        package(tmp_path, component=bound, more=connector)
    assert "parameter 'a.u': unit 'm' cannot be converted to 'N'." in caught.value.problems[0]


# Connections

LITRES = units("ssd:Units", "lpm", 'm="3" s="-1" factor="1.6666666666666667e-05"')


@pytest.mark.parametrize(
    ("a", "b", "parts", "expected"),
    [
        # the description defines a unit that nobody else knows
        (("lpm", ""), ("m3/s", ""), {"units": LITRES}, (1 / 60000, 0.0)),
        (("m3/s", ""), ("m3/s", ""), {"units": LITRES, "z": 'unit="lpm"'}, (1 / 60000, 0.0)),
        # what an FMU states comes before what the description says of the same name
        (("lpm", 'm="3" s="-1" factor="2.0"'), ("m3/s", ""), {"units": LITRES}, (2.0, 0.0)),
        # the FMUs alone
        (("degC", 'K="1" offset="273.15"'), ("K", 'K="1"'), {}, (1.0, 273.15)),
        (
            ("rpm", 'rad="1" s="-1" factor="0.1"'),
            ("rad/s", ""),
            {"attributes": 'suppressUnitConversion="false"'},
            (0.1, 0.0),
        ),
        # suppressed
        (("rpm", ""), ("rad/s", ""), {"attributes": 'suppressUnitConversion="true"'}, (1.0, 0.0)),
        (("N", ""), ("m", ""), {"attributes": 'suppressUnitConversion="1"'}, (1.0, 0.0)),
        (
            ("rpm", ""),
            ("rad/s", ""),
            {"attributes": 'suppressUnitConversion="true"', "transformation": '<ssc:LinearTransformation factor="4"/>'},
            (4.0, 0.0),
        ),
        # converted first, transformed then
        (
            ("degC", 'K="1" offset="273.15"'),
            ("K", 'K="1"'),
            {"transformation": '<ssc:LinearTransformation factor="2" offset="3"/>'},
            (2.0, 2 * 273.15 + 3.0),
        ),
    ],
)
def test_connections_are_converted_as_the_files_say(
    tmp_path: Path, a: tuple[str, str], b: tuple[str, str], parts: dict[str, str], expected: tuple[float, float]
) -> None:
    system = package(tmp_path, a=a, b=b, **parts)
    connection = system.connections[0]
    assert (connection.factor, connection.offset) == pytest.approx(expected, rel=1e-15)
    again = read_system(write_ssp(system.changed({"a.u": 1 / 3}), tmp_path / "again.ssp"))
    assert simulate(again)["b.z"].tolist() == simulate(system.changed({"a.u": 1 / 3}))["b.z"].tolist()


@pytest.mark.parametrize(
    ("a", "b", "parts", "text"),
    [
        (("h", 'm="1"'), ("h", 's="1"'), {}, "unit h (m) does not match h (s)."),
        (
            ("furlong", ""),
            ("m", ""),
            {"z": 'unit="furlong"'},
            "unit furlong does not match m. Nothing says what furlong",
        ),
        (("m", ""), ("m", ""), {"z": 'unit="N"'}, "unit 'N' cannot be converted to 'm'."),
        (("m", ""), ("m", ""), {"z": 'unit="s"', "u": 'unit="parsec"'}, "nothing says what unit 'parsec' is."),
    ],
)
def test_connections_of_different_kinds_are_refused(
    tmp_path: Path, a: tuple[str, str], b: tuple[str, str], parts: dict[str, str], text: str
) -> None:
    with pytest.raises(DescriptionError) as caught:
        package(tmp_path, a=a, b=b, **parts)
    assert text in caught.value.problems[0]
