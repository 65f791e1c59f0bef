"""A directive for the keys of file formats, so that search and index find each key by its name."""

from __future__ import annotations

from typing import Any

from sphinx import addnodes
from sphinx.application import Sphinx


def _key(_: object, signature: str, node: addnodes.desc_signature) -> str:
    """Show a key by its path; its full name, for search and index, begins with the format."""
    file, _, path = signature.partition(" ")
    node += addnodes.desc_name(path, path)
    return f"{file}.{path}"


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_object_type("key", "key", "pair: %s; key of a file", parse_node=_key, objname="key of a file")
    return {"version": "1", "parallel_read_safe": True}
