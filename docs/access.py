"""What Sphinx's HTML lacks for people who use a keyboard: boxes that scroll can be reached."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

SCROLLING = re.compile(r'<pre(?=[ >])|<div(?= class="table-wrapper)')


def reachable(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Gives blocks of code and wide tables, which scroll on narrow screens, a place in the order of tabs."""
    del app, page, template, doctree
    if "body" in context:
        context["body"] = SCROLLING.sub(r'\g<0> tabindex="0"', context["body"])


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("html-page-context", reachable, priority=900)
    return {"version": "1", "parallel_read_safe": True}
