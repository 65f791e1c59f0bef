"""What native and Python FMUs have in common: phases, legal calls, log categories, limits, messages.

The native runtime takes them from ``contract.h``, which ``header`` writes at build time; the Python flavour takes them
from here. This module needs the standard library only, as it travels inside Python FMUs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Literal

Fmi = Literal[2, 3]
"""Major version of the interface."""

OK, WARNING, DISCARD, ERROR = range(4)
"""Status codes; the numbers are those of FMI."""

CATEGORIES: Mapping[str, str] = {
    "logStatusWarning": "Messages with status {fmi}Warning",
    "logStatusDiscard": "Messages with status {fmi}Discard: a value or a step was refused",
    "logStatusError": "Messages with status {fmi}Error: a call was wrong; logged also when logging is off",
    "logAll": "All messages",
}
"""Log category -> its description: first the categories of the statuses 1 to 3, then the one of all messages."""

PHASES: Mapping[str, str] = {
    "INSTANTIATED": "instantiated",
    "INITIALIZATION": "initialization mode",
    "STEP_COMPLETE": "step complete",
    "STEP_FAILED": "step failed",
    "TERMINATED": "terminated",
    "FAILED": "error",
    "EVENT_MODE": "event mode",
    "CONTINUOUS_TIME": "continuous-time mode",
}
"""Phase of an instance -> its name in messages. Each phase is one bit; the first is 1."""

(
    INSTANTIATED,
    INITIALIZATION,
    STEP_COMPLETE,
    STEP_FAILED,
    TERMINATED,
    FAILED,
    EVENT_MODE,
    CONTINUOUS_TIME,
) = (1 << k for k in range(len(PHASES)))

BEFORE = INSTANTIATED | INITIALIZATION
EXCHANGE = EVENT_MODE | CONTINUOUS_TIME
EVALUATED = INITIALIZATION | STEP_COMPLETE | STEP_FAILED | EXCHANGE
"""Phases in which a call that reads values first computes them anew."""
ANY = (1 << len(PHASES)) - 1

LEGAL: Mapping[str, int] = {
    "SET_LOGGING": ANY,
    "SET_UP": INSTANTIATED,
    "ENTER_INITIALIZATION": INSTANTIATED,
    "EXIT_INITIALIZATION": INITIALIZATION,
    "GET": EVALUATED | TERMINATED | FAILED,
    "SET": BEFORE | STEP_COMPLETE | EXCHANGE,
    "STEP": STEP_COMPLETE,
    "ASK_STATUS": STEP_COMPLETE | STEP_FAILED | TERMINATED,
    "TERMINATE": STEP_COMPLETE | STEP_FAILED | EXCHANGE,
    "RESET": ANY,
    "HANDLE_STATE": ANY,
    "DIFFERENTIATE": EVALUATED | TERMINATED | FAILED,
    "ENTER_EVENT_MODE": CONTINUOUS_TIME,
    "UPDATE_DISCRETE_STATES": EVENT_MODE,
    "ENTER_CONTINUOUS_TIME": EVENT_MODE,
    "ENTER_STEP_MODE": EVENT_MODE,
    "COMPLETE_STEP": CONTINUOUS_TIME,
    "SET_CONTINUOUS": EXCHANGE,
    "GET_CONTINUOUS": INITIALIZATION | EXCHANGE | TERMINATED | FAILED,
    "GET_NOMINALS": BEFORE | EXCHANGE | TERMINATED | FAILED,
    "CALL": ANY,
}
"""Kind of call -> the phases in which FMI 2.0 allows it."""

LEGAL_3: Mapping[str, int] = {
    "GET": ANY,
    "TERMINATE": STEP_COMPLETE | EXCHANGE,
    "ENTER_EVENT_MODE": STEP_COMPLETE | CONTINUOUS_TIME,
}
"""Where FMI 3.0 differs."""

LIMITS: Mapping[str, int] = {"ATTEMPTS": 1_000_000, "SAMPLES": 10_000_000}
"""Most attempts of the integrator, and most samples of a controller, in one communication step.

Both limits stand for seconds of work: a step that needs more ends with an error instead of seeming to hang.
"""

MESSAGES: Mapping[str, str] = {
    # phases and arguments
    "NOT_ALLOWED": "%s: not allowed in state '%s'. Follow the {standard} calling sequence, or reset the instance.",
    "NULL_ARGUMENT": "%s: an argument is NULL. Pass an array of %lu elements.",
    "OUT_OF_MEMORY": "%s: out of memory.",
    "UNKNOWN_CATEGORY": "%s: unknown category '%s'. Use those of modelDescription.xml.",
    # life cycle
    "NO_NAME": "%s: the instance name is empty. Give one.",
    "WRONG_TOKEN": "%s: {token} is '%s', this FMU has '%s'. Use the modelDescription.xml of this FMU.",
    "CO_SIMULATION_ONLY": "%s: this is a co-simulation FMU. Instantiate it for co-simulation.",
    "NO_SCHEDULED_EXECUTION": "%s: there is no scheduled execution. Call fmi3InstantiateCoSimulation.",
    "NO_EVENT_MODE": "%s: there is no event mode (hasEventMode is false). Pass eventModeUsed = false.",
    "NO_INTERMEDIATE_UPDATE": "%s: there is no intermediate update. Pass no requiredIntermediateVariables.",
    "WRONG_TIMES": "%s: start time %g s, stop time %g s: give finite times, stop after start.",
    "WRONG_TOLERANCE": "%s: tolerance %g: give a positive number.",
    "BROKEN_RULES": "%s: %s",
    "INITIAL_NOT_FINITE": "%s: the initial %s is not finite. Check parameters and inputs.",
    "NOTE": "%s: %s = %.4g %s is above %s = %.4g %s: %s",
    "NO_EVENT_MODE_USED": "%s: the instance was made with eventModeUsed = false. Stay in step mode.",
    # values
    "UNKNOWN_REFERENCE": "%s: unknown value reference %u. %s has 0 to %d, see modelDescription.xml.",
    "WRONG_TYPE": "%s: %s (value reference %u) is of type %s. Use {fmi}Get%s or {fmi}Set%s.",
    "WRONG_NUMBER": "%s: %lu values, but the variables have %lu elements. Pass one for each.",
    "FIXED": "%s: %s is a fixed parameter. Set it before initialization ends.",
    "COMPUTED": "%s: %s is computed by the FMU. Set inputs and parameters only.",
    "TUNABLE_IN_CONTINUOUS_TIME": "%s: %s is a tunable parameter. Set it in event mode.",
    "NOT_FINITE": "%s: %s = %g %s: must be finite. The previous value %g is kept.",
    "BELOW_MINIMUM": "%s: %s = %.17g %s: below its minimum %.17g %s. The previous value %g is kept.",
    "ABOVE_MAXIMUM": "%s: %s = %.17g %s: above its maximum %.17g %s. The previous value %g is kept.",
    "BREAKS_RULE": "%s: %s = %g %s: %s The previous value %g is kept.",
    "RESULT_NOT_FINITE": "%s: %s is not finite at t = %.17g s. Check inputs and parameters.",
    "NO_INPUT_DERIVATIVES": "%s: inputs are held over a step (canInterpolateInputs is false). Pass none.",
    "NO_OUTPUT_DERIVATIVES": "%s: not provided (maxOutputDerivativeOrder is 0). Ask for none.",
    # FMU state
    "NO_STATE": "%s: this is no state of %s. Pass one that the same FMU gave.",
    "OTHER_KIND": "%s: the state is that of an instance for %s. Use one of the same kind.",
    "FEW_BYTES": "%s: %lu bytes are too few. Give %lu, as the function for their number says.",
    "NO_STATE_BYTES": "%s: these %lu bytes are no state of this FMU. Pass what the same FMU on the same platform "
    "serialized.",
    "DAMAGED_BYTES": "%s: these %lu bytes are a damaged state of this FMU, their checksum is wrong. Pass them as they "
    "were serialized.",
    # derivatives and model exchange
    "NO_UNKNOWN": "%s: %s is no unknown variable. Differentiate outputs and state derivatives.",
    "NO_KNOWN": "%s: %s is no known variable. Differentiate with respect to inputs and continuous states.",
    "ONE_EACH": "%s: %lu values for %lu variables. Pass one for each.",
    "WRONG_LENGTH": "%s: an array of %lu elements, but %s has %lu. Pass one of that length.",
    "TIME_NOT_FINITE": "%s: %g s. Give a finite time.",
    "STATES_NOT_FINITE": "%s: %s = %g: must be finite. The previous states are kept.",
    "DERIVATIVE_NOT_FINITE": "%s: %s is not finite at t = %.17g s. Check inputs and states, or take a smaller step.",
    "FOR_MODEL_EXCHANGE": "%s: the instance is one for model exchange. Enter continuous-time mode.",
    "FOR_CO_SIMULATION": "%s: the instance is one for co-simulation. Enter step mode.",
    "NO_CLOCK": "%s: there are no clocks, a sampling instant is an event.",
    "NO_DEPENDENCIES": "%s: providesPerElementDependencies is false, see ModelStructure.",
    "NO_STRUCTURE": "%s: there are no structural parameters.",
    # steps
    "STEP_SIZE": "%s: communication step size %g s. Give a positive, finite one.",
    "WRONG_POINT": "%s: current communication point %.17g s, but the instance is at %.17g s. Continue where the last "
    "step ended, or set an FMU state.",
    "BEHIND_STOP": "%s: the step ends at %.17g s, behind the stop time %.17g s given before. Set a later stop time "
    "or none.",
    "TOO_MANY_SAMPLES": "%s: the step of %g s holds %g samples of T_s = %g s, but one step may hold %d. Take shorter "
    "steps, or a longer T_s.",
    "SAMPLE_NOT_FINITE": "%s: %s is not finite at the sample t = %.17g s. Check inputs and parameters.",
    "STOPPED": "%s: integration with tolerance %g stopped at t = %.17g s, at %s: %s",
    "NO_STEP_IN_PROGRESS": "%s: no step is in progress, a step is done when its call returns.",
    "ONLY_STATUS": "%s: only %s is known.",
    "NEVER_PENDING": "%s: fmi2DoStep never returns fmi2Pending, there is no such status.",
}
"""Name of a message -> its text, with conversions that printf and Python's ``%`` share; the function comes first."""

REASONS: Mapping[str, str] = {
    "STEP_TOO_SMALL": "the step size became too small. Check inputs and parameters, or make the tolerance larger.",
    "TOO_MANY_STEPS": "too many steps. Check inputs and parameters, or make the communication step shorter.",
    "NOT_FINITE": "a derivative is not finite. Check inputs and parameters, or make the tolerance smaller.",
}
"""Why an integration stopped, and what to do.

With a tolerance below about 1e-11 the rounding of the equations fails the error test. A large tolerance lets a step
reach states at which the equations overflow.
"""

_WORDS: Mapping[Fmi, Mapping[str, str]] = {
    2: {"{fmi}": "fmi2", "{standard}": "FMI 2.0", "{token}": "guid"},
    3: {"{fmi}": "fmi3", "{standard}": "FMI 3.0", "{token}": "instantiationToken"},
}


def worded(text: str, fmi: Fmi = 2) -> str:
    """A text with the words of a version of FMI."""
    for placeholder, word in _WORDS[fmi].items():
        text = text.replace(placeholder, word)
    return text


def message(name: str, *arguments: object) -> str:
    """A message of FMI 2.0; the first argument is the function."""
    return worded(MESSAGES[name]) % arguments


def categories(fmi: Fmi) -> dict[str, str]:
    """Log category -> its description in a version of FMI."""
    return {name: worded(text, fmi) for name, text in CATEGORIES.items()}


def header(fmi: Fmi) -> str:
    """The text of contract.h for a version of FMI."""

    def quoted(text: str) -> str:
        return json.dumps(worded(text, fmi))

    def listed(name: str, texts: Mapping[str, str]) -> list[str]:
        return [f"static const char *const {name}[] = {{", *(f"    {quoted(text)}," for text in texts.values()), "};"]

    legal = {**LEGAL, **(LEGAL_3 if fmi == 3 else {})}
    lines = [
        "/* Generated: phases, legal calls, log categories, limits and messages, those of the Python flavour, too. */",
        "#ifndef CONTRACT_H",
        "#define CONTRACT_H",
        "",
        f"enum {{ OK = {OK}, WARNING = {WARNING}, DISCARD = {DISCARD}, ERROR = {ERROR} }};",
        "",
        "typedef enum {",
        *(f"    {name} = {1 << k}," for k, name in enumerate(PHASES)),
        "} Phase;",
        f"enum {{ N_PHASES = {len(PHASES)} }};",
        *listed("phase_names", PHASES),
        f"#define BEFORE {BEFORE}",
        f"#define EXCHANGE {EXCHANGE}",
        f"#define EVALUATED {EVALUATED}",
        "",
        "/* The phases in which a kind of call is legal. */",
        *(f"#define MAY_{name} {phases}" for name, phases in legal.items()),
        "",
        *listed("category_names", {name: name for name in CATEGORIES}),
        "enum { LOG_WARNING, LOG_DISCARD, LOG_ERROR, LOG_ALL, N_CATEGORIES };",
        "",
        *(f"#define MAX_{name} {number}" for name, number in LIMITS.items()),
        "",
        *(f"#define SAY_{name} {quoted(text)}" for name, text in MESSAGES.items()),
        *(f"#define REASON_{name} {quoted(text)}" for name, text in REASONS.items()),
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"
