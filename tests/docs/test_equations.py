"""The directive and the role for equations on pages of the site."""

from __future__ import annotations

from pathlib import Path

import pytest
from lxml import html

sphinx = pytest.importorskip("sphinx.cmd.build", reason="Sphinx is not installed: install the extra docs")

CONF = """
project = "equations"
extensions = ["myst_parser", "docs.equations"]
"""
PAGE = """# Page

```{equations}
m*der(velocity) = force - b*velocity
y = 0        where x < 0
```

Passive if {equation}`sigma_1*v_d < 9.32*F_C`.
"""


def built(folder: Path, page: str) -> int:
    """Exit code of Sphinx for one page, whose HTML is in ``folder/html``."""
    (folder / "conf.py").write_text(CONF, encoding="utf-8")
    (folder / "index.md").write_text(page, encoding="utf-8")
    return sphinx.main(["-W", "-q", "-b", "html", str(folder), str(folder / "html")])


def test_equations_of_pages_are_mathml(tmp_path: Path) -> None:
    assert built(tmp_path, PAGE) == 0
    page = html.parse(str(tmp_path / "html" / "index.html")).getroot()
    assert page.xpath("//div[@class='equations']//math/@alttext") == [
        "m*der(velocity) = force - b*velocity",
        "y = 0",
        "x < 0",
    ]
    assert page.xpath("//p[contains(., 'Passive')]/math/@alttext") == ["sigma_1*v_d < 9.32*F_C"]
    assert not [name for name in page.xpath("//script/@src") if "mathjax" in name.lower()]


@pytest.mark.parametrize("page", ["# P\n\n```{equations}\ny = a b\n```\n", "# P\n\nHere {equation}`y = a b`.\n"])
def test_an_equation_that_cannot_be_read_fails_the_build(
    tmp_path: Path, page: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert built(tmp_path, page) != 0
    assert "not read: y = a b" in capfd.readouterr().err
