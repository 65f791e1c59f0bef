"""Errors of TOML files: file, line, column, the line itself, and a remedy that can be read."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import DescriptionError
from cosim.fmu.text import read_toml
from cosim.fmu.toml_errors import explained


def message(tmp_path: Path, text: str) -> str:
    path = tmp_path / "stage.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError) as caught:
        read_toml(path)
    return str(caught.value)


REPAIRED = {
    "1/4000": '"1/4000"',
    "1.5 / 30": '"1.5/30"',
    ".5": "0.5",
    "-.5e3": "-0.5e3",
    "5.": "5.0",
    "5.e3": "5.0e3",
    "1e-4 s": '"1e-4 s"',
    "10mm": '"10mm"',
    "180 N/um": '"180 N/um"',
    "5 %": '"5 %"',
    "1_000,5": "1000.5",
    "1.000,5": "1000.5",
    "0,25": "0.25",
    "1 000": "1000",
    "1'000'000": "1000000",
    "007": "7",
    "-01.5": "-1.5",
    "True": "true",
    "FALSE": "false",
    "yes": "true",
    "Off": "false",
    "NaN": "nan",
    "-Infinity": "-inf",
    "plant.fmu": '"plant.fmu"',
    "(1, 2)": "[1, 2]",
    "2026-13-01": '"2026-13-01"',
}
"""Values that TOML does not know, and how they are written."""


ALONE = ("x = {}", "  x = {} # note")
INSIDE = ("x = [1.0, {}]", "x = {{ a = 1, b = {} }}", "x = [\n{},\n2]")
FORMS = [(value, form) for value in REPAIRED for form in (ALONE if "," in value else (*ALONE, *INSIDE))]
"""Inside brackets a comma divides two values."""


@pytest.mark.parametrize(("value", "form"), FORMS)
def test_a_value_is_told_as_it_is_written(tmp_path: Path, value: str, form: str) -> None:
    text = "[a]\nfirst = 1\n" + form.format(value)
    said = message(tmp_path, text)
    right = REPAIRED[value]
    assert right in said.rpartition("'. ")[2]
    row = next(row for row, line in enumerate(text.split("\n")) if value in line)
    assert said.startswith("stage.toml: not valid TOML: ")
    assert f"(line {row + 1}, column " in said
    assert f"'{text.split(chr(10))[row].strip()}'" in said
    assert tomllib.loads(text.replace(value, right))


@pytest.mark.parametrize(
    ("line", "remedy"),
    [
        ("x : 5", "Write = between name and value."),
        ("x: 5", "Write = between name and value."),
        ("x := 5", "Write = between name and value."),
        ("t = { a: 1 }", "Write = between name and value."),
        ("x == 5", "Write one =."),
        ("x =", "The value is missing."),
        ("x = # later", "The value is missing."),
        ("t = { a = , b = 2 }", "The value is missing."),
        ("x", "Write NAME = VALUE."),
        ("= 5", "The name before the = is missing."),
        ("my name = 5", 'quotes: "my name".'),
        ("my\tname = 5", 'quotes: "my name".'),
        ("größe = 5", 'quotes: "größe".'),
        ("t = { my name = 5 }", 'quotes: "my name".'),
        ("[my table]", 'Write ["my table"].'),
        ("[instances.my plant]", 'Write [instances."my plant"].'),
        ("[[b]", "Write [[b]]."),
        ("[b", "Write [b]."),
        ("[]", "Write the name of the table between the brackets."),
        ("x = “abc”", "Write straight quotes, \" or '."),
        ("x = \N{LEFT SINGLE QUOTATION MARK}abc\N{RIGHT SINGLE QUOTATION MARK}", "Write straight quotes, \" or '."),
        ("„x“ = 5", "Write straight quotes, \" or '."),
        ("x = \N{MINUS SIGN}5", "Write - in place of the character U+2212."),
        ("x =\N{NO-BREAK SPACE}5", "Write a usual blank in place of the character U+00A0."),
        (r'x = "C:\stage\log.csv"', "Write / in paths, or single quotes."),
        (r'x = "C:\users\log.csv"', "Write / in paths, or single quotes."),
        ('x = "abc', "A quote is not closed."),
        ("x = 'abc", "A quote is not closed."),
        ('x = abc"', "A quote is missing."),
        ("x = 5;", "Leave out the semicolon."),
        ("// comment", "A comment begins with #."),
        ("; comment", "A comment begins with #."),
        ("x = 5 // half", "Leave out what follows 5, or begin a comment with #."),
        ("x = 5 y = 6", "Write each entry in a line of its own."),
        ("x = [1 2]", "Write a comma between the entries."),
        ("t = { a = 1 b = 2 }", "Write a comma between the entries."),
        ("t = { a = 1, }", "Leave out the comma before the }."),
        ("t = { a = 1,", "Write a table in { } in one line, or as a table [NAME]."),
        ("t = { a = 1,5 }", "Write a decimal point: 1.5."),
        ("x = [1, 2", "Close the list with ] before this line."),
        ("x = None", "TOML has no empty value: leave the entry out."),
        ("x = 2*3", "TOML does not compute: write the number."),
        ("x = pi/2", "TOML does not compute: write the number."),
        ("first = 2", "A name can be given once: keep one of the entries."),
        ("[a]", "A name can be given once: keep one of the entries."),
    ],
)
@pytest.mark.parametrize("last", [False, True])
def test_the_remedy_of_a_line(tmp_path: Path, line: str, remedy: str, last: bool) -> None:
    said = message(tmp_path, f"[a]\nfirst = 1\n{line}" + ("" if last else "\nnext = 3\n"))
    if line == "x = [1, 2":
        assert said.endswith("Close the bracket." if last else remedy)
        return
    assert said.endswith(remedy)
    assert said.startswith("stage.toml: not valid TOML: ")
    assert "(line 3, " in said
    assert " ".join(line.split()) in " ".join(said.split())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = 1\n\ny = [1,\n 2\n", "Unclosed array (line 3, not closed until the end of the file): 'y = [1,'."),
        ('x = 1\ny = """\nabc\n', "Unterminated string (line 2, not closed until the end of the file)"),
        ("x = 1\ny = " + "9" * 5000, "4300 digits"),
        ("x = 1\ny = 1e99999999999999999999", "an exponent that is too large (line 2)"),
        ('x = 1\ny = "a\\u0000"', "U+0000 (line 2)"),
        ("x = 1\n" + "y = [" + 200 * "1, " + ".5]", "... "),
    ],
)
def test_the_place_of_what_does_not_end(tmp_path: Path, text: str, said: str) -> None:
    found = message(tmp_path, text)
    assert said in found
    assert "line 2" in found or "line 3" in found
    assert len(found) < 500


LETTERS = st.sampled_from(list("ax1.-_=,:;/'\"[]{}#\\ \t\n“µ(eT"))


@given(st.lists(LETTERS, max_size=40).map("".join))
def test_every_error_has_a_line(text: str) -> None:
    error: ValueError | None = None
    try:
        tomllib.loads(text)
    except ValueError as found:
        error = found
    assert error is None or "(line " in explained(text, error)


def test_a_file_of_another_editor_is_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    from cosim.commands.cli import main

    (tmp_path / "studies" / "own").mkdir(parents=True)
    text = 'description = "With a mark"\n[instances]\n'
    (tmp_path / "studies" / "own" / "marked.toml").write_text(text, encoding="utf-16")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cosim.fmu.places.study_folders", lambda: [tmp_path / "studies"])
    assert main(["list"]) == 0
    assert "With a mark" in capsys.readouterr().out
