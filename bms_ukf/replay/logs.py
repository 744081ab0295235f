"""CAN logs as what was received, and the time they were received at."""

from __future__ import annotations

import re
from binascii import unhexlify
from collections.abc import Collection, Iterator
from pathlib import Path

import can

from bms_ukf.clock import TOLERANCE_NS
from bms_ukf.errors import ConfigError

Heard = tuple[float, int, bool, bytes, bool]  # stamp in s, then as the arguments of `Core.hear`

_CHUNK_BYTES = 1 << 22


def frames(path: Path, ids: Collection[tuple[int, bool]], *, fd: bool = False) -> Iterator[Heard]:
    """The frames of a log with these ids, each with whether it is an extended one, in the order of the file.

    `fd`: CAN FD frames are to be read. ConfigError if it is no such log. A last line that was cut off ends it.
    """
    if path.suffix.lower() == ".log":
        yield from _candump(path, ids, fd)
        return
    wanted = frozenset(ids)
    try:
        with can.LogReader(path) as reader:
            for message in reader:
                identity = message.arbitration_id, message.is_extended_id
                if identity in wanted:
                    classic = not (message.is_remote_frame or message.is_error_frame or (message.is_fd and not fd))
                    yield message.timestamp, *identity, bytes(message.data), classic
    except (ImportError, NotImplementedError):
        raise ConfigError(path, expected="asammdf, which reads .mf4 (pip install 'bms-ukf[mf4]')") from None
    except Exception as error:  # whatever a broken file makes the readers of five formats stumble over
        raise ConfigError(path, expected=f"a CAN log in the format its name says ({error or type(error)})") from None


def _candump(path: Path, ids: Collection[tuple[int, bool]], fd: bool) -> Iterator[Heard]:
    """`candump -L`, of which one search finds the frames that are wanted: python-can makes a message of every line."""
    known = {(b"%08X" if wide else b"%03X") % number: (number, wide) for number, wide in ids}
    search = re.compile(rb" (" + b"|".join(known) + rb")#(\S*)", re.IGNORECASE).finditer
    lines = 0
    try:
        with path.open("rb") as file:
            while text := file.read(_CHUNK_BYTES) + file.readline():
                text = text[: text.rfind(b"\n") + 1]
                if not text:
                    return
                if not (text.startswith(b"(") and text.count(b"\n(") == text.count(b"\n") - 1):
                    line = next((k for k, line in enumerate(text.splitlines()) if not line.startswith(b"(")), 0)
                    raise _no_candump(path, lines, text, line)
                for found in search(text):
                    name, data = found.groups()
                    begin = text.rfind(b"\n", 0, found.start()) + 2  # after the line's end and the bracket
                    try:
                        stamp_s = float(text[begin : text.index(b")", begin)])
                        payload, classic = _special(data, fd) if data[:1] in b"#R" else (unhexlify(data), True)
                    except ValueError:
                        raise _no_candump(path, lines, text, text.count(b"\n", 0, begin)) from None
                    yield stamp_s, *known[name.upper()], payload, classic
                lines += text.count(b"\n")
    except OSError as error:
        raise ConfigError(path, expected=f"a readable candump log ({error})") from None


def _special(data: bytes, fd: bool) -> tuple[bytes, bool]:
    """Payload of what is no classic frame with data, and whether it is read all the same."""
    if data.startswith(b"#"):
        return unhexlify(data[2:]), fd
    return b"", not data


def _no_candump(path: Path, lines: int, text: bytes, line: int) -> ConfigError:
    """For line `line` of `text`, which follows `lines` others."""
    value = text.splitlines()[line].decode("ascii", "replace").strip()
    expected = "a line of candump -L: (seconds.microseconds) channel id#data"
    return ConfigError(path, key=f"line {lines + line + 1}", value=value, expected=expected)


class LogClock:
    """Time since the first frame of a log. A stamp that goes back is a wall clock that was set: no time has passed."""

    def __init__(self) -> None:
        self.steps = 0
        self._begin_ns: int | None = None  # the stamp of time 0
        self._t_ns = 0

    def due(self, stamp_s: float) -> int:
        """When a frame stamped `stamp_s` is received; it moves nothing."""
        t_ns = self._t_ns
        due_ns = t_ns if self._begin_ns is None else round(stamp_s * 1e9) - self._begin_ns
        return due_ns if due_ns > t_ns else t_ns

    def at(self, stamp_s: float) -> int:
        stamp_ns = round(stamp_s * 1e9)
        if self._begin_ns is None:
            self._begin_ns = stamp_ns - self._t_ns
        t_ns = stamp_ns - self._begin_ns
        if t_ns > self._t_ns:
            self._t_ns = t_ns
        elif t_ns < self._t_ns - TOLERANCE_NS:
            self.steps += 1
            self._begin_ns = stamp_ns - self._t_ns
        return self._t_ns

    def wait(self, waited_ns: int) -> None:
        self._t_ns += waited_ns

    def now(self) -> int:
        return self._t_ns

    def advance(self) -> int:
        return self._t_ns
