"""What is wrong in a TOML file: place, line and a likely remedy beside the words of Python's reader."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable

from ..errors import MOST_SHOWN

_AT = re.compile(r" ?\(at (?:line (\d+), column (\d+)|end of document)\)$")
_NUMBER = r"[-+]?(?:\d[\d_]*)(?:\.\d+)?(?:[eE][-+]?\d+)?"

_OPEN = ("Unterminated", "Unclosed", "Expected \"'", "Expected ']", "Invalid initial character")
"""Beginnings of messages about something that does not end."""
_WITHOUT_PLACE = r"\d{4301}|\\[uU]0000"
"""What tomllib and ``read_toml`` refuse without a place: numbers of thousands of digits, the character U+0000."""
_QUOTED = r"\"[^\"]*\"|'[^']*'"
_SIGNS = {"\N{MINUS SIGN}": "-", "\N{EN DASH}": "-", "\N{NO-BREAK SPACE}": "a usual blank"}
"""Characters of word processors, and the character that TOML reads."""

_WORDS = {
    **dict.fromkeys(("true", "yes", "on"), "Write it as true."),
    **dict.fromkeys(("false", "no", "off"), "Write it as false."),
    **dict.fromkeys(("nan", "+nan", "-nan"), "Write it as nan."),
    **dict.fromkeys(("inf", "+inf", "infinity", "+infinity"), "Write it as inf."),
    **dict.fromkeys(("-infinity", "-inf"), "Write it as -inf."),
    **dict.fromkeys(("none", "null", "nil"), "TOML has no empty value: leave the entry out."),
}

_VALUES: tuple[tuple[str, Callable[[re.Match[str]], str]], ...] = (
    (r"", lambda found: "The value is missing."),
    (r"=.*", lambda found: "Write one =."),
    (r"(.*?)\s*(?://|/\*).*", lambda found: f"Leave out what follows {found[1]}, or begin a comment with #."),
    (r"(.*?)\s*;", lambda found: "Leave out the semicolon."),
    (r"\d{4}-\d\d-\d\d.*", lambda found: f'Write a date in quotes: "{found[0]}".'),
    (rf"{_NUMBER}\s*/\s*{_NUMBER}", lambda found: f'Write a fraction in quotes: "{_joined(found[0])}".'),
    (r"([-+]?)(\.\d.*)", lambda found: f"Write a digit before the point: {found[1]}0{found[2]}."),
    (r"([-+]?\d[\d_]*\.)((?:[eE].*)?)", lambda found: f"Write a digit behind the point: {found[1]}0{found[2]}."),
    (r"([-+]?\d+),(\d+)", lambda found: f"Write a decimal point: {found[1]}.{found[2]}."),
    (
        r"([-+]?\d[\d_]*(?:\.\d{3})*),(\d+)",
        lambda found: f"Write a decimal point: {found[1].replace('.', '').replace('_', '')}.{found[2]}.",
    ),
    (r"[-+]?\d{1,3}(?:[' ]\d{3})+", lambda found: f"Write the digits together: {_joined(found[0])}."),
    (r"([-+]?)0+(\d[\d.eE+-]*)", lambda found: f"Leave out the zeros before it: {found[1]}{found[2]}."),
    (r"\((.*)\)", lambda found: f"Write a list in square brackets: [{found[1]}]."),
    (rf"(?:{_NUMBER}|pi)(?:\s*[-+*/^]+\s*(?:{_NUMBER}|pi))+", lambda found: "TOML does not compute: write the number."),
    (
        rf"{_NUMBER}\s*(?![eE][+-]|[xob]$)[A-Za-zµμ°Ω%][^\s\"'=]*",
        lambda found: f'Write the number alone, or the number and its unit in quotes: "{found[0]}".',
    ),
    (r"[^\W\d][^\"'=]*", lambda found: f'Write text in quotes: "{found[0]}".'),
)
"""Patterns of a whole value that TOML cannot read, and their remedies. The first that fits counts."""


def explained(text: str, error: ValueError) -> str:
    """The message of an error of ``tomllib.loads(text)``: its words, place and line, and a likely remedy."""
    said = str(error)
    at = _AT.search(said)
    if at is None:
        return f"{said}{line_with(text, _WITHOUT_PLACE)}."
    said, lines = _AT.sub("", said), text.split("\n")
    row = _last_statement(lines) if at[1] is None else int(at[1]) - 1
    line = lines[row].rstrip()
    column = len(line) + 1 if at[2] is None else int(at[2])
    place = f"line {row + 1}, column {column}"
    if at[1] is None and (said.startswith(_OPEN) or (said == "Invalid value" and not line.endswith("="))):
        place = f"line {row + 1}, not closed until the end of the file"
        said = said.replace("Invalid value", "Unclosed array")
    found = remedy(said, line, column)
    return f"{said} ({place}): '{_excerpt(line, column)}'.{' ' if found else ''}{found}"


def line_with(text: str, pattern: str) -> str:
    """The first line that has ``pattern``, as ``" (line 3)"``; "" if there is none."""
    found = re.search(pattern, text)
    return "" if found is None else f" (line {text.count(chr(10), 0, found.start()) + 1})"


def remedy(said: str, line: str, column: int) -> str:
    """The likely remedy of an error ``said`` at a column of a line, counted from 1; "" if none is likely."""
    plain = re.sub(f"{_QUOTED}|#.*", "", line)
    if re.search("[\u201c\u201d\u201e\u2018\u2019\u201a\u00ab\u00bb]", plain):
        return "Write straight quotes, \" or '."
    for sign, usual in _SIGNS.items():
        if sign in plain:
            return f"Write {usual} in place of the character U+{ord(sign):04X}."
    here = line[column - 1 : column]
    before = line[: column - 1]
    if said.startswith(("Unescaped", "Invalid hex value")):
        return "In double quotes a backslash begins a special character. Write / in paths, or single quotes."
    if said.startswith(("Unterminated string", "Expected \"'", "Illegal character '\\n'")):
        return "A quote is not closed."
    if said.startswith("Cannot"):
        return "A name can be given once: keep one of the entries."
    if line.lstrip().startswith("[") and "=" not in line and not said.startswith("Unclosed"):
        return _table_remedy(line)
    if comma := re.search(r"=\s*([-+]?\d+),(\d+)\s*$", before):
        return f"Write a decimal point: {comma[1]}.{comma[2]}."
    if said.startswith("Expected '='"):
        return _name_remedy(line, column)
    if said == "Invalid statement":
        if re.match(r"\s*(//|/\*|;|%|--)", line):
            return "A comment begins with #."
        return "The name before the = is missing." if here == "=" else ""
    if said.startswith("Invalid initial character for a key part") and here == "}":
        return "Leave out the comma before the }."
    if not here and "{" in before and said.startswith(("Invalid initial character", "Unclosed inline table")):
        return "Write a table in { } in one line, or as a table [NAME]."
    if found := _value_remedy(_value(said, line, column)):
        return found
    if "Unclosed array" in said and re.match(r"\s*[\w.\"']+\s*=", line[column - 1 :]):
        return "Close the list with ] before this line."
    if said == "Invalid value" and plain.count('"') % 2:
        return "A quote is missing."
    if said.startswith("Unclosed"):
        return "Write a comma between the entries." if here else "Close the bracket."
    if re.search(r"\s[\w\"'.]+\s*=", line[column - 1 :]) or re.match(r"[\w\"'.]+\s*=", line[column - 1 :]):
        return "Write each entry in a line of its own."
    return ""


def _table_remedy(line: str) -> str:
    """The remedy for the head of a table."""
    name = line.strip().strip("[]").strip()
    if not name:
        return "Write the name of the table between the brackets."
    parts = [part if re.fullmatch(r"[\w-]+|\".*\"|'.*'", part, re.ASCII) else f'"{part}"' for part in name.split(".")]
    quoted = ".".join(parts)
    double = line.lstrip().startswith("[[")
    shown = f"[[{quoted}]]" if double else f"[{quoted}]"
    return f"Write {shown}." if shown != line.strip() else ""


def _name_remedy(line: str, column: int) -> str:
    """The remedy for a name without ``=`` behind it."""
    behind = line[column - 1 :]
    if re.match(r"\s*(:=?|->)", behind):
        return "Write = between name and value."
    start = max(line.rfind(mark, 0, column - 1) for mark in "{,") + 1
    name, equals, _ = line[start:].partition("=")
    if equals and '"' not in name:
        return f'Write a name with blanks or special letters in quotes: "{" ".join(name.split())}".'
    return "Write = between name and value." if behind.strip() else "Write NAME = VALUE."


def _value(said: str, line: str, column: int) -> str | None:
    """The value at an error: from the mark before it to the mark behind it. None where no value can be meant."""
    start = column - 1
    if said != "Invalid value":
        start = max(line.rfind(mark, 0, start) for mark in "=[{,") + 1
        if start == 0 and not re.match(r"\s*[-+.\d]", line):
            return None
    ahead = re.sub(_QUOTED, "", line[:start])
    inside = "=" not in ahead or ahead.count("[") + ahead.count("{") > ahead.count("]") + ahead.count("}")
    ends = [end for mark in (",]}#" if inside else "#") if (end := line.find(mark, column - 1)) >= 0]
    return line[start : min(ends, default=len(line))].strip()


def _value_remedy(value: str | None) -> str:
    if value is None:
        return ""
    if word := _WORDS.get(value.lower()):
        return word
    return next((say(found) for pattern, say in _VALUES if (found := re.fullmatch(pattern, value))), "")


def _joined(text: str) -> str:
    return re.sub(r"[\s']", "", text)


def _last_statement(lines: list[str]) -> int:
    """The index of the line with the statement that the end of the file interrupts."""
    for count in range(len(lines) - 1, 0, -1):
        try:
            tomllib.loads("\n".join(lines[:count]))
        except ValueError:
            continue
        rest = [row for row in range(count, len(lines)) if lines[row].strip()]
        return rest[0] if rest else count
    return 0


def _excerpt(line: str, column: int) -> str:
    """The line for a message; of a long one the part around the column."""
    line = "".join(sign if sign.isprintable() else " " for sign in line)
    if len(line) <= MOST_SHOWN:
        return line.strip()
    start = max(0, column - MOST_SHOWN // 2)
    return f"... {line[start : start + MOST_SHOWN].strip()} ..."
