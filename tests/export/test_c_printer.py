"""The C of expressions: what is printed for choices and for calls of the C library."""

from __future__ import annotations

import re

from cosim.export.trace import trace
from cosim.model import Plant, Record, exp, minimum, parameter, sin, variable, where


class Chosen(Plant):
    """Calls of the library whose argument is a choice.

    der(x) = ...

    Source: made for the test.
    """

    limit: float = parameter(0.0, "1", "Option that is off at 0", min=0.0)
    rate: float = parameter(1.0, "1", "Rate")

    class State(Record):
        x: float = variable(0.0, "1", "State")
        y: float = variable(0.0, "1", "State")
        z: float = variable(0.0, "1", "State")

    class Input(Record):
        u: float = variable(0.0, "1", "Input")

    class Output(Record):
        x: float = variable(0.0, "1", "Output")

    def derivative(self, t: float, x: State, u: Input) -> State:
        return self.State(
            x=exp(-minimum(x.x * x.x, 700.0)),
            y=sin(where(self.limit > 0.0, self.rate * x.y, 0.0)),
            z=exp(where(u.u > 0.0, x.z, x.y)),
        )

    def output(self, t: float, x: State, u: Input) -> Output:
        return self.Output(x=x.x)


def test_a_library_function_of_a_constant_is_not_called() -> None:
    """With the option off, and where the limit acts, the branch of the constant needs no call at run time."""
    text = trace(Chosen).functions
    body = text.partition("static void derivative_0")[2].partition("\n}\n")[0]
    assert re.search(r"\(a\d+ \? exp\(-a\d+\) : exp\(-700\.0\)\)", body)
    assert re.search(r"\(c\[\d\] \? sin\(a\d+\) : sin\(0\.0\)\)", body)


def test_a_library_function_of_a_choice_of_variables_is_called_once() -> None:
    body = trace(Chosen).functions.partition("static void derivative_0")[2].partition("\n}\n")[0]
    assert body.count("exp(") == 3  # two in the branches above, and this one
    assert re.search(r"= exp\(a\d+\);", body)
