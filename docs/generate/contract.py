"""The page of the runtime contract: states, legal calls, messages and capabilities of the FMUs.

Texts and legal states come from ``cosim.export.contract``, from which FMUs are built. Which functions are calls of
which kind, and to which state they lead, is said here; a test measures both on built FMUs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from cosim.export import contract
from cosim.export.contract import Fmi
from cosim.export.fmi2_xml import model_description
from cosim.export.fmi3_xml import model_description3
from cosim.export.trace import trace
from fmus.controllers.p_pi import PPi
from fmus.plant.ballscrew_stage import BallscrewStage

from .markup import found_by, literal, markdown

COMMON: Mapping[str, Sequence[str]] = {
    "SET_LOGGING": ["SetDebugLogging"],
    "ENTER_INITIALIZATION": ["EnterInitializationMode"],
    "EXIT_INITIALIZATION": ["ExitInitializationMode"],
    "STEP": ["DoStep"],
    "TERMINATE": ["Terminate"],
    "RESET": ["Reset"],
    "ENTER_EVENT_MODE": ["EnterEventMode"],
    "ENTER_CONTINUOUS_TIME": ["EnterContinuousTimeMode"],
    "COMPLETE_STEP": ["CompletedIntegratorStep"],
    "SET_CONTINUOUS": ["SetTime", "SetContinuousStates"],
    "GET_NOMINALS": ["GetNominalsOfContinuousStates"],
}
_TYPES_2 = ("Real", "Integer", "Boolean", "String")
_TYPES_3 = (
    *("Float32", "Float64", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
    *("Boolean", "String", "Binary", "Clock"),
)

CALLS: Mapping[Fmi, Mapping[str, Sequence[str]]] = {
    2: {
        **COMMON,
        "SET_UP": ["SetupExperiment"],
        "GET": [*(f"Get{kind}" for kind in _TYPES_2), "GetRealOutputDerivatives"],
        "SET": [*(f"Set{kind}" for kind in _TYPES_2), "SetRealInputDerivatives"],
        "ASK_STATUS": [f"Get{kind}Status" for kind in ("", *_TYPES_2)],
        "HANDLE_STATE": [
            *("GetFMUstate", "SetFMUstate", "FreeFMUstate"),
            *("SerializedFMUstateSize", "SerializeFMUstate", "DeSerializeFMUstate"),
        ],
        "DIFFERENTIATE": ["GetDirectionalDerivative"],
        "UPDATE_DISCRETE_STATES": ["NewDiscreteStates"],
        "GET_CONTINUOUS": ["GetContinuousStates", "GetDerivatives", "GetEventIndicators"],
        "CALL": ["CancelStep"],
    },
    3: {
        **COMMON,
        "GET": [f"Get{kind}" for kind in _TYPES_3],
        "SET": [f"Set{kind}" for kind in _TYPES_3],
        "HANDLE_STATE": [
            *("GetFMUState", "SetFMUState", "FreeFMUState"),
            *("SerializedFMUStateSize", "SerializeFMUState", "DeserializeFMUState"),
        ],
        "DIFFERENTIATE": ["GetDirectionalDerivative", "GetAdjointDerivative"],
        "UPDATE_DISCRETE_STATES": ["UpdateDiscreteStates", "EvaluateDiscreteStates"],
        "ENTER_STEP_MODE": ["EnterStepMode"],
        "GET_CONTINUOUS": ["GetContinuousStates", "GetContinuousStateDerivatives", "GetEventIndicators"],
        "CALL": [
            *("GetNumberOfContinuousStates", "GetNumberOfEventIndicators", "GetOutputDerivatives"),
            *("EnterConfigurationMode", "ExitConfigurationMode", "ActivateModelPartition"),
            *("GetNumberOfVariableDependencies", "GetVariableDependencies"),
            *(f"{what}{part}" for what in ("GetInterval", "GetShift") for part in ("Decimal", "Fraction")),
            *(f"{what}{part}" for what in ("SetInterval", "SetShift") for part in ("Decimal", "Fraction")),
        ],
    },
}
"""Kind of call -> its functions, without fmi2 or fmi3 before the name."""

WITHOUT_STATE = ("Instantiate", "FreeInstance", "GetVersion", "GetTypesPlatform")
"""Beginnings of functions that need no instance, or end it."""


class Transition(NamedTuple):
    """A call that leads from one state to another, and the line that draws it."""

    start: str
    function: str
    end: str
    fmi: Sequence[Fmi]
    line: str
    """The path of the line in SVG."""
    at: tuple[int, int]
    """Where the text beside the line begins."""


LEFT, MIDDLE, RIGHT, WIDE, HIGH = 92, 230, 368, 150, 34
PLACES: Mapping[str, tuple[int, int]] = {
    "INSTANTIATED": (MIDDLE, 24),
    "INITIALIZATION": (MIDDLE, 104),
    "STEP_COMPLETE": (LEFT, 204),
    "EVENT_MODE": (RIGHT, 204),
    "STEP_FAILED": (LEFT, 304),
    "CONTINUOUS_TIME": (RIGHT, 304),
    "TERMINATED": (MIDDLE, 404),
    "FAILED": (MIDDLE, 484),
}
"""The middle of the box of each state in the diagram."""
BOTH: Sequence[Fmi] = (2, 3)
TRANSITIONS = (
    Transition("INSTANTIATED", "EnterInitializationMode", "INITIALIZATION", BOTH, "M230 41V85", (238, 68)),
    Transition("INITIALIZATION", "ExitInitializationMode", "STEP_COMPLETE", BOTH, "M190 121L112 185", (2, 142)),
    Transition("INITIALIZATION", "ExitInitializationMode", "EVENT_MODE", BOTH, "M270 121L348 185", (324, 142)),
    Transition("STEP_COMPLETE", "EnterEventMode", "EVENT_MODE", (3,), "M167 199H291", (184, 193)),
    Transition("EVENT_MODE", "EnterStepMode", "STEP_COMPLETE", (3,), "M293 209H169", (188, 223)),
    Transition("STEP_COMPLETE", "DoStep", "STEP_FAILED", BOTH, "M92 221V285", (98, 250)),
    Transition("EVENT_MODE", "EnterContinuousTimeMode", "CONTINUOUS_TIME", BOTH, "M334 221V285", (180, 262)),
    Transition("CONTINUOUS_TIME", "EnterEventMode", "EVENT_MODE", BOTH, "M352 287V223", (357, 248)),
    Transition("STEP_COMPLETE", "Terminate", "TERMINATED", BOTH, "M17 204H6V404H153", (14, 397)),
    Transition("STEP_FAILED", "Terminate", "TERMINATED", (2,), "M125 321L196 385", (92, 362)),
    Transition("CONTINUOUS_TIME", "Terminate", "TERMINATED", BOTH, "M335 321L264 385", (312, 362)),
    Transition("EVENT_MODE", "Terminate", "TERMINATED", BOTH, "M443 204H454V404H307", (390, 397)),
)
"""The calls that change the state. A refused call leads to ``FAILED`` from every state, a reset to ``INSTANTIATED``."""
LABELS = {
    ("INITIALIZATION", "STEP_COMPLETE"): ("ExitInitializationMode", "(co-simulation)"),
    ("INITIALIZATION", "EVENT_MODE"): ("ExitInitializationMode", "(model exchange)"),
    ("STEP_COMPLETE", "STEP_FAILED"): ("DoStep", "that fails"),
    ("EVENT_MODE", "CONTINUOUS_TIME"): ("EnterContinuousTimeMode",),
}
"""Texts beside lines that say more than the function."""


def write(folder: Path) -> None:
    """Fill ``reference/fmu-contract.md``."""
    page = folder / "reference" / "fmu-contract.md"
    parts = {
        "diagram": diagram(),
        "transitions": "\n".join(f"* {_said(transition)}" for transition in TRANSITIONS),
        "calls": "\n".join(_calls(fmi) for fmi in BOTH),
        "categories": _listed({literal(name): _both(text) for name, text in contract.CATEGORIES.items()}),
        "limits": _limits(),
        "messages": _messages(),
        "reasons": "\n".join(f"* {markdown(text)}" for text in contract.REASONS.values()),
        "capabilities": _capabilities(),
    }
    text = page.read_text(encoding="utf-8")
    page.write_text(re.sub(r"^% (\w+)$", lambda found: parts[found[1]], text, flags=re.MULTILINE), encoding="utf-8")


def legal(fmi: Fmi) -> Mapping[str, Sequence[str]]:
    """Kind of call -> the names of the states in which it is legal."""
    bits = {**contract.LEGAL, **(contract.LEGAL_3 if fmi == 3 else {})}
    kinds = CALLS[fmi]
    return {kind: [name for k, name in enumerate(contract.PHASES) if bits[kind] & 1 << k] for kind in kinds}


def diagram() -> str:
    """The states and the calls that change them, as SVG within the page."""
    said = "; ".join(map(_said, TRANSITIONS))
    lines = [
        '<svg class="states" role="img" aria-labelledby="states-title states-text" viewBox="0 0 460 506">',
        "<title id='states-title'>States of an FMU and the calls that change them</title>",
        f"<desc id='states-text'>{escape(said)}.</desc>",
        '<defs><marker id="arrow" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">',
        '<path d="M0 0L8 4L0 8z" fill="currentColor"/></marker></defs>',
    ]
    for state, (x, y) in PLACES.items():
        lines.append(f'<rect x="{x - WIDE // 2}" y="{y - HIGH // 2}" width="{WIDE}" height="{HIGH}" rx="6"/>')
        lines.append(f'<text x="{x}" y="{y + 4}" text-anchor="middle">{escape(contract.PHASES[state])}</text>')
    for t in TRANSITIONS:
        dashes = "" if len(t.fmi) == 2 else ' stroke-dasharray="5 3"'
        lines.append(f'<path d="{t.line}" marker-end="url(#arrow)"{dashes}/>')
        for k, label in enumerate(LABELS.get((t.start, t.end), (t.function,))):
            lines.append(f'<text class="call" x="{t.at[0]}" y="{t.at[1] + 13 * k}">{escape(label)}</text>')
    lines.append('<text class="call" x="230" y="452" text-anchor="middle">any call that is refused:</text>')
    return "\n".join(["```{raw} html", *lines, "</svg>", "```"])


def _said(transition: Transition) -> str:
    """A transition in words."""
    start, end = contract.PHASES[transition.start], contract.PHASES[transition.end]
    function = " ".join(LABELS.get((transition.start, transition.end), (transition.function,)))
    only = "" if len(transition.fmi) == 2 else f", in FMI {transition.fmi[0]}.0 only"
    return f"{function}: from {start} to {end}{only}"


def _calls(fmi: Fmi) -> str:
    lines = [f"### FMI {fmi}.0", ""]
    for kind, states in legal(fmi).items():
        names = [f"fmi{fmi}{name}" for name in CALLS[fmi][kind]]
        where = "every state" if len(states) == len(contract.PHASES) else ", ".join(contract.PHASES[s] for s in states)
        lines += [found_by(*names), ", ".join(map(literal, names)), f": {where}", ""]
    return "\n".join(lines)


def _listed(entries: Mapping[str, str]) -> str:
    return "\n".join(f"{name}\n: {text}\n" for name, text in entries.items())


def _both(text: str) -> str:
    """A text in the words of FMI 2.0, and of FMI 3.0 where these differ."""
    two, three = (contract.worded(text, fmi) for fmi in BOTH)
    return markdown(two) if two == three else f"{markdown(two)} (FMI 3.0: {markdown(three)})"


def _limits() -> str:
    words = {"ATTEMPTS": "attempts of the integrator", "SAMPLES": "samples of a controller"}
    return "\n".join(f"* {number:,} {words[name]}" for name, number in contract.LIMITS.items())


def shown(text: str) -> str:
    """A message with dots in place of its values."""
    return re.sub(r"%(\.\d+)?l?[a-z]", "…", text)


def _messages() -> str:
    """All messages in the words of FMI 2.0 and of FMI 3.0 where these differ, without the function in front."""
    lines: list[str] = []
    for text in contract.MESSAGES.values():
        two, three = (shown(contract.worded(text, fmi)).removeprefix("…: ") for fmi in BOTH)
        other = "" if two == three else f"\n  FMI 3.0: {markdown(three)}"
        lines.append(f"* {markdown(two)}{other}")
    return "\n".join(lines)


def _capabilities() -> str:
    """The attributes of the interfaces in the model descriptions of a plant and of a controller."""
    lines: list[str] = []
    for fmi, title in ((2, "FMI 2.0"), (3, "FMI 3.0")):
        lines += [f"### {title}", ""]
        known: dict[str, dict[str, str]] = {}
        for owner, kind, value in _attributes(fmi):
            known.setdefault(kind, {})[owner] = value
        for name, values in known.items():
            said = set(values.values())
            text = (
                literal(said.pop())
                if len(said) == 1
                else "; ".join(f"{owner}: {literal(value)}" for owner, value in values.items())
            )
            lines += [f"{found_by(name)}\n{literal(name)}\n: {text}\n"]
    return "\n".join(lines)


def _attributes(fmi: int) -> Iterator[tuple[str, str, str]]:
    for owner, component in (("plants", BallscrewStage), ("controllers", PPi)):
        traced = trace(component)
        content = model_description(traced, "", "0", sources=()) if fmi == 2 else model_description3(traced, "", "0")
        root = ElementTree.fromstring(content)
        for element, where in (("CoSimulation", "co-simulation"), ("ModelExchange", "model exchange")):
            found = root.find(element)
            if found is not None:
                for name, value in found.attrib.items():
                    if name != "modelIdentifier":
                        yield f"{owner}, {where}", name, value
