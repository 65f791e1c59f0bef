"""Pages of file formats: the lists of keys from the JSON Schemas of the models, the examples from shipped files.

A page is Markdown in ``docs/reference/formats``. Lines that begin with % are replaced: ``% keys NAME`` by all keys of
the schema NAME, ``% file PATH`` by the content of a file of the project (``% head PATH``: by its first lines),
``% metadata NAME`` by the metadata of a run.
"""

from __future__ import annotations

import json
import re
import runpy
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from cosim.master.metadata import METADATA

from .markup import directive, fenced, found_by, language_of, literal, markdown

ROOT = Path(__file__).resolve().parents[2]
WORDS = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true or false", "object": "table"}
HEAD = 6
"""Number of lines of a long file that are shown."""
_LINE = re.compile(r"^% (keys|file|head|metadata) (\S+)$", re.MULTILINE)


def write(folder: Path) -> None:
    """Fill the pages in ``reference/formats/``."""
    for page in sorted((folder / "reference" / "formats").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        page.write_text(_LINE.sub(lambda found: _filled(found[1], found[2]), text), encoding="utf-8")


def files(page: Path) -> list[Path]:
    """The files that a page of ``docs/reference/formats`` shows."""
    return [ROOT / name for what, name in _LINE.findall(page.read_text(encoding="utf-8")) if what in ("file", "head")]


def _filled(what: str, name: str) -> str:
    if what == "keys":
        return keys(name)
    if what == "metadata":
        return "\n".join(
            found_by(key) + directive("key", f"{name} {key}", markdown(text)) for key, text in METADATA.items()
        )
    path = ROOT / name
    text = path.read_text(encoding="utf-8")
    if what == "head":
        text = "\n".join([*text.splitlines()[:HEAD], "..."])
    return f"{literal(name)}:\n\n{fenced(text, language_of(path.name))}"


# ---- keys ----


class Inner(NamedTuple):
    """A table within a property: its schema by name, and how it is written."""

    reference: str
    path: str
    heading: str


def keys(name: str) -> str:
    """All keys of a format as Markdown: a heading for each table, an entry for each key."""
    schema = json.loads(runpy.run_path(str(ROOT / "docs" / "schemas" / "write.py"))["schema"](name))
    lines: list[str] = []
    waiting: list[tuple[Mapping[str, Any], str, str]] = [(schema, "", "Keys outside of tables")]
    seen: dict[str, str] = {}
    while waiting:
        table, path, heading = waiting.pop(0)
        lines += [f"## {heading}", ""]
        if path:
            lines += [markdown(table.get("description", "")), ""]
        inner: list[Inner] = []
        for key, entry in table["properties"].items():
            full = f"{path}.{key}".lstrip(".")
            found = list(_tables(entry, full, one_of=" = " in heading))
            lines.append(_entry(name, full, entry, key in table.get("required", ()), schema, seen))
            inner += found
        later = []
        for item in inner:
            if item.reference in seen:
                continue
            seen[item.reference] = item.path
            later.append((schema["$defs"][item.reference], item.path, item.heading))
        waiting = later + waiting
    return "\n".join(lines)


def _tables(entry: Mapping[str, Any], path: str, form: str = "[{}]", *, one_of: bool = False) -> Iterator[Inner]:
    """The tables in a property, by their reference in the schema."""
    if "$ref" in entry:
        bare = form.replace("[", "").replace("]", "")
        heading = f"{bare} = {{{{ ... }}}}" if one_of else form
        yield Inner(entry["$ref"].rpartition("/")[2], path, literal(heading.format(path)))
    for choices in (entry.get("anyOf"), entry.get("oneOf")):
        known = [choice for choice in choices or () if choice.get("type") != "null"]
        for choice in known:
            yield from _tables(choice, path, form, one_of=one_of or len(known) > 1)
    if "items" in entry:
        yield from _tables(entry["items"], path, "[[{}]]", one_of=one_of)
    for inner in _values(entry):
        yield from _tables(inner, f"{path}.NAME", form, one_of=one_of)


def _values(entry: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The schema of the values of a mapping with free keys; empty for other properties."""
    extra = entry.get("additionalProperties")
    return [*([extra] if isinstance(extra, Mapping) else []), *entry.get("patternProperties", {}).values()]


def _entry(  # noqa: PLR0917
    name: str, path: str, entry: Mapping[str, Any], required: bool, schema: Mapping[str, Any], seen: Mapping[str, str]
) -> str:
    facts = [_kind(entry)]
    default = entry.get("default")
    if required:
        facts.append("must be given")
    elif default not in (None, "", [], {}) and not isinstance(default, Mapping):
        facts.append(f"default {literal(_toml(default))}")
    text = entry.get("description", "")
    inner = list(_tables(entry, path))
    if not text and inner:
        text = schema["$defs"][inner[0].reference].get("description", "")
    lines = [f"*{', '.join(facts)}*", "", markdown(text)]
    for item in inner:
        if seen.get(item.reference, item.path) != item.path:
            lines += ["", f"The keys of the table are those of {literal(seen[item.reference])}."]
    return found_by(path.rpartition(".")[2]) + directive("key", f"{name} {path}", "\n".join(lines))


def _toml(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _kind(entry: Mapping[str, Any], *, several: bool = False) -> str:
    """The type of a property in words, with its rule."""
    plural = "s" if several else ""
    for choices in (entry.get("anyOf"), entry.get("oneOf")):
        if choices:
            kinds = [_kind(choice, several=several) for choice in choices if choice.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    if "$ref" in entry:
        return f"table{plural}"
    if "enum" in entry and entry.get("type") == "integer":
        return f"whole number from {min(entry['enum'])} to {max(entry['enum'])}"
    if "enum" in entry:
        return " or ".join(literal(_toml(value)) for value in entry["enum"])
    if "const" in entry:
        return literal(_toml(entry["const"]))
    if isinstance(entry.get("type"), list):
        *words, last = (WORDS[kind] for kind in entry["type"])
        return f"{', '.join(words)} or {last}"
    if entry.get("type") == "array":
        if "prefixItems" in entry:
            return f"list of {len(entry['prefixItems'])} {_kind(entry['prefixItems'][0], several=True)}"
        least, most = entry.get("minItems"), entry.get("maxItems")
        count = f"{least} " if least is not None and least == most else ""
        return f"list of {count}{_kind(entry['items'], several=True)}"
    if inner := _values(entry):
        return f"for each name: {_kind(inner[0])}"
    if "type" not in entry:
        return markdown(entry.get("description", "any value"))
    word = WORDS[entry["type"]]
    word = "trues or falses" if several and word == "true or false" else word + plural
    bounds = [
        f"{sign} {entry[key]:g}"
        for key, sign in (("minimum", "at least"), ("exclusiveMinimum", "above"), ("maximum", "at most"))
        if key in entry
    ] + [f"below {entry['exclusiveMaximum']:g}" for key in ("exclusiveMaximum",) if key in entry]
    return " ".join([word, " and ".join(bounds)]).strip()
