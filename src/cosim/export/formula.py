"""One formula of the notation of docstrings as MathML: Python's parser reads it, this module writes it.

mathml.py finds the formulas in the lines of a docstring.
"""

from __future__ import annotations

import ast
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import NamedTuple

NUMBER = r"\d+(?:\.\d+)?(?:[eE][+-]?\d+)?"
PLAIN_WORD = re.compile(r"[A-Za-z]{2,}")
_WORDS = """along also an and as at because before below between but by during each else for from has have held if in is
it its no not of off on only or other otherwise over per rounded so than that the their then there to under unless until
up use when where whether which while with without"""
TEXT_WORDS = frozenset(_WORDS.split())
"""Words that are never a quantity; the remark beside an equation begins with one of them."""
DEPTH = 40
"""Brackets within brackets beyond which a formula is not read: no reader would follow it either."""

_SMALL = {
    unicodedata.name(letter).rsplit(" ", 1)[1].lower().replace("lamda", "lambda"): letter
    for letter in map(chr, range(0x3B1, 0x3CA))
    if letter not in "\u03bf\u03c2"  # omicron and the sigma at the end of a word
}
_CAPITALS = ("gamma", "delta", "theta", "lambda", "xi", "pi", "sigma", "upsilon", "phi", "psi", "omega")
GREEK = _SMALL | {name.capitalize(): _SMALL[name].upper() for name in _CAPITALS}
"""Names of Greek letters; capital ones where they differ from the Latin letters."""
_SUFFIXES = ("ref", "max", "min")
"""Last parts of long names that are set as subscripts; other long names stay as the tables of variables have them."""
_ACCENTS = {"hat": "\u0302", "tilde": "\u0303"}
_DOT_ABOVE = "\u0307"
"""Accents are combining characters: unlike the element mover they sit well without a font for mathematics, too."""
_PRIMES = ("", "\u2032", "\u2033", "\u2034")
_SIGNS: dict[type[ast.AST], str] = {
    ast.Eq: "=",
    ast.NotEq: "\u2260",
    ast.Lt: "&lt;",
    ast.LtE: "\u2264",
    ast.Gt: "&gt;",
    ast.GtE: "\u2265",
    ast.Add: "+",
    ast.Sub: "\u2212",
    ast.USub: "\u2212",
    ast.UAdd: "+",
    ast.Invert: "\u00b1",
}
_DOT, _TIMES, _APPLY = "<mo>\u22c5</mo>", "<mo>\u2062</mo>", "<mo>\u2061</mo>"
_COMMA = '<mo separator="true">,</mo>'
_SLASH = '<mo lspace=".08em" rspace=".08em">/</mo>'
_SUM = "_sum"
_IN_BRACKETS = {"if", "else", "and", "or", "not"}

# How tightly the outermost operation of a formula binds
CHOICE, OR, AND, NOT, RELATION, SUM, PRODUCT, FRACTION, POWER, ATOM = range(10)


class UnreadableError(Exception):
    """The text is no formula for sure."""


@dataclass(frozen=True)
class Token:
    """Number, name, hyphenated word or operator; where it stands in its line."""

    kind: str
    text: str
    start: int
    end: int


class Written(NamedTuple):
    """MathML of a formula, how tightly it binds, and whether a dot must part it from a factor beside it."""

    xml: str
    binding: int
    long: bool = False


def is_word(token: Token) -> bool:
    """Whether the token is a word of letters, neither a letter nor the name of a Greek one."""
    return token.kind == "name" and bool(PLAIN_WORD.fullmatch(token.text)) and token.text not in GREEK


def element(tag: str, *children: str) -> str:
    """An element of MathML; children are MathML."""
    return f"<{tag}>{''.join(children)}</{tag}>"


def formula(tokens: Sequence[Token]) -> str:
    """MathML of a formula, a sequence of elements. Raises UnreadableError."""
    parts: list[list[Token]] = [[]]
    depth = 0
    for token in tokens:
        depth += (token.text in "([") - (token.text in ")]")
        if token.text == "..." and depth == 0:
            parts.append([])
        else:
            parts[-1].append(token)
    return "<mo>\u2026</mo>".join(_Writer(part).whole() for part in parts)


class _Writer:
    """Writes one formula. In its Python form every name is a placeholder, so that no name is a word of Python."""

    def __init__(self, tokens: Sequence[Token]) -> None:
        self.names: dict[str, str] = {}
        self.linear = False
        """Whether fractions are written with a slash: in brackets, scripts and fractions."""
        self.source = self._python(tokens)

    def _python(self, tokens: Sequence[Token]) -> str:
        parts: list[str] = []
        depth, n = 0, 0
        while n < len(tokens):
            token = tokens[n]
            n += 1
            depth += (token.text in "([") - (token.text in ")]")
            if token.kind == "number":
                parts.append(token.text)
            elif token.text == "sum" and n < len(tokens) and tokens[n].text == "of":
                parts.append(f"{_SUM}*")
                n += 1
            elif depth and token.text in _IN_BRACKETS:
                parts.append(token.text)
            elif token.kind == "name":
                words = [token.text]
                while is_word(token) and n < len(tokens) and is_word(tokens[n]) and tokens[n].text not in TEXT_WORDS:
                    words.append(tokens[n].text)
                    n += 1
                if any(word in TEXT_WORDS for word in words):
                    raise UnreadableError
                if parts and tokens[n - 1].start > 0 and parts[-1][-1] in "])":
                    raise UnreadableError
                parts.append(self._placeholder(" ".join(words)))
            elif token.kind == "operator" and token.text not in (";", ":", "..."):
                parts.append({"^": "**", "=": "==", "+-": "~"}.get(token.text, token.text))
            else:
                raise UnreadableError
        return " ".join(parts)

    def _placeholder(self, name: str) -> str:
        keys = {known: key for key, known in self.names.items()}
        key = keys.get(name, f"_{len(keys)}")
        self.names[key] = name
        return key

    def whole(self) -> str:
        try:
            return self.write(ast.parse(self.source, mode="eval").body).xml
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise UnreadableError from error

    def write(self, node: ast.expr) -> Written:
        match node:
            case ast.Constant(value=int() | float()) if not isinstance(node.value, bool):
                return self.number(ast.get_source_segment(self.source, node) or "")
            case ast.Name():
                return self.name(node)
            case ast.UnaryOp(op=ast.Not()):
                return Written("<mtext>not\u00a0</mtext>" + self.within(node.operand, NOT), NOT)
            case ast.UnaryOp():
                sign = f'<mo form="prefix">{_SIGNS[type(node.op)]}</mo>'
                return Written(sign + self.within(node.operand, PRODUCT), SUM)
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                sign = element("mo", _SIGNS[type(node.op)])
                return Written(self.within(node.left, SUM) + sign + self.within(node.right, PRODUCT), SUM)
            case ast.BinOp(op=ast.Mult()):
                return self.product(node)
            case ast.BinOp(op=ast.Div()):
                return self.quotient(node)
            case ast.BinOp(op=ast.Pow()):
                return self.power(node)
            case ast.Compare():
                return self.relation(node)
            case ast.BoolOp():
                binding, word = (AND, "and") if isinstance(node.op, ast.And) else (OR, "or")
                between = f"<mtext>\u00a0{word}\u00a0</mtext>"
                return Written(between.join(self.within(value, binding + 1) for value in node.values), binding)
            case ast.IfExp():
                value, test, other = (self.within(part, OR) for part in (node.body, node.test, node.orelse))
                return Written(
                    f"{value}<mtext>\u00a0if\u00a0</mtext>{test}<mtext>\u00a0else\u00a0</mtext>{other}", CHOICE
                )
            case ast.Subscript():
                return self.name(node.value, self.listed(node.slice))
            case ast.Call(func=ast.Name(), keywords=[]):
                return self.call(node)
            case _:
                raise UnreadableError

    def within(self, node: ast.expr, binding: int) -> str:
        """The formula in a place that asks for this binding: in brackets if it binds less."""
        written = self.write(node)
        return written.xml if written.binding >= binding else self.bracketed(node)

    def in_line(self, node: ast.expr, *, linear: bool = True) -> Written:
        """The formula with its fractions written with a slash, or stacked."""
        before, self.linear = self.linear, linear
        written = self.write(node)
        self.linear = before
        return written

    def bracketed(self, node: ast.expr) -> str:
        return _bracketed(self.in_line(node).xml)

    def number(self, text: str) -> Written:
        mantissa, _, exponent = text.lower().partition("e")
        if not exponent:
            return Written(element("mn", text), ATOM)
        power = element("mn", exponent.lstrip("+-"))
        if exponent.startswith("-"):
            power = element("mrow", '<mo form="prefix">\u2212</mo>', power)
        return Written(f"<mn>{mantissa}</mn><mo>\u00d7</mo>{element('msup', '<mn>10</mn>', power)}", PRODUCT, True)

    def quotient(self, node: ast.BinOp) -> Written:
        above, below = self.in_line(node.left), self.in_line(node.right)
        if self.linear:
            if above.binding == SUM and _starts_with_sign(node.left) and below.binding >= POWER:
                return Written(f"{above.xml}{_SLASH}{below.xml}", SUM, True)
            top = above.xml if above.binding >= PRODUCT else _bracketed(above.xml)
            bottom = below.xml if below.binding >= POWER else _bracketed(below.xml)
            return Written(f"{top}{_SLASH}{bottom}", PRODUCT, True)
        return Written(_fraction(above.xml, below.xml), FRACTION)

    def product(self, node: ast.BinOp) -> Written:
        factors: list[ast.expr] = []
        first: ast.expr = node
        while isinstance(first, ast.BinOp) and isinstance(first.op, ast.Mult):
            factors.insert(0, first.right)
            first = first.left
        factors.insert(0, first)
        xml, binding, last = "", PRODUCT, None
        for n, factor in enumerate(factors):
            if isinstance(factor, ast.Name) and factor.id == _SUM:
                if n == len(factors) - 1:
                    raise UnreadableError
                xml, last = xml + ("" if n == 0 else _TIMES) + self.sum_sign(factors[n + 1 :]), None
                continue
            written = self.write(factor)
            if isinstance(factor, ast.BinOp) and isinstance(factor.op, ast.Div):
                written = self.in_line(factor, linear=False)
            signed = n == 0 and isinstance(factor, ast.UnaryOp) and written.binding == SUM
            if signed:
                binding = SUM
            elif written.binding < FRACTION:
                written = Written(self.bracketed(factor), ATOM)
            if last is not None:
                xml += _between(last, written)
            xml, last = xml + written.xml, written
        return Written(xml, binding)

    def sum_sign(self, factors: Sequence[ast.expr]) -> str:
        """The sign of a sum, with the index over which it runs if there is just one."""
        slices = [part.slice for factor in factors for part in ast.walk(factor) if isinstance(part, ast.Subscript)]
        indexes = {part.id for part in slices if isinstance(part, ast.Name)}
        sign = '<mo movablelimits="false">\u2211</mo>'
        return element("munder", sign, self.write(ast.Name(indexes.pop())).xml) if len(indexes) == 1 else sign

    def power(self, node: ast.BinOp) -> Written:
        exponent = element("mrow", self.in_line(node.right).xml)
        if isinstance(node.left, ast.Name):
            return self.name(node.left, power=exponent)
        if isinstance(node.left, ast.Subscript):
            return self.name(node.left.value, self.listed(node.left.slice), exponent)
        base = self.write(node.left)
        xml = base.xml if base.binding == ATOM else self.bracketed(node.left)
        return Written(element("msup", element("mrow", xml), exponent), POWER, base.long)

    def relation(self, node: ast.Compare) -> Written:
        xml = self.within(node.left, SUM)
        for operation, side in zip(node.ops, node.comparators, strict=True):
            if type(operation) not in _SIGNS:
                raise UnreadableError
            xml += element("mo", _SIGNS[type(operation)]) + self.within(side, SUM)
        return Written(xml, RELATION)

    def listed(self, node: ast.expr) -> str:
        parts = node.elts if isinstance(node, ast.Tuple) and node.elts else [node]
        return _COMMA.join(self.in_line(part).xml for part in parts)

    def call(self, node: ast.Call) -> Written:
        assert isinstance(node.func, ast.Name)
        function, arguments = self.names.get(node.func.id, ""), node.args
        if not function or not arguments or " " in function:
            raise UnreadableError
        if len(arguments) == 1:
            if function == "sqrt":
                return Written(element("msqrt", self.in_line(arguments[0]).xml), ATOM)
            if function == "abs":
                bars = ('<mo form="prefix" fence="true">|</mo>', '<mo form="postfix" fence="true">|</mo>')
                return Written(element("mrow", bars[0], self.in_line(arguments[0]).xml, bars[1]), ATOM)
            if function == "der":
                return self.derivative(arguments[0])
        listed = _COMMA.join(self.in_line(part).xml for part in arguments)
        return Written(self.write(node.func).xml + _APPLY + _bracketed(listed), PRODUCT + 1, True)

    def derivative(self, node: ast.expr) -> Written:
        """A dot over a letter, else d/dt."""
        index = self.listed(node.slice) if isinstance(node, ast.Subscript) else ""
        named = node.value if isinstance(node, ast.Subscript) else node
        if isinstance(named, ast.Name) and _is_letter(self.names.get(named.id, "").split("_")[0]):
            return self.name(named, index, dot=True)
        d, below = '<mi mathvariant="normal">d</mi>', '<mi mathvariant="normal">d</mi><mi>t</mi>'
        if isinstance(named, ast.Name):
            return Written(_fraction(d + '<mspace width=".15em"/>' + self.write(node).xml, below), FRACTION)
        return Written(_fraction(d, below) + self.bracketed(node), FRACTION)

    def name(self, node: ast.expr, index: str = "", power: str = "", *, dot: bool = False) -> Written:
        """A quantity with its subscript, index and exponent."""
        if not isinstance(node, ast.Name) or node.id not in self.names:
            raise UnreadableError
        text = self.names[node.id]
        primes = len(text) - len(text.rstrip("'"))
        if primes and power:
            return Written(element("msup", _bracketed(self.name(node, index).xml), power), POWER, True)
        base, subscript, long = _identifier(text.rstrip("'"), dot)
        below = _COMMA.join(part for part in (subscript, index) if part)
        below = element("mrow", below) if below else ""
        above = element("mo", _PRIMES[primes]) if primes else power
        if below and above:
            xml = element("msubsup", base, below, above)
        elif below:
            xml = element("msub", base, below)
        else:
            xml = element("msup", base, above) if above else base
        return Written(xml, POWER if power else ATOM, long)


def _starts_with_sign(node: ast.expr) -> bool:
    """Whether a product begins with a sign, which stands for the whole."""
    while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        node = node.left
    return isinstance(node, ast.UnaryOp)


def _is_letter(name: str) -> bool:
    return len(name) == 1 or name in GREEK


def _identifier(name: str, dot: bool) -> tuple[str, str, bool]:
    """Base and subscript of a name, and whether the base has several letters.

    A letter or a Greek name takes what follows its underscore as subscript; ``_hat`` and ``_tilde`` are accents.
    """
    parts = name.rstrip("_").split("_")
    if len(parts) == 2 and parts[0] == "der" and _is_letter(parts[1]):
        return _identifier(parts[1], True)
    accent = _ACCENTS.get(parts[-1], "") if len(parts) > 1 and _is_letter(parts[0]) else ""
    if accent:
        parts = parts[:-1]
    if not all(parts):
        raise UnreadableError
    if not _is_letter(parts[0]) and not (len(parts) == 2 and parts[1] in _SUFFIXES):
        parts = ["_".join(parts)]
    base = _letters(parts[0], upright=False)
    if marks := accent + (_DOT_ABOVE if dot else ""):
        base = element("mi", _italic(GREEK.get(parts[0], parts[0])) + marks)
    return base, _COMMA.join(_letters(part, upright=True) for part in parts[1:]), not _is_letter(parts[0])


def _italic(letter: str) -> str:
    """The letter of mathematical italics: an mi of more than one character is upright otherwise."""
    for first, italic in (("a", 0x1D44E), ("A", 0x1D434), ("\u03b1", 0x1D6FC), ("\u0391", 0x1D6E2)):
        if 0 <= ord(letter) - ord(first) < 26:
            return "\u210e" if letter == "h" else chr(italic + ord(letter) - ord(first))
    raise UnreadableError


def _letters(text: str, *, upright: bool) -> str:
    if text.isdigit():
        return element("mn", text)
    shown = GREEK.get(text, escape(text))
    return f'<mi mathvariant="normal">{shown}</mi>' if upright and len(shown) == 1 else element("mi", shown)


def _fraction(above: str, below: str) -> str:
    return element("mfrac", element("mrow", above), element("mrow", below))


def _bracketed(xml: str) -> str:
    return element("mrow", '<mo form="prefix">(</mo>', xml, '<mo form="postfix">)</mo>')


def _between(left: Written, right: Written) -> str:
    """The sign of a product: a dot beside long names, numbers and brackets, which could be read as a call."""
    if right.xml.startswith("<mfrac>") and not left.long:
        return '<mo lspace=".1em" rspace=".1em">\u2062</mo>'
    bracket = right.xml.startswith("<mrow>") or left.xml.endswith("</mrow>")
    return _DOT if bracket or right.xml.startswith("<mn>") or left.long or right.long else _TIMES
