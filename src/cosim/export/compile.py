"""From C sources to shared libraries for each platform, by ziglang. Equal sources give equal bytes."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..errors import CosimError, DescriptionError
from ..files import write_file

RUNTIME = Path(__file__).with_name("runtime")
"""The folder of the C sources common to all native FMUs."""
COMMON_SOURCES = ("core.c", "integrator.c", "integrator.h", "log.h", "sampling.c", "state.c")
SOURCES = ("model.c",)
LIBRARIES = {"loop.c": "-lm", "model.c": "-lm", "proxy.c": "-ldl"}
FLAGS = (
    "-std=c99",
    "-O2",
    "-g0",
    "-s",
    "-shared",
    "-fPIC",
    "-fvisibility=hidden",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-sanitize=undefined",
    "-Wall",
    "-Wextra",
    "-Werror",
)
"""Compiler flags.

``-ffp-contract=off`` forbids fused multiply-add, so that all platforms round alike. ``-g0`` and ``-s`` leave out debug
data. ``-fno-sanitize=undefined`` switches off run-time checks that zig may add.
"""
TARGETS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "linux64": (("x86_64-linux-gnu.2.17",), ".so"),
    "win64": (("x86_64-windows-gnu",), ".dll"),
    "darwin64": (("x86_64-macos.10.13", "aarch64-macos.11.0"), ".dylib"),
    "aarch64-linux": (("aarch64-linux-gnu.2.17",), ".so"),
    "aarch64-darwin": (("aarch64-macos.11.0",), ".dylib"),
}
"""Platform folder of an FMU -> compiler targets and file ending. Two targets make a universal binary."""
TUPLES: Mapping[str, tuple[str, ...]] = {
    "linux64": ("x86_64-linux",),
    "win64": ("x86_64-windows",),
    "darwin64": ("x86_64-darwin", "aarch64-darwin"),
    "aarch64-linux": ("aarch64-linux",),
    "aarch64-darwin": ("aarch64-darwin",),
}
"""Platform of ``TARGETS`` -> its folders in FMI 3.0. If two platforms share a folder, the later binary is taken."""


class BuildError(CosimError):
    """The C compiler refused the generated sources; the message is that of the compiler."""


def host_platform() -> str:
    """The platform folder of this machine. Raises DescriptionError if there is none for it."""
    machine = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}.get(
        platform.machine().lower()
    )
    known = {
        ("Linux", "x86_64"): "linux64",
        ("Linux", "aarch64"): "aarch64-linux",
        ("Windows", "x86_64"): "win64",
        ("Darwin", "x86_64"): "darwin64",
        ("Darwin", "aarch64"): "darwin64",
    }
    found = known.get((platform.system(), machine or ""))
    if found is None:
        raise DescriptionError(
            f"no FMU platform for {platform.system()} on {platform.machine()}. Name one of: {', '.join(TARGETS)}."
        )
    return found


def compile_binary(sources: Mapping[str, bytes], name: str, cache: Path, compiled: Sequence[str] = SOURCES) -> bytes:
    """The shared library of ``sources`` for platform ``name``; it comes from the cache if nothing has changed.

    ``compiled`` names the sources that the compiler is given; these include the other ones. Raises BuildError.
    """
    targets, ending = TARGETS[name]
    slices = [_compile(sources, compiled, target, ending, cache) for target in targets]
    return slices[0] if len(slices) == 1 else _universal(slices)


def _compile(sources: Mapping[str, bytes], compiled: Sequence[str], target: str, ending: str, cache: Path) -> bytes:
    digest = hashlib.sha256(repr((FLAGS, target, importlib.metadata.version("ziglang"))).encode())
    for name in sorted(sources):
        digest.update(name.encode() + b"\0" + sources[name])
    kept = cache / "binaries" / f"{digest.hexdigest()[:32]}{ending}"
    found = _from_cache(kept)
    if found is not None:
        return found
    kept.parent.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": str((cache / "zig").resolve())}
    with tempfile.TemporaryDirectory() as folder:
        for name, content in sources.items():
            (Path(folder) / name).write_bytes(content)
        # relative names and a fixed output name: no path gets into the binary
        command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *FLAGS, *compiled, "-o", f"model{ending}"]
        if not target.startswith("x86_64-windows"):
            command += [LIBRARIES[name] for name in compiled]
        environment["ZIG_LOCAL_CACHE_DIR"] = str(Path(folder) / "local")
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise BuildError(f"compiling for {target} failed:\n{done.stderr.strip()}")
        content = (Path(folder) / f"model{ending}").read_bytes()
    write_file(kept, hashlib.sha256(content).digest() + content)
    return content


def _from_cache(kept: Path) -> bytes | None:
    """A compiled binary, stored after its hash. None if it is missing or damaged: then it has to be compiled again."""
    try:
        stored = kept.read_bytes()
    except FileNotFoundError:
        return None
    digest, content = stored[:32], stored[32:]
    return content if hashlib.sha256(content).digest() == digest else None


def _universal(slices: Sequence[bytes]) -> bytes:
    """A macOS universal binary: big-endian fat header, then each slice at a 16 kB boundary."""
    alignment = 14
    position = 1 << alignment
    header = struct.pack(">II", 0xCAFEBABE, len(slices))
    body = b""
    for content in slices:
        cpu, subtype = struct.unpack("<II", content[4:12])
        offset = position + len(body)
        header += struct.pack(">IIIII", cpu, subtype, offset, len(content), alignment)
        body += content + b"\0" * (-len(content) % (1 << alignment))
    return header + b"\0" * (position - len(header)) + body
