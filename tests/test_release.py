"""``.ci/release.py``: what may be released, and that the same files give the same bytes."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from conftest import ROOT

import cosim.version

CHANGELOG = "# Changelog\n\n## [Unreleased]\n{unreleased}\n## [0.1.0] - {date}\n{entries}"


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("release", ROOT / ".ci" / "release.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["release"] = module
    spec.loader.exec_module(module)
    return module


release: Any = load()
FILES = ("index.html", "static/a.css", "static/a.zip")
VERSION = release.Version("0.1.0", datetime(2026, 11, 26, tzinfo=UTC))


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree that may be released, with its parts built."""
    root = tmp_path / "tree"
    root.mkdir()
    for name in ("pyproject.toml", "CITATION.cff", "constraints.txt"):
        shutil.copy(ROOT / name, root)
    (root / "src" / "cosim").mkdir(parents=True)
    shutil.copy(ROOT / release.VERSION_FILE, root / release.VERSION_FILE)
    write_changelog(root)
    (root / "build" / "dist").mkdir(parents=True)
    (root / "build" / "dist" / "motion_cosim-0.1.0-py3-none-any.whl").write_bytes(b"wheel")
    (root / "build" / "dist" / "motion_cosim-0.1.0.tar.gz").write_bytes(b"sdist")
    site = root / "build" / "site" / "html"
    (site / "static").mkdir(parents=True)
    (site / "index.html").write_text("<h1>Start</h1>", encoding="utf-8")
    (site / "static" / "a.css").write_text("h1 {}", encoding="utf-8")
    (site / ".buildinfo").write_text("of Sphinx", encoding="utf-8")
    write_download(site / "static" / "a.zip", year=2001)
    return root


def write_download(path: Path, year: int) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(zipfile.ZipInfo("a.py", (year, 1, 1, 0, 0, 0)), "print(1)")


def write_changelog(root: Path, date: str = "2026-11-26", unreleased: str = "", entries: str = "- First.\n") -> None:
    text = CHANGELOG.format(date=date, unreleased=unreleased, entries=entries)
    (root / "CHANGELOG.md").write_text(text, encoding="utf-8")


def test_this_version_has_a_section_of_the_changelog(tree: Path) -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    # Entries of the next release may wait under [Unreleased] until it is made.
    (tree / "CHANGELOG.md").write_text(
        re.sub(r"(?s)(## \[Unreleased\]\n).*?(?=^## )", r"\1", text, flags=re.M), "utf-8"
    )
    assert release.changelog_version(tree).number == VERSION.number == cosim.version.VERSION


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"date": "unreleased"}, "has no date: write '## [0.1.0] - YYYY-MM-DD'"),
        ({"date": "2026-13-01"}, "has no date"),
        ({"entries": "\n"}, "the section of version 0.1.0 is empty"),
        ({"unreleased": "- Late.\n"}, "move the entries of [Unreleased]"),
    ],
)
def test_a_changelog_that_is_not_ready_is_refused(tree: Path, changes: dict[str, str], said: str) -> None:
    assert release.changelog_version(tree) == VERSION
    write_changelog(tree, **changes)
    with pytest.raises(ValueError) as caught:  # noqa: PT011 (the text is compared below)
        release.changelog_version(tree)
    assert said in str(caught.value)


def test_another_version_needs_a_section_and_a_citation(tree: Path) -> None:
    (tree / release.VERSION_FILE).write_text('VERSION = "0.2.0"\n', encoding="utf-8")
    with pytest.raises(ValueError, match=r"no section of version 0.2.0 .*\n.*CITATION.cff has version 0.1.0"):
        release.changelog_version(tree)


def test_what_is_not_committed_is_refused(tmp_path: Path) -> None:
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    environment = {**os.environ, "GIT_CONFIG_GLOBAL": os.devnull}
    subprocess.run(["git", "init", "--quiet", str(tmp_path)], env=environment, check=True)
    release.check_tree(tmp_path)
    (tmp_path / "note.txt").touch()
    with pytest.raises(ValueError, match=r"not committed:\n\?\? note.txt"):
        release.check_tree(tmp_path)


def test_a_package_of_another_release_is_refused(tree: Path) -> None:
    (tree / "constraints.txt").write_text("numpy==1.0\nnobody-has-this==2.0\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"numpy \S+ \(not 1.0\)\.$"):
        release.check_packages(tree)


def test_the_files_of_a_release_are_the_same_twice(tree: Path, tmp_path: Path) -> None:
    """The second tree has other dates, another folder and its files in another order."""
    first = release.collect(tree, VERSION)
    other = tmp_path / "another folder" / "tree"
    shutil.copytree(tree, other, ignore=shutil.ignore_patterns("release", "html"), copy_function=shutil.copyfile)
    for path in sorted((tree / "build" / "site" / "html").rglob("*.*"), reverse=True):
        target = other / path.relative_to(tree)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(path.read_bytes())
        os.utime(target, (1e9, 1e9))
    write_download(other / "build" / "site" / "html" / "static" / "a.zip", year=2002)
    second = release.collect(other, VERSION)
    files = {path.name: path.read_bytes() for path in first.iterdir()}
    assert sorted(files) == [
        "SHA256SUMS",
        "motion_cosim-0.1.0-docs.zip",
        "motion_cosim-0.1.0-py3-none-any.whl",
        "motion_cosim-0.1.0.cdx.json",
        "motion_cosim-0.1.0.tar.gz",
    ]
    assert {path.name: path.read_bytes() for path in second.iterdir()} == files


def test_sums_are_those_of_the_files(tree: Path) -> None:
    folder = release.collect(tree, VERSION)
    lines = (folder / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 4
    for line in lines:
        digest, _, name = line.partition("  ")
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest


def test_the_site_is_one_folder_of_a_zip(tree: Path) -> None:
    folder = release.collect(tree, VERSION)
    with zipfile.ZipFile(folder / "motion_cosim-0.1.0-docs.zip") as archive:
        assert archive.namelist() == [f"motion_cosim-0.1.0-docs/{name}" for name in FILES]
        assert archive.read("motion_cosim-0.1.0-docs/index.html") == b"<h1>Start</h1>"


@pytest.mark.parametrize(
    ("gone", "said"),
    [("dist/motion_cosim-0.1.0.tar.gz", "make wheel"), ("site/html/index.html", "python -m docs.build")],
)
def test_a_part_that_is_not_built_is_named(tree: Path, gone: str, said: str) -> None:
    (tree / "build" / gone).unlink()
    with pytest.raises(ValueError, match=said):
        release.collect(tree, VERSION)


@pytest.fixture(scope="module")
def bill() -> dict[str, Any]:
    return json.loads(release.bill_of_materials(ROOT, VERSION, b"wheel"))


def test_the_bill_names_every_requirement_of_the_wheel(bill: dict[str, Any]) -> None:
    scope = {component["bom-ref"]: component["scope"] for component in bill["components"]}
    optional = release.project(ROOT)["optional-dependencies"]
    for requirement in release.direct(ROOT):
        assert scope[release.canonicalize_name(requirement.name)] == "required"
    for extra in ("build", "plots", "parquet", "report", "tools"):
        for requirement in map(release.Requirement, optional[extra]):
            if requirement.name != "motion-cosim":
                assert release.canonicalize_name(requirement.name) in scope
    assert scope["matplotlib"] == scope["ziglang"] == "optional"
    assert scope["nbformat"] == "required"  # through FMPy
    assert "pytest" not in scope


def test_the_bill_names_what_is_compiled_in(bill: dict[str, Any]) -> None:
    components = {component["bom-ref"]: component for component in bill["components"]}
    for name, _, _ in release.LINKED:
        component = components[f"linked {name}"]
        assert component["version"] == components["ziglang"]["version"]
        assert component["licenses"]
    (own,) = [entry for entry in bill["dependencies"] if entry["ref"] == "motion-cosim"]
    assert {"fmpy", "numpy", "linked compiler_rt"} <= set(own["dependsOn"])


def test_the_bill_belongs_to_the_wheel(bill: dict[str, Any]) -> None:
    main = bill["metadata"]["component"]
    assert main["purl"] == "pkg:pypi/motion-cosim@0.1.0"
    assert main["hashes"] == [{"alg": "SHA-256", "content": hashlib.sha256(b"wheel").hexdigest()}]
    assert json.loads(release.bill_of_materials(ROOT, VERSION, b"another"))["serialNumber"] != bill["serialNumber"]


def test_a_package_of_another_system_has_no_version() -> None:
    found = release.closure([release.Requirement("no-such-package>=1; sys_platform == 'win32'")])
    if sys.platform == "win32":
        pytest.skip("here it would have to be installed")
    assert found["no-such-package"].version == ""
    with pytest.raises(ValueError, match="no-such-package is not installed"):
        release.closure([release.Requirement("no-such-package>=1")])
