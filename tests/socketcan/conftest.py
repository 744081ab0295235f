"""The bus and its independent witness for the tests over a real vcan0; `run.py` provides the interface."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import pytest
from can import Bus, BusABC

LINE = re.compile(r"\((?P<stamp>\d+\.\d+)\) (?P<channel>\S+) (?P<id>[0-9A-F]+)#(?P<data>[0-9A-F]*)$")


@dataclass(frozen=True)
class Vcan:
    """The interface under test, and what an installer could do to it."""

    channel: str = "vcan0"
    interface: str = "socketcan"

    @contextmanager
    def bus(self, **options: object) -> Iterator[BusABC]:
        with Bus(interface=self.interface, channel=self.channel, **options) as bus:
            yield bus

    def up(self) -> None:
        self._link("set", self.channel, "up")

    def down(self) -> None:
        self._link("set", self.channel, "down")

    def remove(self) -> None:
        self._link("delete", self.channel)

    def create(self) -> None:
        self._link("add", "dev", self.channel, "type", "vcan")
        self.up()

    def exists(self) -> bool:
        return any(name == self.channel for _, name in socket.if_nameindex())

    def _link(self, *arguments: str) -> None:
        subprocess.run(["ip", "link", *arguments], check=True)


class LoggedFrame(NamedTuple):
    timestamp_us: int
    arbitration_id: int
    is_extended: bool
    data: bytes


class Candump:
    """What `candump -L` has written so far."""

    def __init__(self, log: Path) -> None:
        self._log = log

    def frames(self, at_least: int, timeout_s: float = 20.0, ids: Collection[int] | None = None) -> list[LoggedFrame]:
        """All frames so far with one of these ids (None: with any), once there are `at_least` so many.

        Fails with what was seen if they do not come.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            text = self._log.read_text()
            seen = [_parse(line) for line in text[: text.rindex("\n")].splitlines()] if "\n" in text else []
            seen = [frame for frame in seen if ids is None or frame.arbitration_id in ids]
            if len(seen) >= at_least:
                return seen
            assert time.monotonic() < deadline, f"candump saw fewer than {at_least} frames:\n{text}"
            time.sleep(0.02)


@pytest.fixture
def vcan() -> Iterator[Vcan]:
    """vcan0, up; put back as it was if the test took it down or away."""
    vcan = Vcan()
    assert vcan.exists(), "no vcan0: these tests are started by tests/socketcan/run.py"
    yield vcan
    if vcan.exists():
        vcan.up()
    else:
        vcan.create()


@pytest.fixture
def candump(vcan: Vcan, tmp_path: Path) -> Iterator[Candump]:
    """A running candump that has its socket bound, so it misses nothing the test sends."""
    assert shutil.which("candump"), "can-utils is not installed"
    before = _receivers(vcan.channel)
    log = tmp_path / "candump.log"
    with log.open("wb") as stdout, subprocess.Popen(["candump", "-L", vcan.channel], stdout=stdout) as process:
        deadline = time.monotonic() + 20.0
        while _receivers(vcan.channel) == before:
            assert process.poll() is None, f"candump ended with {process.returncode}"
            assert time.monotonic() < deadline, "candump did not open its socket"
            time.sleep(0.02)
        yield Candump(log)
        process.terminate()


def _receivers(channel: str) -> int:
    """How many sockets listen to every frame of the channel."""
    return sum(line.split()[:1] == [channel] for line in Path("/proc/net/can/rcvlist_all").read_text().splitlines())


def _parse(line: str) -> LoggedFrame:
    match = LINE.match(line)
    assert match, f"not a line of candump -L: {line!r}"
    seconds, microseconds = match["stamp"].split(".")
    stamp_us = int(seconds) * 1_000_000 + int(microseconds)
    return LoggedFrame(stamp_us, int(match["id"], 16), len(match["id"]) == 8, bytes.fromhex(match["data"]))
