"""FMI 2.0 co-simulation: the standard's calls, in the order it wants them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from ctypes import c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any, ClassVar

from bms_ukf.fmi.instance import DISCARD, PENDING, WARNING, Instance, RefusedError, UnusableError
from bms_ukf.fmi.variables import Types
from bms_ukf.fmi.wire import Plan, Setting

_LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
_ALLOCATE = ctypes.CFUNCTYPE(c_void_p, c_size_t, c_size_t)
_FREE = ctypes.CFUNCTYPE(None, c_void_p)
_CO_SIMULATION = 1
_LAST_SUCCESSFUL_TIME, _TERMINATED = 2, 3  # fmi2StatusKind
_FAMILY = {"Enumeration": "Integer"}  # which setters and getters a type uses, if not those of its own name


class _Callbacks(ctypes.Structure):
    _fields_ = (
        ("logger", _LOGGER),
        ("allocate", _ALLOCATE),
        ("free", _FREE),
        ("step_finished", c_void_p),  # none: the FMU must not work asynchronously
        ("environment", c_void_p),
    )


class Fmi2(Instance):
    """An instance of an FMI 2.0 FMU."""

    types: ClassVar[Types] = {
        "Real": (c_double, float),
        "Integer": (c_int, round),
        "Enumeration": (c_int, round),
        "Boolean": (c_int, lambda value: int(bool(value))),
        "String": (c_char_p, bytes),
    }

    def __init__(self, plan: Plan, announce: Callable[[str], None]) -> None:
        super().__init__(plan, announce)
        libc = ctypes.CDLL(None)
        self._callbacks = _Callbacks(
            logger=_LOGGER(lambda _environment, _name, status, _category, message: self._listen(status, message)),
            allocate=ctypes.cast(libc.calloc, _ALLOCATE),
            free=ctypes.cast(libc.free, _FREE),
        )
        if plan["logger_proxy"]:
            ctypes.CDLL(plan["logger_proxy"]).addLoggerProxy(ctypes.byref(self._callbacks))
        self._do_step = self._function("fmi2DoStep", c_void_p, c_double, c_double, c_int)
        self._setters = [(self._accessor("Set", block.type), block) for block in self._inputs]
        self._getters = [(self._accessor("Get", block.type), block) for block in self._outputs]

    def start(self) -> list[float]:
        plan = self._plan
        self.announce("fmi2Instantiate")
        text = (c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int)
        instantiate = self._function("fmi2Instantiate", *text, result=c_void_p)
        self._handle.value = instantiate(
            plan["instance"].encode(),
            _CO_SIMULATION,
            plan["token"].encode(),
            plan["resources"].encode() if plan["resources"] else None,
            ctypes.byref(self._callbacks),
            0,
            0,
        )
        if not self._handle:
            raise UnusableError(f"fmi2Instantiate returned no instance: {self._reason()}")
        for setting in plan["parameters"]:
            self._set_start(setting)
        tolerance = plan["tolerance"]
        self._call(
            "fmi2SetupExperiment",
            self._handle,
            int(tolerance is not None),
            tolerance or 0.0,
            plan["start_time"],
            0,
            0.0,
        )
        self._call("fmi2EnterInitializationMode", self._handle)
        self._set(plan["input_start"])
        self._call("fmi2ExitInitializationMode", self._handle)
        return self._read(plan["start_time"])

    def step(self, t: float, step: float, parts: int, inputs: Sequence[float]) -> list[float]:
        self._set(inputs)
        for part in range(parts):
            begin, end = t + step * part / parts, t + step * (part + 1) / parts
            status = self._do_step(self._handle, begin, end - begin if parts > 1 else step, 1)
            if status > WARNING:
                self._recover(status, begin, end)
        return self._read(t + step)

    def end(self) -> None:
        self._call("fmi2Terminate", self._handle)
        self._function("fmi2FreeInstance", c_void_p, result=None)(self._handle)

    def _recover(self, status: int, begin: float, end: float) -> None:
        """Goes on from where the FMU got to, if it ended a step early; raises if it got nowhere."""
        while status == DISCARD:
            terminated, reached = c_int(0), c_double(begin)
            get_boolean = self._function("fmi2GetBooleanStatus", c_void_p, c_int, c_void_p)
            if get_boolean(self._handle, _TERMINATED, ctypes.byref(terminated)) <= WARNING and terminated.value:
                raise RefusedError(f"the FMU ended the simulation: {self._reason()}")
            get_real = self._function("fmi2GetRealStatus", c_void_p, c_int, c_void_p)
            got = get_real(self._handle, _LAST_SUCCESSFUL_TIME, ctypes.byref(reached))
            if got > WARNING or not begin < reached.value < end:
                break
            begin = reached.value
            status = self._do_step(self._handle, begin, end - begin, 1)
        if status == PENDING:
            raise RefusedError("fmi2DoStep returned pending: the FMU works asynchronously, which is not supported")
        self._check("fmi2DoStep", status)

    def _set_start(self, setting: Setting) -> None:
        self._set_parameter(setting, self._accessor("Set", setting["type"]), sized=False)

    def _set(self, values: Sequence[float]) -> None:
        self._fill_inputs(values)
        for setter, block in self._setters:
            status = setter(self._handle, block.references, block.size, block.values)
            if status > WARNING:
                self._check(f"fmi2Set{block.type}", status)

    def _read(self, t: float) -> list[float]:
        for getter, block in self._getters:
            status = getter(self._handle, block.references, block.size, block.values)
            if status > WARNING:
                self._check(f"fmi2Get{block.type}", status)
        return [t, *self._row()]

    def _accessor(self, verb: str, kind: str) -> Any:
        arguments = (c_void_p, ctypes.POINTER(c_uint), c_size_t, c_void_p)
        return self._function(f"fmi2{verb}{_FAMILY.get(kind, kind)}", *arguments)
