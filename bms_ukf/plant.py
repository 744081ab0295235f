"""A plant: an FMI 2.0 co-simulation FMU that plays the cell, advanced step by step.

The input set at t acts over [t, t + h]; the outputs are those at t + h. Time is counted in whole nanoseconds.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
import math
import tempfile
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, chdir, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from fmpy import fmi2
from fmpy.fmi1 import FMICallException

from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.fmu import describe, unpack, variable_named
from bms_ukf.records import NAN

Parameter = float | int | bool | str


class Role(NamedTuple):
    """What a variable of the FMU is for: its causality, and the unit its values must have."""

    causality: str
    unit: str
    required: bool


ROLES = {
    "current_A": Role("input", "A", required=True),  # positive = discharge
    "ambient_degC": Role("input", "degC", required=False),
    "voltage_V": Role("output", "V", required=True),
    "temperature_degC": Role("output", "degC", required=False),
    "soc": Role("output", "1", required=False),  # the truth an estimate is scored against, 0..1
}


@dataclass(slots=True)
class PlantState:
    """The plant's outputs at `t_ns`; NaN for those it does not have."""

    t_ns: int
    voltage_V: float = NAN
    temperature_degC: float = NAN
    soc: float = NAN


class Plant:
    """One running instance of an FMU; a context manager. `state` holds the latest outputs, from the start on.

    `variables` maps roles (see `ROLES`) to names of the FMU; a role that is left out has its own name, and "" says that
    the FMU does not have it. `parameters` are start values by FMU name. The plant starts at t = 0, with no current, and
    at `ambient_degC` (None: the FMU's own default). Raises ConfigError for an FMU that cannot be used here, and for a
    name or value that it does not take.
    """

    def __init__(
        self,
        fmu: str | Path,
        *,
        variables: Mapping[str, str] | None = None,
        parameters: Mapping[str, Parameter] | None = None,
        ambient_degC: float | None = None,
    ) -> None:
        self.path = Path(fmu)
        description = describe(self.path)
        roles = _roles(self.path, description, variables or {})
        inputs = [variable for role, variable in roles.items() if ROLES[role].causality == "input"]
        self._outputs = [role for role in roles if ROLES[role].causality == "output"]
        self._has_ambient = "ambient_degC" in roles
        with ExitStack() as undo:
            folder = undo.enter_context(tempfile.TemporaryDirectory(prefix="plant-"))
            unpack(self.path, description.coSimulation.modelIdentifier, folder)
            self._fmu = _Fmi2(self.path, folder, description, inputs, [roles[role] for role in self._outputs])
            undo.callback(self._fmu.free)
            for name, value in (parameters or {}).items():
                variable = variable_named(self.path, description, name, "parameters")
                if variable in roles.values():
                    raise ConfigError(
                        self.path, key=f"parameters.{name}", expected="no variable that has a role already"
                    )
                self._fmu.set_start(variable, value)
            self._inputs = [0.0, *(float(variable.start or 0.0) for variable in inputs[1:])]
            self._ambient_degC = self._inputs[1] if self._has_ambient else NAN
            if ambient_degC is not None:
                self.set_ambient(ambient_degC)
            self._fmu.initialise(self._inputs)
            self.state = self._read(0)
            self._undo = undo.pop_all()

    def step(self, current_A: float, step_ns: int) -> PlantState:
        """Advances by `step_ns` > 0 with the current held (A, positive = discharge); returns the new `state`.

        Raises PlantError if the FMU refuses the step, or gives a value that is not finite.
        """
        t_ns = self.state.t_ns
        self._inputs[0] = current_A
        if not self._fmu.step(self._inputs, t_ns * 1e-9, step_ns * 1e-9):
            raise PlantError(f"{self.path}: at t = {t_ns * 1e-9:g} s, current {current_A:g} A: {self._fmu.reason()}")
        self.state = self._read(t_ns + step_ns)
        return self.state

    def set_ambient(self, ambient_degC: float) -> None:
        """Sets the ambient temperature from the next step on: the FMU's input, if it has one."""
        self._ambient_degC = ambient_degC
        if self._has_ambient:
            self._inputs[1] = ambient_degC

    def close(self) -> None:
        """Ends the instance and removes its files. May be called again."""
        self._undo.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _read(self, t_ns: int) -> PlantState:
        values = self._fmu.read()
        if values is None or not all(map(math.isfinite, values)):
            reason = self._fmu.reason() if values is None else f"{', '.join(self._outputs)} = {values}"
            raise PlantError(f"{self.path}: outputs at t = {t_ns * 1e-9:g} s: {reason}")
        state = PlantState(t_ns, **dict(zip(self._outputs, values, strict=True)))
        if "temperature_degC" not in self._outputs:
            state.temperature_degC = self._ambient_degC
        return state


class _Fmi2:
    """An instance of an FMI 2.0 co-simulation FMU: the standard's calls, in the order it wants them."""

    def __init__(
        self, path: Path, folder: str, description: Any, inputs: Sequence[Any], outputs: Sequence[Any]
    ) -> None:
        self._path = path
        self._name = f"{path.stem}-{next(_serial)}"
        self._log = _messages[self._name] = deque(maxlen=3)
        self._in_refs, self._in = _buffers(inputs)
        self._out_refs, self._out = _buffers(outputs)
        self._slave = self._load(folder, description)

    def set_start(self, variable: Any, value: Parameter) -> None:
        """Sets a start value before `initialise`. Raises ConfigError if it has the wrong type or is refused."""
        kind, setter = _SETTERS[variable.type]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self._wrong(variable.name, value, f"a value of FMI type {variable.type}")
        try:
            getattr(self._slave, setter)([variable.valueReference], [value])
        except FMICallException:
            raise self._wrong(variable.name, value, f"a value the FMU takes ({self.reason()})") from None

    def initialise(self, inputs: Sequence[float]) -> None:
        """Leaves the FMU ready for its first step. Raises ConfigError if it refuses its start values."""
        self._in[:] = inputs
        try:
            self._slave.fmi2SetReal(self._slave.component, self._in_refs, len(self._in), self._in)
            self._slave.setupExperiment(startTime=0.0)
            self._slave.enterInitializationMode()
            self._slave.exitInitializationMode()
        except FMICallException:
            raise ConfigError(self._path, expected=f"start values the FMU takes ({self.reason()})") from None

    def step(self, inputs: Sequence[float], t_s: float, step_s: float) -> bool:
        """Sets the inputs and advances from `t_s`; False if the FMU refuses either."""
        self._in[:] = inputs
        dll, component = self._slave.dll, self._slave.component
        return bool(
            dll.fmi2SetReal(component, self._in_refs, len(self._in), self._in) <= fmi2.fmi2Warning
            and dll.fmi2DoStep(component, t_s, step_s, fmi2.fmi2True) <= fmi2.fmi2Warning
        )

    def read(self) -> list[float] | None:
        """The outputs, or None if the FMU refuses to give them."""
        status = self._slave.dll.fmi2GetReal(self._slave.component, self._out_refs, len(self._out), self._out)
        return None if status > fmi2.fmi2Warning else list(self._out)

    def reason(self) -> str:
        """What the FMU last said about why it refused something."""
        return self._log[-1] if self._log else "the FMU gives no reason"

    def free(self) -> None:
        with suppress(FMICallException):
            self._slave.terminate()
        self._slave.freeInstance()
        _messages.pop(self._name, None)

    def _load(self, folder: str, description: Any) -> Any:
        try:
            # fmpy changes the working folder to load a library, and does not change back when that fails.
            with chdir(folder):
                slave = fmi2.FMU2Slave(
                    guid=description.guid,
                    modelIdentifier=description.coSimulation.modelIdentifier,
                    unzipDirectory=folder,
                    instanceName=self._name,
                )
                slave.instantiate(callbacks=_callbacks())
        except Exception as error:  # fmpy raises Exception itself, for a library that does not load as for a bad GUID
            reason = self._log[-1] if self._log else error
            raise ConfigError(self._path, expected=f"an FMU that can be loaded here ({reason})") from None
        return slave

    def _wrong(self, name: str, value: Parameter, expected: str) -> ConfigError:
        return ConfigError(self._path, key=f"parameters.{name}", value=value, expected=expected)


_serial = itertools.count()
_messages: dict[str, deque[str]] = {}  # what each living instance last said, by its name


@functools.cache
def _callbacks() -> Any:
    """Made once and kept for good: an FMU may hold on to them, and fmpy's proxy knows the logger of one set only."""
    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(_listen)
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    # Expands the C format of messages; fmpy has it for some platforms only.
    if hasattr(fmi2, "addLoggerProxy"):
        fmi2.addLoggerProxy(ctypes.byref(callbacks))
    return callbacks


def _listen(_environment: object, name: bytes, status: int, _category: bytes, message: bytes) -> None:
    log = _messages.get(name.decode(errors="replace"))
    if log is not None and status > fmi2.fmi2OK:
        log.append(message.decode(errors="replace"))


_SETTERS: dict[str, tuple[type | tuple[type, ...], str]] = {
    "Real": ((float, int), "setReal"),
    "Integer": (int, "setInteger"),
    "Enumeration": (int, "setInteger"),
    "Boolean": (bool, "setBoolean"),
    "String": (str, "setString"),
}


def _roles(path: Path, description: Any, variables: Mapping[str, str]) -> dict[str, Any]:
    """The FMU's variable for each role it has, in the order of `ROLES`."""
    for role in variables.keys() - ROLES:
        raise ConfigError(path, key=f"variables.{role}", expected=f"a role among {', '.join(ROLES)}")
    found = {}
    for role, wanted in ROLES.items():
        name = variables.get(role, role)
        if not name and not wanted.required:
            continue
        variable = variable_named(path, description, name, f"variables.{role}")
        if (variable.causality, variable.type) != (wanted.causality, "Real"):
            raise ConfigError(
                path,
                key=f"variables.{role}",
                value=f"{name}, {variable.causality} of type {variable.type}",
                expected=f"a Real {wanted.causality}",
            )
        if variable.unit not in (None, wanted.unit):
            raise ConfigError(
                path,
                key=f"variables.{role}",
                value=f"{name} in {variable.unit}",
                expected=f"a variable in {wanted.unit}",
            )
        found[role] = variable
    return found


def _buffers(variables: Sequence[Any]) -> tuple[Any, Any]:
    """Value references and room for values, as C arrays made once."""
    n = len(variables)
    return (ctypes.c_uint * n)(*(variable.valueReference for variable in variables)), (ctypes.c_double * n)()
