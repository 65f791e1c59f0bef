"""Systems as SSP: nothing is lost on the way there and back, and files of other tools are read as SSP 1.0 says."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path

import pytest
from conftest import ROOT
from fmpy.ssp.ssd import read_ssd

from cosim.commands.cli import main
from cosim.errors import DescriptionError
from cosim.master.simulation import simulate
from cosim.system.ssp_integers import with_integers
from cosim.system.ssp_package import read_document
from cosim.system.ssp_read import read_ssp
from cosim.system.ssp_write import write_ssp
from cosim.system.system import System, make_system, read_system
from cosim.system.toml_write import write_system

SYSTEMS = sorted(
    path
    for path in (ROOT / "studies").glob("*/*.toml")
    if re.search(r"^\[experiment\]|^base *=", path.read_text(), re.M)
)

SSD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="foreign"
    xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
    xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
    xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
  <ssd:System name="top">
    {bindings}
    <ssd:Elements>
      <ssd:Component name="source" source="resources/Trajectory.fmu">
        <ssd:Connectors>
          <ssd:Connector name="position" kind="output"><ssc:Real unit="{unit}"/></ssd:Connector>
        </ssd:Connectors>
      </ssd:Component>
      <ssd:Component name="controller" source="resources/PPi.fmu">
        <ssd:Connectors>
          <ssd:Connector name="position_ref" kind="input"><ssc:Real unit="m"/></ssd:Connector>
        </ssd:Connectors>
      </ssd:Component>
      {elements}
    </ssd:Elements>
    <ssd:Connections>
      <ssd:Connection startElement="{ends[0]}" startConnector="{ends[1]}" endElement="{ends[2]}"
        endConnector="{ends[3]}" {attributes}>{transformation}</ssd:Connection>
    </ssd:Connections>
  </ssd:System>
  <ssd:DefaultExperiment startTime="0.5" stopTime="1.0"/>
</ssd:SystemStructureDescription>
"""

SSV = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet version="1.0" name="values" xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
  <ssv:Parameters>
    <ssv:Parameter name="source.amplitude"><ssv:Real value="1e-3"/></ssv:Parameter>
    <ssv:Parameter name="source.kind"><ssv:Enumeration value="sine"/></ssv:Parameter>
    <ssv:Parameter name="controller.command_max"><ssv:Real value="2.5"/></ssv:Parameter>
  </ssv:Parameters>
</ssv:ParameterSet>
"""

FORWARD = ("source", "position", "controller", "position_ref")


def foreign(
    folder: Path,
    native: Path,
    *,
    bindings: str = "",
    elements: str = "",
    attributes: str = "",
    transformation: str = "",
    unit: str = "m",
    ends: tuple[str, ...] = FORWARD,
) -> Path:
    """A package as another tool would write it: values in a file of their own, no annotations of ours."""
    path = folder / "foreign.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        text = SSD.format(
            bindings=bindings,
            elements=elements,
            attributes=attributes,
            transformation=transformation,
            unit=unit,
            ends=ends,
        )
        archive.writestr("SystemStructure.ssd", text)
        archive.writestr("resources/values.ssv", SSV)
        for name in ("Trajectory", "PPi"):
            archive.write(native / f"{name}.fmu", f"resources/{name}.fmu")
    return path


def same(one: System, other: System) -> bool:
    """Whether two systems give the same results and say the same of themselves."""
    return (one.digest, one.description, one.evaluation_order, one.record, one.decimation) == (
        other.digest,
        other.description,
        other.evaluation_order,
        other.record,
        other.decimation,
    )


@pytest.fixture
def rich(native: Path, tmp_path: Path) -> System:
    """A system that has everything: arrays, booleans, enumerations, transformations, multiples, an order."""
    document = {
        "description": "Ein \"reiches\" System <&> \\ 'so'",
        "connections": [
            "source.position -> controller.position_ref",
            {"from": "controller.command", "to": "plant.command", "factor": Decimal("0.1"), "offset": Decimal("-1e-3")},
            "plant.position -> controller.position",
        ],
        "experiment": {
            "start_time": Decimal("0.1"),
            "stop_time": Decimal("0.9"),
            "step_size": Decimal("2e-4"),
            "order": ["source", "controller", "plant"],
            "tolerance": Decimal("1e-5"),
        },
        "instances": {
            "source": {"fmu": "Trajectory", "start": {"kind": "quintic", "amplitude": Decimal("1e-3")}},
            "controller": {
                "fmu": "NctfPi",
                "start": {
                    "antiwindup": False,
                    "compute_delay": 1,
                    "nct.error": [Decimal(k) / 1000 for k in range(1, 129)],
                },
            },
            "plant": {"fmu": "CompliantBallscrew", "step_multiple": 2},
        },
        "record": {"variables": ["plant.*", "controller.command"], "decimation": 4},
    }
    return make_system(document, name="rich.toml", fmus=native)


# ---- there and back ----


@pytest.mark.parametrize("path", SYSTEMS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_shipped_systems_survive(path: Path, native: Path, tmp_path: Path) -> None:
    system = read_system(path, fmus=native)
    packed = write_ssp(system, tmp_path / "system.ssp")
    read = read_system(packed)
    assert same(system, read)
    with zipfile.ZipFile(packed) as archive:
        read_document(archive.read("SystemStructure.ssd"))


def test_everything_survives_ssp_and_toml(rich: System, tmp_path: Path) -> None:
    packed = read_system(write_ssp(rich, tmp_path / "rich.ssp"))
    written = read_system(write_system(packed, tmp_path / "back.toml"))
    for other in (packed, written):
        assert same(rich, other)
        assert [i.step_multiple for i in other.instances] == [1, 1, 2]
        assert (other.start_time, other.stop_time, other.step_size) == (Decimal("0.1"), Decimal("0.9"), Decimal("2e-4"))
        assert [dict(i.start) for i in other.instances] == [dict(i.start) for i in rich.instances]
        assert other.connections == rich.connections
        assert other.tolerance == rich.tolerance
    assert 'kind = "quintic"' in (tmp_path / "back.toml").read_text()


def test_parameter_values_are_valid_and_carry_units(rich: System, tmp_path: Path) -> None:
    with zipfile.ZipFile(write_ssp(rich, tmp_path / "rich.ssp")) as archive:
        text = archive.read("SystemStructure.ssd").decode()
    sets = re.findall(r"<ssv:ParameterSet.*?</ssv:ParameterSet>", text, re.DOTALL)
    assert len(sets) == 2
    head = re.search(r"<ssd:SystemStructureDescription([^>]*)>", text)
    assert head is not None
    spaces = " ".join(re.findall(r'xmlns:\w+="[^"]*"', head[1]))
    for found in sets:
        read_document(found.replace("<ssv:ParameterSet", f"<ssv:ParameterSet {spaces}", 1).encode(), VALUES)
    assert '<ssv:Real value="0.001" unit="m" />' in text


VALUES = "SystemStructureParameterValues"


def test_equal_systems_give_equal_bytes(rich: System, tmp_path: Path) -> None:
    one, other = (write_ssp(rich, tmp_path / name) for name in ("one.ssp", "other.ssp"))
    assert one.read_bytes() == other.read_bytes()


def test_two_fmus_of_one_name_stay_two(native: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "other" / "Trajectory.fmu"
    elsewhere.parent.mkdir()
    elsewhere.write_bytes((native / "MillingForce.fmu").read_bytes())
    document = {
        "experiment": {"stop_time": Decimal(1), "step_size": Decimal("0.1")},
        "instances": {"a": {"fmu": str(native / "Trajectory.fmu")}, "b": {"fmu": str(elsewhere)}},
    }
    read = read_system(write_ssp(make_system(document), tmp_path / "two.ssp"))
    assert [instance.fmu.name for instance in read.instances] == ["Trajectory", "MillingForce"]


def test_run_of_the_package_is_that_of_the_file(native: Path, tmp_path: Path) -> None:
    system = read_system(ROOT / "studies" / "rubio2015" / "super_twisting.toml", fmus=native, stop_time="0.01")
    packed = read_system(write_ssp(system, tmp_path / "s.ssp"))
    one, other = simulate(system), simulate(packed)
    assert (one["plant.position"] == other["plant.position"]).all()
    assert abs(one["plant.position"]).max() > 0.0


def test_fmpy_reads_the_structure(rich: System, tmp_path: Path) -> None:
    ssd = read_ssd(str(write_ssp(rich, tmp_path / "rich.ssp")))
    assert [element.name for element in ssd.system.elements] == ["source", "controller", "plant"]
    assert len(ssd.system.connections) == 3


def test_masters_of_other_tools_are_named(rich: System, tmp_path: Path) -> None:
    """libcosim takes its step size from it; OMSimulator reads no system without its own."""
    with zipfile.ZipFile(write_ssp(rich, tmp_path / "rich.ssp")) as archive:
        text = archive.read("SystemStructure.ssd").decode()
    assert f'<osp:FixedStepAlgorithm baseStepSize="{rich.step_size}"' in text
    master = re.search(r"<oms:FixedStepMaster (.*?)/>", text)
    assert master is not None
    assert f'stepSize="{rich.step_size}"' in master[1]
    assert 'description="oms-ma"' in master[1]


def test_command_line(native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    packed, back = tmp_path / "s.ssp", tmp_path / "s.toml"
    system = str(ROOT / "studies" / "rubio2015" / "p_pi.toml")
    assert main(["export", system, "--fmus", str(native), "--stop-time", "0.01", "-o", str(packed)]) == 0
    assert main(["export", str(packed), "-o", str(back)]) == 0
    assert main(["run", str(packed)]) == 0
    assert main(["check", str(back)]) == 0
    assert main(["export", system, "--fmus", str(native), "-o", str(tmp_path / "s.xml")]) == 2
    assert "ends in .ssp or .toml" in capsys.readouterr().err


# ---- what others write ----


def test_foreign_package_is_read(native: Path, tmp_path: Path) -> None:
    """Parameter values in a file of their own, for all components; times from the default experiment."""
    bindings = '<ssd:ParameterBindings><ssd:ParameterBinding source="resources/values.ssv"/></ssd:ParameterBindings>'
    system = read_system(foreign(tmp_path, native, bindings=bindings), step_size="0.1")
    assert (system.start_time, system.stop_time) == (Decimal("0.5"), Decimal("1.0"))
    source, controller = system.instances
    assert source.start["amplitude"] == pytest.approx(1e-3, abs=0.0)
    assert source.start["kind"] == source.fmu.variables["kind"].items["sine"]
    assert controller.start == {"command_max": 2.5}
    assert str(system.connections[0]) == "source.position -> controller.position_ref"


def test_ssd_beside_its_resources_is_read(native: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(foreign(tmp_path, native)) as archive:
        archive.extractall(tmp_path / "unpacked")
    system = read_system(tmp_path / "unpacked" / "SystemStructure.ssd", step_size="0.1")
    assert len(system.instances) == 2


@pytest.mark.parametrize(
    ("attributes", "transformation", "factor"),
    [
        ("", "", 1e-3),
        ('suppressUnitConversion="true"', '<ssc:LinearTransformation factor="5"/>', 5.0),
        ("", '<ssc:LinearTransformation factor="2" offset="3"/>', 2e-3),
    ],
)
def test_units_are_converted_as_ssp_says(
    native: Path, tmp_path: Path, attributes: str, transformation: str, factor: float
) -> None:
    path = foreign(tmp_path, native, unit="mm", attributes=attributes, transformation=transformation)
    connection = read_system(path, step_size="0.1").connections[0]
    assert connection.factor == pytest.approx(factor, rel=1e-15)


def test_connection_written_from_the_input_is_turned(native: Path, tmp_path: Path) -> None:
    path = foreign(tmp_path, native, ends=("controller", "position_ref", "source", "position"))
    assert str(read_system(path, step_size="0.1").connections[0]) == "source.position -> controller.position_ref"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"elements": '<ssd:Component name="source" source="c.fmu"/>'}, "has two elements called 'source'"),
        ({"elements": '<ssd:Component name="c" source="../c.fmu"/>'}, "source '../c.fmu' is not a path inside"),
        ({"elements": '<ssd:Component name="c" source="http://x/c.fmu"/>'}, "is not a path inside the package"),
        ({"elements": '<ssd:Component source="c.fmu"/>'}, "line 19: "),
        ({"unit": "N"}, "unit 'N' cannot be converted to 'm'"),
        (
            {"transformation": '<ssc:IntegerMappingTransformation><ssc:MapEntry source="1" target="2"/>'
             "</ssc:IntegerMappingTransformation>"},
            "IntegerMappingTransformation is not read",
        ),
        (
            {"bindings": '<ssd:ParameterBindings><ssd:ParameterBinding source="nowhere.ssv"/></ssd:ParameterBindings>'},
            "parameter values of 'top', no file 'nowhere.ssv' in the package.",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_said(native: Path, tmp_path: Path, changes: dict[str, str], text: str) -> None:
    with pytest.raises(DescriptionError, match=re.escape(text)):
        read_ssp(foreign(tmp_path, native, **changes))


@pytest.mark.parametrize("member", ["../evil", "/evil", "a\\..\\..\\b", "a:b"])
def test_hostile_archive_is_refused(tmp_path: Path, member: str) -> None:
    path = tmp_path / "evil.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(member, "x")
    with pytest.raises(DescriptionError, match="Refused"):
        read_ssp(path)


def cut_stream(content: bytes) -> bytes:
    """The compressed text is overwritten in its middle."""
    begin = content.index(b"SystemStructure.ssd") + 40
    return content[:begin] + b"\xff" * 40 + content[begin + 40 :]


def moved_directory(content: bytes) -> bytes:
    """The end of the archive says that the directory lies 25 bytes later, so that members begin before the file."""
    offset = int.from_bytes(content[-6:-2], "little") + 25
    return content[:-6] + offset.to_bytes(4, "little") + content[-2:]


def other_method(content: bytes) -> bytes:
    """The directory names a method of compression that there is not."""
    place = content.rindex(b"PK\x01\x02") + 10
    return content[:place] + b"\x63\x00" + content[place + 2 :]


@pytest.mark.parametrize("damage", [cut_stream, moved_directory, other_method])
def test_a_damaged_package_is_refused(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "damaged.ssp"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", "<a>" + "".join(map(str, range(2000))) + "</a>")
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(DescriptionError, match=r"damaged\.ssp: not a readable zip archive \(.*\)\. Build or download"):
        read_ssp(path)


def test_not_a_package(tmp_path: Path) -> None:
    (tmp_path / "text.ssp").write_text("text")
    with pytest.raises(DescriptionError, match="not a readable zip archive"):
        read_ssp(tmp_path / "text.ssp")
    with zipfile.ZipFile(tmp_path / "empty.ssp", "w") as archive:
        archive.writestr("readme", "x")
    with pytest.raises(DescriptionError, match=r"no SystemStructure\.ssd inside"):
        read_ssp(tmp_path / "empty.ssp")
    with pytest.raises(DescriptionError, match="no such file"):
        read_ssp(tmp_path / "missing.ssp")


# ---- for importers that know no enumerations ----


def test_enumerations_as_integers(native: Path, tmp_path: Path) -> None:
    """The FMUs of the package declare whole numbers; the results are the same."""
    system = read_system("feng2015/circle", fmus=native, stop_time="0.01")
    assert any(variable.items for instance in system.instances for variable in instance.fmu.variables.values())
    found = read_system(write_ssp(system, tmp_path / "integers.ssp", integers=True))
    kinds = {variable.type for instance in found.instances for variable in instance.fmu.variables.values()}
    assert "Enumeration" not in kinds
    assert {i.name: dict(i.start) for i in found.instances} == {i.name: dict(i.start) for i in system.instances}
    assert (simulate(found).rows == simulate(system).rows).all()


def test_integers_are_declared_in_fmi3_too(tmp_path: Path) -> None:
    text = (
        '<fmiModelDescription fmiVersion="3.0"><ModelVariables><Enumeration name="k" declaredType="K" start="2"/>'
        '<Float64 name="x"/></ModelVariables></fmiModelDescription>'
    )
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("binaries/x", b"binary")
    (tmp_path / "b.fmu").write_bytes(with_integers((tmp_path / "a.fmu").read_bytes()))
    with zipfile.ZipFile(tmp_path / "b.fmu") as archive:
        assert b'<Int64 name="k" start="2"/>' in archive.read("modelDescription.xml")
        assert archive.read("binaries/x") == b"binary"


@pytest.mark.parametrize(
    ("more", "name", "note"),
    [([], "s.ssp", True), (["--enumerations", "integer"], "s.ssp", False), ([], "s.toml", False)],
)
def test_export_says_what_importers_read_past(
    native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], name: str, *, note: bool
) -> None:
    arguments = ["export", "feng2015/circle", "--fmus", str(native), "-o", str(tmp_path / name), *more]
    assert main(arguments) == 0
    said = capsys.readouterr()
    text = " ".join((said.out + said.err).split())
    assert ("read past" in text and "trajectory_x.kind" in text) is note, text


def test_integers_are_for_packages(native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["export", "shams2010/fsmc_5sin", "--fmus", str(native), "-o", str(tmp_path / "s.toml")]
    assert main([*arguments, "--enumerations", "integer"]) == 2
    assert "--enumerations integer: only for an .ssp" in " ".join(capsys.readouterr().err.split())
