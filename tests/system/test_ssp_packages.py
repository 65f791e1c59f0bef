"""SSP as other tools write it: systems in systems, connectors of systems, mappings, bindings at any level, any name.

The FMUs compute ``z = gain*u``, so that every expected value is a product that can be worked out by hand.
"""

from __future__ import annotations

import re
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fmu_files import PROBE, Variable, probe_library, write_fmu, write_gain

from cosim.errors import DescriptionError
from cosim.master.simulation import simulate
from cosim.system.ssp_read import read_ssp
from cosim.system.ssp_write import write_ssp
from cosim.system.system import System, make_system, read_system
from cosim.system.toml_write import write_system

SPACES = " ".join(
    f'xmlns:{prefix}="http://ssp-standard.org/SSP1/SystemStructure{name}"'
    for prefix, name in (
        ("ssd", "Description"),
        ("ssc", "Common"),
        ("ssv", "ParameterValues"),
        ("ssm", "ParameterMapping"),
    )
)


# Parts of an SSD


def connector(name: str, kind: str, unit: str = "") -> str:
    attribute = f' unit="{unit}"' if unit else ""
    return f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Real{attribute}/></ssd:Connector>'


def connectors(*parts: str) -> str:
    return f"<ssd:Connectors>{''.join(parts)}</ssd:Connectors>" if parts else ""


def gain(name: str, inner: str = "", **attributes: str) -> str:
    """A component whose output is ``z = gain*u``."""
    given = {"source": "resources/Gain.fmu", **attributes}
    more = "".join(f' {key}="{value}"' for key, value in given.items())
    ports = connectors(connector("u", "input"), connector("z", "output"))
    return f'<ssd:Component name="{name}"{more}>{ports}{inner}</ssd:Component>'


def system(name: str, elements: str = "", *, ports: str = "", values: str = "", wires: str = "") -> str:
    elements = f"<ssd:Elements>{elements}</ssd:Elements>" if elements else ""
    wires = f"<ssd:Connections>{wires}</ssd:Connections>" if wires else ""
    return f'<ssd:System name="{name}">{connectors(ports) if ports else ""}{values}{elements}{wires}</ssd:System>'


def wire(start: str, end: str, inner: str = "", more: str = "") -> str:
    """A connection from ``element.connector`` to another; an empty element is the system itself."""
    ends = ""
    for side, text in (("start", start), ("end", end)):
        element, _, name = text.rpartition(".")
        ends += (f' {side}Element="{element}"' if element else "") + f' {side}Connector="{name}"'
    return f"<ssd:Connection{ends} {more}>{inner}</ssd:Connection>"


def linear(factor: float, offset: float = 0.0) -> str:
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def parameters(kind: str = "Real", unit: str = "", /, **values: object) -> str:
    """A parameter set; two underscores stand for the point in a name."""
    attribute = f' unit="{unit}"' if unit else ""
    rows = "".join(
        f'<ssv:Parameter name="{name.replace("__", ".")}"><ssv:{kind} value="{value}"{attribute}/></ssv:Parameter>'
        for name, value in values.items()
    )
    return (
        f'<ssv:ParameterSet version="1.0" name="v" {SPACES}><ssv:Parameters>{rows}</ssv:Parameters></ssv:ParameterSet>'
    )


def bound(*sets: str, mapping: str = "", more: str = "") -> str:
    """Parameter bindings with the sets inside."""
    rows = "".join(
        f"<ssd:ParameterBinding {more}><ssd:ParameterValues>{values}</ssd:ParameterValues>{mapping}"
        "</ssd:ParameterBinding>"
        for values in sets
    )
    return f"<ssd:ParameterBindings>{rows}</ssd:ParameterBindings>"


def mapped(*entries: str) -> str:
    return f"<ssd:ParameterMapping>{mapping(*entries)}</ssd:ParameterMapping>"


def mapping(*entries: str) -> str:
    return f'<ssm:ParameterMapping version="1.0" {SPACES}>{"".join(entries)}</ssm:ParameterMapping>'


def entry(source: str, target: str, inner: str = "", more: str = "") -> str:
    return f'<ssm:MappingEntry source="{source}" target="{target}" {more}>{inner}</ssm:MappingEntry>'


def description(top: str, version: str = "1.0", after: str = "") -> str:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><ssd:SystemStructureDescription version="{version}" name="p" {SPACES}>'
        f'{top}{after}<ssd:DefaultExperiment startTime="0" stopTime="1"/></ssd:SystemStructureDescription>'
    )


@pytest.fixture
def fmu(tmp_path: Path) -> Path:
    return write_gain(tmp_path, "Gain", "", "")


def package(fmu: Path, top: str, version: str = "1.0", after: str = "", files: dict[str, str] | None = None) -> Path:
    path = fmu.parent / "package.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", description(top, version, after))
        archive.write(fmu, "resources/Gain.fmu")
        for name, text in (files or {}).items():
            archive.writestr(name, text)
    return path


def read(path: Path) -> System:
    return read_system(path, step_size="0.5")


def outputs(found: System) -> dict[str, float]:
    """The last value of every output."""
    result = simulate(found)
    return {column.name: float(result[column.name][-1]) for column in result.columns}


# Systems in systems

CHAIN = system(
    "inner",
    gain("g", bound(parameters(gain=3.0))),
    ports=connector("in", "input") + connector("out", "output"),
    wires=wire("in", "g.u") + wire("g.z", "out"),
)
SOURCE = gain("source", bound(parameters(gain=2.0, u=5.0)))


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_systems_in_systems_are_flattened(fmu: Path, depth: int) -> None:
    nested = CHAIN
    for level in range(1, depth):
        name = f"level{level}"
        child = "inner" if level == 1 else f"level{level - 1}"
        ports = connector("in", "input") + connector("out", "output")
        nested = system(name, nested, ports=ports, wires=wire("in", f"{child}.in") + wire(f"{child}.out", "out"))
    child = "inner" if depth == 1 else f"level{depth - 1}"
    wires = wire("source.z", f"{child}.in") + wire(f"{child}.out", "sink.u")
    found = read(package(fmu, system("top", SOURCE + nested + gain("sink"), wires=wires)))
    path = [*(f"level{level}" for level in range(depth - 1, 0, -1)), "inner", "g"]
    name = "_".join(path)
    assert [instance.name for instance in found.instances] == ["source", name, "sink"]
    assert {str(c) for c in found.connections} == {f"source.z -> {name}.u", f"{name}.z -> sink.u"}
    assert outputs(found) == {"source.z": 10.0, f"{name}.z": 30.0, "sink.z": 30.0}
    assert f"instances have plain names here: '{'.'.join(path)}' is {name}." in found.notes


def test_one_connector_may_feed_many(fmu: Path) -> None:
    fan = system(
        "fan", gain("a") + gain("b"), ports=connector("in", "input"), wires=wire("in", "a.u") + wire("in", "b.u")
    )
    found = read(package(fmu, system("top", SOURCE + fan, wires=wire("source.z", "fan.in"))))
    assert outputs(found) == {"source.z": 10.0, "fan_a.z": 10.0, "fan_b.z": 10.0}


def test_a_system_may_pass_a_signal_through(fmu: Path) -> None:
    through = system(
        "through", ports=connector("in", "input") + connector("out", "output"), wires=wire("in", "out", linear(2.0))
    )
    wires = wire("source.z", "through.in") + wire("through.out", "sink.u")
    found = read(package(fmu, system("top", SOURCE + through + gain("sink"), wires=wires)))
    assert outputs(found)["sink.z"] == 20.0


@pytest.mark.parametrize("turned", [("in", "g.u"), ("g.u", "in")])
def test_connections_of_a_system_may_be_written_from_either_side(fmu: Path, turned: tuple[str, str]) -> None:
    inner = system("inner", gain("g"), ports=connector("in", "input"), wires=wire(*turned))
    found = read(package(fmu, system("top", SOURCE + inner, wires=wire("inner.in", "source.z"))))
    assert [str(connection) for connection in found.connections] == ["source.z -> inner_g.u"]


@pytest.mark.parametrize(
    ("first", "second", "value"),
    [
        (linear(2.0, 1.0), linear(3.0, 4.0), 3.0 * (2.0 * 10.0 + 1.0) + 4.0),
        ("", linear(0.5), 5.0),
        (linear(2.0, -1.0), "", 19.0),
    ],
)
def test_transformations_on_the_way_add_up(fmu: Path, first: str, second: str, value: float) -> None:
    inner = system("inner", gain("g"), ports=connector("in", "input"), wires=wire("in", "g.u", second))
    found = read(package(fmu, system("top", SOURCE + inner, wires=wire("source.z", "inner.in", first))))
    assert outputs(found)["inner_g.z"] == value


@pytest.mark.parametrize(
    ("unit", "more", "value"),
    [
        ("mm", "", 0.01),  # the source is in mm, the input in m
        ("cm", "", 0.01),
        ("", "", 0.01),
        ("mm", 'suppressUnitConversion="true"', 10.0),
    ],
)
def test_units_are_converted_on_the_way(tmp_path: Path, unit: str, more: str, value: float) -> None:
    fmu = write_gain(tmp_path, "Gain", "m", "mm")
    inner = system("inner", gain("g"), ports=connector("in", "input", unit), wires=wire("in", "g.u", "", more))
    found = read(package(fmu, system("top", SOURCE + inner, wires=wire("source.z", "inner.in"))))
    assert outputs(found)["inner_g.z"] == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(("transformation", "more"), [(linear(2.0), ""), ("", 'suppressUnitConversion="true"')])
def test_a_connector_without_unit_forgets_that_of_changed_values(
    tmp_path: Path, transformation: str, more: str
) -> None:
    """What a factor makes of metres at a connector without a unit is not converted any more."""
    fmu = write_gain(tmp_path, "Gain", "cm", "m")
    inner = system("inner", gain("g"), ports=connector("in", "input"), wires=wire("in", "g.u"))
    found = read(package(fmu, system("top", SOURCE + inner, wires=wire("source.z", "inner.in", transformation, more))))
    assert outputs(found)["inner_g.z"] == (20.0 if transformation else 10.0)


def test_units_of_connectors_count_where_the_fmus_have_none(tmp_path: Path) -> None:
    """The output has no unit, the input has metres: the connector between them says that the values are millimetres."""
    variables = [replace(v, unit="m" if v.name == "u" else None) for v in PROBE if v.name in ("u", "z", "gain")]
    fmu = write_fmu(tmp_path / "Gain.fmu", variables, binary=probe_library().read_bytes())
    inner = system("inner", gain("g"), ports=connector("in", "input", "mm"), wires=wire("in", "g.u"))
    found = read(package(fmu, system("top", SOURCE + inner, wires=wire("source.z", "inner.in"))))
    assert outputs(found)["inner_g.z"] == pytest.approx(0.01, rel=1e-15)


def test_a_package_is_the_same_after_export(fmu: Path, tmp_path: Path) -> None:
    found = read(package(fmu, system("top", SOURCE + CHAIN, wires=wire("source.z", "inner.in", linear(2.0, 1.0)))))
    for again in (write_ssp(found, tmp_path / "again.ssp"), write_system(found, tmp_path / "again.toml")):
        assert read_system(again).digest == found.digest


@pytest.mark.parametrize(
    ("top", "text"),
    [
        (system("top", SOURCE + gain("g"), wires=2 * wire("source.z", "g.u")), "'g.u' has two sources, 'source.z' and"),
        (
            system("top", SOURCE + CHAIN, wires=2 * wire("source.z", "inner.in")),
            "'inner.in' has two sources, 'source.z' and 'source.z'. Keep one.",
        ),
        (system("top", SOURCE + CHAIN, wires=wire("source.z", "inner.inn")), "no connector 'inn' of it."),
        (system("top", SOURCE, wires=wire("sorce.z", "source.u")), "no element 'sorce'. Did you mean 'source'?"),
        (system("top", SOURCE + gain("g"), wires=wire("source.u", "g.u")), "both ends take values there"),
        (system("top", SOURCE + gain("g"), wires=wire("source.z", "g.z")), "both ends give values there"),
        (system("top", SOURCE + gain("source")), "has two elements called 'source'"),
        (system("top"), "no component in it: there is nothing to run"),
        (
            system(
                "top",
                system(
                    "a", ports=connector("i", "input") + connector("o", "output"), wires=wire("i", "o")
                ) + gain("g"),
                wires=wire("a.o", "a.i") + wire("a.o", "g.u"),
            ),
            "its signal comes from itself, through connectors only",
        ),
        (
            system("top", gain("g", type="application/x-ssp-package", source="a.ssp")),
            "component 'g' is of type application/x-ssp-package. Only FMUs are read.",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_wired_is_said(fmu: Path, top: str, text: str) -> None:
    with pytest.raises(DescriptionError, match=re.escape(text)):
        read_ssp(package(fmu, top))


def test_a_signal_dictionary_is_not_read(fmu: Path) -> None:
    bus = '<ssd:SignalDictionaryReference name="bus" dictionary="d"/>'
    assert (
        "'bus' is a SignalDictionaryReference, which is not read."
        in read(package(fmu, system("top", SOURCE + bus))).notes
    )
    wired = package(fmu, system("top", SOURCE + bus, wires=wire("source.z", "bus.speed")))
    with pytest.raises(DescriptionError, match="'bus' is a SignalDictionaryReference, which is not read; 'speed'"):
        read_ssp(wired)


def test_the_fmu_knows_the_direction_of_an_inout_connector(fmu: Path) -> None:
    two_way = gain("g").replace('name="u" kind="input"', 'name="u" kind="inout"')
    found = read(package(fmu, system("top", SOURCE + two_way, wires=wire("g.u", "source.z"))))
    assert [str(connection) for connection in found.connections] == ["source.z -> g.u"]
    inner = system("inner", gain("g"), ports=connector("in", "inout"), wires=wire("in", "g.u"))
    with pytest.raises(DescriptionError, match=r"'inner\.in' is an inout connector, which is not read"):
        read_ssp(package(fmu, system("top", SOURCE + inner)))


def test_many_names_are_told_in_part(fmu: Path) -> None:
    notes = read(package(fmu, system("top", "".join(gain(f"g {k}") for k in range(25))))).notes
    assert any(note.endswith("'g 19' is g_19 and 5 more.") for note in notes)


# Connectors that nothing feeds


@pytest.mark.parametrize("level", ["the connector", "the system around it", "both, the outer counts"])
def test_a_connector_that_nothing_feeds_is_a_constant(fmu: Path, level: str) -> None:
    own = {"the system around it": "", "the connector": bound(parameters(**{"in": 7.0}))}.get(
        level, bound(parameters(**{"in": -1.0}))
    )
    outer = "" if level == "the connector" else bound(parameters(inner__in=7.0))
    inner = system(
        "inner", gain("g"), ports=connector("in", "input"), values=own, wires=wire("in", "g.u", linear(2.0, 1.0))
    )
    found = read(package(fmu, system("top", inner, values=outer)))
    assert outputs(found) == {"inner_g.z": 15.0}


def test_of_connectors_in_a_row_the_outermost_value_counts(fmu: Path) -> None:
    inner = system("inner", gain("g"), ports=connector("in", "input"), values=bound(parameters(**{"in": -1.0})),
                   wires=wire("in", "g.u"))  # fmt: skip
    for value, expected in ((bound(parameters(c=7.0)), 7.0), ("", -1.0)):
        top = system("top", inner, ports=connector("c", "input"), values=value, wires=wire("c", "inner.in"))
        assert outputs(read(package(fmu, top))) == {"inner_g.z": expected}


@pytest.mark.parametrize("kind", ["input", "parameter"])
def test_connectors_of_the_top_system_give_constants(fmu: Path, kind: str) -> None:
    name = "u" if kind == "input" else "gain"
    component = gain("g", bound(parameters(**{"u": 1.0, "gain": 1.0})))
    component = component.replace("</ssd:Connectors>", f"{connector('gain', 'parameter')}</ssd:Connectors>", 1)
    top = system(
        "top", component, ports=connector("c", kind), values=bound(parameters(c=4.0)), wires=wire("c", f"g.{name}")
    )
    assert outputs(read(package(fmu, top))) == {"g.z": 4.0}


@pytest.mark.parametrize(
    ("transformation", "more", "value"),
    [
        ("", "", 0.005),
        (linear(2.0, 1.0), "", 1.01),
        ("", 'suppressUnitConversion="true"', 0.5),  # 5 mm are 0.5 in the unit of the connector
        (linear(2.0), 'suppressUnitConversion="true"', 1.0),
    ],
)
def test_constants_are_converted(tmp_path: Path, transformation: str, more: str, value: float) -> None:
    fmu = write_gain(tmp_path, "Gain", "m", "m")
    ports, values = connector("c", "input", "cm"), bound(parameters("Real", "mm", c=5.0))
    wires = wire("c", "g.u", transformation, more)
    found = outputs(read(package(fmu, system("top", gain("g"), ports=ports, values=values, wires=wires))))
    assert found == {"g.z": pytest.approx(value, rel=1e-15)}


def test_what_a_connector_leaves_open_is_noted(fmu: Path) -> None:
    ports = connector("open", "input") + connector("idle", "input")
    top = system("top", SOURCE + gain("g"), ports=ports, values=bound(parameters(idle=1.0)), wires=wire("open", "g.u"))
    notes = read(package(fmu, top)).notes
    assert "nothing feeds 'open', so 'g.u' keeps its own start." in notes
    assert "the value of 'idle' is not used: nothing takes it, or another value comes in." in notes


def test_a_signal_counts_more_than_the_value_of_a_connector(fmu: Path) -> None:
    inner = system("inner", gain("g"), ports=connector("in", "input"), values=bound(parameters(**{"in": 7.0})),
                   wires=wire("in", "g.u"))  # fmt: skip
    found = read(package(fmu, system("top", SOURCE + inner, wires=wire("source.z", "inner.in"))))
    assert outputs(found)["inner_g.z"] == 10.0
    assert any("the value of 'inner.in' is not used" in note for note in found.notes)


# Values


@pytest.mark.parametrize(
    ("top", "value"),
    [
        (system("top", gain("g", bound(parameters(u=1.0, gain=2.0)))), 2.0),
        (system("top", gain("g"), values=bound(parameters(g__u=1.0, g__gain=3.0))), 3.0),
        (system("top", system("s", gain("g"), values=bound(parameters(g__u=1.0, g__gain=4.0)))), 4.0),
        (system("top", system("s", gain("g")), values=bound(parameters(s__g__u=1.0, s__g__gain=5.0))), 5.0),
        (system("top", system("s", gain("g")), values=bound(parameters(u=1.0, gain=6.0), more='prefix="s.g."')), 6.0),
    ],
)
def test_values_may_be_bound_at_any_level(fmu: Path, top: str, value: float) -> None:
    (found,) = outputs(read(package(fmu, top))).values()
    assert found == value


def test_the_outer_value_counts_and_then_the_later(fmu: Path) -> None:
    inner = gain("g", bound(parameters(u=1.0, gain=1.0), parameters(gain=2.0)))
    assert outputs(read(package(fmu, system("top", inner)))) == {"g.z": 2.0}
    middle = system("s", inner, values=bound(parameters(g__gain=3.0)))
    assert outputs(read(package(fmu, system("top", middle)))) == {"s_g.z": 3.0}
    top = system("top", middle, values=bound(parameters(s__g__gain=4.0)))
    assert outputs(read(package(fmu, top))) == {"s_g.z": 4.0}


def test_names_that_lead_nowhere_are_ignored_with_a_note(fmu: Path) -> None:
    found = read(package(fmu, system("top", gain("g"), values=bound(parameters(g__gian=3.0)))))
    assert found.instances[0].start == {}
    assert (
        "parameter values of 'top': nothing there is called 'g.gian'; these values are ignored. Did you mean 'gain'?"
        in found.notes
    )


@pytest.mark.parametrize("external", [False, True])
@pytest.mark.parametrize("prefix", ["", "plant."])
def test_a_mapping_renames_and_transforms(fmu: Path, external: bool, prefix: str) -> None:
    entries = (
        entry(f"{prefix}load", "g.u", linear(2.0, 10.0)),
        entry(f"{prefix}strength", "g.gain", linear(4.0, 5.0)),
        entry(f"{prefix}strength", "h.gain"),
    )
    values = parameters(load=2.0, strength=2.0)
    more = f'prefix="{prefix}"'
    files = {}
    if external:
        files = {"resources/v.ssv": values, "resources/m.ssm": mapping(*entries)}
        inner = '<ssd:ParameterMapping source="resources/m.ssm"/>'
        binding = f'<ssd:ParameterBinding source="resources/v.ssv" {more}>{inner}</ssd:ParameterBinding>'
        bindings = f"<ssd:ParameterBindings>{binding}</ssd:ParameterBindings>"
    else:
        bindings = bound(values, mapping=mapped(*entries), more=more)
    top = system("top", gain("g") + gain("h", bound(parameters(u=1.0))), values=bindings)
    assert outputs(read(package(fmu, top, files=files))) == {"g.z": 14.0 * 13.0, "h.z": 2.0}


def test_names_that_a_mapping_leaves_out_count_as_they_are(fmu: Path) -> None:
    values = bound(parameters(load=2.0, g__gain=3.0), mapping=mapped(entry("load", "g.u"), entry("lead", "g.u")))
    found = read(package(fmu, system("top", gain("g"), values=values)))
    assert outputs(found) == {"g.z": 6.0}
    assert "mapping at 'top': the values hold nothing called 'lead'." in found.notes


@pytest.mark.parametrize(
    ("more", "transformation", "value"),
    [("", "", 0.005), ("", linear(2.0), 0.010), ('suppressUnitConversion="true"', linear(2.0), 10.0)],
)
def test_a_mapping_converts_units_first(tmp_path: Path, more: str, transformation: str, value: float) -> None:
    fmu = write_gain(tmp_path, "Gain", "m", "m")
    values = bound(parameters("Real", "mm", load=5.0), mapping=mapped(entry("load", "g.u", transformation, more)))
    (found,) = outputs(read(package(fmu, system("top", gain("g"), values=values)))).values()
    assert found == pytest.approx(value, rel=1e-15)


def test_a_factor_in_a_mapping_leaves_no_unit(tmp_path: Path) -> None:
    """The connector has no unit, so that nothing says what a factor made of the millimetres."""
    fmu = write_gain(tmp_path, "Gain", "m", "m")
    for transformation, expected in (("", 0.005), (linear(2.0), 10.0)):
        values = bound(parameters("Real", "mm", load=5.0), mapping=mapped(entry("load", "c", transformation)))
        top = system("top", gain("g"), ports=connector("c", "input"), values=values, wires=wire("c", "g.u"))
        assert outputs(read(package(fmu, top))) == {"g.z": pytest.approx(expected, rel=1e-15)}


@pytest.mark.parametrize(("unit", "value"), [("[mm]", 0.005), ("[h]", 2.5), ("[[m]]", 5.0)])
def test_units_in_brackets_are_those_inside(tmp_path: Path, unit: str, value: float) -> None:
    """The set itself says what h is."""
    fmu = write_gain(tmp_path, "Gain", "[m]", "m")
    own = '<ssv:Units><ssc:Unit name="h"><ssc:BaseUnit m="1" factor="0.5"/></ssc:Unit></ssv:Units></ssv:ParameterSet>'
    values = parameters("Real", unit, u=5.0).replace("</ssv:ParameterSet>", own)
    assert outputs(read(package(fmu, system("top", gain("g", bound(values)))))) == {
        "g.z": pytest.approx(value, rel=1e-15)
    }


def table(kind: str, *pairs: tuple[str, str]) -> str:
    rows = "".join(f'<ssc:MapEntry source="{a}" target="{b}"/>' for a, b in pairs)
    return f"<ssc:{kind}MappingTransformation>{rows}</ssc:{kind}MappingTransformation>"


@pytest.mark.parametrize(
    ("kind", "value", "pairs", "start"),
    [
        ("Integer", "3", [("1", "7"), ("3", "2")], {"mode": 2}),
        ("Boolean", "true", [("true", "false"), ("false", "true")], {"flag": False}),
        ("Enumeration", "hoch", [("tief", "low"), ("hoch", "high")], {"mode": 2}),
    ],
)
def test_a_mapping_translates_single_values(
    tmp_path: Path, kind: str, value: str, pairs: list[tuple[str, str]], start: dict[str, object]
) -> None:
    (name,) = start
    variables = [
        Variable("mode", "parameter", 2, "Enumeration", start="1", items=("low", "high")),
        Variable("flag", "parameter", 0, "Boolean", start="true", variability="fixed"),
    ]
    fmu = write_fmu(tmp_path / "Gain.fmu", variables, binary=probe_library().read_bytes())
    values = bound(parameters(kind, x=value), mapping=mapped(entry("x", f"g.{name}", table(kind, *pairs))))
    top = system("top", '<ssd:Component name="g" source="resources/Gain.fmu"/>', values=values)
    assert read(package(fmu, top)).instances[0].start == start
    other = values.replace(f'value="{value}"', f'value="{ {"Integer": "9", "Enumeration": "mitte"}.get(kind, value) }"')
    if kind != "Boolean":
        with pytest.raises(
            DescriptionError, match=f"parameter 'g.{name}': the {kind}MappingTransformation has no entry"
        ):
            read(package(fmu, top.replace(values, other)))


def test_values_may_lie_inside_the_fmu(fmu: Path) -> None:
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.writestr("resources/own.ssv", parameters(u=2.0, gain=4.0))
    inside = '<ssd:ParameterBinding source="resources/{}" sourceBase="component"/>'
    bindings = f"<ssd:ParameterBindings>{inside}</ssd:ParameterBindings>"
    assert outputs(read(package(fmu, system("top", gain("g", bindings.format("own.ssv")))))) == {"g.z": 8.0}
    with pytest.raises(DescriptionError, match=r"file 'resources/no\.ssv' is not in Gain\.fmu"):
        read(package(fmu, system("top", gain("g", bindings.format("no.ssv")))))


@pytest.mark.parametrize(
    ("binding", "text"),
    [
        ('source="resources/no.ssv"', "no file 'resources/no.ssv' in the package. Did you mean 'resources/bad.ssv'?"),
        ('source="https://example.org/a.ssv"', "source 'https://example.org/a.ssv' is not a path inside the package"),
        ('source="../a.ssv"', "source '../a.ssv' is not a path inside the package"),
        ('source="a.csv" type="text/csv"', "type text/csv is not read"),
        ('source="resources/bad.ssv"', "file 'resources/bad.ssv', line 1: "),
    ],
)
def test_values_that_cannot_be_read_are_refused(fmu: Path, binding: str, text: str) -> None:
    values = f"<ssd:ParameterBindings><ssd:ParameterBinding {binding}/></ssd:ParameterBindings>"
    path = package(fmu, system("top", gain("g"), values=values), files={"resources/bad.ssv": "<a>"})
    with pytest.raises(DescriptionError, match=re.escape(f"parameter values of 'top', {text}")):
        read_ssp(path)


# Versions and messages


@pytest.mark.parametrize("version", ["1.0", "1.1", "2.0"])
def test_newer_files_with_what_1_0_has_are_read(fmu: Path, version: str) -> None:
    values = bound(parameters(u=1.0, gain=2.0).replace('"1.0" name="v"', f'"{version}" name="v"'))
    assert outputs(read(package(fmu, system("top", gain("g", values)), version))) == {"g.z": 2.0}


@pytest.mark.parametrize(
    ("version", "text"),
    [
        ("3.0", "line 1: SSP 3.0 is not read. Write it as SSP 1.0."),
        ("one", "line 1: SSP one is not read."),
        ("2.0", "Element 'ssc:Float64': This element is not expected."),
    ],
)
def test_what_the_schema_refuses_is_said_in_words(fmu: Path, version: str, text: str) -> None:
    ports = connector("c", "input").replace("ssc:Real", "ssc:Float64")
    with pytest.raises(DescriptionError) as error:
        read_ssp(package(fmu, system("top", gain("g"), ports=ports), version))
    assert text in str(error.value)
    assert not re.search(r"http:|\[facet|\[\.\]|\\d", str(error.value))
    assert (version == "2.0") == ("SSP 2.0 is read as far as SSP 1.0 goes" in str(error.value))


@pytest.mark.parametrize("version", ["1.0.1", "1.1", "1.0-beta1"])
def test_releases_of_1_0_are_read(fmu: Path, version: str) -> None:
    values = bound(parameters(u=1.0, gain=2.0).replace('"1.0" name="v"', f'"{version}" name="v"'))
    assert outputs(read(package(fmu, system("top", gain("g", values)), version))) == {"g.z": 2.0}


def test_a_draft_of_ssp_is_named(fmu: Path) -> None:
    path = fmu.parent / "draft.ssd"
    space = "http://www.pmsf.net/xsd/SystemStructureDescriptionDraft"
    path.write_text(f'<SystemStructureDescription xmlns="{space}" version="Draft"/>', encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"which is not of SSP 1\.0\. Write it as SSP 1\.0\."):
        read_ssp(path)


def test_known_prefixes_need_no_declaration(fmu: Path) -> None:
    """libcosim reads SSDs whose prefix osp, or ssv in a parameter set, is not declared."""
    algorithm = '<osp:Algorithm><osp:FixedStepAlgorithm baseStepSize="0.25"/></osp:Algorithm>'
    annotation = f'<ssc:Annotation type="com.opensimulationplatform">{algorithm}</ssc:Annotation>'
    values = '<ssv:ParameterSet version="1.0" name="v"><ssv:Parameters><ssv:Parameter name="u"><ssv:Real value="3"/>'
    values += "</ssv:Parameter></ssv:Parameters></ssv:ParameterSet>"
    top = system(
        "top", gain("g", '<ssd:ParameterBindings><ssd:ParameterBinding source="a.ssv"/></ssd:ParameterBindings>')
    )
    top = top.replace("</ssd:System>", f"<ssd:Annotations>{annotation}</ssd:Annotations></ssd:System>")
    found = read_system(package(fmu, top, files={"a.ssv": values}))
    assert (found.steps, outputs(found)) == (4, {"g.z": 3.0})
    assert "prefixes without a declaration have their usual meaning: osp." in found.notes
    assert "file 'a.ssv': prefixes without a declaration have their usual meaning: ssv." in found.notes
    with pytest.raises(DescriptionError, match="not valid XML: Namespace prefix other on Algorithm is not defined"):
        read_ssp(package(fmu, top.replace("osp:", "other:")))


# Files


@pytest.mark.parametrize(
    "source", ["r/G#1.fmu", "r/what?.fmu", "r/100%25.fmu", "r\\G.fmu", "r/Gäin 1.fmu", "r/G%201.FMU"]
)
def test_a_source_may_be_the_plain_path_of_a_file(fmu: Path, source: str) -> None:
    path = package(fmu, system("top", gain("g", bound(parameters(u=3.0)), source=source)))
    with zipfile.ZipFile(path, "a") as archive:
        archive.write(fmu, source.replace("\\", "/"))
    assert outputs(read(path)) == {"g.z": 3.0}


def test_a_file_that_the_package_lacks_is_told_with_the_nearest(fmu: Path) -> None:
    path = package(fmu, system("top", gain("g", source="Resources/gain.fmu")))
    with pytest.raises(
        DescriptionError, match=r"no file 'Resources/gain\.fmu' in the package\. Did you mean 'resources/G"
    ):
        read_ssp(path)


def moved(path: Path, names: dict[str, str]) -> Path:
    """The package with members under other names."""
    target = path.with_name("moved.ssp")
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(target, "w") as archive:
        for name in source.namelist():
            for new in names.get(name, name).split(" "):
                archive.writestr(new, source.read(name))
    return target


@pytest.mark.parametrize(
    "names",
    [
        {"SystemStructure.ssd": "systemstructure.SSD"},
        {"SystemStructure.ssd": "axis.ssd"},
        {"SystemStructure.ssd": "axis/SystemStructure.ssd", "resources/Gain.fmu": "axis/resources/Gain.fmu"},
    ],
)
def test_the_only_description_of_a_package_is_read(fmu: Path, names: dict[str, str]) -> None:
    path = moved(package(fmu, system("top", gain("g", bound(parameters(u=3.0))))), names)
    assert outputs(read(path)) == {"g.z": 3.0}


def test_variants_in_a_package_are_told(fmu: Path) -> None:
    path = package(fmu, system("top", gain("g")))
    found = read_ssp(moved(path, {"SystemStructure.ssd": "SystemStructure.ssd b.ssd"}))
    assert "SystemStructure.ssd is read, not b.ssd. For another, unpack the package and name it." in found.notes
    with pytest.raises(DescriptionError, match=r"no SystemStructure.ssd inside, but a.ssd, b.ssd. Unpack the package"):
        read_ssp(moved(path, {"SystemStructure.ssd": "a.ssd b.ssd"}))


# Names


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("Motor 1", "Motor_1"),
        ("DC-Motor", "DC_Motor"),
        ("x.axis", "x_axis"),
        ("Getriebe-Übersetzung", "Getriebe_Ubersetzung"),
        ("1st", "_1st"),
        ("モーター", "component"),
        ("a -> b", "a_b"),
        ("(left)", "left"),
    ],
)
def test_any_name_is_read(fmu: Path, name: str, plain: str) -> None:
    top = system(
        "top",
        SOURCE + gain(name.replace(">", "&gt;")),
        values=bound(parameters(u=1.0), more=f'prefix="{name.replace(">", "&gt;")}."'),
    )
    found = read(package(fmu, top.replace("a -> b", "a -&gt; b")))
    assert [instance.name for instance in found.instances] == ["source", plain]
    assert f"instances have plain names here: '{name}' is {plain}." in found.notes
    assert found.instances[1].start == {"u": 1.0}


def test_derived_names_are_unique_and_leave_plain_ones_alone(fmu: Path) -> None:
    nested = system("a", gain("b"))
    found = read(package(fmu, system("top", nested + gain("a-b") + gain("a b") + gain("a_b"))))
    assert [instance.name for instance in found.instances] == ["a_b_2", "a_b_3", "a_b_4", "a_b"]


def test_notes_of_the_file_stay_with_a_changed_system(fmu: Path) -> None:
    found = read(package(fmu, system("top", gain("Motor 1"))))
    assert found.changed(stop_time=2.0).notes == found.notes
    assert found.changed({"Motor_1.gain": 2.0}).notes == found.notes


def test_enumerations_of_other_items_are_noted(tmp_path: Path) -> None:
    for name, items in (("A", ("off", "on")), ("B", ("on", "off")), ("C", ("off", "on"))):
        variables = [
            Variable("mode", "input", 0, "Enumeration", start="1", items=items),
            Variable("state", "output", 1, "Enumeration", items=items),
        ]
        write_fmu(tmp_path / f"{name}.fmu", variables, binary=probe_library().read_bytes())
    document: dict[str, Any] = {
        "connections": ["a.state -> b.mode", "a.state -> c.mode"],
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {name.lower(): {"fmu": f"./{name}.fmu"} for name in "ABC"},
    }
    notes = make_system(document, name="modes.toml", folder=tmp_path).notes
    assert notes == ("connection a.state -> b.mode: its numbers choose items of mode: 1 on, 2 off.",)


def test_an_integer_may_choose_the_item_of_an_enumeration(tmp_path: Path) -> None:
    variables = [
        *(v for v in PROBE if v.name in ("count_in", "count")),
        Variable("mode", "input", 0, "Enumeration", start="1", items=("low", "high")),
    ]
    fmu = write_fmu(tmp_path / "Gain.fmu", variables, binary=probe_library().read_bytes())
    parts = "".join(f'<ssd:Component name="{name}" source="resources/Gain.fmu"/>' for name in ("a", "b"))
    values = bound(parameters("Integer", a__count_in=1))
    # the probe takes both inputs for the same one
    chosen, counted = (
        read(package(fmu, system("top", parts, values=values, wires=wire("a.count", f"b.{target}"))))
        for target in ("mode", "count_in")
    )
    assert "connection a.count -> b.mode: its numbers choose items of mode: 1 low, 2 high." in chosen.notes
    assert outputs(chosen) == outputs(counted)
    assert outputs(chosen)["b.count"] != 0.0


# Where FMUs lie


@pytest.mark.parametrize("form", ["../fmus/Gain.fmu", "../fmus/../fmus/Gain.fmu", "file://{folder}/fmus/Gain.fmu"])
def test_an_ssd_may_name_fmus_anywhere(fmu: Path, form: str) -> None:
    for name in ("fmus", "ssd"):
        (fmu.parent / name).mkdir()
    fmu.rename(fmu.parent / "fmus" / "Gain.fmu")
    path = fmu.parent / "ssd" / "SystemStructure.ssd"
    source = form.format(folder=fmu.parent.as_posix())
    path.write_text(description(system("top", gain("g", bound(parameters(u=1.0, gain=2.0)), source=source))))
    assert outputs(read(path)) == {"g.z": 2.0}


@pytest.mark.parametrize("source", ["../Gain.fmu", "resources/../../Gain.fmu", "/Gain.fmu", "file:///Gain.fmu", ""])
def test_a_package_names_fmus_inside_only(fmu: Path, source: str) -> None:
    with pytest.raises(DescriptionError, match=re.escape(f"component 'g': source '{source}' is not a path inside")):
        read_ssp(package(fmu, system("top", gain("g", source=source))))


def test_a_path_that_turns_round_inside_is_read(fmu: Path) -> None:
    read(package(fmu, system("top", gain("g", source="resources/../resources/Gain.fmu"))))


def test_proxies_of_libcosim_run_directly(fmu: Path) -> None:
    found = read(package(fmu, system("top", gain("g", source="proxyfmu://localhost?file=resources/Gain.fmu"))))
    assert "component 'g' is meant for libcosim's proxyfmu; its FMU runs directly here." in found.notes


def test_a_component_for_model_exchange_runs_as_co_simulation(fmu: Path) -> None:
    found = read(package(fmu, system("top", gain("g", implementation="ModelExchange"))))
    assert "component 'g' is meant for model exchange; it runs as co-simulation here." in found.notes


OMS = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"


@pytest.mark.parametrize(
    ("annotation", "step", "order"),
    [
        (f'<oms:FixedStepMaster xmlns:oms="{OMS}" stepSize="0.25"/>', "0.25", "sequential"),
        (f'<osp:FixedStepAlgorithm xmlns:osp="{OSP}" baseStepSize="0.125"/>', "0.125", "parallel"),
    ],
)
def test_steps_of_other_masters_are_read(fmu: Path, annotation: str, step: str, order: str) -> None:
    top = system("top", gain("g")).replace(
        "</ssd:System>",
        f'<ssd:Annotations><ssc:Annotation type="x">{annotation}</ssc:Annotation></ssd:Annotations></ssd:System>',
    )
    found = read_system(package(fmu, top))
    assert (str(found.step_size), found.order) == (step, order)
