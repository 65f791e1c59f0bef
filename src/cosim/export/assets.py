"""What an FMU carries beside its model: reference results, validation picture and icon, made beforehand.

``build_fmus.py --references`` writes these files into ``fmus/references/NAME`` of the component's package. A component
without that folder has none. A build only copies them, so the bytes of an FMU do not depend on the solver of the
machine that builds it.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..model import Component
from .contract import Fmi

REFERENCES = "references"
"""Folder in ``fmus``."""
EXTRA = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = "fmi-ls-manifest.xml"
GUIDE = "fmi-ls-ref.txt"
"""Text file that explains the references; every component gets the same one."""
PICTURE, ICON, MEASURED = "validation.png", "model.png", "validation.json"
PLACES = {
    PICTURE: f"documentation/{PICTURE}",
    GUIDE: f"documentation/{GUIDE}",
    MEASURED: None,
}
"""Place in the FMU of each file that is no reference; None for a file that FMUs do not hold."""
ICONS: Mapping[Fmi, str] = {2: ICON, 3: "terminalsAndIcons/icon.png"}
"""Where FMI 2.0 and 3.0 look for the icon."""


def folder(component: Path, name: str) -> Path:
    """The folder of the assets of the component ``name``; ``component`` is its file, ``fmus/ROOM/name.py``."""
    return component.resolve().parent.parent / REFERENCES / name


def asset_files(component: Path, name: str) -> list[Path]:
    """The files made for a component, sorted, then the guide to the references; empty if none were made."""
    place = folder(component, name)
    if not place.is_dir():
        return []
    guide = place.parent / GUIDE
    return [*sorted(path for path in place.iterdir() if path.is_file()), *([guide] if guide.is_file() else [])]


def missing_assets(component: Path, name: str) -> list[str]:
    """Names of the assets that a component lacks for a release; a component that lacks one is a draft."""
    held = {path.name for path in asset_files(component, name)}
    wanted = {"icon": ICON, "validation experiments with references": MANIFEST, "validation picture": PICTURE}
    return [text for text, file in wanted.items() if file not in held]


def assets(kind: type[Component], fmi: Fmi = 2) -> dict[str, bytes]:
    """Member of the FMU -> content, for a component."""
    places = {**PLACES, ICON: ICONS[fmi]}
    found: dict[str, bytes] = {}
    for path in asset_files(Path(inspect.getfile(kind)), kind.__name__):
        member = places.get(path.name, f"{EXTRA}/{path.name}")
        if member is not None:
            found[member] = path.read_bytes()
    return found


def measured(component: Path, name: str) -> Mapping[str, Any] | None:
    """The results of the validation, as ``validation.json`` holds them; None for a component without validation."""
    path = folder(component, name) / MEASURED
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
