"""What an importer may do to an FMU: link several, hand over broken memory, damage states, set absurd values."""

from __future__ import annotations

import ctypes
import math
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy.fmi2 import fmi2CallbackAllocateMemoryTYPE, fmi2CallbackFreeMemoryTYPE
from instances import DISCARD, ERROR, OK, Instance
from test_fmi3 import Instance as Instance3

from cosim.export import contract

HEADERS = Path(fmpy.__file__).parent / "c-code"
FLAVOURS = ("native", "python")


def compiler(*arguments: object, language: Sequence[str] = ("cc", "-std=c99")) -> None:
    """Run the compiler that makes FMUs, every warning an error."""
    command = [sys.executable, "-m", "ziglang", *language, "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    done = subprocess.run([*command, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def sources(path: Path, folder: Path) -> Path:
    """The unpacked sources of an FMU."""
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder, [member for member in archive.namelist() if member.startswith("sources/")])
    return folder / "sources"


# ---- sources ----

TWO_FMUS = """
#include <stdio.h>
#define {upper}_EXPORT
#include "{header}"
#undef {lower}GetVersion
const char *PPi_{lower}GetVersion(void);
const char *Trajectory_{lower}GetVersion(void);
int main(void) {{ printf("%s %s", PPi_{lower}GetVersion(), Trajectory_{lower}GetVersion()); return 0; }}
"""


@pytest.mark.parametrize(("flavour", "lower", "version"), [("native", "fmi2", "2.0"), ("fmi3", "fmi3", "3.0")])
def test_two_fmus_link_into_one_program(
    request: pytest.FixtureRequest, tmp_path: Path, flavour: str, lower: str, version: str
) -> None:
    folder: Path = request.getfixturevalue(flavour)
    objects: list[Path] = []
    for name in ("PPi", "Trajectory"):
        place = sources(folder / f"{name}.fmu", tmp_path / name)
        objects.append(tmp_path / f"{name}.o")
        compiler("-c", f"-D{lower.upper()}_FUNCTION_PREFIX={name}_", place / "model.c", "-o", objects[-1])
    main = tmp_path / "main.c"
    main.write_text(TWO_FMUS.format(lower=lower, upper=lower.upper(), header=f"{lower}.h"))
    compiler(f"-I{tmp_path / 'PPi' / 'sources'}", main, *objects, "-lm", "-o", tmp_path / "both")
    done = subprocess.run([str(tmp_path / "both")], capture_output=True, text=True, check=True)
    assert done.stdout == f"{version} {version}"


THREE_FMUS = """
#include <stdio.h>
#define FMI2_EXPORT
#define FMI3_EXPORT
#include "fmi2.h"
#include "fmi3.h"
fmi2Component Plant_fmi2Instantiate(fmi2String, fmi2Type, fmi2String, fmi2String, const fmi2CallbackFunctions *,
                                    fmi2Boolean, fmi2Boolean);
fmi2Component Control_fmi2Instantiate(fmi2String, fmi2Type, fmi2String, fmi2String, const fmi2CallbackFunctions *,
                                      fmi2Boolean, fmi2Boolean);
fmi3Instance Third_fmi3InstantiateCoSimulation(
    fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean, fmi3Boolean, fmi3Boolean, const fmi3ValueReference[],
    size_t, fmi3InstanceEnvironment, fmi3LogMessageCallback, fmi3IntermediateUpdateCallback);
int main(void) {
    const fmi2CallbackFunctions none = {NULL, NULL, NULL, NULL, NULL};
    const int plant = Plant_fmi2Instantiate("a", fmi2CoSimulation, "GUID_0", NULL, &none, 0, 0) != NULL;
    const int control = Control_fmi2Instantiate("b", fmi2CoSimulation, "GUID_1", NULL, &none, 0, 0) != NULL;
    const int third =
        Third_fmi3InstantiateCoSimulation("c", "GUID_2", NULL, 0, 0, 0, 0, NULL, 0, NULL, NULL, NULL) != NULL;
    printf("%d %d %d", plant, control, third);
    return 0;
}
"""


def test_sources_compiled_as_cpp_link_with_others_into_a_c_program(native: Path, fmi3: Path, tmp_path: Path) -> None:
    """A plant in FMI 2.0 and 3.0 and a controller, all from sources that a C++ compiler took."""
    program = THREE_FMUS
    objects: list[Path] = []
    fmus = ((native, "BallscrewStage", "FMI2", "Plant"), (native, "PPi", "FMI2", "Control"))
    for k, (folder, name, upper, prefix) in enumerate((*fmus, (fmi3, "BallscrewStage", "FMI3", "Third"))):
        place = sources(folder / f"{name}.fmu", tmp_path / prefix)
        objects.append(tmp_path / f"{prefix}.o")
        compiler(
            *("-c", f"-D{upper}_FUNCTION_PREFIX={prefix}_", "-x", "c++", place / "model.c", "-o", objects[-1]),
            language=("c++", "-std=c++11"),
        )
        guid = fmpy.read_model_description(folder / f"{name}.fmu").guid
        program = program.replace(f"GUID_{k}", str(guid))
    main = tmp_path / "main.c"
    main.write_text(program)
    headers = [f"-I{tmp_path / prefix / 'sources'}" for prefix in ("Plant", "Third")]
    compiler(*headers, main, *objects, "-lm", "-o", tmp_path / "three")
    done = subprocess.run([str(tmp_path / "three")], capture_output=True, text=True, check=True)
    assert done.stdout == "1 1 1"


@pytest.mark.parametrize("name", ["BallscrewStage", "PPi"])
@pytest.mark.parametrize(("flavour", "lower"), [("native", "fmi2"), ("fmi3", "fmi3")])
def test_functions_are_those_of_the_standards_headers(
    request: pytest.FixtureRequest, tmp_path: Path, flavour: str, lower: str, name: str
) -> None:
    """Compiled with the headers that FMPy carries in place of ours, every prototype must agree."""
    upper = lower.upper()
    place = sources(request.getfixturevalue(flavour) / f"{name}.fmu", tmp_path)
    text = (place / "model.c").read_text()
    (place / "model.c").write_text(f'#include "{lower}Functions.h"\n#define {upper}_H\n#define {upper}_EXPORT\n{text}')
    compiler("-c", "-isystem", HEADERS, place / "model.c", "-o", tmp_path / "model.o")
    declared = set(re.findall(rf"{lower}\w+TYPE\s+({lower}\w+);", (HEADERS / f"{lower}Functions.h").read_text()))
    defined = set(re.findall(rf"#define ({lower}\w+) {upper}_NAME", (place / f"{lower}.h").read_text()))
    assert defined == declared


def test_description_says_that_the_hosts_memory_is_not_used(native: Path) -> None:
    description = fmpy.read_model_description(native / "BallscrewStage.fmu")
    assert description.coSimulation.canNotUseMemoryManagementFunctions
    assert description.modelExchange.canNotUseMemoryManagementFunctions


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_broken_memory_functions_of_the_host_do_no_harm(request: pytest.FixtureRequest, flavour: str) -> None:
    """Addresses cut to 32 bits, as one importer gives them."""
    freed: list[int] = []
    fmu = Instance(request.getfixturevalue(flavour) / "PPi.fmu")
    fmu.callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(lambda _n, _size: 0x1234)
    fmu.callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(lambda address: freed.append(address or 0))
    with fmu:
        fmu.initialize()
        fmu.step(0.0, 1e-4)
        state = fmu.fmu.getFMUstate()
        fmu.fmu.freeFMUstate(state)
    assert freed == []


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("name", [b"Achse \xfc", b"\xed\xa0\x80", b"100 %n%s", b"n" * 100_000])
def test_any_instance_name_is_taken(request: pytest.FixtureRequest, flavour: str, name: bytes) -> None:
    """Hosts of other times do not name instances in UTF-8."""
    fmu = Instance(request.getfixturevalue(flavour) / "PPi.fmu")
    instantiate = fmu.fmu.dll["fmi2Instantiate"]
    instantiate.restype = ctypes.c_void_p
    resources = (Path(fmu.folder.name) / "resources").as_uri().encode()
    guid = fmu.description.guid.encode()
    fmu.fmu.component = instantiate(name, 1, guid, resources, ctypes.byref(fmu.callbacks), 0, 0)
    assert fmu.fmu.component
    fmu.initialize()
    fmu.step(0.0, 1e-4)
    fmu.__exit__()


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_message_is_harmless_as_a_format(request: pytest.FixtureRequest, flavour: str) -> None:
    """Some importers hand the message to printf."""
    with Instance(request.getfixturevalue(flavour) / "PPi.fmu") as fmu:
        names = (ctypes.c_char_p * 1)(b"%s%n")
        assert fmu.status("SetDebugLogging", 1, ctypes.c_size_t(1), names) == ERROR
        assert "#s#n" in fmu.messages[-1]


# ---- fixed parameters set again ----


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize(
    ("name", "variable", "other"),
    [
        ("BallscrewStage", "m", 60.0),
        ("PPi", "velocity_source", 1),
        ("Trajectory", "kind", 2),
        ("NctfPi", "nct.error[2]", 0.5),
    ],
)
def test_fixed_parameter_may_be_set_again_to_its_value(
    request: pytest.FixtureRequest, flavour: str, name: str, variable: str, other: float
) -> None:
    with Instance(request.getfixturevalue(flavour) / f"{name}.fmu") as fmu:
        fmu.initialize()
        fmu.step(0.0, 1e-4)
        (value,) = fmu.get([variable])
        assert value != other
        assert fmu.set_status(variable, value) == OK
        fmu.step(1e-4, 1e-4)
        assert fmu.set_status(variable, other) == ERROR
        assert f"{variable} is a fixed parameter" in fmu.messages[-1]


def test_fixed_parameter_may_be_set_again_in_fmi3(fmi3: Path) -> None:
    with Instance3(fmi3 / "BallscrewStage.fmu") as fmu:
        fmu.initialize()
        fmu.fmu.doStep(0.0, 1e-4)
        (mass,) = fmu.get(["m"])
        fmu.set({"m": mass})
        with pytest.raises(Exception, match="fmi3SetFloat64"):
            fmu.set({"m": mass + 1.0})
        assert "m is a fixed parameter" in fmu.messages[-1]


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("step_first", [False, True])
def test_start_value_of_the_tolerance_may_be_set_again(
    request: pytest.FixtureRequest, flavour: str, step_first: bool
) -> None:
    """The importer gave the experiment another tolerance, which stays; another value is refused."""
    with Instance(request.getfixturevalue(flavour) / "BallscrewStage.fmu") as fmu:
        fmu.initialize(tolerance=1e-6)
        if step_first:
            fmu.step(0.0, 1e-4)
        assert fmu.set_status("tolerance", float(fmu.variables["tolerance"].start)) == OK
        assert fmu.get(["tolerance"]) == [1e-6]
        assert fmu.set_status("tolerance", 1e-7) == ERROR


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_tolerance_that_the_importer_set_is_fixed_to_that_value(request: pytest.FixtureRequest, flavour: str) -> None:
    with Instance(request.getfixturevalue(flavour) / "BallscrewStage.fmu") as fmu:
        fmu.initialize({"tolerance": 1e-7}, tolerance=1e-6)
        assert fmu.set_status("tolerance", 1e-7) == OK
        assert fmu.set_status("tolerance", float(fmu.variables["tolerance"].start)) == ERROR


# ---- FMU states ----


def refused_flips(fmu: Instance, serial: bytes, every: int) -> int:
    """The number of single flipped bits that were refused, of one in ``every``; none may be accepted."""
    buffer = ctypes.create_string_buffer(serial, len(serial))
    target = ctypes.c_void_p()
    refused = 0
    for bit in range(0, 8 * len(serial), every):
        buffer[bit // 8] = bytes([serial[bit // 8] ^ 1 << bit % 8])
        status = fmu.status("DeSerializeFMUstate", buffer, ctypes.c_size_t(len(serial)), ctypes.byref(target))
        assert status == ERROR, f"bit {bit}"
        assert "state of this FMU" in fmu.messages[-1]
        fmu.messages.clear()
        refused += 1
        buffer[bit // 8] = serial[bit // 8]
    assert fmu.status("DeSerializeFMUstate", buffer, ctypes.c_size_t(len(serial)), ctypes.byref(target)) == OK
    return refused


@pytest.mark.parametrize(("flavour", "every"), [("native", 1), ("python", 7)])
@pytest.mark.parametrize("name", ["BallscrewStage", "PPi"])
def test_every_flipped_bit_of_a_serialized_state_is_refused(
    request: pytest.FixtureRequest, flavour: str, every: int, name: str
) -> None:
    with Instance(request.getfixturevalue(flavour) / f"{name}.fmu") as fmu:
        fmu.initialize()
        fmu.step(0.0, 1e-4)
        serial = bytes(fmu.fmu.serializeFMUstate(fmu.fmu.getFMUstate()))
        assert refused_flips(fmu, serial, every) >= 8 * len(serial) // every


def test_every_flipped_bit_is_refused_in_fmi3(fmi3: Path) -> None:
    with Instance3(fmi3 / "PPi.fmu") as fmu:
        fmu.initialize()
        serial = bytes(fmu.fmu.serializeFMUState(fmu.fmu.getFMUState()))
        target = ctypes.c_void_p()
        for bit in range(8 * len(serial)):
            spoiled = bytearray(serial)
            spoiled[bit // 8] ^= 1 << bit % 8
            content = bytes(spoiled)
            status = fmu.status("DeserializeFMUState", content, ctypes.c_size_t(len(content)), ctypes.byref(target))
            assert status == ERROR, f"bit {bit}"


def test_cut_off_state_is_refused(native: Path) -> None:
    with Instance(native / "PPi.fmu") as fmu:
        serial = bytes(fmu.fmu.serializeFMUstate(fmu.fmu.getFMUstate()))
        target = ctypes.c_void_p()
        for size in (0, 1, 40, len(serial) - 1):
            status = fmu.status("DeSerializeFMUstate", serial, ctypes.c_size_t(size), ctypes.byref(target))
            assert status == ERROR


def test_a_state_of_another_fmu_is_refused_though_never_serialized(native: Path) -> None:
    with Instance(native / "PPi.fmu") as one, Instance(native / "BallscrewStage.fmu") as other:
        one.initialize()
        assert other.status("SetFMUstate", one.fmu.getFMUstate()) == ERROR
        assert "this is no state of BallscrewStage" in other.messages[-1]


# ---- values that overflow ----


def stepped(fmu: Instance, values: dict[str, float], inputs: dict[str, float], steps: int, step: float) -> int:
    """The worst status of initialization, steps and reading outputs; what is read with OK is finite."""
    fmu.fmu.setupExperiment()
    if any(fmu.set_status(name, value) != OK for name, value in values.items()):
        return DISCARD
    fmu.fmu.enterInitializationMode()
    worst = fmu.status("ExitInitializationMode")
    references = (ctypes.c_uint * 1)()
    value = (ctypes.c_double * 1)()
    for k in range(steps if worst == OK else 0):
        for name, given in inputs.items():
            worst = max(worst, fmu.set_status(name, given * (k % 3)))
        worst = max(worst, fmu.step_status(k * step, step))
        for name in fmu.names("output"):
            references[0] = fmu.reference(name)
            status = fmu.status("GetReal", references, ctypes.c_size_t(1), value)
            assert status != OK or math.isfinite(value[0]), f"{name} = {value[0]} with OK"
            worst = max(worst, status)
        if worst > OK:
            break
    return worst


ABSURD: dict[str, tuple[str, dict[str, float], dict[str, float]]] = {
    "milling force": ("MillingForce", {"K_n": 1e308, "axial_depth": 1e10}, {}),
    "trajectory frequency": ("Trajectory", {"frequency": 1e300}, {}),
    "trajectory amplitude": ("Trajectory", {"amplitude": 1e300, "frequency": 1e10}, {}),
    "stage gain": ("BallscrewStage", {"m": 1e-3}, {"command": 1e308}),
    "milling edge": ("MillingForce", {"h_min": 1.7e308}, {}),
    "controller gain": ("PPi", {"K_v": 1e200, "K_p": 1e200}, {"position_ref": 1e10}),
    "motor": ("LinearMotor", {}, {"command": 1e308}),
}


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("case", ABSURD)
def test_never_ok_with_a_value_that_is_not_finite(request: pytest.FixtureRequest, flavour: str, case: str) -> None:
    name, values, inputs = ABSURD[case]
    with Instance(request.getfixturevalue(flavour) / f"{name}.fmu") as fmu:
        known = {n: v for n, v in values.items() if n in fmu.variables}
        if stepped(fmu, known, inputs, 20, 1e-3) != OK:
            assert re.search("finite|minimum|maximum|too many steps|too small", fmu.messages[0]), fmu.messages


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_output_that_overflows_is_discarded_with_its_name(request: pytest.FixtureRequest, flavour: str) -> None:
    """The acceleration of 1e300 m at 1e10 Hz is beyond the range of doubles."""
    with Instance(request.getfixturevalue(flavour) / "Trajectory.fmu") as fmu:
        values = {"amplitude": 1e300, "frequency": 1e10}
        assert stepped(fmu, values, {}, 3, 1e-3) in (DISCARD, ERROR)
        assert re.search(r"(\w+ is not finite|the initial \w+ is not finite|maximum)", fmu.messages[0])


# ---- the contract ----


def called(text: str) -> set[str]:
    """Names of the messages that a C source uses."""
    return set(re.findall(r"\bSAY_(\w+)", text))


def test_every_message_of_the_contract_is_used_and_none_stands_twice() -> None:
    runtime = Path(contract.__file__).with_name("runtime")
    texts = [path.read_text() for path in sorted(runtime.glob("*.c"))]
    assert set().union(*map(called, texts)) == set(contract.MESSAGES)
    own = [*texts, *(path.read_text() for path in sorted((runtime.parent / "python").glob("*.[cp]*")))]
    for name, text in contract.MESSAGES.items():
        longest = max(re.split(r"%[.\d]*l?[a-z]|\{\w+\}", text), key=len)
        assert len(longest) < 12 or not any(longest in source for source in own), name


@pytest.mark.parametrize("fmi", [2, 3])
def test_header_has_legal_calls_of_its_version(fmi: contract.Fmi) -> None:
    found = {name: int(bits) for name, bits in re.findall(r"#define MAY_(\w+) (\d+)", contract.header(fmi))}
    assert found == {**contract.LEGAL, **(contract.LEGAL_3 if fmi == 3 else {})}
    other = "fmi3" if fmi == 2 else "fmi2"
    words = [line for line in contract.header(fmi).splitlines() if "NEVER_PENDING" not in line]
    assert not any(f"{other}Get" in line or f"{other}Warning" in line for line in words)


@pytest.mark.parametrize(("flavour", "word"), [("native", "fmi2"), ("fmi3", "fmi3")])
def test_log_categories_speak_of_their_version(request: pytest.FixtureRequest, flavour: str, word: str) -> None:
    with zipfile.ZipFile(request.getfixturevalue(flavour) / "PPi.fmu") as archive:
        text = archive.read("modelDescription.xml").decode()
    found = dict(re.findall(r'<Category name="(\w+)" description="([^"]*)"', text))
    assert found == contract.categories(2 if word == "fmi2" else 3)
    assert word in found["logStatusDiscard"]


REFUSALS: dict[str, Callable[[Instance], Any]] = {
    "value": lambda f: (f.initialize(), f.set_status("command_max", math.nan)),
    "minimum": lambda f: f.set_status("command_max", -1.0),
    "fixed": lambda f: (f.initialize(), f.set_status("T_s", 1.0)),
    "computed": lambda f: f.set_status("command", 1.0),
    "phase": lambda f: f.step_status(0.0, 1e-4),
    "point": lambda f: (f.initialize(), f.step_status(0.5, 1e-4)),
    "step": lambda f: (f.initialize(), f.step_status(0.0, -1.0)),
    "samples": lambda f: (f.initialize(), f.step_status(0.0, 1e6)),
    "type": lambda f: (
        f.initialize(),
        f.status("GetInteger", (ctypes.c_uint * 1)(f.reference("T_s")), ctypes.c_size_t(1), (ctypes.c_int * 1)()),
    ),
    "reference": lambda f: (
        f.initialize(),
        f.status("GetReal", (ctypes.c_uint * 1)(999), ctypes.c_size_t(1), (ctypes.c_double * 1)()),
    ),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_flavours_refuse_with_the_same_words(native: Path, python: Path, case: str) -> None:
    said: list[str] = []
    for folder in (native, python):
        with Instance(folder / "PPi.fmu") as fmu:
            REFUSALS[case](fmu)
            said.append(fmu.messages[-1])
    assert said[0] == said[1]


# ---- small changes of the runtime that must be seen ----


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("name", ["BallscrewStage", "CompliantBallscrew"])
def test_tunable_parameter_acts_from_the_step_it_is_set_at(
    request: pytest.FixtureRequest, flavour: str, name: str
) -> None:
    """Set after initialization, before the first step, it is as good as set before."""
    traces: dict[str, list[list[float]]] = {}
    path: Path = request.getfixturevalue(flavour) / f"{name}.fmu"
    for case, before, after in (("before", 3.0, 3.0), ("after", 1.0, 3.0), ("never", 1.0, 1.0)):
        with Instance(path) as fmu:
            fmu.initialize({"friction_scale": before})
            fmu.set({"friction_scale": after, "command": 12.0})
            rows = traces[case] = []
            for k in range(20):
                fmu.step(k * 1e-4, 1e-4)
                rows.append(fmu.get(fmu.names("output")))
    assert traces["after"] == traces["before"] != traces["never"]


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("name", ["PPi", "LinearMotor", "Trajectory"])
def test_no_step_goes_past_the_stop_time(request: pytest.FixtureRequest, flavour: str, name: str) -> None:
    with Instance(request.getfixturevalue(flavour) / f"{name}.fmu") as fmu:
        fmu.fmu.setupExperiment(startTime=0.0, stopTime=0.01)
        fmu.fmu.enterInitializationMode()
        fmu.fmu.exitInitializationMode()
        t = 0.0
        for _ in range(100):  # added up, the last point is not exactly 0.01
            fmu.step(t, 1e-4)
            t += 1e-4
        assert fmu.step_status(t, 1e-4) == ERROR
        assert "behind the stop time 0.01" in fmu.messages[-1]


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_one_step_may_not_jump_over_the_stop_time(request: pytest.FixtureRequest, flavour: str) -> None:
    with Instance(request.getfixturevalue(flavour) / "LinearMotor.fmu") as fmu:
        fmu.fmu.setupExperiment(startTime=0.0, stopTime=0.01)
        fmu.fmu.enterInitializationMode()
        fmu.fmu.exitInitializationMode()
        assert fmu.step_status(0.0, 0.01001) == ERROR


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_step_to_an_output_that_overflows_is_discarded(request: pytest.FixtureRequest, flavour: str) -> None:
    """A step of 1e308 m with 1e308 m added, after 2.5 ms: finite before, beyond the range of doubles then."""
    with Instance(request.getfixturevalue(flavour) / "Trajectory.fmu") as fmu:
        fmu.initialize({"kind": 1, "amplitude": 1e308, "offset": 1e308, "start_time": 2.5e-3, "dwell": 1.0})
        fmu.step(0.0, 1e-3)
        fmu.step(1e-3, 1e-3)
        assert fmu.step_status(2e-3, 1e-3) == DISCARD
        assert "fmi2DoStep: position is not finite at t = 0.003" in fmu.messages[-1]
        assert fmu.fmu.getRealStatus(2) == 2e-3
