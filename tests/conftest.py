"""Fixtures of all tests."""

from __future__ import annotations

import contextlib
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cosim.commands.cli import main
from cosim.export.compile import host_platform
from cosim.export.loop_library import FOLDER, compile_loop
from cosim.export.workspace import Flavour, Workspace

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Background jobs of a shell without job control start so, as under nohup. Then no child process of a test could be
    # interrupted, either.
    signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
WORKSPACE = Workspace(ROOT, ROOT / "build" / "cache")
Command = Callable[..., tuple[int, str, str]]
"""Function: arguments of ``cosim`` -> its exit code, output and errors."""


def built(flavour: Flavour) -> Path:
    """The folder of the FMUs of a flavour, every one current."""
    folder = ROOT / "build" / "fmus" / flavour
    platforms = (host_platform(),)
    stale = WORKSPACE.stale(WORKSPACE.components(), folder, platforms, flavour)
    problems = [f"{name}: {error}" for name, _, error in WORKSPACE.build(stale, folder, platforms, flavour) if error]
    assert not problems, "\n".join(problems)
    return folder


@pytest.fixture(scope="session", autouse=True)
def compiled_loop() -> None:
    """The inner loop of the master, current."""
    compile_loop([host_platform()], FOLDER, WORKSPACE.cache)


@pytest.fixture(scope="session")
def native() -> Path:
    """The folder of the native FMUs, every one current."""
    return built("native")


@pytest.fixture(scope="session")
def python() -> Path:
    """The folder of the Python FMUs, every one current."""
    return built("python")


@pytest.fixture(scope="session")
def fmi3() -> Path:
    """The folder of the FMI 3.0 FMUs, every one current."""
    return built("fmi3")


@pytest.fixture
def cosim(capsys: pytest.CaptureFixture[str]) -> Command:
    """The command ``cosim``, in this process."""

    def called(*arguments: str | Path) -> tuple[int, str, str]:
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as ended:
            code = int(ended.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return called


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium without a window; tests that need it are skipped where it cannot start, with the reason.

    Of a module only: while playwright runs, its event loop is in the way of others.
    """
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: install the extra test")
    with contextlib.ExitStack() as resources:
        try:
            playwright = resources.enter_context(api.sync_playwright())
        except Exception as error:
            pytest.skip(f"the driver of playwright does not start: {error} (Debian: apt-get install libatomic1)")
        own = playwright.chromium.executable_path
        path = own if Path(own).exists() else next(filter(None, map(shutil.which, BROWSERS)), None)
        if path is None:
            pytest.skip("no Chromium on this machine (apt-get install chromium, or playwright install chromium)")
        # Containers run as root, where Chromium starts only without its sandbox.
        opened = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield opened
        opened.close()
