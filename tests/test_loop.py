"""The compiled loop by itself: FMI functions are Python callbacks here, which write down how they are called."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.master import loop
from cosim.master.kernel import compiled

EXCHANGE = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint), ctypes.c_size_t, ctypes.c_void_p
)
STEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)


class Machine:
    """Signals, a program and functions to call; slot ``i`` is input ``i`` of whoever."""

    def __init__(self, size: int = 8) -> None:
        self.values = np.zeros(size)
        self.integers = np.zeros(size, dtype=np.int32)
        self.rows: list[dict[Any, int]] = []
        self.split = 0
        self.links: list[tuple[int, float, float]] = []
        self.calls: list[Any] = []
        self.status: dict[str, int] = {}
        self.state = np.zeros(loop.STATE_LENGTH, dtype=np.int64)
        self.record = np.zeros(0, dtype=np.uint64)
        self.log: Any = None
        self._keep: list[Any] = []

    def function(self, name: str, kind: int) -> int:
        integer = kind in (loop.SET_INTEGER, loop.SET_BOOLEAN, loop.GET_INTEGER, loop.GET_BOOLEAN)

        def called(component: int, references: Any, count: int, address: int) -> int:
            content = (ctypes.c_int if integer else ctypes.c_double) * count
            buffer = content.from_address(address)
            if kind in (loop.GET_REAL, loop.GET_INTEGER, loop.GET_BOOLEAN):
                for i in range(count):
                    buffer[i] = references[i] * 10 + len(self.calls)
            self.calls.append((name, component, list(references[:count]), list(buffer)))
            return self.status.get(name, 0)

        return self._address(EXCHANGE(called))

    def stepper(self, name: str = "step") -> int:
        def called(component: int, time: float, step: float, no_set: int) -> int:
            self.calls.append((name, component, time, step, no_set))
            return self.status.get(name, 0)

        return self._address(STEP(called))

    def _address(self, function: Any) -> int:
        self._keep.append(function)
        return int(ctypes.cast(function, ctypes.c_void_p).value or 0)

    def call(self, name: str, kind: int, references: list[int], slot: int, component: int = 77) -> dict[Any, int]:
        array = np.array(references, dtype=np.uint32)
        self._keep.append(array)
        buffer = self.values if kind in (loop.SET_REAL, loop.GET_REAL) else self.integers
        return {
            loop.COMPONENT: component,
            loop.CALL: kind,
            loop.FUNCTION: self.function(name, kind),
            loop.REFERENCES: array.ctypes.data,
            loop.COUNT: len(references),
            loop.BUFFER: buffer.ctypes.data + slot * buffer.itemsize,
            loop.SLOT: slot,
        }

    def run(
        self, end: int, last: int | None = None, *, decimation: int = 1, start: float = 0.0, h: float = 0.1
    ) -> bool:
        program = np.zeros((len(self.rows), loop.PROGRAM_COLUMNS), dtype=np.uint64)
        for number, row in enumerate(self.rows):
            for column, value in row.items():
                program[number, column] = value
        last = end if last is None else last
        if self.log is None:
            self.log = np.full((last // decimation + 1, self.record.size), np.nan)
        return bool(
            loop.advance(
                program.reshape(-1),
                self.split,
                np.array([source for source, _, _ in self.links], dtype=np.uint64),
                np.array([factor for _, factor, _ in self.links], dtype=np.float64),
                np.array([offset for _, _, offset in self.links], dtype=np.float64),
                self.values,
                self.integers,
                self.record,
                self.log,
                np.array([start, h]),
                self.state,
                end=end,
                last=last,
                decimation=decimation,
            )
        )


def stepping(machine: Machine, *, multiple: int = 1, component: int = 77) -> dict[Any, int]:
    return {
        loop.COMPONENT: component,
        loop.CALL: loop.FROM_INTEGER,
        loop.STEP: machine.stepper(),
        loop.MULTIPLE: multiple,
    }


def test_calls_of_a_point_then_steps_and_at_the_end_only_the_point() -> None:
    machine = Machine()
    machine.rows = [machine.call("set", loop.SET_REAL, [5], 0), stepping(machine)]
    machine.split = 1
    assert machine.run(2)
    assert [call[0] for call in machine.calls] == ["set", "step", "set", "step", "set"]
    assert machine.calls[0] == ("set", 77, [5], [0.0])
    assert machine.state[loop.POINT] == 2


def test_times_of_steps_are_products() -> None:
    machine = Machine()
    machine.rows = [stepping(machine)]
    assert machine.run(50, start=0.3, h=0.1)
    assert [call[2:] for call in machine.calls] == [(0.3 + k * 0.1, 0.1, 1) for k in range(50)]


def test_guard_leaves_rows_out() -> None:
    """A row of every third point, and a step of three that ends there."""
    machine = Machine()
    guard = {loop.CALL: loop.GUARD, loop.MULTIPLE: 3, loop.COUNT: 1}
    machine.rows = [guard, machine.call("set", loop.SET_REAL, [1], 0), machine.call("all", loop.SET_REAL, [1], 0)]
    machine.rows += [guard, stepping(machine, multiple=3)]
    machine.split = 3
    assert machine.run(6)
    names = [call[0] for call in machine.calls]
    assert names == ["set", "all", "all", "all", "step", "set", "all", "all", "all", "step", "set", "all"]
    steps = [call[2:4] for call in machine.calls if call[0] == "step"]
    assert steps == [(0.0, 3 * 0.1), (3 * 0.1, 3 * 0.1)]


def test_connections_transform_and_keep_what_they_set() -> None:
    machine = Machine()
    machine.values[4:7] = (1.5, -2.0, 8.0)
    machine.links = [(6, 1.0, 0.0), (4, 2.0, 0.25), (5, -1.0, 1.0)]
    machine.rows = [{**machine.call("set", loop.SET_REAL, [1, 2], 0), loop.LINKS: 2, loop.LINK: 1}, stepping(machine)]
    machine.split = 1
    assert machine.run(0)
    assert machine.calls == [("set", 77, [1, 2], [3.25, 3.0])]
    assert machine.values[:2].tolist() == [3.25, 3.0]


@pytest.mark.parametrize(
    ("convert", "kind", "sent"),
    [(loop.TO_INTEGER, loop.SET_INTEGER, [2, -3, 0]), (loop.TO_BOOLEAN, loop.SET_BOOLEAN, [1, 1, 0])],
)
def test_integers_and_booleans_are_converted(convert: int, kind: int, sent: list[int]) -> None:
    machine = Machine()
    machine.values[4:7] = (1.75, -3.25, 0.0)
    machine.links = [(4, 1.0, 0.0), (5, 1.0, 0.0), (6, 1.0, 0.0)]
    call = machine.call("set", kind, [1, 2, 3], 0)
    machine.rows = [{loop.CALL: convert, loop.SLOT: 0, loop.COUNT: 3, loop.LINKS: 3, loop.LINK: 0}, call]
    machine.rows += [stepping(machine)]
    machine.split = 2
    assert machine.run(0)
    assert machine.calls == [("set", 77, [1, 2, 3], sent)]


def test_integers_read_become_doubles() -> None:
    machine = Machine()
    read = machine.call("get", loop.GET_INTEGER, [4, 2], 3)
    machine.rows = [read, {loop.CALL: loop.FROM_INTEGER, loop.SLOT: 3, loop.COUNT: 2}, stepping(machine)]
    machine.split = 2
    assert machine.run(0)
    assert machine.values.tolist() == [0, 0, 0, 40, 20, 0, 0, 0]


def test_rows_hold_the_values_of_the_point() -> None:
    """What is read after the step of point k stands in row k + 1; the first row is what was there."""
    machine = Machine()
    machine.values[3] = -1.0
    machine.record = np.array([3, 0], dtype=np.uint64)
    machine.rows = [{**machine.call("get", loop.GET_REAL, [1], 3), loop.STEP: machine.stepper(), loop.MULTIPLE: 1}]
    assert machine.run(3)
    assert machine.log[:, 0].tolist() == [-1.0, 11.0, 13.0, 15.0]
    assert machine.state[loop.ROWS] == 4


@pytest.mark.parametrize("chunk", [1, 2, 3, 7])
@pytest.mark.parametrize("decimation", [1, 4])
def test_in_chunks_as_in_one_go(chunk: int, decimation: int) -> None:
    def made() -> Machine:
        machine = Machine()
        machine.record = np.array([3], dtype=np.uint64)
        machine.rows = [machine.call("set", loop.SET_REAL, [1], 0)]
        machine.rows += [{**machine.call("get", loop.GET_REAL, [1], 3), loop.STEP: machine.stepper(), loop.MULTIPLE: 1}]
        machine.split = 1
        return machine

    whole, parts = made(), made()
    assert whole.run(21, decimation=decimation)
    for end in [*range(chunk, 21, chunk), 21]:
        assert parts.run(end, 21, decimation=decimation)
    assert parts.calls == whole.calls
    assert parts.log.tolist() == whole.log.tolist()
    assert not np.isnan(whole.log).any()


@pytest.mark.parametrize("status", [2, 3, 4, 5, -1])
@pytest.mark.parametrize("name", ["set", "get", "step"])
def test_any_status_but_ok_and_warning_stops(name: str, status: int) -> None:
    machine = Machine()
    machine.record = np.array([3], dtype=np.uint64)
    machine.rows = [machine.call("set", loop.SET_REAL, [1], 0, component=70)]
    machine.rows += [
        {
            **machine.call("get", loop.GET_REAL, [1], 3, component=71),
            loop.STEP: machine.stepper(),
            loop.MULTIPLE: 1,
        }
    ]
    machine.split = 1
    assert machine.run(2, 9)
    machine.status[name] = status
    assert not machine.run(9)
    assert machine.state[loop.POINT] == 2
    assert machine.state[loop.ROWS] == (2 if name == "set" else 3)
    assert machine.state[loop.FAILED_COMPONENT] == (70 if name == "set" else 71)
    function = {"set": "fmi2SetReal", "get": "fmi2GetReal", "step": "fmi2DoStep"}[name]
    assert loop.FUNCTIONS[machine.state[loop.FAILED_FUNCTION]] == function
    assert machine.state[loop.FAILED_STATUS] == status


def test_warnings_are_counted() -> None:
    machine = Machine()
    machine.rows = [machine.call("set", loop.SET_REAL, [1], 0), stepping(machine)]
    machine.split = 1
    machine.status = {"set": 1, "step": 1}
    assert machine.run(10)
    assert machine.state[loop.WARNINGS] == 21


def in_new_process(code: str, cache: Path) -> str:
    """What ``code`` prints in a process whose user cache is ``cache`` and whose package folder cannot be written."""
    start = "import sys; from pathlib import Path; from cosim import loop\n"
    folders = f"loop._folders = lambda: (Path('/proc/nowhere'), Path({str(cache)!r}))\n"
    run = subprocess.run([sys.executable, "-c", start + folders + code], capture_output=True, text=True, check=True)
    return run.stdout


def test_machine_code_is_kept_and_loaded_without_numba(tmp_path: Path) -> None:
    code = "loop._machine_code(); print('numba' in sys.modules)"
    assert in_new_process(code, tmp_path) == "True\n"
    (file,) = tmp_path.iterdir()
    assert in_new_process(code, tmp_path) == "False\n"
    file.write_bytes(file.read_bytes()[:-100])
    assert in_new_process(code, tmp_path) == "True\n"
    assert in_new_process(code, tmp_path) == "False\n"
    assert list(tmp_path.iterdir()) == [file]


def test_machine_code_needs_nothing_from_python(tmp_path: Path) -> None:
    """No reference counts, no exceptions, no lock: only instructions of the compiler itself."""
    _, text = compiled()
    declared = [line for line in text.splitlines() if line.startswith("declare")]
    assert all("@llvm." in line for line in declared), declared
