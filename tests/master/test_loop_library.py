"""The loop's library: where it is found, that it agrees with its sources and with the loop in Python."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import ROOT, WORKSPACE
from fmu_files import write_probe

from cosim import make_system, read_system, simulate
from cosim.export.compile import TARGETS, compile_binary, host_platform
from cosim.export.loop_library import SOURCE, compile_loop, library_names
from cosim.master import loop

SYSTEMS = ("shams2010/fsmc_5sin", "maeda2008/step", "feng2015/circle_two_mass", "rubio2015/super_twisting_20khz")


@pytest.mark.parametrize("name", SYSTEMS)
def test_both_loops_give_the_same_rows(name: str, native: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    system = read_system(ROOT / "studies" / f"{name}.toml")
    system = system.changed(stop_time=system.start_time + 300 * system.step_size)
    assert loop.compiled() is not None
    compiled = simulate(system)
    monkeypatch.setattr(loop, "compiled", lambda: None)
    plain = simulate(system)
    assert plain.rows.tobytes() == compiled.rows.tobytes()
    assert plain.rows.shape[0] > 100


def test_both_files_name_the_same_numbers() -> None:
    text = SOURCE.read_text(encoding="utf-8")
    lists = [
        [name.strip() for name in found.split(",")] for found in re.findall(r"^enum \{(.*?)\};", text, re.M | re.S)
    ]
    assert len(lists) == 4
    for list_ in lists:
        assert [getattr(loop, name) for name in list_] == list(range(len(list_)))
    (row,) = re.findall(r"typedef struct \{([^}]*\}[^}]*\}[^}]*)\} Row;", text)
    plain = re.sub(r"union \{[^}]*\}", "", row)
    columns = [name.strip(" *\n") for name in re.findall(r"(\w+) ?[,;]", plain)]
    assert [getattr(loop, name.upper()) for name in columns] == list(range(loop.PROGRAM_COLUMNS))


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_both_loops_agree_on_all_types_and_step_multiples(
    order: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_probe(tmp_path)
    document = {
        "connections": [
            {"from": "fast.y", "to": "slow.u", "factor": 0.3, "offset": -0.1},
            *("slow.y -> fast.u", "fast.count -> slow.count_in", "slow.flag -> fast.flag_in"),
        ],
        "experiment": {"stop_time": 3.0, "step_size": 0.1, "order": order},
        "instances": {
            "fast": {"fmu": "Probe", "start": {"y_start": 1.0, "gain": -1.0}},
            "slow": {"fmu": "Probe", "step_multiple": 3},
        },
    }
    system = make_system(document, fmus=tmp_path)
    compiled = simulate(system)
    monkeypatch.setattr(loop, "compiled", lambda: None)
    assert simulate(system).rows.tobytes() == compiled.rows.tobytes()
    assert compiled.rows.shape[0] == 31


@pytest.fixture
def missing(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A machine whose library is not there."""
    path = ROOT / "loop-of-no-machine.so"
    monkeypatch.setattr(loop, "library", lambda: path)
    loop.compiled.cache_clear()
    yield path
    loop.compiled.cache_clear()


def test_a_missing_library_is_told_once_and_runs_go_on(
    native: Path, missing: Path, caplog: pytest.LogCaptureFixture
) -> None:
    system = read_system(ROOT / "studies" / "shams2010" / "fsmc_5sin.toml", stop_time=0.001)
    with caplog.at_level(logging.WARNING, "cosim"):
        assert simulate(system).time.size == 11
        assert simulate(system).time.size == 11
    (told,) = [record for record in caplog.records if record.name == "cosim"]
    assert told.getMessage().startswith(f"No compiled loop for this machine ({missing.name} is missing). ")


def test_the_library_that_is_built_is_the_one_that_is_loaded() -> None:
    assert loop.library().name == library_names([host_platform()])[host_platform()]
    assert loop.library().is_file()
    assert set(library_names(tuple(TARGETS))) == set(TARGETS)


def test_libraries_of_other_versions_are_removed(tmp_path: Path) -> None:
    old = tmp_path / "loop-000000000000-linux64.so"
    old.write_bytes(b"old")
    (path,) = compile_loop([host_platform()], tmp_path, WORKSPACE.cache)
    assert list(tmp_path.iterdir()) == [path]
    assert compile_loop([host_platform()], tmp_path, WORKSPACE.cache) == []


def test_same_bytes_without_cache(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    (cache / "zig").parent.mkdir(parents=True)
    # the C library that ziglang builds takes minutes to make; the loop itself is compiled anew
    (cache / "zig").symlink_to(WORKSPACE.cache / "zig", target_is_directory=True)
    built = compile_binary({SOURCE.name: SOURCE.read_bytes()}, host_platform(), cache, (SOURCE.name,))
    assert built == loop.library().read_bytes()
