"""The coefficients of src/cosim/export/runtime/integrator.c from their order conditions, in exact arithmetic.

With ``w = 1/(1 - gamma*z)`` every operator of the method is a polynomial in ``w`` without constant term. On a linear
problem the solution is ``x + sum solution[k] w^k (h f)``; what is not linear enters through the remainders at the nodes
``c`` and 1, weighted by ``at_node`` and ``at_end``. With phi_1(z) = (e^z - 1)/z, phi_{k+1}(z) = (phi_k(z) - 1/k!)/z:

- ``solution`` agrees with phi_1(z) up to z^4, ``node`` with c phi_1(c z) up to z^3;
- ``c^2 at_node + at_end`` agrees with 2 phi_3(z) and ``c^3 at_node + at_end`` with 6 phi_4(z) up to z^2; the node
  c = 3/5 makes the quadrature with nodes 0, 0, c, 1 exact for fourth powers too (Radau);
- ``end`` weights the remainder at the node in the last stage so that the condition of the tree f''(f, f''(f, f)) holds;
- at infinity the operators agree with -1/z in their first power of w (stiff accuracy, L-stability), ``solution`` also
  in the second, so that the stability function falls as 1/z^2, and the remainders' to second order.

Together these are all conditions of order 5 for a method with exact Jacobian. Numbers the conditions leave free are
chosen for |R(z) - e^z| < 0.004 on the negative axis (``solution[2]``) and for small deviations from the phi functions.
"""

from __future__ import annotations

from fractions import Fraction
from math import comb, factorial

GAMMA = Fraction(7, 50)
NODE = Fraction(3, 5)
FREE_SOLUTION = {2: Fraction("0.126")}
FREE_NODE = {1: Fraction("0.133"), 2: Fraction("0.310"), 3: Fraction("-1.174")}
FREE_END = {1: Fraction("-0.1")}
CHAIN, REMAINDER, END = 8, 5, 3


def taylor(power: int, order: int) -> Fraction:
    """Coefficient of z**order in w**power."""
    return comb(power - 1 + order, order) * GAMMA**order


def solve(rows: list[list[Fraction]], right: list[Fraction]) -> list[Fraction]:
    """Solve a square system by Gauss-Jordan elimination."""
    n = len(rows)
    assert all(len(row) == n for row in rows)
    m = [[*row, value] for row, value in zip(rows, right, strict=True)]
    for k in range(n):
        pivot = next(i for i in range(k, n) if m[i][k] != 0)
        m[k], m[pivot] = m[pivot], m[k]
        m[k] = [value / m[k][k] for value in m[k]]
        for i in range(n):
            if i != k:
                m[i] = [a - m[i][k] * b for a, b in zip(m[i], m[k], strict=True)]
    return [row[-1] for row in m]


def unit(index: int, size: int) -> list[Fraction]:
    return [Fraction(i == index) for i in range(size)]


def chain(c: Fraction, order: int, at_infinity: int, free: dict[int, Fraction]) -> list[Fraction]:
    """Coefficients of w, w^2, ... for c phi_1(c z)."""
    rows = [[taylor(k + 1, j) for k in range(CHAIN)] for j in range(order)]
    right = [c ** (j + 1) / Fraction(factorial(j + 1)) for j in range(order)]
    for i in range(at_infinity):
        rows.append(unit(i, CHAIN))
        right.append(GAMMA)
    for index, value in free.items():
        rows.append(unit(index, CHAIN))
        right.append(value)
    return solve(rows, right)


def remainders() -> tuple[list[Fraction], list[Fraction]]:
    """Weights of the remainders at the node and at the end."""
    rows: list[list[Fraction]] = []
    right: list[Fraction] = []
    for power in (2, 3):
        for j in range(3):
            row = [taylor(k + 1, j) for k in range(REMAINDER)]
            rows.append([NODE**power * value for value in row] + row)
            right.append(Fraction(factorial(power), factorial(power + 1 + j)))
        second = unit(1, REMAINDER)
        rows.append([NODE**power * value for value in second] + second)
        right.append(GAMMA - power * GAMMA**2)
    rows += [unit(0, 2 * REMAINDER), unit(REMAINDER, 2 * REMAINDER)]
    right += [Fraction(0), GAMMA]
    both = solve(rows, right)
    return both[:REMAINDER], both[REMAINDER:]


def coefficients() -> dict[str, list[Fraction]]:
    """The tables of integrator.c by name."""
    solution = chain(Fraction(1), 5, 2, FREE_SOLUTION)
    node = chain(NODE, 4, 1, FREE_NODE)
    at_node, at_end = remainders()
    # sum_i b_i c_i w_i = 1/30, the last stage having w = c^2/2 * sum(end), the node none.
    total = Fraction(1, 30) / sum(at_end) / (NODE**2 / 2)
    rows = [[Fraction(1)] * END, unit(0, END)] + [unit(i, END) for i in FREE_END]
    end = solve(rows, [total, GAMMA / NODE**2, *FREE_END.values()])
    return {
        "to_node": node,
        "to_end": solution,
        "node_in_stage": end,
        "from_node": at_node,
        "from_end": at_end,
    }
