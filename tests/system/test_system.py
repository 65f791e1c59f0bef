"""System files and FMU files: what is read from them, and the text of everything that can be wrong."""

from __future__ import annotations

import itertools
import stat
import zipfile
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path

import pytest
from fmu_files import PROBE, Variable, description, library_name, write_fmu, write_zip

from cosim.errors import DescriptionError
from cosim.fmu.description import read_fmu
from cosim.fmu.places import base_name, find_fmus, shipped_file
from cosim.system.system import System, make_system, read_system
from cosim.system.values import parse_value

SOURCE = (Variable("y", "output", 0, unit="m"),)
PLANT = (
    Variable("command", "input", 0, start="0", unit="V"),
    Variable("position", "output", 1, unit="m"),
    Variable("acceleration", "output", 2, unit="m/s2", depends_on=("command",)),
    Variable("mass", "parameter", 3, start="1", unit="kg", min="0.001", max="100"),
    Variable("force", "local", 4, unit="N"),
)
CONTROLLER = (
    Variable("position_ref", "input", 0, start="0", unit="m"),
    Variable("position", "input", 1, start="0", unit="m"),
    Variable("acceleration", "input", 2, start="0", unit="m/s2"),
    Variable("count", "input", 3, "Integer", start="0"),
    Variable("enable", "input", 4, "Boolean", start="true"),
    Variable("command", "output", 5, unit="V", depends_on=("position_ref", "position", "acceleration")),
    Variable("T_s", "parameter", 6, start="0.001", unit="s", min="1e-9"),
    Variable("kind", "parameter", 7, "Enumeration", start="1", items=("sine", "step")),
    Variable("active", "parameter", 8, "Boolean", start="false"),
    Variable("order", "parameter", 9, "Integer", start="2", min="1", max="5"),
    Variable("title", "parameter", 10, "String", start="a"),
    Variable("nct.error[1]", "parameter", 11, start="0"),
    Variable("nct.error[2]", "parameter", 12, start="1"),
    Variable("ready", "output", 13, "Boolean"),
    Variable("hits", "output", 14, "Integer"),
)

GOOD = """
description = "A loop"
connections = [
    "source.y -> controller.position_ref",
    "plant.position -> controller.position",
    { from = "controller.command", to = "plant.command", factor = 2.0, offset = 0.5 },
]
[experiment]
stop_time = 1.0
step_size = 1e-3
[instances.plant]
fmu = "Plant"
start = { mass = 2.5 }
[instances.controller]
fmu = "Controller"
[instances.source]
fmu = "Source"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    fmus = tmp_path / "build" / "fmus" / "native"
    fmus.mkdir(parents=True)
    write_fmu(fmus / "Source.fmu", SOURCE)
    write_fmu(fmus / "Plant.fmu", PLANT)
    write_fmu(fmus / "Controller.fmu", CONTROLLER)
    return tmp_path


@pytest.fixture
def read(folder: Path) -> Callable[..., System]:
    def read_text(text: str = GOOD, /, *changes: tuple[str, str], **arguments: object) -> System:
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = folder / "loop.toml"
        path.write_text(text, encoding="utf-8")
        return read_system(path, **arguments)  # type: ignore[arg-type]

    return read_text


@pytest.fixture
def problems(read: Callable[..., System]) -> Callable[..., tuple[str, ...]]:
    def problems_of(*changes: tuple[str, str], **arguments: object) -> tuple[str, ...]:
        with pytest.raises(DescriptionError) as caught:
            read(GOOD, *changes, **arguments)
        return caught.value.problems

    return problems_of


Problems = Callable[..., tuple[str, ...]]
Read = Callable[..., System]


# What is read


def test_everything_of_the_file_arrives(read: Read) -> None:
    system = read()
    assert system.description == "A loop"
    assert [instance.name for instance in system.instances] == ["plant", "controller", "source"]
    assert system.instance("plant").start == {"mass": 2.5}
    assert [str(connection) for connection in system.connections][2] == "controller.command -> plant.command"
    assert (system.connections[2].factor, system.connections[2].offset) == (2.0, 0.5)
    assert (system.start_time, system.stop_time, system.step_size) == (0, 1, Decimal("0.001"))
    assert system.steps == 1000
    assert system.notes == ()


def test_default_record_is_all_outputs(read: Read) -> None:
    assert read().record == (
        ("plant", "position"),
        ("plant", "acceleration"),
        ("controller", "command"),
        ("controller", "ready"),
        ("controller", "hits"),
        ("source", "y"),
    )


def test_patterns_record_what_varies(read: Read) -> None:
    system = read(record=["plant.*", "*.position", "controller.T_s"], decimation=10)
    assert system.record == (
        ("plant", "command"),
        ("plant", "position"),
        ("plant", "acceleration"),
        ("plant", "force"),
        ("controller", "position"),
        ("controller", "T_s"),
    )
    assert system.decimation == 10


def test_order_is_derived_from_feedthrough(read: Read) -> None:
    """The controller's command depends on its inputs, so the plant comes after it although it is named first."""
    assert read().evaluation_order.index("controller") < read().evaluation_order.index("plant")


def test_instances_that_need_each_other_through_different_variables_come_twice(folder: Path) -> None:
    """x.b needs y, which needs x.from_a, which does not need x.b: no loop, but x is needed before and after y."""
    pair = (
        Variable("a", "input", 0, start="0", unit="m"),
        Variable("b", "input", 1, start="0", unit="m"),
        Variable("from_a", "output", 2, unit="m", depends_on=("a",)),
        Variable("from_b", "output", 3, unit="m", depends_on=("b",)),
    )
    write_fmu(folder / "build/fmus/native/Pair.fmu", pair)
    system = make_system(
        {
            "connections": ["s.y -> x.a", "x.from_a -> y.a", "y.from_a -> x.b"],
            "experiment": {"stop_time": 1, "step_size": 1},
            "instances": {"y": {"fmu": "Pair"}, "x": {"fmu": "Pair"}, "s": {"fmu": "Source"}},
        },
        folder=folder,
    )
    assert system.evaluation_order == ("s", "x", "y", "x")


def test_a_given_order_against_feedthrough_is_a_note(read: Read) -> None:
    system = read(GOOD, ("step_size = 1e-3", 'step_size = 1e-3\norder = ["plant", "controller", "source"]'))
    assert system.evaluation_order == ("plant", "controller", "source")
    assert system.notes == (
        "connection controller.command -> plant.command: one step of delay: controller comes after plant in the "
        "order, and its output depends directly on its inputs. Put controller before plant.",
    )


def test_start_values_of_every_type(read: Read) -> None:
    start = '{ T_s = 2e-3, kind = "step", active = true, order = 3, title = "b", nct.error = [0.5, 0.75] }'
    system = read(GOOD, ('fmu = "Controller"', f'fmu = "Controller"\nstart = {start}'))
    assert system.instance("controller").start == {
        "T_s": 2e-3,
        "kind": 2,
        "active": True,
        "order": 3,
        "title": "b",
        "nct.error[1]": 0.5,
        "nct.error[2]": 0.75,
    }


def test_overrides_replace_start_values(read: Read) -> None:
    values = {"plant.mass": 7, "controller.nct.error": [1, 2], "controller.nct.error[2]": 3.0, "controller.kind": 2}
    system = read(overrides=values)
    assert system.instance("plant").start == {"mass": 7.0}
    assert system.instance("controller").start == {"nct.error[1]": 1.0, "nct.error[2]": 3.0, "kind": 2}
    again = system.changed({"plant.mass": 8.0}, stop_time=2.0)
    assert again.instance("plant").start == {"mass": 8.0}
    assert again.instance("controller").start == system.instance("controller").start
    assert again.steps == 2000


def test_the_digest_stays_where_the_results_stay(read: Read) -> None:
    digest = read().digest
    assert read().digest == digest
    assert read(overrides={"plant.mass": 2.5}).digest == digest
    assert read(GOOD, ("A loop", "The same loop")).digest == digest


NOISY = '{ from = "plant.position", to = "controller.position", noise = { rms = 1e-9, seed = 1 } }'


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("mass = 2.5", "mass = 2.6"),
        ("step_size = 1e-3", "step_size = 5e-4"),
        ("stop_time = 1.0", "stop_time = 2.0"),
        ("[experiment]", '[experiment]\norder = "parallel"'),
        ("[experiment]", "[experiment]\ntolerance = 1e-6"),
        ("[experiment]", "[record]\ndecimation = 2\n[experiment]"),
        ("[experiment]", '[record]\nvariables = ["plant.position"]\n[experiment]'),
        ('fmu = "Controller"', 'fmu = "Controller"\nstep_multiple = 2'),
        ("factor = 2.0", "factor = 3.0"),
        ("offset = 0.5", "offset = 0.0"),
        ('"plant.position -> controller.position"', NOISY),
    ],
)
def test_the_digest_tells_what_decides_the_results(read: Read, old: str, new: str) -> None:
    assert read(GOOD, (old, new)).digest != read().digest


def test_the_digest_tells_the_noise(read: Read) -> None:
    noisy = ('"plant.position -> controller.position"', NOISY)
    changes = (("seed = 1", "seed = 2"), ("1e-9", "2e-9"), ("1e-9", "1e-9"))
    assert len({read(GOOD, noisy, change).digest for change in changes}) == 3


def test_the_digest_tells_the_order_of_a_sum(read: Read) -> None:
    """Sums in another order may differ in the last bit."""
    sums = [
        f'{{ from = ["{first}", "{second}"], to = "controller.position_ref" }}'
        for first, second in itertools.permutations(("source.y", "plant.position"))
    ]
    assert len({read(GOOD, ('"source.y -> controller.position_ref"', entry)).digest for entry in sums}) == 2


def test_values_typed_at_a_prompt() -> None:
    assert parse_value("1e-4") == Decimal("1e-4")
    assert parse_value("true") is True
    assert parse_value("[1, 2]") == [1, 2]
    assert parse_value("sine") == "sine"


def test_base_is_completed_by_the_file(folder: Path) -> None:
    (folder / "base.toml").write_text(GOOD, encoding="utf-8")
    (folder / "variant.toml").write_text(
        'base = "base.toml"\n[experiment]\nstop_time = 2.0\n[instances.plant.start]\nmass = 9\n', encoding="utf-8"
    )
    system = read_system(folder / "variant.toml")
    assert (system.steps, system.instance("plant").start, len(system.connections)) == (2000, {"mass": 9.0}, 3)
    (folder / "base.toml").write_text('base = "variant.toml"', encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"base.toml: base: 'variant.toml' leads back to this file"):
        read_system(folder / "variant.toml")
    (folder / "variant.toml").write_text('base = "../base.toml"', encoding="utf-8")
    with pytest.raises(
        DescriptionError, match=r"base: \"../base.toml\" is no file, and no system that comes with cosim"
    ):
        read_system(folder / "variant.toml")


def test_a_base_in_another_folder_keeps_its_fmus(folder: Path) -> None:
    by_path = GOOD.replace('fmu = "Plant"', 'fmu = "build/fmus/native/Plant.fmu"')
    (folder / "base.toml").write_text(by_path, encoding="utf-8")
    (folder / "out").mkdir()
    text = 'base = "../base.toml"\ninstances.plant.start.mass = 9\n'
    (folder / "out" / "start.toml").write_text(text, encoding="utf-8")
    system = read_system(folder / "out" / "start.toml")
    assert system.instance("plant").start == {"mass": 9.0}
    assert base_name("base.toml", folder / "start.toml") == "base.toml"
    assert base_name(folder / "base.toml", folder / "new" / "start.toml") == "../base.toml"
    assert base_name("shams2010/fsmc_5sin", folder / "start.toml") == "shams2010/fsmc_5sin"
    with pytest.raises(DescriptionError, match=r"base bas.toml: no such file"):
        base_name("bas.toml", folder / "start.toml")


def test_fmu_folder_is_found_upwards(folder: Path) -> None:
    deep = folder / "a" / "b"
    deep.mkdir(parents=True)
    assert find_fmus(deep) == folder / "build" / "fmus" / "native"


@pytest.mark.parametrize(
    ("stop", "step", "steps"),
    [("1.0", "0.1", 10), ("0.3", "0.1", 3), ("1", "1e-7", 10_000_000), ("1.0", "0.0009765625", 1024), ("7", "7", 1)],
)
def test_decimals_divide_exactly(read: Read, stop: str, step: str, steps: int) -> None:
    changes = ("step_size = 1e-3", f"step_size = {step}"), ("stop_time = 1.0", f"stop_time = {stop}")
    assert read(GOOD, *changes, ('fmu = "Controller"', f'fmu = "Controller"\nstart.T_s = {step}')).steps == steps


# What can be wrong in a system file. Each case: what is changed in the good file, and the text that must come.

CASES: dict[str, tuple[list[tuple[str, str]], str]] = {
    "unknown instance in a connection": (
        [('"source.y', '"sorce.y')],
        "connection sorce.y -> controller.position_ref: no instance 'sorce'. Did you mean 'source'?",
    ),
    "unknown input": (
        [("controller.position_ref", "controller.positon")],
        "connection source.y -> controller.positon: Controller has no input 'positon'. Did you mean 'position'?",
    ),
    "unknown output": (
        [('"plant.position', '"plant.positio')],
        "connection plant.positio -> controller.position: Plant has no output 'positio'. Did you mean 'position'?",
    ),
    "an input on the left": (
        [('"source.y ->', '"plant.command ->')],
        "connection plant.command -> controller.position_ref: 'plant.command' is of causality input; the left end "
        "must be an output. Known: position, acceleration.",
    ),
    "a parameter on the right": (
        [('to = "plant.command"', 'to = "plant.mass"')],
        "connection controller.command -> plant.mass: 'plant.mass' is of causality parameter; the right end must be "
        "an input. Known: command.",
    ),
    "an input connected twice": (
        [('"source.y -> controller.position_ref"', '"source.y -> controller.position"')],
        "connection plant.position -> controller.position: input 'controller.position' is connected already, to "
        "'source.y'. Keep one.",
    ),
    "units of different kinds": (
        [('"plant.position -> controller.position"', '"plant.acceleration -> controller.position"')],
        "connection plant.acceleration -> controller.position: unit m/s2 does not match m. To convert, write "
        '{ from = "plant.acceleration", to = "controller.position", factor = ... (m per m/s2) }.',
    ),
    "Integer fed by Real": (
        [("controller.position_ref", "controller.count")],
        "connection source.y -> controller.count: an output of type Real cannot feed an input of type Integer.",
    ),
    "Boolean fed by Integer": (
        [('"source.y -> controller.position_ref"', '"controller.hits -> controller.enable"')],
        "connection controller.hits -> controller.enable: an output of type Integer cannot feed an input of type "
        "Boolean.",
    ),
    "factor to a Boolean": (
        [
            (
                '"source.y -> controller.position_ref"',
                '{ from = "controller.ready", to = "controller.enable", factor=2 }',
            )
        ],
        "connection controller.ready -> controller.enable: factor and offset need an input of type Real, not Boolean.",
    ),
    "connection without arrow": (
        [("source.y -> controller", "source.y - controller")],
        "connections, number 1: cannot read 'source.y - controller.position_ref'. Write it like "
        "'controller.command -> plant.command'.",
    ),
    "connection without variable": (
        [('"source.y ->', '"source ->')],
        "connections, number 1: 'source -> controller.position_ref': write INSTANCE.VARIABLE at both ends.",
    ),
    "factor that is no number": (
        [("factor = 2.0", "factor = nan")],
        "connections, number 3, factor: NaN is not a finite number.",
    ),
    "connection of another kind": (
        [('"source.y -> controller.position_ref"', "7")],
        "connections, number 1: write a text 'a.y -> b.u' or a table { from = ..., to = ... }.",
    ),
    "connection table without end": (
        [('to = "plant.command", ', "")],
        'connections, number 3: give both ends: { from = "a.y", to = "b.u", factor = 1.0, offset = 0.0 }.',
    ),
    "algebraic loop": (
        [('"plant.position -> controller.position"', '"plant.acceleration -> controller.acceleration"')],
        "connections: algebraic loop: ",
    ),
    "missing stop time": (
        [("stop_time = 1.0", "")],
        "experiment.stop_time: missing. Give it in seconds, such as stop_time = 1.0, or --stop-time 1.0.",
    ),
    "stop before start": (
        [("stop_time = 1.0", "stop_time = 1.0\nstart_time = 2.0")],
        "experiment.stop_time: 1.0 s must be after start_time = 2.0 s.",
    ),
    "zero step": ([("step_size = 1e-3", "step_size = 0.0")], "experiment.step_size: 0.0 s must be positive."),
    "negative step": ([("step_size = 1e-3", "step_size = -1e-3")], "experiment.step_size: -0.001 s must be positive."),
    "NaN step": (
        [("step_size = 1e-3", "step_size = nan")],
        "experiment.step_size: NaN is not a finite number of seconds.",
    ),
    "step as text": (
        [("step_size = 1e-3", 'step_size = "1e-3"')],
        'experiment.step_size: "1e-3" is not a finite number of seconds.',
    ),
    "step that does not divide": (
        [("step_size = 1e-3", "step_size = 3e-3")],
        "experiment.step_size: 0.003 s does not divide stop_time - start_time = 1.0 s into whole steps (333.333). "
        "Change step_size, or take stop_time = 0.999 or 1.002.",
    ),
    "step multiple that does not divide": (
        [('fmu = "Plant"', 'fmu = "Plant"\nstep_multiple = 3')],
        "instances.plant.step_multiple: 3 does not divide the 1000 steps of the run.",
    ),
    "step multiple of zero": (
        [('fmu = "Plant"', 'fmu = "Plant"\nstep_multiple = 0')],
        "instances.plant.step_multiple: 0 is not a count. Give a whole number of at least 1.",
    ),
    "sampling time between the steps": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart = { T_s = 1.5e-3 }')],
        "instances.controller: T_s = 0.0015 s against a communication step of 0.001 s: neither is a multiple of the "
        "other, so samples would fall between communication points. Change start.T_s, step_size or step_multiple.",
    ),
    "sampling time against a slower step": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart = { T_s = 4e-3 }\nstep_multiple = 10')],
        "instances.controller: T_s = 0.004 s against a communication step of 0.010 s: neither is a multiple",
    ),
    "unknown order": ([("step_size = 1e-3", 'step_size = 1e-3\norder = "paralel"')], "Did you mean 'parallel'?"),
    "unknown instance in the order": (
        [("step_size = 1e-3", 'step_size = 1e-3\norder = ["plant", "controler", "source"]')],
        "experiment.order: no instance 'controler'. Did you mean 'controller'?",
    ),
    "order that repeats": (
        [("step_size = 1e-3", 'step_size = 1e-3\norder = ["plant", "plant", "controller", "source"]')],
        "experiment.order: instance 'plant' is named 2 times. Name it once.",
    ),
    "order that forgets": (
        [("step_size = 1e-3", 'step_size = 1e-3\norder = ["plant", "controller"]')],
        "experiment.order: instance source is missing. Name every instance.",
    ),
    "order that is no list": (
        [("step_size = 1e-3", "step_size = 1e-3\norder = 3")],
        'experiment.order: give "sequential", "parallel" or a list of all instances.',
    ),
    "tolerance": (
        [("step_size = 1e-3", "step_size = 1e-3\ntolerance = 2.0")],
        "experiment.tolerance: 2.0: give a number between 0 and 1.",
    ),
    "start of an unknown variable": (
        [("mass = 2.5", "mas = 2.5")],
        "instances.plant.start.mas: Plant has no variable 'mas'. Did you mean 'mass'?",
    ),
    "start of an output": (
        [("mass = 2.5", "position = 2.5")],
        "instances.plant.start.position: a continuous output cannot be set. Only parameters, inputs and initial "
        "states can be set.",
    ),
    "start below its minimum": (
        [("mass = 2.5", "mass = 0.0")],
        "instances.plant.start.mass: 0.0 kg is below its minimum 0.001 kg.",
    ),
    "start above its maximum": (
        [("mass = 2.5", "mass = 101")],
        "instances.plant.start.mass: 101 kg is above its maximum 100 kg.",
    ),
    "NaN start": ([("mass = 2.5", "mass = nan")], "instances.plant.start.mass: NaN is not finite. Give a number."),
    "infinite start": (
        [("mass = 2.5", "mass = inf")],
        "instances.plant.start.mass: Infinity is not finite. Give a number.",
    ),
    "text for a number": (
        [("mass = 2.5", 'mass = "heavy"')],
        'instances.plant.start.mass: "heavy" is not a number. The unit is kg.',
    ),
    "Boolean for a number": ([("mass = 2.5", "mass = true")], "instances.plant.start.mass: true is not a number."),
    "number for a Boolean": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart.active = 1')],
        "instances.controller.start.active: 1: give true or false.",
    ),
    "half an Integer": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart.order = 2.5')],
        "instances.controller.start.order: 2.5 is not a whole number.",
    ),
    "a very large Integer": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart.order = 3_000_000_000')],
        "instances.controller.start.order: 3000000000 does not fit Integer, which is -2147483648 to 2147483647.",
    ),
    "unknown item": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart.kind = "sin"')],
        "instances.controller.start.kind: 'sin' is no item of this enumeration. Did you mean 'sine'?",
    ),
    "unknown item number": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart.kind = 3')],
        "instances.controller.start.kind: 3 is no item of this enumeration. Known: sine, step.",
    ),
    "number for a String": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart.title = 3')],
        "instances.controller.start.title: 3 is not a text. Write it in quotes.",
    ),
    "short array": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart.nct.error = [1.0]')],
        "instances.controller.start.nct.error: 1 values for an array of 2 elements.",
    ),
    "number for an array": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart.nct.error = 1.0')],
        "instances.controller.start.nct.error: 1.0 is no list: Controller has an array of 2 elements here.",
    ),
    "bad element of an array": (
        [('fmu = "Controller"', 'fmu = "Controller"\nstart.nct.error = [1.0, nan]')],
        "instances.controller.start.nct.error[2]: NaN is not finite. Give a number.",
    ),
    "missing FMU": (
        [('fmu = "Plant"', 'fmu = "Plnt"')],
        "instances.plant.fmu: no FMU 'Plnt' in ",
    ),
    "missing FMU file": ([('fmu = "Plant"', 'fmu = "other/Plant.fmu"')], "other/Plant.fmu: no such file."),
    "no FMU named": ([('fmu = "Plant"', "")], "instances.plant.fmu: missing. Give the name of an FMU or a path"),
    "bad instance name": (
        [("[instances.source]", '["instances"."my source"]')],
        "instances.my source: an instance's name is made of letters, digits and _, and starts with no digit.",
    ),
    "unknown key": ([("description =", "descripton =")], "descripton: unknown key. Did you mean 'description'?"),
    "unknown key of an experiment": (
        [("stop_time = 1.0", "stop_time = 1.0\nstepsize = 1.0")],
        "experiment.stepsize: unknown key. Did you mean 'step_size'?",
    ),
    "unknown key of an instance": (
        [('fmu = "Plant"', 'fmu = "Plant"\nstarts = {}')],
        "instances.plant.starts: unknown key. Did you mean 'start'?",
    ),
    "start that is no table": ([("start = { mass = 2.5 }", "start = 3")], "instances.plant.start: must be a table"),
    "instance that is no table": (
        [('[instances.source]\nfmu = "Source"', "[instances]\nsource = 3")],
        "instances.source: must be a table: write [instances.source].",
    ),
    "connections that are no list": (
        [("description =", 'connections = "a -> b"\nx ='), ("connections = [", "y = [")],
        'connections: must be a list, such as ["a.y -> b.u"].',
    ),
    "recording an unknown variable": (
        [("[instances.plant]", '[record]\nvariables = ["plant.positio"]\n[instances.plant]')],
        "record.variables: 'plant.positio': Plant has no variable 'positio'. Did you mean 'position'?",
    ),
    "recording an unknown instance": (
        [("[instances.plant]", '[record]\nvariables = ["plan.position"]\n[instances.plant]')],
        "record.variables: 'plan.position': no instance 'plan'. Did you mean 'plant'?",
    ),
    "description that is no text": (
        [('description = "A loop"', "description = 3")],
        "description: must be a text, not 3.",
    ),
    "step with an exponent that fills the memory": (
        [("step_size = 1e-3", "step_size = 1e999999999")],
        "experiment.step_size: 1E+999999999 is not a finite number of seconds.",
    ),
    "step that no machine has": (
        [("step_size = 1e-3", "step_size = 1e-19")],
        "experiment.step_size: a time must be 0 or lie between 1e-18 s and 1000000000000 s.",
    ),
    "more steps than a double counts": (
        [("step_size = 1e-3", "step_size = 1e-17")],
        "experiment.step_size: 1e+17 steps: at most 2^53 can be counted exactly.",
    ),
    "recording nothing": (
        [("[instances.plant]", '[record]\nvariables = ["plant.x*"]\n[instances.plant]')],
        "record.variables: 'plant.x*' matches no input, output or local variable.",
    ),
    "recording a String": (
        [("[instances.plant]", '[record]\nvariables = ["controller.title"]\n[instances.plant]')],
        "record.variables: 'controller.title' is a String; only numbers are recorded.",
    ),
    "record that is no list": (
        [("[instances.plant]", '[record]\nvariables = "plant.*"\n[instances.plant]')],
        'record.variables: must be a list, such as ["plant.position", "controller.*"].',
    ),
    "decimation of a half": (
        [("[instances.plant]", "[record]\ndecimation = 0.5\n[instances.plant]")],
        "record.decimation: 0.5 is not a count. Give a whole number of at least 1.",
    ),
    "decimation beyond the end": (
        [("[instances.plant]", "[record]\ndecimation = 2000\n[instances.plant]")],
        "record.decimation: 2000 is more than the 1000 steps of the run. Take less.",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_problem_is_named(problems: Problems, case: str) -> None:
    changes, text = CASES[case]
    found = problems(*changes)
    assert any(text in problem for problem in found), found
    assert all(problem.startswith("loop.toml: ") for problem in found)


def test_algebraic_loop_is_told_in_the_direction_of_the_signals(problems: Problems) -> None:
    (problem,) = problems(*CASES["algebraic loop"][0])
    cycle = "plant.command -> plant.acceleration -> controller.acceleration -> controller.command"
    turns = {" -> ".join(cycle.split(" -> ")[i:] + cycle.split(" -> ")[: i + 1]) for i in range(4)}
    assert any(f"algebraic loop: {turn}. " in problem for turn in turns), problem
    assert 'order = "parallel" (one step of delay)' in problem


def test_algebraic_loop_may_run_in_parallel(read: Read) -> None:
    loop = CASES["algebraic loop"][0]
    assert read(GOOD, *loop, order="parallel").parallel


def test_dependencies_that_are_not_given_are_all_inputs(folder: Path, read: Read, problems: Problems) -> None:
    plant = (PLANT[0], Variable("position", "output", 1, unit="m", depends_on=None), *PLANT[2:])
    write_fmu(folder / "build/fmus/native/Plant.fmu", plant)
    (problem,) = problems()
    assert "algebraic loop" in problem
    assert read_fmu(folder / "build/fmus/native/Plant.fmu").unstated == {"position"}


def test_all_problems_come_at_once(problems: Problems) -> None:
    found = problems(("mass = 2.5", "mas = 2.5"), ("1e-3", "3e-3"), ("source.y", "sorce.y"), ("A loop", "A loop\ny"))
    assert len(found) == 1  # not TOML: nothing else can be known
    found = problems(
        ("mass = 2.5", "mas = 2.5"), ("1e-3", "3e-3"), ('"source.y', '"sorce.y'), overrides={"plan.mass": 1, "plant": 2}
    )
    assert len(found) == 5


def test_bad_overrides(problems: Problems) -> None:
    assert problems(overrides={"plan.mass": 1}) == (
        "loop.toml: value for plan.mass: no instance 'plan'. Did you mean 'plant'?",
    )
    assert problems(overrides={"mass": 1}) == (
        "loop.toml: value for 'mass': write INSTANCE.VARIABLE, such as plant.m.",
    )
    assert problems(stop_time="soon") == ('loop.toml: experiment.stop_time: "soon" is not a finite number of seconds.',)


def test_a_factor_may_change_the_unit_and_the_remedy_knows_it(folder: Path, read: Read, problems: Problems) -> None:
    source = (Variable("y", "output", 0, unit="mm"),)
    write_fmu(folder / "build/fmus/native/Source.fmu", source)
    (problem,) = problems()
    assert 'To convert, write { from = "source.y", to = "controller.position_ref", factor = 0.001 }.' in problem
    system = read(
        GOOD,
        (
            '"source.y -> controller.position_ref"',
            '{ from = "source.y", to = "controller.position_ref", factor = 1e-3 }',
        ),
    )
    assert system.connections[0].factor == 1e-3


def test_units_written_differently_are_the_same(folder: Path, read: Read) -> None:
    plant = (Variable("command", "input", 0, start="0", unit="kg.m2/(s3.A)"), *PLANT[1:])
    write_fmu(folder / "build/fmus/native/Plant.fmu", plant)
    read(GOOD, ("factor = 2.0, offset = 0.5", "factor = 1.0"))


def test_sampling_time_of_a_source_is_its_own_affair(folder: Path, read: Read) -> None:
    source = (*SOURCE, Variable("T_s", "parameter", 1, start="0.0003", unit="s"))
    write_fmu(folder / "build/fmus/native/Source.fmu", source)
    read()


@pytest.mark.parametrize("sampling", ["1e-3", "5e-4", "4e-3", "0.1", "1e-6"])
def test_sampling_times_that_fit(read: Read, sampling: str) -> None:
    read(GOOD, ('fmu = "Controller"', f'fmu = "Controller"\nstart.T_s = {sampling}'))


def test_files_that_are_not_there(folder: Path) -> None:
    (folder / "loop.toml").write_text(GOOD, encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"lop.toml: no such file. Did you mean 'loop.toml'\?"):
        read_system(folder / "lop.toml")
    with pytest.raises(DescriptionError, match=r"no FMU 'Plant' in .*empty.* The folder has no FMUs: build them"):
        read_system(folder / "loop.toml", fmus=folder / "empty")


def test_no_fmu_folder_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cosim.fmu.places.CHECKOUT", tmp_path)
    monkeypatch.setattr("cosim.fmu.places.PREBUILT", tmp_path / "none")
    (tmp_path / "loop.toml").write_text(GOOD, encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"no FMU folder found for 'Plant'.* name the folder with --fmus"):
        read_system(tmp_path / "loop.toml")


def test_no_instances() -> None:
    with pytest.raises(DescriptionError, match=r"instances: none given. Write \[instances.NAME\]"):
        make_system({"experiment": {"stop_time": 1, "step_size": 1}})


# FMU files


def open_problem(path: Path) -> str:
    with pytest.raises(DescriptionError) as caught:
        read_fmu(path)
    return "\n".join(caught.value.problems)


def test_probe_is_read(tmp_path: Path) -> None:
    fmu = read_fmu(write_fmu(tmp_path / "Probe.fmu", PROBE))
    assert fmu.inputs == ("u", "count_in", "flag_in")
    assert fmu.dependencies["z"] == ("u",)
    assert fmu.dependencies["y"] == ()
    assert fmu.variables["time_constant"].min == 1e-6
    assert fmu.variables["label"].start == "probe"
    assert fmu.library == library_name()


def test_missing_platform_binary(folder: Path, problems: Problems) -> None:
    text = description(PLANT, name="Plant")
    write_zip(folder / "build/fmus/native/Plant.fmu", {"modelDescription.xml": text, "binaries/vax32/probe.so": b""})
    (problem,) = problems()
    assert "Plant.fmu: no binary for this platform (" in problem
    assert "the FMU has: vax32. Build it for this platform" in problem


def test_not_a_zip(tmp_path: Path) -> None:
    path = tmp_path / "Bad.fmu"
    path.write_bytes(b"not a zip")
    assert "Bad.fmu: not a readable zip archive (" in open_problem(path)
    good = write_fmu(tmp_path / "Good.fmu", PROBE, binary=b"x" * 5000).read_bytes()
    path.write_bytes(good[: len(good) // 2])
    assert "Bad.fmu: not a readable zip archive (" in open_problem(path)


def test_damaged_member(tmp_path: Path) -> None:
    path = write_fmu(tmp_path / "Bad.fmu", PROBE, binary=b"abcdefgh" * 500)
    path.write_bytes(path.read_bytes().replace(b"abcdefgh" * 10, b"abcdefgX" * 10))
    assert f"Bad.fmu: '{library_name()}' is damaged" in open_problem(path)


@pytest.mark.parametrize(
    ("member", "text"),
    [
        ("../evil.so", "points outside the archive. Refused."),
        ("resources/../../evil.so", "points outside the archive. Refused."),
        ("/etc/evil.so", "points outside the archive. Refused."),
        ("resources\\..\\..\\evil.so", "points outside the archive. Refused."),
        ("C:/evil.so", "has a colon or null in its name. Refused."),
    ],
)
def test_member_that_leaves_the_archive(tmp_path: Path, member: str, text: str) -> None:
    path = write_zip(tmp_path / "Evil.fmu", {"modelDescription.xml": description(PROBE), member: b"x"})
    assert f"Evil.fmu: archive member {member!r} {text}" in open_problem(path)


def test_symbolic_link(tmp_path: Path) -> None:
    path = write_fmu(tmp_path / "Evil.fmu", PROBE)
    with zipfile.ZipFile(path, "a") as archive:
        link = zipfile.ZipInfo("resources/link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc/passwd")
    assert "'resources/link' is a symbolic link. Refused." in open_problem(path)


def test_huge_member(tmp_path: Path) -> None:
    path = write_fmu(tmp_path / "Huge.fmu", PROBE)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("resources/zeros", bytes(513 * 2**20))
    assert path.stat().st_size < 2**23
    assert "'resources/zeros' would unpack to 513 MiB; at most 512 MiB are allowed." in open_problem(path)


def test_too_much_in_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.fmu.archive.MAX_TOTAL_BYTES", 2**20)
    monkeypatch.setattr("cosim.fmu.archive.MAX_MEMBERS", 5)
    members = {f"resources/{i}": bytes(2**18) for i in range(6)}
    text = open_problem(write_zip(tmp_path / "Huge.fmu", {"modelDescription.xml": description(PROBE), **members}))
    assert "Huge.fmu: would unpack to 2 MiB; at most 1 MiB are allowed." in text
    assert "Huge.fmu: 7 archive members; at most 5 are allowed." in text


def test_member_twice(tmp_path: Path) -> None:
    path = write_fmu(tmp_path / "Twice.fmu", PROBE)
    with pytest.warns(UserWarning, match="Duplicate name"), zipfile.ZipFile(path, "a") as archive:
        archive.writestr("modelDescription.xml", description(PROBE))
    assert "'modelDescription.xml' is there twice, with different content. Refused." in open_problem(path)


def test_no_description(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "Empty.fmu", {"readme.txt": "nothing"})
    assert open_problem(path) == "Empty.fmu: no modelDescription.xml inside. This is not an FMU."


def test_invalid_description(tmp_path: Path) -> None:
    def problem(text: str) -> str:
        return open_problem(write_zip(tmp_path / "Bad.fmu", {"modelDescription.xml": text}))

    good = description(PROBE)
    assert "Bad.fmu: modelDescription.xml: cannot be read: " in problem("<fmiModelDescription")
    assert "Bad.fmu: modelDescription.xml: this is not the description of an FMU." in problem("<a/>")
    assert "causality" in problem(good.replace('causality="input"', 'causality="imput"', 1))


def test_model_exchange_is_no_co_simulation(tmp_path: Path) -> None:
    text = description(PROBE).replace("<CoSimulation ", "<ModelExchange ")
    text = text.replace('canHandleVariableCommunicationStepSize="true"', "")
    fmu = read_fmu(write_zip(tmp_path / "Exchange.fmu", {"modelDescription.xml": text}))
    assert fmu.obstacles == ("only for model exchange. Export it for co-simulation.",)


def test_external_entities_are_not_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("do not tell", encoding="utf-8")
    text = (
        description(PROBE)
        .replace("?>\n", f'?>\n<!DOCTYPE x [<!ENTITY e SYSTEM "{secret.as_uri()}">]>\n', 1)
        .replace("<LogCategories>", "&e;<LogCategories>")
    )
    assert "do not tell" not in open_problem(write_zip(tmp_path / "Evil.fmu", {"modelDescription.xml": text}))


def test_exploding_entities_are_refused(tmp_path: Path) -> None:
    levels = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 20}">' for i in range(8))
    text = description(PROBE).replace("?>\n", f'?>\n<!DOCTYPE x [<!ENTITY e0 "ha">{levels}]>\n', 1)
    text = text.replace('guid="probe"', 'guid="&e8;"')
    assert "cannot be read" in open_problem(write_zip(tmp_path / "Evil.fmu", {"modelDescription.xml": text}))


def test_one_instance_a_process(folder: Path, problems: Problems) -> None:
    path = folder / "build/fmus/native/Plant.fmu"
    write_fmu(path, PLANT, attributes='canBeInstantiatedOnlyOncePerProcess="true"')
    (problem,) = problems(
        ('[instances.source]\nfmu = "Source"', '[instances.source]\nfmu = "Source"\n[instances.p2]\nfmu = "Plant"')
    )
    assert problem == "loop.toml: instances.p2: Plant allows one instance a process; plant is one already."


def test_changed_file_is_not_unpacked(tmp_path: Path) -> None:
    path = write_fmu(tmp_path / "Probe.fmu", PROBE)
    fmu = read_fmu(path)
    write_fmu(path, PROBE, binary=b"other")
    with pytest.raises(DescriptionError, match="changed after it was read"):
        fmu.extract(tmp_path / "out")


def test_only_what_runs_here_is_unpacked(tmp_path: Path) -> None:
    members = {
        "modelDescription.xml": description(PROBE),
        library_name(): b"here",
        "binaries/vax32/probe.so": b"elsewhere",
        "resources/a/data.txt": b"data",
        "sources/probe.c": b"source",
    }
    fmu = read_fmu(write_zip(tmp_path / "Probe.fmu", members))
    library = fmu.extract(tmp_path / "out")
    assert library.read_bytes() == b"here"
    files = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert files == {library_name(), "resources/a/data.txt"}


def test_files_that_come_with_cosim_are_found_by_name(
    tmp_path: Path, native: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = shipped_file("shams2010/fsmc_5sin")
    assert found.parts[-3:] == ("studies", "shams2010", "fsmc_5sin.toml")
    assert found.is_file()
    assert shipped_file("studies/shams2010/fsmc_5sin.toml") == found
    assert shipped_file("studies/maeda2008/sweeps/gain_friction.toml").is_file()
    assert read_system("shams2010/fsmc_5sin", fmus=native).steps == 100000
    for own in ("shams2010/nothing", "nothing.toml", "shams2010", str(tmp_path / "shams2010" / "fsmc_5sin.toml")):
        assert shipped_file(own) == Path(own)
    mine = tmp_path / "studies" / "shams2010"
    mine.mkdir(parents=True)
    (mine / "fsmc_5sin.toml").write_text("")
    assert shipped_file("studies/shams2010/fsmc_5sin.toml") == Path("studies/shams2010/fsmc_5sin.toml")
