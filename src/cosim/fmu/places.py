"""Where FMUs, systems and studies are found by name."""

from __future__ import annotations

from pathlib import Path

FMU_FOLDER = Path("build") / "fmus" / "native"


_PACKAGE = Path(__file__).resolve().parents[1]


PREBUILT = _PACKAGE / "prebuilt"
"""FMUs that come with the installed package; a checkout has none there."""


def find_fmus(folder: Path) -> Path | None:
    """Where FMUs given by name are: ``build/fmus/native`` in or above ``folder`` or the working directory, else the
    FMUs that come with the package. None if there are none.
    """
    for start in (folder.resolve(), Path.cwd()):
        for place in (start, *start.parents):
            if (place / FMU_FOLDER).is_dir():
                return place / FMU_FOLDER
    return PREBUILT if PREBUILT.is_dir() else None


def study_folders() -> tuple[Path, ...]:
    """Where studies are looked for: beside the package's source tree, then inside the installed package."""
    return (_PACKAGE.parents[1] / "studies", _PACKAGE / "studies")


def shipped_file(path: str | Path) -> Path:
    """``path``; if there is no such file, the one of that name which comes with cosim, if there is one.

    The name is that in the folder ``studies``: ``shams2010/fsmc_5sin`` or ``studies/shams2010/fsmc_5sin.toml``.
    """
    path = Path(path)
    name = path.relative_to("studies") if path.is_relative_to("studies") else path
    places = () if path.exists() or path.is_absolute() else study_folders()
    candidates = (place / f"{name.as_posix()}{ending}" for place in places for ending in ("", ".toml"))
    return next(filter(Path.is_file, candidates), path)


def shipped_systems() -> dict[str, Path]:
    """System files that come with the project: ``study/system`` -> path."""
    found: dict[str, Path] = {}
    for place in study_folders():
        for path in sorted(place.glob("*/*.toml")):
            found.setdefault(f"{path.parent.name}/{path.stem}", path)
    return found
