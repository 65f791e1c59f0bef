"""The page of the runtime contract says what built FMUs do: legal calls and transitions are measured."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy.fmi2 import FMU2Model, FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Model, FMU3Slave

from cosim.export import contract
from cosim.export.contract import Fmi
from docs.generate.contract import CALLS, TRANSITIONS, WITHOUT_STATE, legal, shown, write

NOTHING = [ctypes.c_void_p(0)] * 12
"""Arguments of a call whose legality is asked for: an FMU looks at the state first."""
ROUTES: dict[str, Sequence[str]] = {
    "INSTANTIATED": [],
    "INITIALIZATION": ["EnterInitializationMode"],
    "STEP_COMPLETE": ["EnterInitializationMode", "ExitInitializationMode"],
    "STEP_FAILED": ["EnterInitializationMode", "ExitInitializationMode", "a step that fails"],
    "EVENT_MODE": ["EnterInitializationMode", "ExitInitializationMode"],
    "CONTINUOUS_TIME": ["EnterInitializationMode", "ExitInitializationMode", "EnterContinuousTimeMode"],
    "TERMINATED": ["EnterInitializationMode", "ExitInitializationMode", "Terminate"],
    "FAILED": ["ExitInitializationMode"],
}
"""State -> the calls that lead to it."""
EXCHANGE = ("EVENT_MODE", "CONTINUOUS_TIME")


class Driven:
    """An instance of an FMU that is driven by raw calls; messages are collected."""

    def __init__(self, folder: Path, name: str, fmi: Fmi, *, exchange: bool, events: bool) -> None:
        self.fmi, self.messages = fmi, list[str]()
        description = fmpy.read_model_description(folder)
        kinds = {(2, False): FMU2Slave, (2, True): FMU2Model, (3, False): FMU3Slave, (3, True): FMU3Model}
        token = description.guid if fmi == 2 else description.instantiationToken
        options = {"guid": token, "unzipDirectory": str(folder), "modelIdentifier": name, "instanceName": "driven"}
        self.fmu: Any = kinds[fmi, exchange](**options)
        self.command = next((v.valueReference for v in description.modelVariables if v.name == "command"), 0)
        if fmi == 2:
            self.log = fmi2CallbackLoggerTYPE(lambda _e, _n, _s, _c, text: self.messages.append(text.decode()))
            self.fmu.instantiate(callbacks=fmi2CallbackFunctions(logger=self.log), loggingOn=True)
        elif exchange:
            self.fmu.instantiate(logMessage=self._said, loggingOn=True)
        else:
            self.fmu.instantiate(logMessage=self._said, loggingOn=True, eventModeUsed=events)

    def _said(self, _environment: object, _status: int, _category: bytes, text: bytes) -> None:
        self.messages.append(text.decode())

    def call(self, function: str, *arguments: Any) -> int:
        raw = self.fmu.dll[f"fmi{self.fmi}{function}"]
        raw.restype = ctypes.c_int
        return raw(ctypes.c_void_p(self.fmu.component), *arguments)

    def go(self, function: str) -> None:
        """A call with the arguments that it needs."""
        if function in ("a step that fails", "DoStep"):
            self.fmu.setReal([self.command], [1e308]) if self.fmi == 2 else self.fmu.setFloat64([self.command], [1e308])
            times = [ctypes.c_double(0.0), ctypes.c_double(1e-3), ctypes.c_int(1)]
            flags = [ctypes.byref(ctypes.c_double()) for _ in range(4)] if self.fmi == 3 else []
            self.call("DoStep", *times, *flags)
        elif function == "EnterInitializationMode" and self.fmi == 3:
            no, zero = ctypes.c_bool(False), ctypes.c_double(0.0)
            self.call(function, no, zero, zero, no, zero)
        else:
            self.call(function)

    def refused(self, function: str) -> bool:
        """Whether a call is refused for the state of the instance."""
        self.messages.clear()
        self.call(function, *NOTHING)
        return any("not allowed in state" in text for text in self.messages)

    def state(self) -> str:
        """The state, as the message of a refused call names it."""
        if not self.refused("ExitInitializationMode"):
            return contract.PHASES["INITIALIZATION"]
        (found,) = re.findall(r"not allowed in state '(.+?)'", self.messages[0])
        return found


@pytest.fixture(scope="module")
def unpacked(native: Path, fmi3: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[Fmi, str], Path]:
    files = {(fmi, name): folder for fmi, folder in ((2, native), (3, fmi3)) for name in ("BallscrewStage", "PPi")}
    places: dict[tuple[Fmi, str], Path] = {}
    for (fmi, name), folder in files.items():
        place = tmp_path_factory.mktemp(f"{name}{fmi}")
        fmpy.extract(folder / f"{name}.fmu", unzipdir=str(place))
        places[2 if fmi == 2 else 3, name] = place
    return places


@contextmanager
def driven(
    unpacked: dict[tuple[Fmi, str], Path], fmi: Fmi, state: str, *, exchange: bool = False, events: bool = False
) -> Iterator[Driven]:
    """An instance in a state: for model exchange if the state asks for it, or with event mode in a co-simulation."""
    name = "PPi" if events else "BallscrewStage"
    exchange = not events and (exchange or state in EXCHANGE)
    instance = Driven(unpacked[fmi, name], name, fmi, exchange=exchange, events=events)
    try:
        for function in ROUTES[state]:
            instance.go(function)
        yield instance
    finally:
        instance.fmu.freeInstance()


def exported(fmi: Fmi) -> set[str]:
    """All functions of the interface."""
    header = Path(contract.__file__).with_name("runtime") / f"fmi{fmi}.h"
    return set(re.findall(rf"#define fmi{fmi}(\w+) FMI{fmi}_NAME", header.read_text(encoding="utf-8")))


@pytest.mark.parametrize("fmi", [2, 3])
def test_every_function_is_a_call_of_one_kind(fmi: Fmi) -> None:
    listed = [name for names in CALLS[fmi].values() for name in names]
    assert len(listed) == len(set(listed))
    assert set(listed) == {name for name in exported(fmi) if not name.startswith(WITHOUT_STATE)}


@pytest.mark.parametrize("state", ROUTES)
@pytest.mark.parametrize("fmi", [2, 3])
def test_calls_are_legal_where_the_page_says(unpacked: dict[tuple[Fmi, str], Path], fmi: Fmi, state: str) -> None:
    with driven(unpacked, fmi, state) as instance:
        assert instance.state() == contract.PHASES[state]
    for kind, states in legal(fmi).items():
        for function in CALLS[fmi][kind]:
            with driven(unpacked, fmi, state) as instance:
                assert instance.refused(function) == (state not in states), function


@pytest.mark.parametrize("transition", TRANSITIONS, ids=lambda t: f"{t.start} {t.function}")
@pytest.mark.parametrize("fmi", [2, 3])
def test_calls_lead_where_the_page_says(unpacked: dict[tuple[Fmi, str], Path], fmi: Fmi, transition: Any) -> None:
    if fmi not in transition.fmi:
        with driven(unpacked, fmi, transition.start) as instance:
            assert transition.function not in exported(fmi) or instance.refused(transition.function)
        return
    # Event mode within a co-simulation is for controllers of FMI 3.0: such an instance begins in it.
    events = transition.fmi == (3,)
    exchange = transition.end == "EVENT_MODE"
    start = "EVENT_MODE" if events else transition.start
    with driven(unpacked, fmi, start, exchange=exchange, events=events) as instance:
        if events and transition.start == "STEP_COMPLETE":
            instance.go("EnterStepMode")
        instance.go(transition.function)
        assert instance.state() == contract.PHASES[transition.end]


def test_a_message_is_shown_without_its_conversions() -> None:
    assert shown("%s: %s = %.17g %s: below its minimum %lu.") == "…: … = … …: below its minimum …."


def test_the_page_is_filled(tmp_path: Path) -> None:
    source = Path(__file__).resolve().parents[2] / "docs" / "reference" / "fmu-contract.md"
    page = tmp_path / "reference" / "fmu-contract.md"
    page.parent.mkdir()
    page.write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
    write(tmp_path)
    text = page.read_text(encoding="utf-8")
    assert not re.search("^% ", text, re.MULTILINE)
    assert text.count("\n* ") >= len(contract.MESSAGES) + len(TRANSITIONS)
    assert "`canGetAndSetFMUstate`" in text
    assert "`canGetAndSetFMUState`" in text
