"""``cosim build``: builds FMUs from components of the library or from the user's own files.

Large packages are imported only when the command runs.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import CosimError, DescriptionError, FileError, suggest
from ..extras import require
from .console import Bar, make_table, print_error, print_note, standard_output
from .parser import EXIT_CODES

if TYPE_CHECKING:
    from ..export.workspace import Flavour, Workspace

LABELS: Mapping[Flavour, str] = {"native": "Native", "python": "Python", "fmi3": "Native FMI 3.0"}
NEEDED: Mapping[str, Sequence[str]] = {
    "native": ("casadi", "ziglang"),
    "python": ("casadi", "pythonfmu", "ziglang"),
}
"""For each flavour, the packages that it needs from the extra ``build``."""


def add(commands: Any) -> None:
    """Add ``build`` to the subparsers of ``cosim``."""
    parser = commands.add_parser(
        "build",
        help="build FMUs from components",
        description="Build FMUs from components: FILE.py with one, FILE.py:CLASS, or names of the library.",
    )
    parser.examples = ("cosim build CascadeP -o my_fmus",)
    parser.exit_codes = {
        **EXIT_CODES,
        1: "the compiler failed, or a file could not be written",
        2: "a component breaks a rule, or an option is wrong",
    }
    parser.add_argument("names", nargs="+", metavar="FILE.py[:CLASS]", help="a component's file, or a library name")
    build_arguments(parser)
    parser.set_defaults(command=_run)


def build_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``cosim build`` and ``build_fmus.py``."""
    parser.add_argument(
        "--flavour",
        choices=["native", "python", "both"],
        default="native",
        help="native is compiled, python needs PythonFMU and Python on the target (default: native)",
    )
    parser.add_argument("--fmi", type=int, choices=[2, 3], default=2, help="version of the interface (default: 2)")
    parser.add_argument(
        "--platform", default="host", metavar="NAME", help="host, all, or one such as linux64 (default: host)"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="DIR",
        help="folder of the FMUs; with --flavour both, folders within it (default: the current folder; build_fmus.py: "
        "build/fmus)",
    )


def _run(options: argparse.Namespace) -> int:
    """Build FMUs into ``--output`` (default: the current folder)."""
    from ..export.workspace import Workspace

    return build_all(options, Workspace(library(), cache_folder()), Path())


def build_all(options: argparse.Namespace, workspace: Workspace, default: Path, split: bool = False) -> int:
    """Build the FMUs that the options name. Returns the exit code: 2 for a wrong description, 1 for another error.

    FMUs are written to ``--output``, or to ``default`` without this option. With several flavours, each flavour has its
    own folder inside it. With ``split``, ``default`` always has a folder for each flavour.
    Raises DescriptionError for wrong options or missing packages.
    """
    from ..export.compile import BuildError

    if options.fmi == 3 and options.flavour != "native":
        raise DescriptionError("--fmi 3: PythonFMU makes FMI 2.0 only. Leave --flavour out.")
    flavours: tuple[Flavour, ...] = ("native", "python") if options.flavour == "both" else (options.flavour,)
    if options.fmi == 3:
        flavours = ("fmi3",)
    for flavour in flavours:
        for package in NEEDED["python" if flavour == "python" else "native"]:
            require(package, "building")
    workspace, names = workspace.choose(options.names or tuple(workspace.components()))
    platforms = {flavour: _platforms(options.platform, flavour) for flavour in flavours}
    base, apart = options.output or default, len(flavours) > 1 or (split and options.output is None)
    errors: list[CosimError] = []
    for flavour in flavours:
        errors += _build(workspace, names, base / flavour if apart else base, platforms[flavour], flavour)
    if not errors:
        _tell_drafts(workspace, names)
    if any(isinstance(error, BuildError | FileError) for error in errors):
        return 1
    return 2 if errors else 0


def library() -> Path:
    """The folder that contains ``fmus/``: a work tree, or the folder where the package is installed."""
    installed = Path(__file__).parents[2]
    return installed if (installed / "fmus").is_dir() else installed.parent


def cache_folder() -> Path:
    """The folder of compiled binaries: ``build/cache`` in a work tree, else in the user's cache folder."""
    tree = library()
    if (tree / "pyproject.toml").is_file():
        return tree / "build" / "cache"
    try:
        if sys.platform == "win32":
            user = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
        elif sys.platform == "darwin":
            user = Path.home() / "Library" / "Caches"
        else:
            user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        (user / "motion-cosim").mkdir(parents=True, exist_ok=True)
        if os.access(user / "motion-cosim", os.W_OK):
            return user / "motion-cosim"
    except (OSError, RuntimeError):  # no home folder, or it cannot be written to
        pass
    return Path(tempfile.gettempdir()) / f"motion-cosim-{os.getuid() if hasattr(os, 'getuid') else 'cache'}"


def build_loop(platform: str, cache: Path) -> None:
    """Compile the master's inner loop for the platforms of ``--platform``, unless it exists already."""
    from ..export.loop_library import FOLDER, compile_loop

    compile_loop(_platforms(platform, "native"), FOLDER, cache)


def _platforms(choice: str, flavour: Flavour) -> tuple[str, ...]:
    from ..export.compile import TARGETS, host_platform
    from ..export.python.python_package import BINARIES

    known = tuple(BINARIES if flavour == "python" else TARGETS)
    if choice == "all":
        return known
    if choice not in ("host", *TARGETS):
        raise DescriptionError(f"--platform {choice}: there is no such platform.{suggest(choice, ('host', *known))}")
    return (host_platform() if choice == "host" else choice,)


def _build(
    workspace: Workspace, names: Sequence[str], output: Path, platforms: tuple[str, ...], flavour: Flavour
) -> list[CosimError]:
    """Build the changed FMUs of one flavour and show a table. Returns the errors."""
    stale = workspace.stale(names, output, platforms, flavour)
    seconds: dict[str, float] = {}
    problems: dict[str, CosimError] = {}
    with Bar(f"Building {LABELS[flavour]} FMUs") as bar:
        for name, spent, error in workspace.build(stale, output, platforms, flavour) if stale else ():
            seconds[name] = spent
            if error:
                problems[name] = error
            bar.update(len(seconds), len(stale), name)
    numbers = ("Size / kB", "Time / s")
    title = f"{LABELS[flavour]} FMUs in {output} for {', '.join(platforms)}"
    table = make_table("FMU", *numbers, "State", right=numbers, title=title)
    for name in names:
        state = "failed" if name in problems else "built" if name in seconds else "unchanged"
        target = output / f"{name}.fmu"
        size = f"{target.stat().st_size / 1024:.0f}" if target.exists() else ""
        table.add_row(name, size, f"{seconds[name]:.1f}" if name in seconds else "", state)
    standard_output().print(table)
    for name in names:
        for remark in workspace.remarks(output / f"{name}.fmu") if name not in problems else ():
            print_note(f"note: {remark}")
    for error in problems.values():
        for line in error.problems if isinstance(error, DescriptionError) else (str(error),):
            print_error(line)
    return list(problems.values())


def _tell_drafts(workspace: Workspace, names: Sequence[str]) -> None:
    """Print a note for each component that lacks files for a release."""
    from ..export.assets import folder, missing_assets

    for name in names:
        path = workspace.components()[name]
        missing = missing_assets(path, name)
        if missing:
            place = folder(path, name)
            inside = place.is_relative_to(workspace.root)
            where = f" A release has them in {place.relative_to(workspace.root).as_posix()}." if inside else ""
            print_note(f"{name} is a draft: its FMU lacks {', '.join(missing)}.{where}")


def make_references(workspace: Workspace, names: Sequence[str]) -> int:
    """Write ``fmus/references``. Returns the number of components whose FMU does not agree with its references."""
    from fmus.references.experiments import EXPERIMENTS
    from fmus.references.icons import drawer

    from ..reference.make import write

    failed = 0
    for name in names:
        if name not in EXPERIMENTS:
            print_note(f"{name}: no experiments in fmus/references/experiments.py, no references.")
            continue
        try:
            report = write(workspace, name, EXPERIMENTS[name], drawer(name))
        except CosimError as error:
            failed += 1
            print_error(str(error))
            continue
        worst = max(signal.share for outcome in report.outcomes for signal in outcome.signals)
        print_note(f"{name}: {len(report.outcomes)} experiments, at most {worst:.2g} of a tolerance")
    return failed
