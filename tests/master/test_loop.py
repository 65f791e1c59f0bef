"""The loops, compiled and in Python: FMI functions are Python callbacks here, which write down how they are called."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np
import pytest

from cosim.master import loop, loop_plain
from cosim.master.loop import BOOLEAN8, BOOLEAN32, FLOAT64, INT8, INT32, TYPES, UINT64

POINTER, REFERENCES, SIZE, REAL = ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint), ctypes.c_size_t, ctypes.c_double
FLAG = ctypes.POINTER(ctypes.c_bool)
EXCHANGE = {
    2: ctypes.CFUNCTYPE(ctypes.c_int, POINTER, REFERENCES, SIZE, POINTER),
    3: ctypes.CFUNCTYPE(ctypes.c_int, POINTER, REFERENCES, SIZE, POINTER, SIZE),
}
STEP2 = ctypes.CFUNCTYPE(ctypes.c_int, POINTER, REAL, REAL, ctypes.c_int)
STEP3 = ctypes.CFUNCTYPE(
    ctypes.c_int, POINTER, REAL, REAL, ctypes.c_bool, FLAG, FLAG, FLAG, ctypes.POINTER(ctypes.c_double)
)
Row = dict[int, int]


@pytest.fixture(autouse=True, params=["compiled", "plain"])
def implementation(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test with both loops."""
    advance = loop.compiled() if request.param == "compiled" else loop_plain.advance
    assert advance is not None
    monkeypatch.setattr(Machine, "advance", staticmethod(advance), raising=False)


class Machine:
    """Signals, a program and functions to call; slot ``i`` is input ``i`` of whoever."""

    advance: loop.Advance

    def __init__(self, size: int = 8) -> None:
        self.values = np.zeros(size)
        self.others = np.zeros(size, dtype=np.uint64)
        self.rows: list[Row] = []
        self.split = 0
        self.links: list[tuple[int, int, float, float]] = []
        self.calls: list[Any] = []
        self.seen: list[tuple[int, str] | None] = []
        """What the state said during each call."""
        self.status: dict[str, int] = {}
        self.flags: tuple[bool, bool, bool] = (False, False, False)
        """What fmi3DoStep says: event, terminate, early return."""
        self.state = np.zeros(loop.STATE_LENGTH, dtype=np.int64)
        self.record = np.zeros(0, dtype=np.uint64)
        self.log: Any = None
        self.check = True
        self._keep: list[Any] = []

    def function(self, name: str, *, into: bool, kind: int, fmi: int) -> int:
        def called(component: int, references: Any, n: int, address: int, values: int | None = None) -> int:
            count = n if values is None else values
            buffer = (TYPES[kind][1] * count).from_address(address)
            if not into:
                for i in range(count):
                    buffer[i] = references[min(i, n - 1)] * 10 + len(self.calls) + max(i - n + 1, 0)
            self.calls.append((name, component, list(references[:n]), list(buffer)))
            self.seen.append(loop.call_of(self.state))
            return self.status.get(name, 0)

        return self._address(EXCHANGE[fmi](called))

    def stepper(self, name: str = "step") -> int:
        def called(component: int, time: float, step: float, no_set: int) -> int:
            self.calls.append((name, component, time, step, no_set))
            self.seen.append(loop.call_of(self.state))
            return self.status.get(name, 0)

        return self._address(STEP2(called))

    def stepper3(self, name: str = "step") -> int:
        def called(component: int, time: float, step: float, no_set: bool, *answers: Any) -> int:
            self.calls.append((name, component, time, step, no_set))
            self.seen.append(loop.call_of(self.state))
            for answer, flag in zip(answers, self.flags, strict=False):
                answer[0] = flag
            answers[3][0] = time + (0.5 if self.flags[2] else 1.0) * step
            return self.status.get(name, 0)

        return self._address(STEP3(called))

    def _address(self, function: Any) -> int:
        self._keep.append(function)
        return int(ctypes.cast(function, ctypes.c_void_p).value or 0)

    def call(
        self,
        name: str,
        references: list[int],
        slot: int,
        *,
        into: bool,
        kind: int = FLOAT64,
        fmi: int = 2,
        instance: int = 7,
        count: int | None = None,
    ) -> Row:
        array = np.array(references, dtype=np.uint32)
        self._keep.append(array)
        buffer = self.values if kind == FLOAT64 else self.others
        called = {2: {FLOAT64: "Real", INT32: "Integer", BOOLEAN32: "Boolean"}.get(kind), 3: TYPES[kind][0]}[fmi]
        return {
            loop.FMI: fmi,
            loop.ACT: loop.EXCHANGE,
            loop.COMPONENT: 70 + instance,
            loop.FUNCTION: self.function(name, into=into, kind=kind, fmi=fmi),
            loop.CALL: loop.call_number(instance, f"fmi{fmi}{'Set' if into else 'Get'}{called}"),
            loop.REFERENCES: array.ctypes.data,
            loop.REFERENCE_COUNT: len(references),
            loop.COUNT: len(references) if count is None else count,
            loop.BUFFER: buffer.ctypes.data + slot * buffer.itemsize,
            loop.SLOT: slot,
            loop.TYPE: kind,
            loop.SET: int(into),
        }

    def stepping(self, *, multiple: int = 1, instance: int = 7, fmi: int = 2) -> Row:
        """The columns of a step."""
        return {
            loop.FMI: fmi,
            loop.COMPONENT: 70 + instance,
            loop.STEP: self.stepper() if fmi == 2 else self.stepper3(),
            loop.STEP_CALL: loop.call_number(instance, f"fmi{fmi}DoStep"),
            loop.MULTIPLE: multiple,
        }

    def run(
        self, end: int, last: int | None = None, *, decimation: int = 1, start: float = 0.0, h: float = 0.1
    ) -> bool:
        last = end if last is None else last
        if self.log is None:
            self.log = np.full((last // decimation + 1, self.record.size), np.nan)
        links = np.array(self.links, dtype=loop.LINK_TYPE)
        arrays = loop.array(self.rows), self.split, links, self.values, self.record, self.log, np.array([start, h])
        return self.advance(*arrays, self.state, end=end, last=last, decimation=decimation, check=self.check)


def test_calls_of_a_point_then_steps_and_at_the_end_only_the_point() -> None:
    machine = Machine()
    machine.rows = [machine.call("set", [5], 0, into=True), machine.stepping()]
    machine.split = 1
    assert machine.run(2)
    assert [call[0] for call in machine.calls] == ["set", "step", "set", "step", "set"]
    assert machine.calls[0] == ("set", 77, [5], [0.0])
    assert machine.state[loop.POINT] == 2


def test_times_of_steps_are_products() -> None:
    machine = Machine()
    machine.rows = [machine.stepping(), {**machine.call("get", [1], 3, into=False), **machine.stepping()}]
    assert machine.run(50, start=0.3, h=0.1)
    steps = [call[2:] for call in machine.calls if call[0] == "step"]
    assert steps == [(0.3 + k * 0.1, 0.1, 1) for k in range(50) for _ in range(2)]


def test_guard_leaves_rows_out() -> None:
    """A row of every third point, and a step of three that ends there."""
    machine = Machine()
    guard = {loop.ACT: loop.GUARD, loop.MULTIPLE: 3, loop.COUNT: 1}
    machine.rows = [guard, machine.call("set", [1], 0, into=True), machine.call("all", [1], 0, into=True)]
    machine.rows += [guard, machine.stepping(multiple=3)]
    machine.split = 3
    assert machine.run(6)
    names = [call[0] for call in machine.calls]
    assert names == ["set", "all", "all", "all", "step", "set", "all", "all", "all", "step", "set", "all"]
    steps = [call[2:4] for call in machine.calls if call[0] == "step"]
    assert steps == [(0.0, 3 * 0.1), (3 * 0.1, 3 * 0.1)]


def test_connections_transform_and_keep_what_they_set() -> None:
    machine = Machine()
    machine.values[4:7] = (1.5, -2.0, 8.0)
    machine.links = [(6, 7, 1.0, 0.0), (4, 0, 2.0, 0.25), (5, 1, -1.0, 1.0)]
    machine.rows = [{**machine.call("set", [1, 2], 0, into=True), loop.LINKS: 2, loop.LINK: 1}, machine.stepping()]
    machine.split = 1
    assert machine.run(0)
    assert machine.calls == [("set", 77, [1, 2], [3.25, 3.0])]
    assert machine.values[:2].tolist() == [3.25, 3.0]
    assert machine.values[7] == 0.0


def test_product_and_sum_are_rounded_separately() -> None:
    """A fused multiply-add would give another last bit."""
    machine = Machine()
    factor, value = 1.0 + 2.0**-30, 1.0 - 2.0**-30
    machine.values[4] = value
    machine.links = [(4, 0, factor, -1.0)]
    machine.rows = [{**machine.call("set", [1], 0, into=True), loop.LINKS: 1}]
    machine.split = 1
    assert machine.run(0)
    assert machine.values[0] == 0.0


def test_connections_add_up() -> None:
    machine = Machine()
    machine.values[4:7] = (1.5, -2.0, 8.0)
    machine.links = [(4, 0, 1.0, 0.5), (5, 0, 3.0, 0.0), (6, 0, 1.0, 0.0)]
    machine.rows = [{loop.LINKS: 1, loop.ACT: loop.NOTHING}, {loop.LINK: 1, loop.LINKS: 2, loop.ACT: loop.ADD}]
    machine.rows += [machine.call("set", [1], 0, into=True), machine.stepping()]
    machine.split = 3
    assert machine.run(1)
    assert [call[3] for call in machine.calls if call[0] == "set"] == [[4.0], [4.0]]


@pytest.mark.parametrize("chunk", [1, 3, 9])
def test_tables_fill_slots_point_by_point(chunk: int) -> None:
    """A table is filled anew for each call of the loop, from the point where it goes on."""
    machine = Machine()
    record = np.arange(20.0).reshape(10, 2)
    table = np.zeros((chunk + 1, 2))
    machine.record = np.array([4, 5], dtype=np.uint64)
    machine.rows = [{loop.ACT: loop.TABLE, loop.BUFFER: table.ctypes.data, loop.COUNT: 2, loop.SLOT: 4}]
    machine.rows += [machine.stepping()]
    machine.split = 1
    for begin in range(0, 9, chunk):
        table[:] = record[begin : begin + chunk + 1]
        assert machine.run(begin + chunk, 9)
    assert machine.log.tolist() == record.tolist()


@pytest.mark.parametrize(("kind", "sent"), [(INT32, [2, -4, 0]), (BOOLEAN32, [1, 1, 0])])
def test_integers_and_booleans_are_converted(kind: int, sent: list[int]) -> None:
    """Halves go to the even neighbour."""
    machine = Machine()
    machine.values[4:7] = (1.75, -3.5, 0.0)
    machine.links = [(4, 0, 1.0, 0.0), (5, 1, 1.0, 0.0), (6, 2, 1.0, 0.0)]
    machine.rows = [{**machine.call("set", [1, 2, 3], 0, into=True, kind=kind), loop.LINKS: 3}, machine.stepping()]
    machine.split = 1
    assert machine.run(0)
    assert machine.calls == [("set", 77, [1, 2, 3], sent)]


def test_integers_read_become_doubles() -> None:
    machine = Machine()
    machine.rows = [machine.call("get", [4, 2], 3, into=False, kind=INT32), machine.stepping()]
    machine.split = 1
    assert machine.run(0)
    assert machine.values.tolist() == [0, 0, 0, 40, 20, 0, 0, 0]


@pytest.mark.parametrize("kind", range(1, len(TYPES)))
def test_every_type_there_and_back(kind: int) -> None:
    machine = Machine()
    fmi = 2 if kind == BOOLEAN32 else 3
    machine.values[:3] = (1.0, 0.0, 100.0)
    machine.rows = [machine.call("set", [1, 2, 3], 0, into=True, kind=kind, fmi=fmi)]
    machine.rows += [machine.call("get", [4, 2], 3, into=False, kind=kind, fmi=fmi), machine.stepping(fmi=fmi)]
    machine.split = 2
    assert machine.run(0)
    boolean = kind in (BOOLEAN8, BOOLEAN32)
    assert machine.calls[0][3] == [1, 0, 1 if boolean else 100]
    assert machine.values[3:5].tolist() == [41.0, 21.0]


@pytest.mark.parametrize("kind", range(INT8, UINT64 + 1))
def test_what_does_not_fit_an_integer_stops_the_loop(kind: int) -> None:
    limits = np.iinfo(np.dtype(TYPES[kind][1]).name)
    least, most = limits.min, limits.max
    largest = float(most) if float(most) == most else math.nextafter(float(most), 0.0)
    for value, sent in ((float(least), least), (largest, int(largest)), (least - 0.25, least)):
        machine = Machine()
        machine.values[1] = value
        machine.rows = [machine.call("set", [1, 2], 0, into=True, kind=kind, fmi=3)]
        machine.split = 1
        assert machine.run(0), value
        assert machine.calls[0][3] == [0, sent]
    for value, sent in ((least * 1.001 - 1.0, least), (most * 1.001 + 1.0, int(largest)), (math.nan, least)):
        machine = Machine()
        machine.values[1] = value
        machine.rows = [machine.call("set", [1, 2], 0, into=True, kind=kind, fmi=3)]
        machine.split = 1
        assert not machine.run(0), value
        assert (machine.state[loop.REASON], machine.state[loop.FAILED_SLOT]) == (loop.OUT_OF_RANGE, 1)
        assert machine.calls == []
        machine.check = False
        assert machine.run(0)
        assert machine.calls[0][3] == [0, sent], value


def test_what_does_not_fit_float32_stops_the_loop() -> None:
    machine = Machine()
    machine.values[1] = 1e39
    machine.rows = [machine.call("set", [1, 2], 0, into=True, kind=loop.FLOAT32, fmi=3)]
    machine.split = 1
    assert not machine.run(0)
    assert (machine.state[loop.REASON], machine.state[loop.FAILED_SLOT]) == (loop.OUT_OF_RANGE, 1)
    machine.check = False
    assert machine.run(0)
    assert machine.calls[0][3] == [0.0, math.inf]


def test_rows_hold_the_values_of_the_point() -> None:
    """What is read after the step of point k stands in row k + 1; the first row is what was there."""
    machine = Machine()
    machine.values[3] = -1.0
    machine.record = np.array([3, 0], dtype=np.uint64)
    machine.rows = [{**machine.call("get", [1], 3, into=False), **machine.stepping()}]
    assert machine.run(3)
    assert machine.log[:, 0].tolist() == [-1.0, 11.0, 13.0, 15.0]
    assert machine.state[loop.ROWS] == 4


@pytest.mark.parametrize("chunk", [1, 2, 3, 7])
@pytest.mark.parametrize("decimation", [1, 4])
def test_in_chunks_as_in_one_go(chunk: int, decimation: int) -> None:
    def made() -> Machine:
        machine = Machine()
        machine.record = np.array([3], dtype=np.uint64)
        machine.rows = [machine.call("set", [1], 0, into=True)]
        machine.rows += [{**machine.call("get", [1], 3, into=False), **machine.stepping()}]
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
@pytest.mark.parametrize("fmi", [2, 3])
def test_any_status_but_ok_and_warning_stops(name: str, status: int, fmi: int) -> None:
    machine = Machine()
    machine.record = np.array([3], dtype=np.uint64)
    machine.rows = [machine.call("set", [1], 0, into=True, fmi=fmi, instance=0)]
    machine.rows += [
        {**machine.call("get", [1], 3, into=False, fmi=fmi, instance=1), **machine.stepping(fmi=fmi, instance=1)}
    ]
    machine.split = 1
    assert machine.run(2, 9)
    machine.status[name] = status
    assert not machine.run(9)
    assert machine.state[loop.POINT] == 2
    assert machine.state[loop.ROWS] == (2 if name == "set" else 3)
    function = {"set": ("SetReal", "SetFloat64"), "get": ("GetReal", "GetFloat64"), "step": ("DoStep", "DoStep")}
    assert loop.call_of(machine.state) == (0 if name == "set" else 1, f"fmi{fmi}{function[name][fmi - 2]}")
    assert machine.state[loop.REASON] == loop.CALL_FAILED
    assert machine.state[loop.STATUS] == status


def test_warnings_are_counted() -> None:
    machine = Machine()
    machine.rows = [machine.call("set", [1], 0, into=True), machine.stepping()]
    machine.split = 1
    machine.status = {"set": 1, "step": 1}
    assert machine.run(10)
    assert machine.state[loop.WARNINGS] == 21


def test_the_state_says_which_call_is_made_now() -> None:
    """A process that shares the memory of the state may look at any time."""
    machine = Machine()
    machine.rows = [machine.call("set", [1], 0, into=True, instance=0)]
    machine.rows += [machine.call("set", [1], 0, into=True, kind=INT32, instance=1)]
    machine.rows += [{**machine.call("get", [1], 3, into=False, instance=0), **machine.stepping(instance=0)}]
    machine.rows += [machine.stepping(instance=1, fmi=3)]
    machine.split = 2
    machine.state[loop.CALLING] = -1
    assert machine.run(1)
    point = [(0, "fmi2SetReal"), (1, "fmi2SetInteger")]
    assert machine.seen == [*point, (0, "fmi2DoStep"), (0, "fmi2GetReal"), (1, "fmi3DoStep"), *point]
    assert loop.call_of(machine.state) is None


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("kind", [FLOAT64, INT32])
def test_a_value_that_is_not_finite_stops_before_it_is_used(value: float, kind: int) -> None:
    machine = Machine()
    machine.values[4:6] = (1.0, value)
    machine.links = [(4, 0, 1.0, 0.0), (5, 1, 2.0, 0.0)]
    machine.rows = [{**machine.call("set", [1, 2], 0, into=True, kind=kind), loop.LINKS: 2}, machine.stepping()]
    machine.split = 1
    assert not machine.run(3)
    assert (machine.state[loop.REASON], machine.state[loop.FAILED_LINK]) == (loop.NOT_FINITE, 1)
    assert machine.calls == []


def test_values_that_are_not_finite_go_through_unchecked() -> None:
    machine = Machine()
    machine.check = False
    machine.values[4:6] = (-math.inf, 1e308)
    machine.links = [(4, 0, 1.0, 0.0), (5, 1, 1e10, 0.0)]
    machine.rows = [{**machine.call("set", [1, 2], 0, into=True), loop.LINKS: 2}, machine.stepping()]
    machine.split = 1
    assert machine.run(0)
    assert machine.calls[0][3] == [-math.inf, math.inf]


def test_fmi3_beside_fmi2() -> None:
    """One loop steps both; an array has fewer value references than values."""
    machine = Machine()
    machine.record = np.array([3, 4, 5], dtype=np.uint64)
    machine.rows = [machine.call("set3", [1], 0, into=True, fmi=3, count=2), machine.call("set2", [1], 2, into=True)]
    machine.rows += [{**machine.call("get3", [4], 3, into=False, fmi=3, count=2), **machine.stepping(fmi=3)}]
    machine.rows += [{**machine.call("get2", [6], 5, into=False), **machine.stepping()}]
    machine.split = 2
    assert machine.run(1, start=0.5)
    assert [call[0] for call in machine.calls] == ["set3", "set2", "step", "get3", "step", "get2", "set3", "set2"]
    assert machine.calls[0] == ("set3", 77, [1], [0.0, 0.0])
    assert machine.calls[2] == ("step", 77, 0.5, 0.1, True)
    assert machine.log[1].tolist() == [43.0, 44.0, 65.0]
    assert machine.state.view(np.float64)[loop.LAST_TIME] == 0.6


@pytest.mark.parametrize(
    ("flags", "reason", "time"),
    [((False, True, False), loop.TERMINATED, 0.1), ((False, False, True), loop.RETURNED_EARLY, 0.05)],
)
def test_fmi3_ends_or_returns_early(flags: tuple[bool, bool, bool], reason: int, time: float) -> None:
    machine = Machine()
    machine.rows = [machine.stepping(fmi=3)]
    machine.flags = flags
    assert not machine.run(5)
    assert machine.state[loop.REASON] == reason
    assert machine.state.view(np.float64)[loop.LAST_TIME] == time
    assert len(machine.calls) == 1


def test_an_event_alone_does_not_stop() -> None:
    machine = Machine()
    machine.rows = [machine.stepping(fmi=3)]
    machine.flags = (True, False, False)
    assert machine.run(5)
