"""FMI 3.0 co-simulation: the standard's calls, in the order it wants them."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from ctypes import c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any, ClassVar

from bms_ukf.fmi.instance import WARNING, Instance, RefusedError, UnusableError
from bms_ukf.fmi.variables import Types
from bms_ukf.fmi.wire import Plan, Setting

_LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)
_FAMILY = {"Enumeration": "Int64"}  # which setters and getters a type uses, if not those of its own name
_EVENT_LIMIT = 1000  # iterations of an event, and early returns within one step, before it counts as endless


class Fmi3(Instance):
    """An instance of an FMI 3.0 FMU. Event mode is used if the FMU has it; an early return is followed by the rest."""

    types: ClassVar[Types] = {
        "Float32": (ctypes.c_float, float),
        "Float64": (c_double, float),
        **{f"Int{bits}": (getattr(ctypes, f"c_int{bits}"), round) for bits in (8, 16, 32, 64)},
        **{f"UInt{bits}": (getattr(ctypes, f"c_uint{bits}"), round) for bits in (8, 16, 32, 64)},
        "Enumeration": (ctypes.c_int64, round),
        "Boolean": (c_bool, bool),
        "String": (c_char_p, bytes),
    }

    def __init__(self, plan: Plan, announce: Callable[[str], None]) -> None:
        super().__init__(plan, announce)
        self._logger = _LOGGER(lambda _environment, status, _category, message: self._listen(status, message))
        flags = [ctypes.POINTER(c_bool)] * 3
        step = (c_void_p, c_double, c_double, c_bool, *flags, ctypes.POINTER(c_double))
        self._do_step = self._function("fmi3DoStep", *step)
        self._event, self._terminate, self._early = c_bool(), c_bool(), c_bool()
        self._reached = c_double()
        self._told = [ctypes.byref(cell) for cell in (self._event, self._terminate, self._early, self._reached)]
        self._next_event = math.inf  # where the FMU wants a step to end
        self._discrete = plan["event_mode"] and plan["discrete_inputs"]
        self._held: Sequence[float] = plan["input_start"]
        self._setters = [(self._accessor("Set", block.type), block) for block in self._inputs]
        self._getters = [(self._accessor("Get", block.type), block) for block in self._outputs]

    def start(self) -> list[float]:
        plan = self._plan
        self.announce("fmi3InstantiateCoSimulation")
        text = [c_char_p, c_char_p, c_char_p, c_bool, c_bool, c_bool, c_bool]
        rest = [c_void_p, c_size_t, c_void_p, _LOGGER, c_void_p]
        instantiate = self._function("fmi3InstantiateCoSimulation", *text, *rest, result=c_void_p)
        self._handle.value = instantiate(
            plan["instance"].encode(),
            plan["token"].encode(),
            plan["resources"].encode() if plan["resources"] else None,
            False,  # visible
            False,  # loggingOn
            plan["event_mode"],
            True,  # earlyReturnAllowed
            None,
            0,
            None,
            self._logger,
            None,
        )
        if not self._handle:
            raise UnusableError(f"fmi3InstantiateCoSimulation returned no instance: {self._reason()}")
        if plan["structural"]:
            self._call("fmi3EnterConfigurationMode", self._handle)
            for setting in plan["structural"]:
                self._set_start(setting)
            self._call("fmi3ExitConfigurationMode", self._handle)
        for setting in plan["parameters"]:
            self._set_start(setting)
        tolerance, start_time = plan["tolerance"], plan["start_time"]
        self._call(
            "fmi3EnterInitializationMode", self._handle, tolerance is not None, tolerance or 0.0, start_time, False, 0.0
        )
        self._set(plan["input_start"])
        self._call("fmi3ExitInitializationMode", self._handle)
        if plan["event_mode"]:  # initialisation leads there
            self._leave_event()
        return self._read(start_time)

    def step(self, t: float, step: float, parts: int, inputs: Sequence[float]) -> list[float]:
        if self._discrete and inputs != self._held:
            self._call("fmi3EnterEventMode", self._handle)
            self._set(inputs)
            self._leave_event()
            self._held = inputs
        else:
            self._set(inputs)
        for part in range(parts):
            begin, end = t + step * part / parts, t + step * (part + 1) / parts
            self._advance(begin, end, end - begin if parts > 1 else step)
        return self._read(t + step)

    def end(self) -> None:
        self._call("fmi3Terminate", self._handle)
        self._function("fmi3FreeInstance", c_void_p, result=None)(self._handle)

    def _advance(self, begin: float, end: float, step: float) -> None:
        for _ in range(_EVENT_LIMIT):
            until = end
            if begin < self._next_event < end:
                until, step = self._next_event, self._next_event - begin
            self._event.value = self._terminate.value = self._early.value = False
            self._reached.value = until
            status = self._do_step(self._handle, begin, step, True, *self._told)
            if status > WARNING:
                self._check("fmi3DoStep", status)
            if self._terminate.value:
                raise RefusedError(f"the FMU ended the simulation: {self._reason()}")
            reached = min(self._reached.value, until) if self._early.value else until
            if self._event.value or reached >= self._next_event:
                self._handle_event()
            if reached >= end:
                return
            begin = max(begin, reached)
            step = end - begin
        raise RefusedError(f"fmi3DoStep returned early {_EVENT_LIMIT} times and got no further than t = {begin:g} s")

    def _handle_event(self) -> None:
        if self._plan["event_mode"]:
            self._call("fmi3EnterEventMode", self._handle)
            self._leave_event()

    def _leave_event(self) -> None:
        needed, ends, nominals, states, is_next = [c_bool() for _ in range(5)]
        next_event = c_double()
        told = [*map(ctypes.byref, (needed, ends, nominals, states, is_next)), ctypes.byref(next_event)]
        update = self._function("fmi3UpdateDiscreteStates", c_void_p, *[c_void_p] * 6)
        for _ in range(_EVENT_LIMIT):
            self._check("fmi3UpdateDiscreteStates", update(self._handle, *told))
            if ends.value:
                raise RefusedError(f"the FMU ended the simulation: {self._reason()}")
            if not needed.value:
                is_met = is_next.value and self._plan["variable_step"]
                self._next_event = next_event.value if is_met else math.inf
                self._call("fmi3EnterStepMode", self._handle)
                return
        raise RefusedError(f"an event did not end within {_EVENT_LIMIT} iterations")

    def _set_start(self, setting: Setting) -> None:
        self._set_parameter(setting, self._accessor("Set", setting["type"]), sized=True)

    def _set(self, values: Sequence[float]) -> None:
        self._fill_inputs(values)
        for setter, block in self._setters:
            status = setter(self._handle, block.references, len(block.references), block.values, block.size)
            if status > WARNING:
                self._check(f"fmi3Set{block.type}", status)

    def _read(self, t: float) -> list[float]:
        for getter, block in self._getters:
            status = getter(self._handle, block.references, len(block.references), block.values, block.size)
            if status > WARNING:
                self._check(f"fmi3Get{block.type}", status)
        return [t, *self._row()]

    def _accessor(self, verb: str, kind: str) -> Any:
        arguments = (c_void_p, ctypes.POINTER(c_uint), c_size_t, c_void_p, c_size_t)
        return self._function(f"fmi3{verb}{_FAMILY.get(kind, kind)}", *arguments)
