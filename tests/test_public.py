"""The names that ``dir()`` and tab completion show of the package and its public modules."""

from __future__ import annotations

import inspect
from importlib import import_module
from types import ModuleType

import pytest

import cosim
from docs.generate.api import PAGES, public

MODULES = [page.source for page in PAGES if page.source not in ("cosim.model", "cosim.units")]
"""``model`` and ``units`` travel in Python FMUs and import nothing from the package."""


@pytest.mark.parametrize("name", MODULES)
def test_dir_shows_the_public_names_of_a_module(name: str) -> None:
    module = import_module(name)
    shown = dir(module)
    assert {own for own, _ in public(module)} <= set(shown)
    for entry in shown:
        found = getattr(module, entry)
        assert not entry.startswith("_")
        assert not isinstance(found, ModuleType)
        if inspect.isclass(found) or inspect.isfunction(found):
            assert found.__module__.startswith("cosim."), entry
    assert not {"np", "math", "Path", "Any", "annotations", "DescriptionError", "write_file"} & set(shown)


def test_dir_of_the_packages() -> None:
    assert dir(cosim) == sorted(cosim.__all__)
    assert {f"cosim.design.{name}" for name in dir(cosim.design)} == {
        page.source for page in PAGES if page.source.startswith("cosim.design.")
    }
    assert all(isinstance(getattr(cosim.design, name), ModuleType) for name in dir(cosim.design))
    with pytest.raises(AttributeError, match="no attribute 'sweeps'"):
        cosim.design.sweeps  # noqa: B018
