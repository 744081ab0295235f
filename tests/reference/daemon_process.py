"""`bms-ukf run` as its own process, with what it says on stderr, for tests that treat it as a service manager would."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

ROOT = Path(__file__).resolve().parents[2]
# A guest on a busy machine was seen to need a minute to import numba; what never comes is a hang all the same.
PATIENCE_S = 300.0


class DaemonProcess:
    """A context manager: at its end the process is gone, whatever became of the test. `begin` may be called again."""

    def __init__(
        self, config: Path, *, prefix: Sequence[str] = (), environment: Mapping[str, str] | None = None
    ) -> None:
        """`prefix`: a command that starts the daemon's. The log is `stderr.log` in the folder of `config`."""
        self._command = [*prefix, sys.executable, "-X", "faulthandler", "-m", "bms_ukf", "run", str(config)]
        self._folder, self._log = config.parent, config.parent / "stderr.log"
        self._environment = os.environ | {"PYTHONPATH": str(ROOT)} | dict(environment or {})
        self._process: subprocess.Popen[bytes] | None = None
        self._log.touch()

    def begin(self) -> Self:
        """Start it, and wait until it says that it runs."""
        times = self.said().count("running: ")
        with self._log.open("ab") as stderr:
            self._process = subprocess.Popen(
                self._command, cwd=self._folder, env=self._environment, stdin=subprocess.DEVNULL, stderr=stderr
            )
        self.wait_for("running: ", times + 1)
        return self

    @property
    def process(self) -> subprocess.Popen[bytes]:
        assert self._process is not None, "not begun"
        return self._process

    def said(self) -> str:
        return self._log.read_text()

    def alive(self) -> bool:
        return self.process.poll() is None

    def wait_for(self, text: str, times: int = 1) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while self.said().count(text) < times:
            assert self.alive(), f"ended with {self.process.returncode}:\n{self.said()}"
            if time.monotonic() > deadline_s:
                self.process.send_signal(signal.SIGABRT)  # faulthandler writes where it hangs
                self.process.wait(PATIENCE_S)
                raise AssertionError(f"never said {text!r}:\n{self.said()}")
            time.sleep(0.05)

    def end(self, number: int) -> float:
        """End it by a signal: how long it took to leave the bus, in s; the process itself may take longer."""
        began_s, times = time.monotonic(), self.said().count("stopped: ")
        self.process.send_signal(number)
        while self.said().count("stopped: ") == times and self.alive():
            time.sleep(0.01)
        took_s = time.monotonic() - began_s
        self.process.wait(PATIENCE_S)
        return took_s

    def capabilities(self) -> int:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.split("CapEff:")[1].split()[0], 16)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None and self.alive():
            self._process.kill()
            self._process.wait(PATIENCE_S)
