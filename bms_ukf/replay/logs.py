"""CAN logs as a bus: every frame is received at the time it is stamped with, and what is sent goes nowhere."""

from __future__ import annotations

import struct
import threading
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

import can

from bms_ukf.clock import TOLERANCE_NS
from bms_ukf.errors import ConfigError


def frames(path: Path, ids: Collection[tuple[int, bool]]) -> Iterator[can.Message]:
    """The frames of a log with these ids, each with whether it is an extended one, in the order of the file.

    ConfigError if it is no such log. A last line that was cut off ends it.
    """
    wanted = frozenset(ids)
    if path.suffix.lower() == ".log":
        yield from _candump(path, wanted)
        return
    try:
        with can.LogReader(path) as reader:
            for message in reader:
                if (message.arbitration_id, message.is_extended_id) in wanted:
                    yield message
    except (ImportError, NotImplementedError):
        raise ConfigError(path, expected="asammdf, which reads .mf4 (pip install 'bms-ukf[mf4]')") from None
    except (OSError, ValueError, IndexError, KeyError, AssertionError, struct.error, can.CanError) as error:
        raise ConfigError(path, expected=f"a CAN log in the format its name says ({error or type(error)})") from None


def _candump(path: Path, wanted: frozenset[tuple[int, bool]]) -> Iterator[can.Message]:
    """`candump -L`: what python-can reads at a tenth of the speed, as it makes a message of every line."""
    known: dict[str, tuple[int, bool] | None] = {}
    try:
        with path.open(encoding="ascii") as file:
            for number, line in enumerate(file, 1):
                try:
                    stamp, _, frame = line.split()[:3]
                    name, _, data = frame.partition("#")
                    if name not in known:
                        identity = (int(name, 16), len(name) > 3)
                        known[name] = identity if identity in wanted else None
                    found = known[name]
                    if found is not None:
                        yield _message(float(stamp[1:-1]), *found, data)
                except ValueError:
                    if not line.endswith("\n"):
                        return
                    expected = "a line of candump -L: (seconds.microseconds) channel id#data"
                    raise ConfigError(path, key=f"line {number}", value=line.strip(), expected=expected) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(path, expected=f"a readable candump log ({error})") from None


def _message(stamp_s: float, identifier: int, extended: bool, text: str) -> can.Message:
    if text.startswith("#"):
        return can.Message(stamp_s, identifier, extended, is_fd=True, data=bytes.fromhex(text[2:]))
    if text.startswith("R"):
        return can.Message(stamp_s, identifier, extended, is_remote_frame=True)
    return can.Message(stamp_s, identifier, extended, data=bytes.fromhex(text))


class LogClock:
    """Time since the first frame of a log. A stamp that goes back is a wall clock that was set: no time has passed."""

    def __init__(self) -> None:
        self.steps = 0
        self._stamp_ns: int | None = None
        self._t_ns = 0

    def due(self, stamp_s: float) -> int:
        """When a frame stamped `stamp_s` is received; it moves nothing."""
        if self._stamp_ns is None:
            return self._t_ns
        return self._t_ns + max(round(stamp_s * 1e9) - self._stamp_ns, 0)

    def at(self, stamp_s: float) -> int:
        stamp_ns = round(stamp_s * 1e9)
        if self._stamp_ns is not None and stamp_ns < self._stamp_ns - TOLERANCE_NS:
            self.steps += 1
            self._stamp_ns = stamp_ns
        self._t_ns = self.due(stamp_s)
        self._stamp_ns = stamp_ns if self._stamp_ns is None else max(self._stamp_ns, stamp_ns)
        return self._t_ns

    def wait(self, waited_ns: int) -> None:
        self._t_ns += waited_ns
        if self._stamp_ns is not None:
            self._stamp_ns += waited_ns

    def now(self) -> int:
        return self._t_ns

    def advance(self) -> int:
        return self._t_ns


class LogBus:
    """A bus on which a log is heard, by `clock`; sets `ended` once it is over."""

    def __init__(self, log: Iterable[can.Message], clock: LogClock, ended: threading.Event) -> None:
        self._frames, self._clock, self._ended = iter(log), clock, ended
        self._next = next(self._frames, None)

    def recv(self, timeout: float) -> can.Message | None:
        message = self._next
        if message is None:
            self._ended.set()
            return None
        timeout_ns = max(round(timeout * 1e9), 1_000_000)  # a wait of no time would never end
        if self._clock.due(message.timestamp) - self._clock.now() > timeout_ns:
            self._clock.wait(timeout_ns)
            return None
        self._next = next(self._frames, None)
        return message

    def send(self, message: can.Message) -> None:
        """Nobody is there."""

    def shutdown(self) -> None:
        """Nothing to close."""
