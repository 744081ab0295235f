"""DBC files, and their signals compiled to functions: a payload's bytes to a number, and a number to payload bits."""

from __future__ import annotations

import difflib
import functools
import math
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Literal

import cantools
from cantools.database import Database
from cantools.database.can import Message, Signal
from cantools.database.errors import Error

from bms_ukf.e2e import Profile11A
from bms_ukf.errors import ConfigError
from bms_ukf.records import NAN
from bms_ukf.resources import default_dbc

NOT_AVAILABLE = "NotAvailable"  # the name our own DBC gives to "all bits set" in its value tables

Extract = Callable[[bytes], float]
Insert = Callable[[float], int]


class Matrix:
    """The messages of one or more DBC files.

    A file that is not strictly valid is refused if `strict`, else read as far as it goes; `warnings` then says so, and
    `find` refuses the messages that contradict themselves.
    """

    def __init__(self, paths: Sequence[str | Path], *, strict: bool = True) -> None:
        self.warnings: list[str] = []
        self._source = ", ".join(str(path) for path in paths)
        self._suspect: set[Message] = set()  # those of files that are not strictly valid
        self._messages = [message for path in paths for message in self._load(path, strict)]

    def _load(self, path: str | Path, strict: bool) -> list[Message]:
        try:
            return _read(path, strict=True)
        except (Error, OSError, UnicodeDecodeError) as error:
            reason = error
        try:
            if strict or isinstance(reason, OSError):
                raise reason
            messages = _read(path, strict=False)
        except (Error, OSError, UnicodeDecodeError) as error:
            raise ConfigError(path, expected=f"a readable DBC file ({error})") from None
        self.warnings.append(f"{path}: not strictly valid, read all the same ({reason})")
        self._suspect.update(messages)
        return messages

    def sound(self) -> list[Message]:
        """The messages that do not contradict themselves, and whose name no other one has."""
        names = Counter(message.name for message in self._messages)
        return [message for message in self._messages if names[message.name] == 1 and self._fault(message) is None]

    def _fault(self, message: Message) -> Error | None:
        """What is wrong with the layout of a message, if anything."""
        if message in self._suspect:
            try:
                message.refresh(strict=True)
            except Error as error:
                return error
        return None

    def message(self, name: str, *, source: str | Path | None = None, key: str | None = None) -> Message:
        """The message called `name`. ConfigError if there is none, or more than one, or it contradicts itself."""
        found = [message for message in self._messages if message.name == name]
        source = source or self._source
        if len(found) != 1:
            near = _nearest(name, [message.name for message in self._messages])
            expected = f"the name of one message of {self._source}{near}" + (", not of several" if found else "")
            raise ConfigError(source, key=key, value=name, expected=expected)
        if (fault := self._fault(found[0])) is not None:
            raise ConfigError(source, key=key, value=name, expected=f"a sound layout ({fault})")
        return found[0]

    def find(self, path: str, *, source: str | Path | None = None, key: str | None = None) -> tuple[Message, Signal]:
        """The message and signal of `path`, a "Message.Signal". ConfigError as for `message`, or if there is none."""
        message_name, _, signal_name = path.partition(".")
        message = self.message(message_name, source=source, key=key)
        try:
            return message, message.get_signal_by_name(signal_name)
        except KeyError:
            near = _nearest(signal_name, [signal.name for signal in message.signals], prefix=f"{message_name}.")
            expected = f"a signal of {message_name} in {self._source}{near}"
            raise ConfigError(source or self._source, key=key, value=path, expected=expected) from None


@functools.cache
def own_matrix() -> Matrix:
    """The project's own CAN matrix, `can/bms.dbc`."""
    return Matrix([default_dbc()])


def protection(message: Message) -> Profile11A | None:
    """The E2E profile that the attributes of `message` declare (E2EProfile, E2EDataId, E2EMaxDelta, E2ETimeout)."""
    attributes = {name: attribute.value for name, attribute in message.dbc.attributes.items()} if message.dbc else {}
    if attributes.get("E2EProfile", "none") == "none":
        return None
    if attributes["E2EProfile"] != "P11A":
        raise ConfigError(message.name, key="E2EProfile", value=attributes["E2EProfile"], expected='"P11A" or "none"')
    return Profile11A(
        data_id=int(attributes["E2EDataId"]),
        max_delta=int(attributes["E2EMaxDelta"]),
        timeout_ns=int(attributes["E2ETimeout"]) * 1_000_000,
    )


class Field:
    """Where one signal lies when the payload is read as one integer, and what its raw values mean.

    `codes` are the raw values that are words and not numbers: those with a name in the signal's value table, and those
    in `not_available`. Raw values are unsigned here, negative ones as their two's complement.
    """

    def __init__(self, message: Message, signal: Signal, not_available: Collection[int] = ()) -> None:
        self.order: Literal["little", "big"] = "little" if signal.byte_order == "little_endian" else "big"
        self.shift = signal.start
        if self.order == "big":  # a DBC counts the bits of each byte from its right, but gives the leftmost one
            from_left = 8 * (signal.start // 8) + 7 - signal.start % 8
            self.shift = 8 * message.length - from_left - signal.length
        self.width = signal.length
        self.mask = (1 << signal.length) - 1
        self.sign = 1 << (signal.length - 1) if signal.is_signed else 0
        self.is_float = bool(signal.conversion.is_float)
        self.scale, self.offset = float(signal.scale), float(signal.offset)
        self.minimum, self.maximum = signal.minimum, signal.maximum
        named = {str(name): int(raw) & self.mask for raw, name in (signal.choices or {}).items()}
        self.codes = frozenset(named.values()) | {code & self.mask for code in not_available}
        self.missing = named.get(NOT_AVAILABLE)

    def raw(self) -> Callable[[bytes], int]:
        """A function from the payload, exactly as long as the DBC says, to the raw value."""
        order, shift, mask, from_bytes = self.order, self.shift, self.mask, int.from_bytes
        return lambda data: (from_bytes(data, order) >> shift) & mask

    def span(self) -> tuple[float, float]:
        """The physical values of the lowest and the highest raw value that is a number; infinite for a float signal."""
        if self.is_float:
            return -math.inf, math.inf
        numbers = [raw - 2 * (raw & self.sign) for raw in self._ends()]
        return numbers[0] * self.scale + self.offset, numbers[1] * self.scale + self.offset

    def _ends(self) -> tuple[int, int]:
        low, high = (self.sign, self.sign - 1) if self.sign else (0, self.mask)
        while low in self.codes and low != high:
            low = (low + 1) & self.mask
        while high in self.codes and low != high:
            high = (high - 1) & self.mask
        return low, high

    def extract(self, factor: float = 1.0, plus: float = 0.0) -> Extract:
        """A function from the payload, exactly as long as the DBC says, to the physical value * `factor` + `plus`.

        It returns NaN for the codes, and for a float signal that is not finite.
        """
        order, shift, mask, from_bytes = self.order, self.shift, self.mask, int.from_bytes
        sign, scale, offset, codes = self.sign, self.scale * factor, self.offset * factor + plus, self.codes

        def unsigned(data: bytes) -> float:
            raw = (from_bytes(data, order) >> shift) & mask
            return NAN if raw in codes else raw * scale + offset

        def signed(data: bytes) -> float:
            raw = (from_bytes(data, order) >> shift) & mask
            return NAN if raw in codes else ((raw ^ sign) - sign) * scale + offset

        def real(data: bytes) -> float:
            raw = (from_bytes(data, order) >> shift) & mask
            value: float = unpack(raw.to_bytes(size, "little"))[0] * scale + offset
            return NAN if raw in codes or not math.isfinite(value) else value

        size = self.width // 8
        unpack = struct.Struct({2: "<e", 4: "<f", 8: "<d"}.get(size, "<d")).unpack
        return real if self.is_float else signed if sign else unsigned

    def insert(self, factor: float = 1.0) -> Insert:
        """A function from a value to its bits in the payload's integer; the inverse of `extract(factor)`.

        NaN gives the not-available code, which the signal must have; what is beyond the DBC's limits gives the limit.
        """
        scale, offset, shift, mask, missing = (
            self.scale * factor,
            self.offset * factor,
            self.shift,
            self.mask,
            self.missing,
        )
        if missing is None or self.minimum is None or self.maximum is None:
            raise ValueError("a signal to be sent needs limits, and a code for not available")
        ends = [round((limit - self.offset) / self.scale) for limit in (self.minimum, self.maximum)]
        (lowest, low), (highest, high) = sorted((raw * scale + offset, raw) for raw in ends)

        def insert(value: float) -> int:
            if lowest <= value <= highest:
                return (round((value - offset) / scale) & mask) << shift
            if math.isnan(value):
                return missing << shift
            return ((low if value < lowest else high) & mask) << shift

        return insert


def _read(path: str | Path, *, strict: bool) -> list[Message]:
    database = cantools.database.load_file(path, database_format="dbc", strict=strict)
    assert isinstance(database, Database)
    return database.messages


def _nearest(name: str, names: Iterable[str], prefix: str = "") -> str:
    near = difflib.get_close_matches(name, list(names), n=3, cutoff=0.5)
    return f" (near: {', '.join(prefix + found for found in near)})" if near else ""
