"""The documentation as a site: python -m docs.build [--quick]. make docs calls it.

Copies this folder to build/site/source, adds the pages that docs/generate writes from the code, and runs Sphinx, which
runs the tutorials. --quick leaves these and the commands on pages out. The site is build/site/html; it needs
no server and no network.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from sphinx.cmd.build import main as sphinx

from docs import equations
from docs.generate import api, commands, components, contract, errors, explanations, formats

DOCS = Path(__file__).parent
SITE = DOCS.parent / "build" / "site"
GENERATORS: list[Callable[[Path], None]] = [
    commands.write,
    formats.write,
    api.write,
    components.write,
    equations.write,
    errors.write,
    contract.write,
    explanations.write,
]
"""Each writes its pages into the copy of docs that Sphinx reads."""


def build(*, quick: bool = False) -> int:
    """Exit code of Sphinx; a warning is an error."""
    source = SITE / "source"
    shutil.rmtree(SITE, ignore_errors=True)
    shutil.copytree(DOCS, source, ignore=shutil.ignore_patterns("generate", "build.py", "gallery.py", "__pycache__"))
    for write in GENERATORS:
        write(source)
    # programs that tutorials start find this cosim, and their outputs are as wide as a page
    os.environ.update(PATH=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", COLUMNS="80")
    options = ["-D", "plot_gallery=0", "-D", "run_commands=0"] if quick else []
    options += ["-d", str(SITE / "doctrees"), "-W", "--keep-going", "-q", "-b", "html"]
    return sphinx([*options, str(source), str(SITE / "html")])


if __name__ == "__main__":
    sys.exit(build(quick="--quick" in sys.argv[1:]))
