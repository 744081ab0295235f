"""What FMI 2.0 and 3.0 co-simulation have in common: a library, a status for each call, and an order of calls."""

from __future__ import annotations

import ctypes
import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

from bms_ukf.fmi.variables import Types, blocks, fill, row
from bms_ukf.fmi.wire import Plan, Setting

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_NO_REASON = "the FMU gives no reason"


class UnusableError(Exception):
    """No instance can be had of the library."""


class RefusedError(Exception):
    """A call returned an error; the instance lives on."""


class ParameterError(RefusedError):
    """A start value was refused; `name` is the variable's."""

    def __init__(self, name: str, reason: str) -> None:
        self.name = name
        super().__init__(reason)


class FatalError(Exception):
    """A call returned Fatal: the standard allows no further call."""


class Instance(ABC):
    """A co-simulation instance. Subclasses make the calls of one version of the standard."""

    types: ClassVar[Types]

    def __init__(self, plan: Plan, announce: Callable[[str], None]) -> None:
        self._plan, self.announce = plan, announce
        self._log: deque[str] = deque(maxlen=4)  # what the FMU last said
        self._handle = ctypes.c_void_p()
        self._inputs = blocks(self.types, plan["inputs"])
        self._outputs = blocks(self.types, plan["outputs"])
        self._dll = self._load(plan["library"])

    @abstractmethod
    def start(self) -> list[float]:
        """From nothing to the first communication point; the outputs there."""

    @abstractmethod
    def step(self, t: float, step: float, parts: int, inputs: Sequence[float]) -> list[float]:
        """Holds the inputs over `parts` steps that make up `step`: the time reached and the outputs there."""

    @abstractmethod
    def end(self) -> None:
        """Tells the FMU that it is over, and lets go of it."""

    def _load(self, library: str) -> ctypes.CDLL:
        self.announce("loading the library")
        folder = Path.cwd()
        os.chdir(Path(library).parent)  # where some libraries expect to find what they load themselves
        try:
            return ctypes.CDLL(library)
        except OSError as error:
            # A library may lack functions that it never calls, which only loading it lazily forgives.
            open_lazily = ctypes.CDLL(None).dlopen
            open_lazily.argtypes, open_lazily.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
            if handle := open_lazily(library.encode(), os.RTLD_LAZY):
                return ctypes.CDLL(library, handle=handle)
            raise UnusableError(str(error).replace(f"{Path(library).parent}/", "")) from None
        finally:
            os.chdir(folder)

    def _function(self, name: str, *arguments: Any, result: Any = ctypes.c_int) -> Any:
        try:
            function = getattr(self._dll, name)
        except AttributeError:
            raise UnusableError(f"its library has no function {name}") from None
        function.argtypes, function.restype = arguments, result
        return function

    def _check(self, call: str, status: int) -> None:
        if status <= WARNING:
            return
        if status == FATAL:
            raise FatalError(f"{call} returned fatal: {self._reason()}")
        label = _STATUS[status] if status <= PENDING else f"{status}, which is no status"
        raise RefusedError(f"{call} returned {label}: {self._reason()}")

    def _call(self, name: str, *arguments: Any) -> None:
        self.announce(name)
        self._check(name, self._function(name, *(_ctype(argument) for argument in arguments))(*arguments))

    def _set_parameter(self, setting: Setting, function: Callable[..., int], *, sized: bool) -> None:
        (block,) = blocks(self.types, [setting])
        block.fill([v.encode() for v in setting["values"]] if setting["type"] == "String" else setting["values"])
        arguments = [self._handle, block.references, 1, block.values] + ([block.size] if sized else [])
        try:
            self._check("setting it", function(*arguments))
        except RefusedError as error:
            raise ParameterError(setting["name"], str(error)) from None

    def _listen(self, status: int, message: bytes | None) -> None:
        if status > OK and message:
            self._log.append(" ".join(message.decode(errors="replace").split()))

    def _reason(self) -> str:
        said = "; ".join(self._log)
        self._log.clear()
        return said[-400:] or _NO_REASON

    def _fill_inputs(self, values: Sequence[float]) -> None:
        fill(self._inputs, values)

    def _row(self) -> list[float]:
        return row(self._outputs)


def _ctype(argument: Any) -> Any:
    """The C type of an argument that is an int (of FMI's 32 bit), a bool, a float, or of a C type already."""
    return {bool: ctypes.c_bool, int: ctypes.c_int, float: ctypes.c_double}.get(type(argument), type(argument))
