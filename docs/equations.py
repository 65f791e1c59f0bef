"""Equations on pages of the site: the notation of docstrings, typeset as in the page of an FMU (MathML, no scripts).

    ```{equations}
    m*der(velocity) = force - b*velocity
    friction = F_C*sign(velocity)        where velocity != 0
    ```

Within a line the role does it: {equation}`sigma_1*v_d < 9.32*min(F_C, F_S)`. What ``cosim.export.mathml`` cannot read
fails the build of a page that somebody wrote; an equation of a docstring stays text (option ``text``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole

from cosim.export.mathml import STYLE, inline, statements, typeset


class Equations(SphinxDirective):
    """A block of equations."""

    has_content = True
    option_spec = {"text": directives.flag}  # noqa: RUF012 - docutils has it so

    def run(self) -> list[nodes.Node]:
        block = "\n".join(self.content)
        left = [line for lines, html in statements(block) if html is None for line in lines]
        if left and "text" not in self.options:
            raise self.error(
                f"equations: not read: {'; '.join(left)}. See src/cosim/export/mathml.py for the notation."
            )
        return [nodes.raw("", typeset(block), format="html")]


class Equation(SphinxRole):
    """An equation within a line."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        html = inline(self.text)
        if html.startswith("<code>"):
            message = self.inliner.reporter.error(f"equation: not read: {self.text}", line=self.lineno)
            return [], [message]
        return [nodes.raw("", html, format="html")], []


def write(folder: Path) -> None:
    """Write the styles of equations beside those of the site."""
    (folder / "static" / "equations.css").write_text(STYLE, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("equations", Equations)
    app.add_role("equation", Equation())
    app.add_css_file("equations.css")
    return {"version": "1", "parallel_read_safe": True}
