"""Pages of the Python API: which names they show; Sphinx reads signatures and docstrings from the code."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import cosim
from docs.docstrings import restructured


class Page(NamedTuple):
    """A page: the module as users name it, where it is, and names of other modules that belong to it."""

    name: str
    source: str
    title: str
    also: Sequence[str] = ()


PACKAGE: Mapping[str, Sequence[str]] = {
    "Systems": ("read_system", "make_system", "System"),
    "Runs": ("simulate", "Simulation"),
    "Results and records": ("Result", "read_result", "Record", "read_record"),
    "Comparison": ("compare", "Comparison", "Tolerance"),
    "Pictures and pages": ("plot", "plot_comparison", "report_run", "report_comparison"),
}
"""The names of the package ``cosim`` by heading; its exceptions are on the page of errors, too."""

PAGES = (
    Page("cosim.model", "cosim.model", "declare a component"),
    Page("cosim.metrics", "cosim.result.metrics", "figures of merit"),
    Page("cosim.plots", "cosim.result.plots", "pictures"),
    Page("cosim.units", "cosim.units", "units"),
    Page(
        "cosim.design.sweep",
        "cosim.design.sweep",
        "many runs",
        ("cosim.design.plan.read_sweep", "cosim.design.plan.make_sweep", "cosim.design.plan.Sweep"),
    ),
    Page("cosim.design.friction", "cosim.design.friction", "first values from a log"),
    Page(
        "cosim.design.fit",
        "cosim.design.fit",
        "fit a system to records",
        ("cosim.design.fit_file.read_fit", "cosim.design.fit_file.make_fit", "cosim.design.fit_file.Fit"),
    ),
    Page("cosim.design.tune", "cosim.design.tune", "optimize parameters"),
    Page("cosim.design.linearize", "cosim.design.linearize", "state space"),
    Page("cosim.design.margins", "cosim.design.margins", "margins of loops"),
    Page("cosim.design.stability", "cosim.design.stability", "limits of NCTF control"),
    Page("cosim.design.identify", "cosim.design.identify", "nominal characteristic trajectory"),
    Page("cosim.design.pulse", "cosim.design.pulse", "friction pulses"),
)


def write(folder: Path) -> None:
    """Write ``reference/python/``: a page for the package and one for each public module."""
    target = folder / "reference" / "python"
    target.mkdir(parents=True, exist_ok=True)
    (target / "cosim.rst").write_text(_package(), encoding="utf-8")
    for page in PAGES:
        (target / f"{page.name}.rst").write_text(_module(page), encoding="utf-8")


def public(module: ModuleType) -> Iterator[tuple[str, object]]:
    """The public functions and classes that a module defines, in the order of its source."""
    for name, found in vars(module).items():
        own = inspect.isfunction(found) or inspect.isclass(found)
        if own and not name.startswith("_") and found.__module__ == module.__name__:
            yield name, found


def exceptions() -> list[str]:
    """The names of the exceptions of the package ``cosim``."""
    return [name for name in cosim.__all__ if _is_exception(getattr(cosim, name))]


def _is_exception(found: object) -> bool:
    return inspect.isclass(found) and issubclass(found, BaseException)


def _package() -> str:
    lines = [*_heading("cosim: systems, runs, results", "="), ".. py:module:: cosim", ""]
    lines += restructured(inspect.getdoc(cosim) or "")
    for heading, names in PACKAGE.items():
        lines += _heading(heading, "-")
        for name in names:
            lines += _entry(f"cosim.{name}", getattr(cosim, name))
    lines += _heading("Exceptions", "-")
    for name in exceptions():
        lines += _entry(f"cosim.{name}", getattr(cosim, name))
    return "\n".join(lines)


def _module(page: Page) -> str:
    module = import_module(page.source)
    lines = [*_heading(f"{page.name}: {page.title}", "="), f".. py:module:: {page.name}", ""]
    lines += restructured(inspect.getdoc(module) or "")
    for path in page.also:
        place, _, name = path.rpartition(".")
        lines += _entry(path, getattr(import_module(place), name))
    for name, found in public(module):
        lines += _entry(f"{page.name}.{name}", found)
    return "\n".join(lines)


def _heading(text: str, line: str) -> list[str]:
    return [text, line * len(text), ""]


def _entry(path: str, found: object) -> list[str]:
    if not inspect.isclass(found):
        return [f".. autofunction:: {path}", ""]
    kind = "autoexception" if _is_exception(found) else "autoclass"
    return [f".. {kind}:: {path}", "   :members:", "   :undoc-members:", "   :member-order: bysource", ""]
