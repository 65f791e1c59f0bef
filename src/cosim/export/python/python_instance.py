"""An instance of a Python FMU: it does the work of the C runtime with a component's own Python methods.

PythonFMU's library calls the public methods, so their names and arguments are given by its protocol. None of them
raises: an error becomes a message with a status, and the FMU's binary (``python/proxy.c``) returns that status.

This module and the declaration layer travel inside the FMU, under a package name made from their content.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from ...model import Component, Controller, Note, Plant, Record, Source, unflatten
from .. import contract
from ..contract import (
    BEFORE,
    DISCARD,
    ERROR,
    FAILED,
    INITIALIZATION,
    STEP_COMPLETE,
    STEP_FAILED,
    TERMINATED,
    WARNING,
)
from ..interface import InterfaceVariable, unchecked
from .dual import Dual, plain
from .integrator import Problem, StepProgress, Stopped, integrate
from .memory import Memory, float_of, interface, numbers, restored, value_of, with_types
from .messages import CATEGORIES, PHASES, LogEntry, Refusal
from .ticks import EPSILON


class Instance:
    """An instance of the component ``kind``; subclassed with PythonFMU's ``Fmi2Slave`` inside the FMU."""

    kind: ClassVar[type[Component]]

    def __init__(self, **arguments: Any) -> None:
        self.instance_name = str(arguments["instance_name"])
        self.log_queue: list[LogEntry] = []
        self.face = interface(self.kind)
        starts = [variable.start for variable in self.face.variables]
        self.memory = Memory(v=starts, next=[0.0] * len(starts[self.face.states]))
        self.made: Any = None

    # What PythonFMU calls

    def _get_log_queue(self) -> list[LogEntry]:
        return self.log_queue

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """fmi2SetupExperiment; None stands for a value that is not defined."""

        def keep(function: str) -> None:
            self.set_up(function, start_time, stop_time, tolerance)

        self.guard("fmi2SetupExperiment", contract.LEGAL["SET_UP"], keep)

    def enter_initialization_mode(self) -> None:
        """fmi2EnterInitializationMode."""
        self.guard("fmi2EnterInitializationMode", contract.LEGAL["ENTER_INITIALIZATION"], self.enter)

    def exit_initialization_mode(self) -> None:
        """fmi2ExitInitializationMode."""
        self.guard("fmi2ExitInitializationMode", contract.LEGAL["EXIT_INITIALIZATION"], self.leave)

    def terminate(self) -> None:
        """fmi2Terminate."""

        def end(function: str) -> None:
            self.tell_notes(function)
            self.memory.phase = TERMINATED

        self.guard("fmi2Terminate", contract.LEGAL["TERMINATE"], end)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """fmi2DoStep; False if the step was discarded or failed."""
        self.guard(
            "fmi2DoStep", contract.LEGAL["STEP"], lambda function: self.advance(function, current_time, step_size)
        )
        return not self.log_queue

    def get_real(self, vrs: Sequence[int]) -> list[float]:
        """fmi2GetReal."""
        return self.get("fmi2GetReal", ("Real",), vrs, float)

    def get_integer(self, vrs: Sequence[int]) -> list[int]:
        """fmi2GetInteger, enumerations included."""
        return self.get("fmi2GetInteger", ("Integer", "Enumeration"), vrs, int)

    def get_boolean(self, vrs: Sequence[int]) -> list[bool]:
        """fmi2GetBoolean."""
        return self.get("fmi2GetBoolean", ("Boolean",), vrs, bool)

    def get_string(self, vrs: Sequence[int]) -> list[str]:
        """fmi2GetString: there are no strings."""
        return self.get("fmi2GetString", (), vrs, str)

    def set_real(self, vrs: Sequence[int], values: Sequence[float]) -> None:
        """fmi2SetReal."""
        self.set("fmi2SetReal", ("Real",), vrs, values)

    def set_integer(self, vrs: Sequence[int], values: Sequence[int]) -> None:
        """fmi2SetInteger, enumerations included."""
        self.set("fmi2SetInteger", ("Integer", "Enumeration"), vrs, values)

    def set_boolean(self, vrs: Sequence[int], values: Sequence[bool]) -> None:
        """fmi2SetBoolean."""
        self.set("fmi2SetBoolean", ("Boolean",), vrs, values)

    def set_string(self, vrs: Sequence[int], values: Sequence[str]) -> None:
        """fmi2SetString: there are no strings."""
        self.set("fmi2SetString", (), vrs, [math.nan for _ in values])

    def _get_fmu_state(self) -> dict[str, Any]:
        return self.memory.copy()

    def _set_fmu_state(self, state: Mapping[str, Any]) -> None:
        def restore(function: str) -> None:
            memory = restored(state, self.memory, self.face)
            if memory is None:
                raise Refusal(ERROR, "NO_STATE", function, self.kind.__name__)
            self.memory, self.made = memory, None

        self.guard("fmi2SetFMUstate", contract.LEGAL["HANDLE_STATE"], restore)

    @staticmethod
    def _fmu_state_to_bytes(state: Mapping[str, Any]) -> bytes:
        return json.dumps(state).encode()

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> dict[str, Any]:
        try:
            return json.loads(state)
        except ValueError:
            return {}

    # Statuses and messages

    def say(self, status: int, text: str) -> None:
        """Log a message; the FMI call in progress returns its status."""
        self.log_queue.append(LogEntry(status, CATEGORIES[status], text))

    def guard(self, function: str, phases: int, call: Callable[[str], None]) -> None:
        """Run one FMI call if it is legal in this phase. Any problem becomes a message; an error fails the instance."""
        memory = self.memory
        if not memory.phase & phases:
            self.say(ERROR, contract.message("NOT_ALLOWED", function, PHASES[memory.phase]))
            memory.phase = FAILED
            return
        try:
            call(function)
        except Refusal as refusal:
            self.say(refusal.status, refusal.text)
            if refusal.status == ERROR:
                memory.phase = FAILED
        except BaseException as error:  # also KeyboardInterrupt: no exception may reach PythonFMU
            kind = type(error).__name__
            self.say(ERROR, f"{function}: {self.kind.__name__} failed in Python: {kind}: {error}".rstrip(": "))
            memory.phase = FAILED

    def checked(self, function: str, reference: int, types: Sequence[str]) -> InterfaceVariable:
        """The variable of a value reference. Refused if its type is none of ``types``."""
        if not 0 <= reference < len(self.face.variables):
            last = len(self.face.variables) - 1
            raise Refusal(ERROR, "UNKNOWN_REFERENCE", function, reference, self.kind.__name__, last)
        variable = self.face.variables[reference]
        if variable.type not in types:
            kind = "Integer" if variable.type == "Enumeration" else variable.type
            raise Refusal(ERROR, "WRONG_TYPE", function, variable.name, reference, kind, kind, kind)
        return variable

    # Life cycle

    def set_up(self, function: str, start: float, stop: float | None, tolerance: float | None) -> None:
        """Keep times and tolerance."""
        memory = self.memory
        if not math.isfinite(start) or (stop is not None and not (math.isfinite(stop) and stop > start)):
            raise Refusal(ERROR, "WRONG_TIMES", function, start, start if stop is None else stop)
        if tolerance is not None and not (math.isfinite(tolerance) and tolerance > 0.0):
            raise Refusal(ERROR, "WRONG_TOLERANCE", function, tolerance)
        memory.start = memory.time = memory.count.origin = start
        memory.stop = math.inf if stop is None else stop
        memory.tolerance = tolerance or 0.0
        memory.parameters_dirty = True
        self.touch()

    def enter(self, function: str) -> None:
        """Take the importer's tolerance unless the parameter was set."""
        memory = self.memory
        memory.phase = INITIALIZATION
        if issubclass(self.kind, Plant) and memory.tolerance > 0.0 and not memory.tolerance_set:
            variable = self.face.variables[self.face.references["tolerance"]]
            memory.v[variable.reference] = min(max(memory.tolerance, variable.min), variable.max)
            memory.parameters_dirty = True

    def leave(self, function: str) -> None:
        """Check the rules between parameters and the initial values."""
        memory, face = self.memory, self.face
        rule = self.broken_rule()
        if rule:
            raise Refusal(ERROR, "BROKEN_RULES", function, rule)
        self.refresh(True)
        for offset, value in enumerate(memory.v[face.states.start : face.derivatives.stop]):
            if not math.isfinite(value):
                raise Refusal(ERROR, "INITIAL_NOT_FINITE", function, face.variables[face.states.start + offset].name)
        self.touch()
        memory.phase = STEP_COMPLETE
        self.tell_notes(function)

    def tell_notes(self, function: str) -> None:
        """Log the notes, which tell what is legal but suspicious; each note is logged once."""
        memory = self.memory
        self.refresh_parameters()
        notes: tuple[Note, ...] = self.component().notes(self.state(memory.v[self.face.states]))
        for note in notes:
            key = f"{note.name}, {note.limit_name}"
            if note.value > note.limit and key not in memory.told:
                memory.told.append(key)
                known = note.name, note.value, note.unit, note.limit_name, note.limit, note.unit, note.text
                self.say(WARNING, contract.message("NOTE", function, *known))

    # Values

    def get(self, function: str, types: Sequence[str], references: Sequence[int], convert: Callable[[Any], Any]) -> Any:
        """Values by reference. There are always as many as were asked for, also after an error."""
        values: list[Any] = []

        def read(function: str) -> None:
            wanted = [self.checked(function, reference, types) for reference in references]
            if self.memory.phase & contract.EVALUATED:
                self.refresh(any(variable.role == "derivative" for variable in wanted))
            for variable in wanted:
                if variable.role == "counter":
                    values.append(min(self.memory.counts[variable.reference - self.face.counter_0], 2**31 - 1))
                else:
                    value = self.memory.v[variable.reference]
                    if not math.isfinite(value):
                        raise Refusal(DISCARD, "RESULT_NOT_FINITE", function, variable.name, self.memory.time)
                    values.append(convert(value))

        self.guard(function, contract.LEGAL["GET"], read)
        return values if len(values) == len(references) else [convert(0) for _ in references]

    def set(self, function: str, types: Sequence[str], references: Sequence[int], values: Sequence[float]) -> None:
        """Set values one by one. A refused value gives a message, and the variable keeps its previous value."""

        def write(function: str) -> None:
            wanted = [self.checked(function, reference, types) for reference in references]
            for variable, value in zip(wanted, values, strict=True):
                try:
                    self.set_one(function, variable, float(value))
                except Refusal as refusal:
                    if refusal.status == ERROR:
                        raise
                    self.say(refusal.status, refusal.text)

        self.guard(function, contract.LEGAL["SET"], write)

    def set_one(self, function: str, variable: InterfaceVariable, value: float) -> None:
        """Set one variable or refuse its value."""
        memory, reference, role = self.memory, variable.reference, variable.role
        name, unit, previous = variable.name, variable.unit, memory.v[reference]
        is_tolerance = variable.name == "tolerance" and issubclass(self.kind, Plant)
        again = role in ("fixed", "tunable") and not memory.phase & BEFORE
        # Some importers set all parameters again. The tolerance that they gave the experiment stays.
        if again and (value == previous or (is_tolerance and not memory.tolerance_set and value == variable.start)):
            return
        if role not in ("input", "tunable") and not (role == "fixed" and memory.phase & BEFORE):
            raise Refusal(ERROR, "FIXED" if role == "fixed" else "COMPUTED", function, name)
        if not math.isfinite(value):
            raise Refusal(DISCARD, "NOT_FINITE", function, name, value, unit, previous)
        if value < variable.min:
            raise Refusal(DISCARD, "BELOW_MINIMUM", function, name, value, unit, variable.min, unit, previous)
        if value > variable.max:
            raise Refusal(DISCARD, "ABOVE_MAXIMUM", function, name, value, unit, variable.max, unit, previous)
        memory.v[reference] = value
        self.touch()
        if role == "input":
            return
        memory.parameters_dirty = True
        if is_tolerance:
            memory.tolerance_set = True
        rule = self.broken_rule() if memory.phase == STEP_COMPLETE else ""
        if rule:
            memory.v[reference] = previous
            raise Refusal(DISCARD, "BREAKS_RULE", function, name, value, unit, rule, previous)

    # Evaluation

    def component(self) -> Any:
        """The component with the present parameters; bounds and rules are not checked again."""
        if self.made is None:
            values = zip(self.face.variables, self.memory.v[self.face.parameters], strict=False)
            self.made = unchecked(self.kind, (value_of(variable, number) for variable, number in values))
        return self.made

    def broken_rule(self) -> str:
        """The text of the first condition between parameters that does not hold, or ``""``."""
        gap = next((gap for gap in self.face.gaps if self.memory.v[gap.reference] not in gap.numbers), None)
        if gap is not None:
            return gap.text
        self.made = None
        component = self.component()
        self.made = None
        return next((rule.text for rule in component.rules() if not rule.condition), "")

    def state(self, values: Sequence[Dual | float]) -> Record:
        """The ``State`` with these values, given in the order of the FMU."""
        typed = with_types(values, self.face.whole_states)
        return self.kind.State(**unflatten(self.kind.State, (typed[i] for i in self.face.to_record)))

    def input(self) -> Record:
        """The ``Input`` with the present values."""
        values = with_types(self.memory.v[self.face.inputs], self.face.whole_inputs)
        return self.kind.Input(**unflatten(self.kind.Input, iter(values)))

    def states_of(self, call: Callable[[], Any]) -> list[float]:
        """The values of the ``State`` that ``call`` returns, in the order of the FMU."""
        flat = numbers(call, len(self.face.from_record))
        return [flat[i] for i in self.face.from_record]

    def refresh_parameters(self) -> None:
        """Update the component and, before the first step, the initial state."""
        memory = self.memory
        if not memory.parameters_dirty:
            return
        self.made = None
        component = self.component()
        if memory.phase & BEFORE:
            memory.v[self.face.states] = self.states_of(component.initial)
        memory.parameters_dirty = False

    def refresh(self, derivatives: bool) -> None:
        """Update everything that an importer may read to the present inputs, parameters and time."""
        self.refresh_parameters()
        memory, face, component = self.memory, self.face, self.component()
        if memory.outputs_dirty:
            n = face.outputs.stop - face.outputs.start
            if isinstance(component, Controller):
                if memory.count.at_instant(self.sampling_time(), memory.time):
                    self.take_sample()
            elif isinstance(component, Source):
                memory.v[face.outputs] = numbers(lambda: component.output(memory.time), n)
            else:
                state, inputs = self.state(memory.v[face.states]), self.input()
                memory.v[face.outputs] = numbers(lambda: component.output(memory.time, state, inputs), n)
            memory.outputs_dirty = False
        if derivatives and memory.derivatives_dirty and isinstance(component, Plant):
            state, inputs = self.state(memory.v[face.states]), self.input()
            rates = self.states_of(lambda: component.derivative(memory.time, state, inputs))
            memory.v[face.derivatives] = rates[: face.n_continuous]
            memory.derivatives_dirty = False

    def touch(self) -> None:
        """Inputs or parameters changed: mark the values that depend on them to be computed again."""
        memory = self.memory
        memory.outputs_dirty = memory.derivatives_dirty = True
        memory.sampled = False

    # Sampling

    def sampling_time(self) -> float:
        """The sampling time ``T_s`` in s."""
        return self.memory.v[self.face.references["T_s"]]

    def sample_time(self) -> float:
        """Time of the next sample in s, as the equations get it."""
        return self.memory.start + self.memory.count.sample * self.sampling_time()

    def take_sample(self) -> None:
        """Compute the outputs of the next sample and the state after it."""
        memory, face, component = self.memory, self.face, self.component()
        t, x, u = self.sample_time(), self.state(memory.v[face.states]), self.input()
        found: list[Any] = []

        def output() -> Any:
            found.append(component.output(t, x, u))
            return found[0]

        memory.v[face.outputs] = numbers(output, face.outputs.stop - face.outputs.start)
        if found:
            memory.next = self.states_of(lambda: component.update(t, x, u, found[0]))
        else:
            memory.next = [math.nan] * len(memory.next)
        memory.sampled, memory.outputs_dirty = True, False

    # Stepping

    def advance(self, function: str, time: float, step: float) -> None:
        """One communication step."""
        memory = self.memory
        if not (math.isfinite(step) and step > 0.0) or math.isinf(time + step):
            raise Refusal(ERROR, "STEP_SIZE", function, step)
        if not abs(time - memory.time) <= 1e-6 * step + 8.0 * EPSILON * abs(memory.time):
            raise Refusal(ERROR, "WRONG_POINT", function, time, memory.time)
        end = time + step
        # an importer may add up its time, t += h: then each step adds a rounding error
        if end > memory.stop + 1e-6 * step + (8.0 + memory.steps) * EPSILON * abs(memory.stop):
            raise Refusal(ERROR, "BEHIND_STOP", function, end, memory.stop)
        self.refresh_parameters()
        memory.time = time
        memory.steps += 1
        if issubclass(self.kind, Controller):
            self.run_samples(function, step)
            memory.outputs_dirty = False
        else:
            if issubclass(self.kind, Plant):
                self.integrate(function, end)
            memory.outputs_dirty = memory.derivatives_dirty = True
        memory.time = end
        if not issubclass(self.kind, Controller):
            self.check_outputs(function, time)

    def check_outputs(self, function: str, before: float) -> None:
        """Refuse the step from ``before`` on if an output is not finite at its end."""
        memory = self.memory
        self.refresh(False)
        for variable in self.face.variables[self.face.outputs]:
            if not math.isfinite(memory.v[variable.reference]):
                end, memory.time, memory.phase = memory.time, before, STEP_FAILED
                raise Refusal(DISCARD, "RESULT_NOT_FINITE", function, variable.name, end)

    def run_samples(self, function: str, step: float) -> None:
        """Take all samples of a communication step."""
        memory, face, T_s = self.memory, self.face, self.sampling_time()
        samples = memory.count.begin(T_s, memory.time, step)
        if samples > contract.LIMITS["SAMPLES"]:
            memory.phase = STEP_FAILED
            raise Refusal(DISCARD, "TOO_MANY_SAMPLES", function, step, samples, T_s, contract.LIMITS["SAMPLES"])
        names = [v.name for v in (*face.variables[face.outputs], *face.variables[face.states])]
        for _ in range(int(samples)):
            if not memory.sampled:
                self.take_sample()
            for name, value in zip(names, (*memory.v[face.outputs], *memory.next), strict=True):
                if not math.isfinite(value):
                    instant = memory.count.instant(T_s)
                    memory.time, memory.phase = max(memory.time, instant), STEP_FAILED
                    raise Refusal(DISCARD, "SAMPLE_NOT_FINITE", function, name, instant)
            memory.v[face.states] = memory.next
            memory.sampled = False
            memory.count.sample += 1
        memory.count.end(samples)

    def integrate(self, function: str, end: float) -> None:
        """Integrate the continuous states to ``end`` with inputs held; discrete states follow each accepted step.

        If integration stops early, the states are those of the last accepted step.
        """
        memory, face = self.memory, self.face
        n, component, inputs = face.n_continuous, self.component(), self.input()
        states = list(memory.v[face.states])

        def derivative(t: float, x: Sequence[float]) -> list[float]:
            record = self.state([*x, *states[n:]])
            return self.states_of(lambda: component.derivative(t, record, inputs))[:n]

        def linear(t: float, x: Sequence[float]) -> tuple[list[float], list[list[float]], list[float]]:
            seeds = [tuple([1.0 if i == k else 0.0 for i in range(n + 1)]) for k in range(n + 1)]
            record = self.state([*map(Dual, x, seeds), *states[n:]])
            try:
                flat = list(component.derivative(Dual(t, seeds[n]), record, inputs))
                rates = [flat[i] for i in face.from_record][:n]
            except (ArithmeticError, ValueError):
                rates = [math.nan] * n
            slopes = [rate.slopes if isinstance(rate, Dual) else (0.0,) * (n + 1) for rate in rates]
            return (
                [float_of(plain(rate)) for rate in rates],
                [list(row[:n]) for row in slopes],
                [row[n] for row in slopes],
            )

        def accepted(t: float, x: Sequence[float]) -> None:
            states[:n] = x
            if len(states) > n:
                record = self.state(states)
                states[n:] = self.states_of(lambda: component.update(t, record, inputs))[n:]

        if n == 0:
            memory.counts[0] += 1
            accepted(end, ())
        else:
            tolerance = memory.v[face.references["tolerance"]]
            problem = Problem(derivative, linear, accepted, face.nominals, tolerance, int(contract.LIMITS["ATTEMPTS"]))
            progress = StepProgress(memory.step, memory.counts)
            try:
                integrate(problem, progress, memory.time, end, states[:n])
            except Stopped as stopped:
                memory.time, memory.phase = stopped.time, STEP_FAILED
                names = [variable.name for variable in face.variables[face.states]]
                where = "no single state" if stopped.state is None else names[stopped.state]
                why = contract.REASONS[stopped.reason]
                raise Refusal(DISCARD, "STOPPED", function, tolerance, stopped.time, where, why) from stopped
            finally:
                memory.v[face.states], memory.step = states, progress.step
        memory.v[face.states] = states
