"""The names that ``dir()`` and tab completion show of a module."""

from __future__ import annotations

from collections.abc import Callable, Mapping


def public_names(module: Mapping[str, object], *also: str) -> Callable[[], list[str]]:
    """The ``__dir__`` of a module: its public names without those of its imports, and the imported names ``also``.

    ``module`` is its ``globals()``. Call this after the imports, before the first definition.
    """
    imported = {*module, "__dir__"} - set(also)
    return lambda: sorted(name for name in module if name not in imported and not name.startswith("_"))
