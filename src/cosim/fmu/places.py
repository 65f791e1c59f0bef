"""Finds FMUs, systems and studies by name. All commands and functions search here."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from ..errors import DescriptionError, suggest
from .text import named_path, read_toml

FMU_FOLDER = Path("build") / "fmus" / "native"

SYSTEM_ENDINGS = (".toml", ".ssp", ".ssd")

_PACKAGE = Path(__file__).resolve().parents[1]

CHECKOUT = _PACKAGE.parents[1]
"""The folder of the source tree, if the package is an editable installation."""

PREBUILT = _PACKAGE / "prebuilt"
"""FMUs that come with the installed package. A checkout does not have this folder."""


def has_ending(path: str | Path, *endings: str) -> bool:
    """Whether a file name has one of these endings; upper and lower case count as equal."""
    return Path(path).suffix.lower() in endings


# FMUs


def find_fmus(folder: Path | None = None) -> Path | None:
    """The folder in which FMUs are looked up by name; None if there is none.

    The first of these folders that exists: ``build/fmus/native`` in or above ``folder``, the same in or above the
    working directory, the FMUs that come with the package, the FMUs built in the checkout of the package.
    """
    for start in ([] if folder is None else [folder.resolve()]) + [Path.cwd()]:
        for place in (start, *start.parents):
            if (place / FMU_FOLDER).is_dir():
                return place / FMU_FOLDER
    return next((place for place in (PREBUILT, CHECKOUT / FMU_FOLDER) if place.is_dir()), None)


def fmus_in(folder: Path) -> dict[str, Path]:
    """The FMU files of a folder by name, in the order of their names."""
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return {path.stem: path for path in files if has_ending(path, ".fmu")}


def is_fmu_path(text: str) -> bool:
    """Whether ``text`` is the path of an FMU rather than its name."""
    return has_ending(text, ".fmu") or "/" in text or "\\" in text


def find_fmu(text: str, fmus: Path | None = None, folder: Path | None = None) -> Path:
    """The file of an FMU. ``text`` is a path, relative to ``folder``, or a name in the folder ``fmus``.

    Without ``fmus``, ``find_fmus`` gives the folder. Raises DescriptionError for an unknown name. Whether a path exists
    is not checked.
    """
    if is_fmu_path(text):
        return named_path(text, folder)
    where = fmus if fmus is not None else find_fmus(folder)
    if where is None:
        start = Path.cwd() if folder is None else folder.resolve()
        raise DescriptionError(
            f"no FMU folder found for '{text}': there is no {FMU_FOLDER.as_posix()} in or above {start}. "
            "Build the FMUs, or name the folder with --fmus."
        )
    known = fmus_in(where)
    if text not in known:
        hint = "" if known else " The folder has no FMUs: build them, or name another with --fmus."
        raise DescriptionError(f"no FMU '{text}' in {where}.{suggest(text, known)}{hint}")
    return known[text]


# Systems and studies


def study_folders() -> tuple[Path, ...]:
    """The folders in which studies are looked for: first in the source tree, then inside the installed package."""
    return (CHECKOUT / "studies", _PACKAGE / "studies")


def shipped_file(path: str | Path, folder: str | Path = ".") -> Path:
    """``path`` in ``folder``, or the file of this name that comes with cosim if the former does not exist.

    Names start at the folder ``studies``: ``shams2010/fsmc_5sin`` or ``studies/shams2010/fsmc_5sin.toml``.
    """
    wanted = named_path(path, Path(folder))
    path = Path(path)
    name = path.relative_to("studies") if path.is_relative_to("studies") else path
    places = () if os.path.exists(wanted) or path.is_absolute() else study_folders()
    candidates = (place / f"{name.as_posix()}{ending}" for place in places for ending in ("", ".toml"))
    return next(filter(os.path.isfile, candidates), wanted)


def shipped_systems() -> dict[str, Path]:
    """System files that come with the project: ``study/system`` -> path."""
    found: dict[str, Path] = {}
    for path in _shipped("*/*.toml"):
        name = f"{path.parent.name}/{path.stem}"
        if name not in found and _is_system(path):
            found[name] = path
    return found


def shipped_studies() -> dict[str, Path]:
    """Studies that come with the project: name -> folder."""
    found: dict[str, Path] = {}
    for path in _shipped("*/study.py"):
        found.setdefault(path.parent.name, path.parent)
    return found


def _shipped(pattern: str) -> Iterator[Path]:
    for place in study_folders():
        yield from sorted(place.glob(pattern))


def _is_system(path: Path) -> bool:
    """Whether a TOML file is a system: it has instances, or has a base file to complete."""
    try:
        document = read_toml(path)
    except DescriptionError:
        return True  # A damaged file is listed, so that its error is seen.
    return "instances" in document or "base" in document


def base_name(text: str | Path, start: Path) -> str:
    """What the file ``start`` says as its ``base`` in order to complete the system ``text``.

    ``text`` is a path, relative to the folder of ``start`` or to the working folder, or the name of a system that comes
    with cosim. Raises DescriptionError if there is no such system.
    """
    shipped = shipped_systems()
    path = next((place for place in (start.parent / text, Path(text)) if place.is_file()), None)
    if path is None:
        name = str(text).removeprefix("studies/").removesuffix(".toml")
        if name in shipped:
            return name
        raise DescriptionError(
            f"base {text}: no such file, and no system that comes with cosim.{suggest(name, shipped)}"
        )
    for name, file in shipped.items():
        if file.resolve() == path.resolve():
            return name
    try:
        return Path(os.path.relpath(path.resolve(), start.resolve().parent)).as_posix()
    except ValueError:  # another drive of Windows
        return path.resolve().as_posix()


def find_system(text: str, fmus: Path | None = None) -> Path:
    """The file of a system. ``text`` is a path, the name of a system that comes with cosim, or an FMU (path or name).

    Raises DescriptionError for an unknown name. Whether a path exists is not checked.
    """
    path = shipped_file(text)
    if path.is_file() or has_ending(text, *SYSTEM_ENDINGS, ".fmu"):
        return path
    where = fmus if fmus is not None else find_fmus()
    known = {} if where is None else fmus_in(where)
    if text in known:
        return known[text]
    raise DescriptionError(f"{text}: no such file, system or FMU.{suggest(text, [*shipped_systems(), *known])}")
