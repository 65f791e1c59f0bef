"""Equations in the plain-text notation of docstrings as presentation MathML (MathML Core), without scripts.

The notation is Python's, with ``=`` for equality, ``^`` or ``**`` for powers, ``der(x)`` for the time derivative,
``x[k+1]`` for an index, ``x'`` for a derivative by name, ``sum of x[i]`` for a sum over an index and ``a ... b`` for a
range. A name of several words (torque ripple) is an operand. Text may stand beside the mathematics: before it
(``rolling: y = x``), after a comma or two spaces, or from a word such as ``where`` or ``limited to`` on. A line goes on
in the next one if that begins with an operator; lines aligned with the right side of an equation are its cases.

What cannot be read for sure stays, line by line, the preformatted text that it is. In particular ``a -b``, ``a b``,
``f (x)``, ``x-y`` or ``m/s`` without an operator before it, and ``3-phase`` are not read: they could mean two things.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

from .formula import DEPTH, GREEK, NUMBER, PLAIN_WORD, TEXT_WORDS, Token, UnreadableError, element, formula, is_word

STYLE = """\
.equations{overflow-x:auto;padding:.5rem 1rem;border-left:4px solid #d55e00}
.equations p{margin:.55rem 0;line-height:1.7}
.equations .part{display:inline-block;margin-right:2.2em}
.equations .tight{white-space:nowrap}
.equations pre{margin:.55rem 0;padding:0;border:0;background:none;overflow:visible;white-space:pre}
math.equation{font-size:1.12em;font-family:"Cambria Math","STIX Two Math","STIX Math","Latin Modern Math",
"TeX Gyre Termes Math","DejaVu Math TeX Gyre",math}
.equations mtd{text-align:left;padding:.2em 1em .2em 0}
.equations .broken mtd{padding:.15em 0}
"""
"""CSS of typeset blocks; it takes the colours of the page."""

_TOKEN = re.compile(
    r"(?P<gap>\s+)"
    rf"|(?P<number>{NUMBER}(?![\w.]))"
    r"|(?P<hyphenated>[A-Za-z]+(?:-[A-Za-z]+)+(?![\w(\[']))"
    r"|(?P<name>[A-Za-z]\w*'{0,3}(?!['\w]))"
    r"|(?P<operator>\.\.\.|\*\*|<=|>=|!=|==|\+-|[-+*/^=<>()\[\],;:])",
    re.ASCII,
)
_RELATIONS = {"=", "==", "!=", "<", ">", "<=", ">="}
_BINARY = {"+", "-", "*", "/", "^", "**", "...", *_RELATIONS}
_PREFIXES = {"+", "-", "+-"}
NAME_WORDS = 4
"""Largest number of words in the name of a quantity, as in "load side angular velocity". More words are text."""
_BEFORE = "what_precedes"
_OPENING = {"(": ")", "[": "]"}


@dataclass(frozen=True)
class Piece:
    """A part of a line: a formula, or text. ``gap`` tells that two spaces or more stand before it."""

    kind: Literal["math", "text"]
    source: str
    tokens: tuple[Token, ...] = ()
    gap: bool = False
    joined: bool = False
    """Stands right after the piece before it, without a space."""


def typeset(block: str) -> str:
    """HTML of a block of equations; lines that cannot be read are preformatted text in it."""
    parts: list[str] = []
    for readable, group in _together(statements(block)):
        lines = "\n".join(group)
        parts.append(lines if readable else f"<pre>{lines}</pre>")
    body = "\n".join(parts)
    return f'<div class="equations" role="group" aria-label="Equations" tabindex="0">\n{body}\n</div>'


def inline(text: str) -> str:
    """HTML of an equation within running text; code if it cannot be read."""
    try:
        return _parts(pieces(text))
    except UnreadableError:
        return f"<code>{escape(text, quote=False)}</code>"


def statements(block: str) -> list[tuple[list[str], str | None]]:
    """The lines of a block in statements, each with its HTML; None for lines that stay text."""
    lines = textwrap.dedent(block.expandtabs()).strip("\n").splitlines()
    found: list[tuple[list[str], str | None]] = []
    while lines:
        group = [lines.pop(0)]
        while lines and _goes_on(group, lines[0]):
            group.append(lines.pop(0))
        cases: list[str] = []
        if len(group) == 1:
            column = _right_side(group[0])
            while lines and column is not None and _indent(lines[0]) == column and not _goes_on(group, lines[0]):
                cases.append(lines.pop(0))
        found.append(([*group, *cases], _statement(group, cases)))
    return found


def _together(items: Iterable[tuple[list[str], str | None]]) -> list[tuple[bool, list[str]]]:
    """HTML of the statements; neighbours that stay text are put together."""
    groups: list[tuple[bool, list[str]]] = []
    for lines, html in items:
        shown = [escape(line, quote=False) for line in lines] if html is None else [html]
        if groups and groups[-1][0] == (html is not None):
            groups[-1][1].extend(shown)
        else:
            groups.append((html is not None, shown))
    return groups


# ---- lines ----


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def _goes_on(group: Sequence[str], line: str) -> bool:
    """Whether ``line`` continues the equation: it begins with an operator, or a bracket is open."""
    if not line.strip():
        return False
    so_far = " ".join(group)
    if any(so_far.count(a) > so_far.count(b) for a, b in _OPENING.items()):
        return _indent(line) > _indent(group[0])
    first = re.match(r"(?:\*\*|[*/^]|[-+](?= ))", line.strip())
    return first is not None and _indent(line) > _indent(group[0])


def _right_side(line: str) -> int | None:
    """Column at which the right side of an equation with a condition begins."""
    try:
        read = pieces(line)
    except UnreadableError:
        return None
    if len(read) < 2 or read[0].kind != "math" or not (read[1].gap or read[1].source.split()[0] in TEXT_WORDS):
        return None
    tokens = read[0].tokens
    marks = [n for n, token in enumerate(tokens) if token.text in _RELATIONS]
    return tokens[marks[0] + 1].start if len(marks) == 1 and tokens[marks[0]].text == "=" else None


def _statement(group: Sequence[str], cases: Sequence[str]) -> str | None:
    try:
        if len(group) > 1:
            read = pieces(" ".join(line.strip() for line in group))
            if len(read) > 1 and len(pieces(group[0])) > 1:
                raise UnreadableError  # the operator would belong to the remark, not to the equation
            if len(read) == 1 and (broken := _broken(group)):
                return f"<p>{broken}</p>"
        else:
            read = pieces(group[0])
        if any(piece.gap for piece in read) and all(len(piece.tokens) < 2 for piece in read):
            return None  # a table, which its spaces align
        html = _cases(read, [pieces(line) for line in cases], [*group, *cases]) if cases else _parts(read)
    except UnreadableError:
        return None
    indent = _indent(group[0])
    style = f' style="padding-left:{indent / 2:g}em"' if indent else ""
    return f"<p{style}>{html}</p>"


def _broken(group: Sequence[str]) -> str | None:
    """An equation of several lines, broken where its source is, if the operators there allow it."""
    first = pieces(group[0])[0].tokens
    marks = [n for n, token in enumerate(first) if token.text == "="]
    if len(marks) != 1 or any(token.text in ("<", ">", "<=", ">=", "!=", "==", "...") for token in first):
        return None
    left, right = formula(first[: marks[0]]) + "<mo>=</mo>", formula(first[marks[0] + 1 :])
    rows = [element("mtr", element("mtd", left), element("mtd", right))]
    before = formula(pieces(_BEFORE)[0].tokens)
    for line in group[1:]:
        # the operator has its meaning only with something before it, which is then taken away
        read = pieces(f"{_BEFORE} {line.strip()}")
        if len(read) != 1 or any(token.text in {*_RELATIONS, "..."} for token in read[0].tokens):
            return None
        written = formula(read[0].tokens)
        if not written.startswith(f"{before}<mo>"):
            return None
        infix = written.removeprefix(before).replace("<mo>", '<mo form="infix">', 1)
        rows.append(element("mtr", "<mtd></mtd>", element("mtd", infix)))
    table = f'<mtable displaystyle="true" class="broken">{"".join(rows)}</mtable>'
    return _math(table, "\n".join(line.strip() for line in group))


def _cases(first: Sequence[Piece], others: Sequence[Sequence[Piece]], lines: Sequence[str]) -> str:
    """An equation with a brace and a row for each case."""
    tokens = first[0].tokens
    mark = next(n for n, token in enumerate(tokens) if token.text == "=")
    values = [tokens[mark + 1 :], *(row[0].tokens for row in others)]
    if not all(values) or any(t.text in _RELATIONS for value in values for t in value) or min(map(len, others)) < 2:
        raise UnreadableError
    rows = [
        element("mtr", element("mtd", formula(value)), element("mtd", _remark(row[1:])))
        for value, row in zip(values, [first, *others], strict=True)
    ]
    brace = '<mo form="prefix" stretchy="true">{</mo>'
    equation = (
        formula(tokens[:mark])
        + "<mo>=</mo>"
        + element("mrow", brace, f'<mtable displaystyle="true">{"".join(rows)}</mtable>')
    )
    return _math(equation, "\n".join(line.strip() for line in lines))


def _remark(row: Sequence[Piece]) -> str:
    """Text and formulas in a cell of a table."""
    cells = [
        element("mrow", formula(piece.tokens))
        if piece.kind == "math"
        else element(
            "mtext", escape(f"{'' if piece.joined else ' '}{piece.source} ".replace(" ", "\N{NO-BREAK SPACE}"))
        )
        for piece in row
    ]
    return element("mrow", *cells)


def _parts(read: Sequence[Piece]) -> str:
    """HTML of a line: its parts between gaps, text as text."""
    parts: list[list[str]] = [[]]
    for piece in read:
        html = escape(piece.source, quote=False) if piece.kind == "text" else _math(formula(piece.tokens), piece.source)
        last = parts[-1]
        if piece.joined and html[0] in ",;:)" and last and last[-1].endswith("</math>"):
            last[-1] = f'<span class="tight">{last[-1]}{html[0]}</span>{html[1:]}'
        elif piece.gap:
            parts.append([html])
        else:
            last += [html] if piece.joined or not last else [" ", html]
    texts = ["".join(part) for part in parts]
    return texts[0] if len(texts) == 1 else " ".join(f'<span class="part">{text}</span>' for text in texts)


def _math(content: str, source: str) -> str:
    return f'<math class="equation" displaystyle="true" alttext="{escape(source)}"><mrow>{content}</mrow></math>'


# ---- formulas and text in a line ----


def pieces(line: str) -> list[Piece]:
    """Formulas and text of a line, in order. Raises UnreadableError."""
    reader = _LineReader(line)
    return reader.pieces(0, len(reader.tokens))


class _LineReader:
    """Finds where formulas begin and end among the words of a line."""

    def __init__(self, line: str) -> None:
        self.line = line
        self.tokens: list[Token] = []
        place = 0
        while place < len(line):
            match = _TOKEN.match(line, place)
            if match is None:
                raise UnreadableError
            kind = str(match.lastgroup)
            if kind == "hyphenated" and self.is_difference(match):
                match = re.compile("[A-Za-z]+").match(line, place)
                assert match is not None
                kind = "name"
            if kind != "gap":
                self.tokens.append(Token(kind, match.group(), match.start(), match.end()))
            place = match.end()
        self.closing = self._brackets()

    def is_difference(self, match: re.Match[str]) -> bool:
        """Whether names with hyphens between them are quantities: letters after an operator."""
        parts = match.group().split("-")
        return all(len(part) == 1 or part in GREEK for part in parts) and bool(
            self.tokens and self.tokens[-1].kind == "operator" and self.tokens[-1].text not in {")", "]", ":", ";"}
        )

    def _brackets(self) -> dict[int, int]:
        """Index of each opening bracket -> index of the closing one."""
        closing: dict[int, int] = {}
        opened: list[int] = []
        for n, token in enumerate(self.tokens):
            if token.text in _OPENING:
                opened.append(n)
                if len(opened) > DEPTH:
                    raise UnreadableError
            elif token.text in _OPENING.values():
                if not opened or _OPENING[self.tokens[opened[-1]].text] != token.text:
                    raise UnreadableError
                closing[opened.pop()] = n
        if opened:
            raise UnreadableError
        return closing

    def space(self, n: int) -> int:
        """Number of spaces before token ``n``."""
        return self.tokens[n].start - self.tokens[n - 1].end if n else 0

    def pieces(self, n: int, stop: int) -> list[Piece]:
        found: list[Piece] = []
        while n < stop:
            end = self.formula(n, stop)
            if end is not None:
                if found and found[-1].kind == "math" and self.space(n) < 2:
                    raise UnreadableError  # two formulas without an operator
                found.append(self.piece("math", n, end))
                n = end
            elif self.tokens[n].text == "(":
                if n and self.space(n) == 0 and self.tokens[n - 1].text not in _OPENING:
                    raise UnreadableError  # "(a)(b)"
                inner = self.pieces(n + 1, self.closing[n])
                if found and found[-1].kind == "math" and self.space(n) < 2 and any(p.kind == "math" for p in inner):
                    raise UnreadableError  # "f (x)"
                found += [
                    self.piece("text", n, n + 1),
                    *inner,
                    self.piece("text", self.closing[n], self.closing[n] + 1),
                ]
                n = self.closing[n] + 1
            elif self.is_text(n):
                end = n + 1
                while end < stop and self.space(end) < 2 and self.is_text(end) and self.formula(end, stop) is None:
                    end += 1
                found.append(self.piece("text", n, end))
                n = end
            else:
                raise UnreadableError
        return found

    def piece(self, kind: Literal["math", "text"], n: int, end: int) -> Piece:
        source = self.line[self.tokens[n].start : self.tokens[end - 1].end]
        tokens = tuple(self.tokens[n:end]) if kind == "math" else ()
        return Piece(kind, source, tokens, gap=self.space(n) >= 2, joined=n > 0 and self.space(n) == 0)

    def is_text(self, n: int) -> bool:
        token = self.tokens[n]
        return is_word(token) or token.kind == "hyphenated" or token.text in {",", ";", ":", "a"}

    def formula(self, n: int, stop: int) -> int | None:
        """End of the formula that begins at token ``n``; None if text begins there."""
        if self.tokens[n].text == "(":
            after = self.closing[n] + 1
            if after >= stop or self.tokens[after].text not in _BINARY or self.space(after) > 1:
                return None  # a remark in brackets
        end = self.operand(n, stop)
        if end is None:
            return None
        connected = False
        while end < stop and self.tokens[end].text in _BINARY:
            after = self.operator(end, stop)
            if after is None:
                break
            operand = self.operand(after, stop)
            if operand is None:
                raise UnreadableError
            end, connected = operand, True
        if not connected and self.plain(n, end):
            return None
        self.check_slashes(self.tokens[n:end])
        return end

    @staticmethod
    def check_slashes(tokens: Sequence[Token]) -> None:
        """Refuse words with slashes between them, which may be units or alternatives: N/m, input/output."""
        words = all(token.kind == "name" and token.text.isalpha() for token in tokens[::2])
        if len(tokens) > 1 and words and {token.text for token in tokens[1::2]} == {"/"}:
            raise UnreadableError

    def plain(self, n: int, end: int) -> bool:
        """Whether the operand is but words, or the article "a" among words."""
        if all(is_word(token) for token in self.tokens[n:end]):
            return True
        beside = [m for m in (n - 1, end) if 0 <= m < len(self.tokens)]
        return end == n + 1 and self.tokens[n].text == "a" and any(is_word(self.tokens[m]) for m in beside)

    def operator(self, n: int, stop: int) -> int | None:
        """Index after the operator ``n``; None if it begins the next part as a sign."""
        if n + 1 >= stop:
            raise UnreadableError
        attached = self.space(n + 1) == 0
        if self.tokens[n].text in _PREFIXES and attached and self.space(n) > 0:
            if self.space(n) >= 2:
                return None
            raise UnreadableError  # "a -b"
        before, after = self.tokens[n - 1], self.tokens[n + 1]
        doubtful = after.kind in ("number", "hyphenated") or is_word(after)
        if self.tokens[n].text == "-" and attached and before.kind == "number" and doubtful:
            raise UnreadableError  # "2-3", "3-phase"
        return n + 1

    def operand(self, n: int, stop: int) -> int | None:
        """Index after the operand that begins at token ``n``; None if none begins there."""
        if n < stop and self.tokens[n].text in _PREFIXES:
            n += 1
            if n >= stop or self.space(n) > 0:
                raise UnreadableError
        if n + 2 < stop and [token.text for token in self.tokens[n : n + 2]] == ["sum", "of"]:
            return self.operand(n + 2, stop)
        if n >= stop:
            return None
        token = self.tokens[n]
        if token.kind == "number":
            return n + 1
        if token.text == "(":
            return self.closing[n] + 1
        if token.kind != "name" or token.text in TEXT_WORDS or self.limited_to(n):
            return None
        end = n + 1
        if end < stop and self.tokens[end].text in _OPENING and self.space(end) == 0:
            while end < stop and self.tokens[end].text in _OPENING and self.space(end) == 0:
                end = self.closing[end] + 1
            return end
        if PLAIN_WORD.fullmatch(token.text) and is_word(token):
            while end < min(stop, n + NAME_WORDS) and self.name_goes_on(end):
                end += 1
        return end

    def name_goes_on(self, n: int) -> bool:
        """Whether token ``n`` is a further word of a name such as torque ripple."""
        token = self.tokens[n]
        follows = n + 1 < len(self.tokens) and self.tokens[n + 1].text in _OPENING and self.space(n + 1) == 0
        plain = is_word(token) and token.text not in TEXT_WORDS and not follows
        return plain and self.space(n) == 1 and not self.limited_to(n)

    def limited_to(self, n: int) -> bool:
        return [token.text for token in self.tokens[n : n + 2]] == ["limited", "to"]
