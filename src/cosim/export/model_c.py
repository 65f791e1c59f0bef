"""The generated model.c: sizes, tables and traced functions in front of the interface and its core."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ..model import Controller, Plant
from .contract import Fmi
from .interface import InterfaceVariable, fmi3_variables, reference_of, variables_of
from .trace import Trace

_TYPES: Mapping[Fmi, Mapping[str, str]] = {
    2: {"Real": "REAL", "Integer": "INTEGER", "Enumeration": "INTEGER", "Boolean": "BOOLEAN"},
    3: {"Real": "REAL", "Integer": "INTEGER", "Enumeration": "ENUMERATION", "Boolean": "BOOLEAN"},
}

_HEAD = """\
/* Generated from the declaration of {name}: do not edit. Indices: see the table of variables below. */
#define MODEL_NAME "{name}"
#define MODEL_GUID "{guid}"
#define PLANT 1
#define CONTROLLER 2
#define SOURCE 3
#define KIND {kind}
{sizes}
typedef struct {{
    const char *name;
    const char *unit;
    int type;
    int role;
    double start;
    double min;
    double max;
}} Variable;
enum {{ REAL, INTEGER, BOOLEAN, STRING, ENUMERATION, UNSIGNED }};
enum {{ FIXED, TUNABLE, INPUT, STATE, OUTPUT, DERIVATIVE, COUNTER, INDEPENDENT }};

#include <math.h>

"""

_VARIANT = """\
typedef struct {
    void (*constants)(double, const double *, const double *, const double *, const double *, double *);
    void (*initial)(double, const double *, const double *, const double *, const double *, double *);
    void (*rules)(double, const double *, const double *, const double *, const double *, double *);
    void (*derivative)(double, const double *, const double *, const double *, const double *, double *);
    void (*jacobian)(double, const double *, const double *, const double *, const double *, double *, double *);
    void (*output)(double, const double *, const double *, const double *, const double *, double *);
    void (*update)(double, double *, const double *, const double *, const double *);
    void (*sample)(double, const double *, const double *, const double *, const double *, double *, double *);
    void (*directional)(double, const double *, const double *, const double *, const double *, const double *,
                        double *);
    void (*notes)(double, const double *, const double *, const double *, const double *, double *);
} Variant;

"""


def model_c(trace: Trace, guid: str, fmi: Fmi = 2) -> str:
    """The text of model.c for one version of FMI."""
    variables = variables_of(trace.kind)
    kind = trace.kind
    listed = variables if fmi == 2 else (*variables, fmi3_variables(kind)[-1][0])
    sizes = {
        "N_PARAMETERS": len(trace.parameters),
        "N_INPUTS": len(trace.inputs),
        "N_STATES": len(trace.states),
        "N_CONTINUOUS": trace.n_continuous,
        "N_OUTPUTS": len(trace.outputs),
        "N_VARIABLES": len(variables),
        "N_REFERENCES": len(listed),
        "N_CONSTANTS": trace.n_constants,
        "N_RULES": len(trace.rules),
        "N_NOTES": len(trace.notes),
        "N_CHOICES": len(trace.choices),
        "PLAIN_INPUTS": int(bool(trace.inputs) and _plain(variables, ("input",))),
        "PLAIN_OUTPUTS": int(bool(trace.outputs) and _plain(variables, ("state", "output"))),
    }
    if issubclass(kind, Plant):
        label = "PLANT"
        sizes["PARAMETER_TOLERANCE"] = reference_of(kind, variables, "tolerance")
    elif issubclass(kind, Controller):
        label = "CONTROLLER"
        sizes["PARAMETER_T_S"] = reference_of(kind, variables, "T_s")
    else:
        label = "SOURCE"
    head = _HEAD.format(
        name=kind.__name__, guid=guid, kind=label, sizes="".join(f"#define {k} {v}\n" for k, v in sizes.items())
    )
    tables = _table(listed, fmi) + (_lengths(trace) if fmi == 3 else "") + _choices(trace) + _notes(trace)
    return head + tables + trace.functions + _VARIANT + _variants(trace) + _tail(trace, fmi)


def _plain(variables: Sequence[InterfaceVariable], roles: Sequence[str]) -> bool:
    """Whether all variables of these roles are Real and inputs have no bounds: the runtime then takes a faster path."""
    chosen = [v for v in variables if v.role in roles]
    return all(v.type == "Real" and (v.role != "input" or (v.min, v.max) == (-math.inf, math.inf)) for v in chosen)


def _table(variables: Sequence[InterfaceVariable], fmi: Fmi) -> str:
    def kind(v: InterfaceVariable) -> str:
        return "UNSIGNED" if v.role == "counter" and fmi == 3 else _TYPES[fmi][v.type]

    rows = "".join(
        f'    /* {v.reference} */ {{"{v.name}", "{v.unit}", {kind(v)}, {v.role.upper()}, '
        f"{c_number(v.start)}, {c_number(v.min)}, {c_number(v.max)}}},\n"
        for v in variables
    )
    return f"static const Variable variables[N_REFERENCES] = {{\n{rows}}};\n\n"


def _lengths(trace: Trace) -> str:
    numbers = [n for group in fmi3_variables(trace.kind) for n in (len(group), *[0] * (len(group) - 1))]
    return f"static const int lengths[N_REFERENCES] = {{{', '.join(map(str, numbers))}}};\n\n"


def _choices(trace: Trace) -> str:
    rows = ", ".join(f"{{{index}, {count}, {first}}}" for index, first, count in trace.choices)
    text = f"static const struct {{ int parameter, count, first; }} choices[] = {{{rows}}};\n\n" if rows else ""
    if trace.rules:
        texts = "".join(f"    {c_text(rule)},\n" for rule in trace.rules)
        text += f"static const char *const rule_texts[N_RULES] = {{\n{texts}}};\n\n"
    else:
        text += 'static const char *const rule_texts[1] = {""};\n\n'
    return text


def _notes(trace: Trace) -> str:
    if not trace.notes:
        return ""
    rows = "".join(f"    {{{', '.join(map(c_text, note))}}},\n" for note in trace.notes)
    return (
        "static const struct { const char *name, *limit_name, *unit, *text; } note_texts[N_NOTES] = {\n"
        + rows
        + "};\n\n"
    )


def _variants(trace: Trace) -> str:
    rows = "".join(f"    {{{', '.join(names)}}},\n" for names in trace.variants)
    return f"static const Variant variants[] = {{\n{rows}}};\n\n"


def _tail(trace: Trace, fmi: Fmi) -> str:
    text = ""
    if issubclass(trace.kind, Plant):
        nominals = ", ".join(c_number(s.declaration.nominal) for s in trace.states[: trace.n_continuous]) or "1.0"
        text = f"static const double nominals[] = {{{nominals}}};\n\n"
    return text + f'#include "fmi{fmi}.c"\n'


def c_number(value: float) -> str:
    """A double as C text that reads back to the same bits."""
    if math.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


def c_text(text: str) -> str:
    """A text as C string literal. Question marks in a row are escaped, since C99 may read ``??`` as a trigraph."""
    special = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r", "?": "\\?" if "??" in text else "?"}
    return '"' + "".join(special.get(letter, letter) for letter in text) + '"'
