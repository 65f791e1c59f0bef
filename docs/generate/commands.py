"""Pages of the commands, from the parser that reads their arguments: the same texts as ``cosim COMMAND --help``."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from cosim.commands.cli import make_parser
from cosim.commands.parser import EXIT_CODES, Parser, broken

from .markup import directive, fenced, found_by, literal, markdown

FORMATS = {"SWEEP": "sweep", "FIT": "fit", "TUNING": "tuning", "MAP": "map", "SYSTEM|FMU": "system", "SYSTEM": "system"}
"""Name of an argument -> the page of the file that it takes."""


def write(folder: Path) -> None:
    """Write ``reference/commands/``: one page for each command, and their list."""
    target = folder / "reference" / "commands"
    target.mkdir(parents=True, exist_ok=True)
    parser = make_parser()
    found = list(leaves(parser))
    for command, _ in found:
        (target / f"{page_name(command)}.md").write_text(page(command), encoding="utf-8")
    (target / "index.md").write_text(_index(parser, found), encoding="utf-8")


def leaves(parser: Parser) -> Iterator[tuple[Parser, str]]:
    """The parsers of all commands that run something, each with the short text of the list of commands."""
    for action in parser._actions:
        if not isinstance(action, argparse._SubParsersAction):
            continue
        texts = {choice.dest: choice.help or "" for choice in action._choices_actions}
        for name, inner in action.choices.items():
            if any(isinstance(a, argparse._SubParsersAction) for a in inner._actions):
                yield from leaves(inner)
            else:
                yield inner, texts.get(name, "")


def page_name(parser: Parser) -> str:
    """The file name of a command's page without its ending."""
    return "-".join(parser.prog.split()[1:])


def page(parser: Parser) -> str:
    """The page of a command."""
    parser.formatter_class = partial(argparse.HelpFormatter, width=78)  # type: ignore[assignment]
    usage = parser.format_usage().replace("usage: ", "").replace("\n       ", "\n")
    arguments = [a for a in parser._actions if not a.option_strings]
    options = [a for a in parser._actions if a.option_strings and not isinstance(a, argparse._HelpAction)]
    lines = [f"# {parser.prog}", "", f"{markdown(parser.description or '')}", "", fenced(usage, "text")]
    lines += [directive("program", parser.prog)]
    lines += ["## Example" + "s" * (len(parser.examples) > 1), ""]
    lines += [fenced(f"$ {broken(example)}", "console") for example in parser.examples]
    for title, actions in (("Arguments", arguments), ("Options", options)):
        if actions:
            lines += [f"## {title}", "", *(_option(action) for action in actions)]
    lines += ["## Exit codes", "", *_codes(parser)]
    return "\n".join(lines)


def _option(action: argparse.Action) -> str:
    values = _values(action)
    names = [f"{name} {values}".rstrip() for name in action.option_strings] or [_metavar(action)]
    text = markdown((action.help or "").replace("%%", "%"))
    notes = []
    if action.choices is not None:
        notes.append("One of " + ", ".join(literal(str(choice)) for choice in action.choices) + ".")
    if action.required and action.option_strings:
        notes.append("Must be given.")
    if not action.option_strings and action.nargs in ("+", "*"):
        notes.append("Several may be given." if action.nargs == "+" else "None, one or several may be given.")
    if not action.option_strings and (page := FORMATS.get(_metavar(action))):
        notes.append(f"Format: [{page} file](../formats/{page}.md).")
    return found_by(*action.option_strings) + directive(
        "option", ", ".join(names), "\n\n".join([text, *([" ".join(notes)] if notes else [])])
    )


def _metavar(action: argparse.Action) -> str:
    if action.metavar is not None:
        return action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar)
    if action.choices is not None:
        return "{" + ",".join(str(choice) for choice in action.choices) + "}"
    return action.dest.upper()


def _values(action: argparse.Action) -> str:
    """The values that an option takes, as in its usage."""
    name = _metavar(action)
    if action.nargs == 0:
        return ""
    return f"{name} [{name} ...]" if action.nargs == "+" else name


def _codes(parser: Parser) -> list[str]:
    return [f"{code}\n: {markdown(meaning)}\n" for code, meaning in parser.exit_codes.items()]


def _index(parser: Parser, found: list[tuple[Parser, str]]) -> str:
    lines = ["# Commands", "", markdown(parser.description or ""), ""]
    lines += ["The same texts are shown in a terminal by ``cosim COMMAND --help``.", ""]
    lines += [fenced("\n".join(f"$ {example}" for example in parser.examples), "console")]
    for command, text in found:
        lines += [f"[{command.prog}]({page_name(command)}.md)", f": {markdown(text)}", ""]
    lines += [directive("program", "cosim"), directive("option", "--version", "Show the version and exit.")]
    lines += ["## Exit codes", "", "A command that gives a code another meaning says so on its page.", ""]
    lines += [f"{code}\n: {markdown(meaning)}\n" for code, meaning in EXIT_CODES.items()]
    lines += ["```{toctree}", ":hidden:", "", *(page_name(command) for command, _ in found), "```", ""]
    return "\n".join(lines)
