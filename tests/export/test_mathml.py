"""Equations of docstrings as MathML: they mean what their source means, and what cannot be read stays as it is."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import pytest
from conftest import WORKSPACE
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from cosim.export.mathml import inline, pieces, statements, typeset

etree: Any = importlib.import_module("lxml.etree")

CHILDREN = {
    "math": 1,
    "mfrac": 2,
    "msub": 2,
    "msup": 2,
    "msubsup": 3,
    "munder": 2,
    "msqrt": None,
    "mrow": None,
    "mtable": None,
    "mtr": 2,
    "mtd": None,
    "mi": 0,
    "mn": 0,
    "mo": 0,
    "mtext": 0,
    "mspace": 0,
}
"""Elements of MathML Core that may appear, with their number of children; None for any number."""
ATTRIBUTES = {
    "class", "alttext", "displaystyle", "mathvariant", "form", "fence", "separator", "stretchy", "movablelimits",
    "lspace", "rspace", "width",
}  # fmt: skip
MINUS, TIMES, DOT, APPLY = "\u2212", "\u2062", "\u22c5", "\u2061"


def block_of(name: str) -> list[str]:
    doc = inspect.getdoc(WORKSPACE.component(name)) or ""
    return [block for block in re.split(r"\n\s*\n", doc) if block.startswith("    ")]


BLOCKS = [(name, block) for name in sorted(WORKSPACE.components()) for block in block_of(name)]


def parsed(html: str) -> Any:
    return etree.fromstring(f"<body>{html}</body>")


def check_mathml(root: Any) -> None:
    """Every math element holds MathML Core elements only, each with the number of children that it needs."""
    for math in root.iter("math"):
        assert math.get("alttext")
        for node in math.iter():
            children = CHILDREN[node.tag]
            assert children is None or len(node) == children, etree.tostring(node)
            assert set(node.attrib) <= ATTRIBUTES, node.attrib
            assert node.tag in ("mi", "mn", "mo", "mtext", "mspace") or not (node.text or "").strip()
            if node.tag == "mtable":
                assert all(row.tag == "mtr" and [cell.tag for cell in row] == ["mtd", "mtd"] for row in node)


def source_of(node: Any) -> str:
    """The text of a typeset block as it was before: formulas by their alternative text."""
    parts = [node.get("alttext")] if node.tag == "math" else [node.text or "", *map(source_of, node)]
    return "".join([*parts, node.tail or ""])


def squeezed(text: str) -> str:
    return "".join(text.split())


# ---- what a formula on the page says, read without the code that wrote it ----


@dataclass(frozen=True)
class Number:
    """A rational number. Its power is no power, but another function of both, so that all values stay exact."""

    value: Fraction

    def __add__(self, other: Number) -> Number:
        return Number(self.value + other.value)

    def __sub__(self, other: Number) -> Number:
        return Number(self.value - other.value)

    def __mul__(self, other: Number) -> Number:
        return Number(self.value * other.value)

    def __truediv__(self, other: Number) -> Number:
        return Number(self.value / other.value)

    def __pow__(self, other: Number) -> Number:
        return Number(3 * self.value * self.value + 5 * other.value + self.value * other.value / 7)

    def __neg__(self) -> Number:
        return Number(-self.value)

    def __pos__(self) -> Number:
        return self


def number(text: str) -> Number:
    return Number(Fraction(text))


def absolute(x: Number) -> Number:
    return Number(abs(x.value))


def root(x: Number) -> Number:
    return Number(x.value * 11 + 4)


FUNCTIONS: dict[str, Any] = {
    "abs": absolute,
    "sqrt": root,
    "exp": lambda x: Number(x.value * 13 - 2),
    "max": lambda x, y: Number(x.value * 17 + 19 * y.value),
    "f": lambda x: Number(x.value * 23 + 6),
    "sigma_f": lambda x: Number(x.value * 29 + 8),
}
SHOWN_FUNCTIONS = {"exp": "exp", "max": "max", "f": "f", "sigma_f": "\N{GREEK SMALL LETTER SIGMA}|f"}
NAMES = {
    "a": "a",
    "x": "x",
    "T_s": "T|s",
    "sigma_0": "\N{GREEK SMALL LETTER SIGMA}|0",
    "lambda_": "\N{GREEK SMALL LETTER LAMDA}",
    "speed": "speed",
    "drive_lag": "drive_lag",
    "position_ref": "position|ref",
    "m_hat": "\N{MATHEMATICAL ITALIC SMALL M}\u0302",
    "F_C_hat": "\N{MATHEMATICAL ITALIC CAPITAL F}\u0302|C",
    "K_pos": "K|pos",
    "z[k]": "z|k",
    "F_C[i]": "F|C,i",
    "table[i]": "table|i",
    "der(z)": "\N{MATHEMATICAL ITALIC SMALL Z}\u0307",
    "der_e": "\N{MATHEMATICAL ITALIC SMALL E}\u0307",
    "u'": "u^\u2032",
}
"""Names of quantities in the notation, each as it must be on the page: base, subscript, superscript."""
VALUES = {name: number(f"{prime}/3") for name, prime in zip(NAMES, range(7, 100, 4), strict=False)}
SHOWN = {shown: VALUES[name] for name, shown in NAMES.items()}
SHOWN |= {SHOWN_FUNCTIONS[name]: FUNCTIONS[name] for name in SHOWN_FUNCTIONS}


def leaves(node: Any) -> str:
    return "".join(node.itertext())


def flat(node: Any) -> list[Any]:
    """The elements in a row, without the rows between, as an eye sees them."""
    if node.tag in ("mrow", "math", "mtd", "mtr", "mtable"):
        return [part for child in node for part in flat(child)]
    return [node]


class Page:
    """Reads a formula as a person does: fractions, scripts and roots by their place, the rest by precedence."""

    def __init__(self, nodes: Sequence[Any]) -> None:
        self.nodes = list(nodes)

    def sign(self) -> str | None:
        return self.nodes[0].text if self.nodes and self.nodes[0].tag == "mo" else None

    def take(self, *signs: str) -> str | None:
        return self.nodes.pop(0).text if self.sign() in signs else None

    def whole(self) -> Any:
        value = self.sum()
        assert not self.nodes, leaves(self.nodes[0])
        return value

    def sum(self) -> Any:
        value = -self.product() if self.take(MINUS) else self.product()
        while sign := self.take("+", MINUS):
            other = self.product()
            value = value + other if sign == "+" else value - other
        return value

    def product(self) -> Any:
        value = self.factor()
        while sign := self.take(TIMES, DOT, "\N{MULTIPLICATION SIGN}", "/"):
            if sign == "\N{MULTIPLICATION SIGN}":
                power = self.nodes.pop(0)
                assert leaves(power[0]) == "10"
                value *= number(f"1e{leaves(power[1]).replace(MINUS, '-')}")
                continue
            other = self.factor()
            value = value / other if sign == "/" else value * other
        return value

    def factor(self) -> Any:
        for opening, closing in (("(", ")"), ("|", "|")):
            if self.sign() == opening and self.nodes[0].get("form") == "prefix":
                inside = Page(self.enclosed(opening, closing)).whole()
                return absolute(inside) if opening == "|" else inside
        node = self.nodes.pop(0)
        value = self.single(node)
        if self.take(APPLY):
            inner: list[list[Any]] = [[]]
            depth = 0
            for part in self.enclosed("(", ")"):
                depth += (leaves(part) == "(") - (leaves(part) == ")")
                if leaves(part) == "," and depth == 0:
                    inner.append([])
                else:
                    inner[-1].append(part)
            return value(*(Page(part).whole() for part in inner))
        return value

    def enclosed(self, opening: str, closing: str) -> list[Any]:
        depth, inside = 0, []
        while True:
            node = self.nodes.pop(0)
            if node.text in (opening, closing) and node.tag == "mo":
                depth += 1 if node.get("form") == "prefix" else -1
                if depth == 0:
                    return inside[1:]
            inside.append(node)

    def single(self, node: Any) -> Any:
        match node.tag:
            case "mn":
                return number(leaves(node))
            case "mfrac":
                return Page(flat(node[0])).whole() / Page(flat(node[1])).whole()
            case "msqrt":
                return root(Page([part for child in node for part in flat(child)]).whole())
            case "mi":
                return SHOWN[leaves(node)]
            case "msub":
                return SHOWN[f"{leaves(node[0])}|{leaves(node[1])}"]
            case "msup" if leaves(node[1]) == "\u2032":
                return SHOWN[f"{leaves(node[0])}^\u2032"]
            case "msup":
                return Page(flat(node[0])).whole() ** Page(flat(node[1])).whole()
            case "msubsup":
                return SHOWN[f"{leaves(node[0])}|{leaves(node[1])}"] ** Page(flat(node[2])).whole()
            case _:
                raise AssertionError(etree.tostring(node))


def meaning(expression: str) -> Any:
    """The value of an expression by Python itself."""
    source = expression.replace("^", "**")
    source = re.sub(r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?", lambda match: f"number('{match.group()}')", source)
    for place, name in enumerate(sorted(NAMES, key=len, reverse=True)):
        source = re.sub(rf"(?<![\w']){re.escape(name)}(?![\w'\[])", f"Q{place}", source)
    values = {f"Q{place}": VALUES[name] for place, name in enumerate(sorted(NAMES, key=len, reverse=True))}
    return eval(source, {"number": number, **FUNCTIONS, **values})


@st.composite
def expressions(draw: st.DrawFn, depth: int = 4) -> str:
    """An expression of the notation, with brackets where they are needed, and sometimes elsewhere."""
    kind = draw(st.integers(0, 11)) if depth else draw(st.integers(0, 3))
    part = expressions(depth=depth - 1)
    if kind < 3:
        return draw(st.sampled_from(list(NAMES)))
    if kind == 3:
        return draw(st.sampled_from(["2", "10", "0.5", "3.25", "1e3", "2e-3"]))
    if kind < 9:
        left, right = draw(part), draw(part)
        sign = draw(st.sampled_from([" + ", " - ", "*", "/", "^", "**", " * ", " / "]))
        left = f"({left})" if draw(st.booleans()) else left
        right = f"({right})" if draw(st.booleans()) else right
        return f"{left}{sign}{right}"
    if kind == 9:
        inner = draw(part)
        return f"-{inner}" if draw(st.booleans()) and not inner.startswith("-") else f"(-({inner}))"
    if kind == 10:
        return f"{draw(st.sampled_from(['abs', 'sqrt', 'exp', 'f', 'sigma_f']))}({draw(part)})"
    return f"max({draw(part)}, {draw(part)})"


def assert_page_means(html: str, expression: str) -> None:
    node = parsed(html)
    check_mathml(node)
    (math,) = node.iter("math")
    try:
        expected = meaning(expression)
    except ZeroDivisionError:
        assume(False)
        return
    rows = flat(math)
    marks = [n for n, part in enumerate(rows) if part.text == "="]
    assert Page(rows[marks[0] + 1 :] if marks else rows).whole() == expected, html


@settings(deadline=None)
@given(expressions())
@example("-a^2")
@example("a^-x^2")
@example("(-a)^2")
@example("a/x/speed")
@example("a/(x/speed)")
@example("(a + x)/(a - x)*speed")
@example("a - (x - speed)")
@example("a*(x*speed)")
@example("(a/x)^2")
@example("(a^x)^2")
@example("f(a)^2")
@example("abs(a - abs(x))")
@example("exp(-a/T_s)")
@example("exp(-(a/T_s)^2)")
@example("a*-x")
@example("a + -x*speed")
@example("a/-x")
@example("exp(a/x*speed)")
@example("exp(a/(x*speed)/T_s)")
@example("2*3/4e2")
@example("2e-3^x")
@example("f(1e3/2)")
@example("f(a/1e3)")
@example("F_C[i]^2*table[i]")
def test_formulas_on_a_page_mean_what_their_source_means(expression: str) -> None:
    """Powers bind to the right and before signs, products and quotients to the left; brackets come where they must."""
    html = inline(f"y = {expression}")
    assert "<code>" not in html, "the notation has this expression"
    assert_page_means(html, expression)


@settings(deadline=None)
@given(expressions(depth=3), st.sampled_from(["+", "-", "*", "/"]), expressions(depth=3))
@example("a", "*", "(x + speed)")
@example("a + x", "*", "speed")
@example("a", "-", "x + speed")
@example("a/x", "*", "(a + x)/speed")
@example("a", "*", "x/speed")
def test_equations_of_two_lines_mean_what_both_lines_mean(first: str, operator: str, second: str) -> None:
    block = f"    y = {first}\n        {operator} {second}"
    assert_page_means(typeset(block), f"{first} {operator} {second}")


def test_comparisons_conditions_and_sums_are_written_in_order() -> None:
    assert leaves(parsed(inline("0 <= a < x"))) == "0≤a<x"
    assert leaves(parsed(inline("y = (0 if frozen else a*x)"))) == f"y=(0\u00a0if\u00a0frozen\u00a0else\u00a0a{TIMES}x)"
    assert leaves(parsed(inline("y = (a > x and not z)"))) == "y=(a>x\u00a0and\u00a0not\u00a0z)"
    summed = parsed(inline("y = sum of F[i] + c"))
    assert leaves(summed.find(".//munder")) == "∑i"
    assert leaves(summed) == "y=∑iFi+c"


@pytest.mark.parametrize(
    ("source", "shown"),
    [
        ("der(angle) = speed", "<mfrac><mrow><mi mathvariant=\"normal\">d</mi><mspace width=\".15em\"/><mi>angle</mi>"),
        ("der(x*y) = z", "</mfrac><mrow><mo form=\"prefix\">(</mo>"),
        ("y = K*(a + b)", "<mi>K</mi><mo>⋅</mo><mrow>"),
        ("y = K(a + b)", "<mi>K</mi><mo>\u2061</mo><mrow>"),
        ("y = 2*pi*t", "<mn>2</mn><mo>\u2062</mo><mi>π</mi>"),
        ("y = a-b", "<mi>a</mi><mo>\u2212</mo><mi>b</mi>"),
        ("y = torque ripple - a", "<mi>torque ripple</mi><mo>\N{MINUS SIGN}</mo>"),
        ("y = x limited to -a ... a", "</math> limited to <math"),
        ("y = x limited to +-a", "<mo form=\"prefix\">±</mo><mi>a</mi>"),
        ("y = drift_amplitude*t", "<mi>drift_amplitude</mi>"),
    ],
)  # fmt: skip
def test_notation(source: str, shown: str) -> None:
    assert shown in inline(source)


def test_lines_aligned_with_the_right_side_are_cases() -> None:
    block = "    y  = 0 where x <= a\n         (x - a)/2 between,  a = 1\n         1 where x > 3\n    z = y"
    (first, html), (second, _) = statements(block)
    assert (len(first), len(second)) == (3, 1)
    rows = [[leaves(cell) for cell in row] for row in parsed(html).iter("mtr")]
    assert [value for value, _ in rows] == ["0", "x\N{MINUS SIGN}a2", "1"]
    assert [remark.replace("\u00a0", " ").strip() for _, remark in rows] == ["where x≤a", "between, a=1", "where x>3"]


def test_gaps_part_a_condition_from_its_equation() -> None:
    parts = [leaves(part) for part in parsed(inline("y = a    -x where a = 0")).iter("span")]
    assert [part.replace("\u2212", "-") for part in parts] == ["y=a", "-x where a=0"]


@pytest.mark.parametrize(
    "line",
    [
        "y = a -b",
        "y = a b",
        "y = sigma_0 sigma_1",
        "y = f (x)",
        "y = 3 N.m",
        "y = 3 m",
        "force of fmus/physics/milling.py",
        "y = a/b.c",
        "y = a and/or b",
        "y in [0, 1]",
        "y = 7 % 3",
        "y = a // b",
        "y = |x|",
        "y = (a + b",
        "y = a + b)",
        "y = a +",
        "y = speed-velocity",
        "y = 2-3",
        "y = 3-phase",
        "input/output",
        "a*(b + c)(d)",
        "(a + b)(c + d)",
        "F in N/m",
        "y = 2x",
        "y = 1_000",
        "y = x.real",
        "N,N -> N",
        "y = x/sum of k[i]",
        "y = (x).conjugate()",
        "y = [i for i in x]",
        "y = (lambda: 1)",
        "y = f(x)(z)",
        "y = 'text'",
        "y = \u03c3",
        "y = a @ b",
        "y = f(x) (z)",
        "(" * 60 + "a" + ")" * 60,
        "y = " + "-" * 2000 + "a",
        "y = " + " + ".join(["a"] * 5000),
        "y = " + "^".join(["a"] * 5000),
        "y = a" + "[k]" * 3000,
    ],
)
def test_what_could_mean_two_things_stays_text(line: str) -> None:
    html = typeset(f"    {line}")
    assert "<math" not in html
    assert parsed(html).findtext(".//pre") == line
    assert "<math" not in inline(line)


def test_words_with_hyphens_are_text_beside_formulas() -> None:
    assert leaves(parsed(inline("x-y table"))) == "x-y table"
    assert leaves(parsed(inline("P-PI: y = x"))) == "P-PI: y=x"
    assert leaves(parsed(inline("y = r, stick-slip where x > 0"))) == "y=r, stick-slip where x>0"


def test_a_line_that_cannot_be_read_leaves_the_others_typeset() -> None:
    html = typeset("    y = a*b\n      table \\ of  what\n    z = 1/b")
    assert [math.get("alttext") for math in parsed(html).iter("math")] == ["y = a*b", "z = 1/b"]
    assert parsed(html).findtext(".//pre") == "  table \\ of  what"


TOKENS = ["a", "x", "speed", "T_s", "sigma_0", "where", "limited", "to", "sum", "of", "der", "if", "else", "and", "0"]
TOKENS += ["2.5", "1e-3", "+", "-", "*", "/", "^", "**", "=", "<=", "...", "+-", "(", ")", "[", "]", ",", ";", ":", "'"]
TOKENS += [" ", "  ", "    ", "\n    ", "\n        ", "&", "<", ">", '"', "\\", "abs(", "x[k+1]", "jerk-limited"]


@settings(deadline=None)
@given(st.one_of(st.text(), st.lists(st.sampled_from(TOKENS), max_size=30).map("".join)))
@example("    y = a\n\n    z = b")
@example("    y = 0 where a\n        1 where b")
@example("\n")
@example("\t= a")
def test_any_text_gives_a_page_that_holds_all_of_it(text: str) -> None:
    html = typeset(text)
    legal = re.sub("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "", html)
    node = parsed(legal)
    check_mathml(node)
    assert squeezed(source_of(node)) == squeezed(re.sub("[\0-\x1f\ud800-\udfff\ufffe\uffff]", "", text))
    inline(text)


def test_equations_of_the_components_are_typeset(record_property: Callable[[str, object], None]) -> None:
    counts = {True: 0, False: 0}
    left: list[str] = []
    for name, block in BLOCKS:
        for lines, html in statements(block):
            counts[html is not None] += len(lines)
            left += [f"{name}: {line}" for line in lines if html is None]
    record_property("typeset", counts[True])
    record_property("text", counts[False])
    assert counts[True] > 130
    assert counts[False] == 0, left


@pytest.mark.parametrize("name", sorted({name for name, _ in BLOCKS}))
def test_equations_of_a_component_are_whole_and_mathml(name: str) -> None:
    for block in block_of(name):
        node = parsed(typeset(block))
        check_mathml(node)
        assert squeezed(source_of(node)) == squeezed(block)


def test_formulas_keep_their_source_as_alternative_text() -> None:
    read = pieces("y = a < b, held while x > 0")
    assert [piece.source for piece in read if piece.kind == "math"] == ["y = a < b", "x > 0"]
    assert 'alttext="y = a &lt; b"' in inline("y = a < b, held while x > 0")


def same(mapping: Mapping[str, str]) -> bool:
    return len(set(mapping.values())) == len(mapping)


def test_names_of_the_test_are_told_apart_on_the_page() -> None:
    assert same(NAMES)
