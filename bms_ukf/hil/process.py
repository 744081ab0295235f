"""The daemon as a process of its own, on a CAN interface, in real time: `bms-ukf run`."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.config import Bus
from bms_ukf.errors import ConfigError
from bms_ukf.faults.base import Injection
from bms_ukf.frames import Frame
from bms_ukf.hil.unit import STATE, obstacle

START_S = 60.0  # a slow machine compiles for long
ANSWER_SHARE = 0.8  # of a step; the rest is the plant's
LATE_S = 0.01
END_S = 10.0


class Process:
    """A `Unit`."""

    def __init__(self, config: Path, interface: str, channel: str) -> None:
        """ConfigError if the interface cannot be opened."""
        settings = Bus(interface=interface, channel=channel)
        self._config, self._channel = config, channel
        self.state = config.parent / STATE
        self._log = config.parent / "stderr.log"
        self._bus = SafeBus(lambda: open_bus(settings, "hil"))
        self._process: subprocess.Popen[bytes] | None = None
        self._started_s = time.monotonic()
        self._heard: list[Frame] = []

    @staticmethod
    def obstacle(faults: Sequence[Injection], interface: str) -> str | None:
        """Why faults cannot be had here; None: they can."""
        impossible = {"clock_step": f"the wall clock of this machine is not set (over {interface})"}
        if interface != "socketcan" or os.geteuid() != 0:
            impossible["interface_down"] = f"taking {interface} down needs socketcan and root"
        return obstacle(faults, impossible)

    def __enter__(self) -> Self:
        try:
            self.start()
            self._wait_until_it_runs()
        except BaseException:
            self.__exit__()
            raise
        self._started_s = time.monotonic()
        return self

    def __exit__(self, *error: object) -> None:
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self.kill()
        self._bus.close()

    def advance(self, t_ns: int) -> bool:
        at_s = self._started_s + t_ns * 1e-9
        punctual = time.monotonic() < at_s + LATE_S
        self._listen(at_s)
        return punctual

    def send(self, frame: Frame) -> None:
        self._bus.send(frame, 0)

    def answers(self, until_ns: int) -> list[Frame]:
        """What has come when most of the time until then is over."""
        left_s = self._started_s + until_ns * 1e-9 - time.monotonic()
        self._listen(time.monotonic() + ANSWER_SHARE * max(left_s, 0.0))
        heard, self._heard = self._heard, []
        return heard

    def interface(self, *, up: bool) -> None:
        subprocess.run(["ip", "link", "set", self._channel, "up" if up else "down"], check=True)

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def start(self) -> None:
        with self._log.open("ab") as stderr:
            command = [sys.executable, "-m", "bms_ukf", "run", str(self._config)]
            environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=stderr, env=environment)

    def set_clock(self, offset_s: float) -> None:
        raise RuntimeError("the clock is the machine's, as `obstacle` says")

    def _listen(self, until_s: float) -> None:
        while True:
            message = self._bus.recv(max(until_s - time.monotonic(), 0.0))
            if message is not None and not message.is_error_frame:
                self._heard.append((message.arbitration_id, message.is_extended_id, bytes(message.data)))
            if message is None and time.monotonic() >= until_s:
                return

    def _wait_until_it_runs(self) -> None:
        deadline = time.monotonic() + START_S
        while "running: " not in self._log.read_text():
            ended = self._process is None or self._process.poll() is not None
            if ended or time.monotonic() > deadline:
                said = self._log.read_text().strip().splitlines()
                raise ConfigError("hil", expected=f"a daemon that starts ({said[-1] if said else 'it says nothing'})")
            time.sleep(0.02)
