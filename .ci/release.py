"""A release: checks that the tree may be released, and collects its files in ``build/release``. See ``make release``.

    python .ci/release.py check      before anything is built
    python .ci/release.py collect    wheel and sdist of build/dist, site of build/site, bill of materials, SHA-256 sums

Nothing here depends on the time or the folder: the same commit and the same Python give the same bytes.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import re
import shutil
import subprocess
import sys
import tomllib
import uuid
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType, Property
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentScope, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from cosim.fmu.archive import write_zip

ROOT = Path(__file__).resolve().parents[1]
VERSION_FILE = "src/cosim/version.py"
EXTRAS = ("build", "parquet", "plots", "report", "tools")
"""The extras for users. The others serve the work on the project."""
SYSTEMS: Sequence[Mapping[str, str]] = (
    {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix"},
    {"sys_platform": "darwin", "platform_system": "Darwin", "os_name": "posix"},
    {"sys_platform": "win32", "platform_system": "Windows", "os_name": "nt"},
)
"""Systems on which the wheel is installed; a dependency of one of them is in the bill of materials."""
GLIBC = "LGPL-2.1-or-later, with unlimited permission to link the compiled file into other programs"
LINKED: Sequence[tuple[str, str, str]] = (
    ("compiler_rt", "MIT", "arithmetic that the processor lacks; all platforms"),
    ("zig libc", "MIT", "C library; win64"),
    ("mingw-w64 runtime", "ZPL-2.1", "start code of a DLL, import libraries; win64"),
    ("glibc, libc_nonshared", GLIBC, "the part of the C library that is linked statically; linux64, aarch64-linux"),
)
"""Name, license and purpose of what the compiler may link into the FMUs and the loop, beside sources of this project.

The C libraries of Linux (glibc) and macOS (libSystem) themselves are loaded when an FMU is. The declarations of FMI in
``src/cosim/export/runtime`` are this project's own: the official headers are not compiled in.
"""


@dataclass(frozen=True)
class Version:
    """The version of the package, and the date of its section in the changelog."""

    number: str
    date: datetime


@dataclass
class Package:
    """A package of the bill of materials; ``version`` is empty if it is only installed on another system."""

    name: str
    version: str = ""
    license: str = ""
    needs: frozenset[str] = frozenset()
    """Normalised names."""


def project(root: Path) -> dict[str, Any]:
    """The table ``project`` of pyproject.toml."""
    return tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def version_of(root: Path) -> str:
    """The version in ``src/cosim/version.py``. Raises ValueError if there is none."""
    found = re.search(r'^VERSION = "(.+)"$', (root / VERSION_FILE).read_text(encoding="utf-8"), flags=re.MULTILINE)
    if found is None:
        raise ValueError(f'{VERSION_FILE} has no line VERSION = "...".')
    return found[1]


def normalized(lines: Iterable[str]) -> dict[str, str]:
    """Normalised name -> version, of lines ``name==version``."""
    pairs = (line.strip().split("==") for line in lines if "==" in line)
    return {canonicalize_name(name): version for name, version in pairs}


def changelog_version(root: Path) -> Version:
    """The version to be released. Raises ValueError with all reasons why it may not be."""
    number = version_of(root)
    text = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", text, flags=re.MULTILINE | re.DOTALL))
    wanted = f"[{number}] - YYYY-MM-DD"
    problems: list[str] = []
    date = datetime(1, 1, 1, tzinfo=UTC)
    heading = next((heading for heading in sections if heading.startswith(f"[{number}]")), None)
    if heading is None:
        problems.append(f"CHANGELOG.md has no section of version {number} of {VERSION_FILE}: write '## {wanted}'.")
    else:
        try:
            date = datetime.strptime(heading, f"[{number}] - %Y-%m-%d").replace(tzinfo=UTC)
        except ValueError:
            problems.append(f"CHANGELOG.md: '## {heading}' has no date: write '## {wanted}'.")
        if not sections[heading].strip():
            problems.append(f"CHANGELOG.md: the section of version {number} is empty.")
    if sections.get("[Unreleased]", "").strip():
        problems.append(f"CHANGELOG.md: move the entries of [Unreleased] into '## {wanted}'.")
    cited = re.search(r"^version: (.+)$", (root / "CITATION.cff").read_text(encoding="utf-8"), flags=re.MULTILINE)
    if cited is None or cited[1] != number:
        problems.append(f"CITATION.cff has version {cited[1] if cited else 'none'}, {VERSION_FILE} {number}.")
    if problems:
        raise ValueError("\n".join(problems))
    return Version(number, date)


def check_tree(root: Path) -> None:
    """Raise ValueError unless the tree is a commit: what is not committed would be in the sdist or in the FMUs."""
    done = subprocess.run(
        ["git", "status", "--porcelain"], cwd=root, capture_output=True, text=True, check=False, encoding="utf-8"
    )
    if done.returncode:
        raise ValueError(f"{root} is no git checkout: {done.stderr.strip()}")
    if done.stdout:
        raise ValueError(f"Commit, or put aside, what is not committed:\n{done.stdout.rstrip()}")


def check_packages(root: Path) -> None:
    """Raise ValueError if another release of a package is installed than constraints.txt names."""
    pins = normalized((root / "constraints.txt").read_text(encoding="utf-8").splitlines())
    installed = {
        canonicalize_name(name): distribution.version
        for distribution in importlib.metadata.distributions()
        if (name := distribution.metadata["Name"])
    }
    others = [
        f"{name} {installed[name]} (not {pins[name]})" for name in pins if installed.get(name, pins[name]) != pins[name]
    ]
    if others:
        raise ValueError(f"Installed are other packages than constraints.txt has: {', '.join(others)}.")


def license_of(metadata: Any) -> str:
    """The license that a package states: an SPDX expression, or the name of its classifier."""
    if expression := metadata.get("License-Expression"):
        return expression
    classifiers = [text.rpartition(" :: ")[2] for text in metadata.get_all("Classifier") or () if "License ::" in text]
    return (
        " AND ".join(sorted(set(classifiers) - {"OSI Approved"}))
        or str(metadata.get("License") or "").partition("\n")[0]
    )


def holds(requirement: Requirement, extras: Iterable[str]) -> bool:
    """Whether a requirement counts with one of the extras on one of SYSTEMS."""
    marker = requirement.marker
    return marker is None or any(
        marker.evaluate({**system, "extra": extra}) for system in SYSTEMS for extra in ("", *extras)
    )


def closure(requirements: Iterable[Requirement]) -> dict[str, Package]:
    """All packages that ``requirements`` install, directly or through others: normalised name -> package."""
    found: dict[str, Package] = {}
    seen: set[tuple[str, frozenset[str]]] = set()
    pending = [requirement for requirement in requirements if holds(requirement, ())]
    while pending:
        requirement = pending.pop()
        key, extras = canonicalize_name(requirement.name), frozenset(requirement.extras)
        if (key, extras) in seen:
            continue
        seen.add((key, extras))
        try:
            distribution = importlib.metadata.distribution(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                raise ValueError(f"{requirement.name} is not installed: make release") from None
            found.setdefault(key, Package(requirement.name))
            continue
        children = [child for line in distribution.requires or () if holds(child := Requirement(line), extras)]
        package = found.setdefault(
            key, Package(distribution.metadata["Name"], distribution.version, license_of(distribution.metadata))
        )
        package.needs |= {canonicalize_name(child.name) for child in children}
        pending += children
    return found


def direct(root: Path, extras: Sequence[str] = ()) -> list[Requirement]:
    """The requirements of the wheel with extras."""
    about = project(root)
    lines = [*about["dependencies"], *(line for extra in extras for line in about["optional-dependencies"][extra])]
    return [Requirement(line) for line in lines if not line.startswith(f"{about['name']}[")]


def bill_of_materials(root: Path, version: Version, wheel: bytes) -> str:
    """The bill of materials of the wheel, as CycloneDX 1.6 in JSON.

    Packages have the releases that were installed, which are those of constraints.txt: the wheel was tested with these.
    Serial number and time come from the wheel and the changelog.
    """
    licenses = LicenseFactory()
    about = project(root)
    digest = hashlib.sha256(wheel).hexdigest()
    main = Component(
        name=about["name"],
        version=version.number,
        type=ComponentType.LIBRARY,
        bom_ref=about["name"],
        description=about["description"],
        licenses=[licenses.make_from_string(about["license"])],
        purl=PackageURL("pypi", name=about["name"], version=version.number),
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest)],
    )
    bom = Bom(serial_number=uuid.uuid5(uuid.NAMESPACE_URL, f"{main.purl}#{digest}"))
    bom.metadata.component = main
    bom.metadata.timestamp = version.date
    needed, everything = closure(direct(root)), closure(direct(root, EXTRAS))
    wanted: dict[str, list[str]] = {}
    for extra in ("", *EXTRAS):
        for requirement in direct(root, (extra,) if extra else ()):
            name = canonicalize_name(requirement.name)
            if not extra or name not in {canonicalize_name(base.name) for base in direct(root)}:
                wanted.setdefault(name, []).append(f"{requirement}" + (f" (extra {extra})" if extra else ""))
    components: dict[str, Component] = {}
    for key, package in sorted(everything.items()):
        components[key] = Component(
            name=package.name,
            version=package.version or None,
            bom_ref=key,
            scope=ComponentScope.REQUIRED if key in needed else ComponentScope.OPTIONAL,
            licenses=[licenses.make_from_string(package.license)] if package.license else None,
            purl=PackageURL("pypi", name=key, version=package.version or None),
            properties=[Property(name="requirement", value=line) for line in sorted(set(wanted.get(key, ())))],
        )
    compiler = components["ziglang"]
    linked = [
        Component(
            name=name,
            version=compiler.version,
            bom_ref=f"linked {name}",
            scope=ComponentScope.REQUIRED,
            description=f"Linked into FMUs and the loop of the master by ziglang, whose version this is: {purpose}",
            licenses=[licenses.make_from_string(license)],
        )
        for name, license, purpose in LINKED
    ]
    for component in (*components.values(), *linked):
        bom.components.add(component)
    bom.register_dependency(main, [*(components[key] for key in wanted), *linked])
    for key, package in everything.items():
        bom.register_dependency(components[key], [components[need] for need in package.needs])
    # sorted keys: the same bytes whatever the order inside the library
    text = json.dumps(json.loads(JsonV1Dot6(bom).output_as_string()), indent=2, sort_keys=True) + "\n"
    error = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if error is not None:
        raise ValueError(f"the bill of materials breaks its schema: {error}")
    return text


def site_archive(site: Path, target: Path) -> None:
    """The site as a zip with one folder; its bytes depend on its pages alone. Raises ValueError if there is none.

    Hidden files are left out: they are Sphinx's own, and tell times and folders. Zips within the site are packed anew,
    without the times of their files.
    """
    files: dict[str, bytes | Path] = {}
    for path in site.rglob("*"):
        name = path.relative_to(site)
        if path.is_file() and not any(part.startswith(".") for part in name.parts):
            files[f"{target.stem}/{name.as_posix()}"] = _packed_anew(path) if path.suffix == ".zip" else path
    index = f"{target.stem}/index.html"
    if index not in files:
        raise ValueError(f"{site} holds no site: python -m docs.build")
    write_zip(target, files, index, files)


def _packed_anew(path: Path) -> bytes:
    """The content of an archive that has the same members as ``path`` and no times."""
    with zipfile.ZipFile(path) as archive, TemporaryDirectory() as folder:
        members = {name: archive.read(name) for name in archive.namelist()}
        target = Path(folder) / path.name
        write_zip(target, members, min(members), members)
        return target.read_bytes()


def write_sums(folder: Path) -> None:
    """SHA256SUMS of all files of ``folder``, as ``sha256sum --check`` reads it."""
    files = sorted(path for path in folder.iterdir() if path.name != "SHA256SUMS")
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in files]
    (folder / "SHA256SUMS").write_text("".join(lines), encoding="utf-8", newline="\n")


def collect(root: Path, version: Version) -> Path:
    """Put the files of the release into ``build/release``; returns this folder. Raises ValueError if one is missing."""
    built, target = root / "build" / "dist", root / "build" / "release"
    stem = f"motion_cosim-{version.number}"
    wheel, sdist = f"{stem}-py3-none-any.whl", f"{stem}.tar.gz"
    if absent := [name for name in (wheel, sdist) if not (built / name).is_file()]:
        raise ValueError(f"{built} has no {', no '.join(absent)}: make wheel")
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    for name in (wheel, sdist):
        shutil.copyfile(built / name, target / name)
    site_archive(root / "build" / "site" / "html", target / f"{stem}-docs.zip")
    bill = bill_of_materials(root, version, (target / wheel).read_bytes())
    (target / f"{stem}.cdx.json").write_text(bill, encoding="utf-8", newline="\n")
    write_sums(target)
    return target


def main(command: str) -> int:
    """Carry out ``check`` or ``collect``; returns the exit code."""
    try:
        version = changelog_version(ROOT)
        check_tree(ROOT)
        check_packages(ROOT)
        if command == "collect":
            folder = collect(ROOT, version)
            print(f"{folder}:\n{(folder / 'SHA256SUMS').read_text(encoding='utf-8')}", end="")
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in ("check", "collect"):
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1]))
