"""`bms-ukf run` as systemd runs it, without any privilege, on a real vcan0: killed, configured anew, ended."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from can import BusABC, Message
from model_cell import ModelCell

from bms_ukf import Sample, slots
from bms_ukf.dbc import own_matrix
from bms_ukf.node import SampleEncoder

pytestmark = pytest.mark.socketcan

ROOT = Path(__file__).resolve().parents[2]
PERIOD_S = 0.1
CONFIG = """
format = 1
cell = "lgm50_chen2020"
silence_s = 0.5
bus = { interface = "socketcan", channel = "vcan0" }
state = { file = "state", period_s = 0.2 }
"""


# A process that begins with this has no capability, whoever it belongs to, and cannot gain one.
UNPRIVILEGED = ["setpriv", "--no-new-privs", "--bounding-set", "-all", "--inh-caps", "-all"]


class Process:
    def __init__(self, folder: Path) -> None:
        self._log = folder / "stderr.log"
        environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "STATE_DIRECTORY": str(folder / "var"),
            "NUMBA_CACHE_DIR": str(folder / "cache"),
        }
        with self._log.open("ab") as stderr:
            command = [*UNPRIVILEGED, sys.executable, "-m", "bms_ukf", "run", str(folder / "bms.toml")]
            self._process = subprocess.Popen(command, cwd="/", env=environment, stderr=stderr)

    def said(self) -> str:
        return self._log.read_text()

    def wait_for(self, text: str, times: int = 1) -> None:
        deadline = time.monotonic() + 120.0
        while self.said().count(text) < times:
            assert self._process.poll() is None, f"ended with {self._process.returncode}:\n{self.said()}"
            assert time.monotonic() < deadline, f"never said {text!r}:\n{self.said()}"
            time.sleep(0.05)

    def end(self, number: int) -> tuple[int, float]:
        """Its exit code, and how long it took to leave the bus."""
        began_s, times = time.monotonic(), self.said().count("stopped: ")
        self._process.send_signal(number)
        while self.said().count("stopped: ") == times and self._process.poll() is None:
            time.sleep(0.01)
        took_s = time.monotonic() - began_s
        return self._process.wait(30.0), took_s

    def signal(self, number: int) -> None:
        self._process.send_signal(number)

    def capabilities(self) -> int:
        status = Path(f"/proc/{self._process.pid}/status").read_text()
        return int(status.split("CapEff:")[1].split()[0], 16)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What systemd would make for the service: state and cache of its own, the configuration to be read."""
    (tmp_path / "bms.toml").write_text(CONFIG)
    (tmp_path / "var").mkdir()
    shutil.copytree(os.environ["NUMBA_CACHE_DIR"], tmp_path / "cache")
    return tmp_path


@pytest.fixture
def start(vcan: Any, folder: Path) -> Iterator[Callable[[], Process]]:
    started: list[Process] = []

    def begin() -> Process:
        started.append(Process(folder))
        started[-1].wait_for("running: ", len(started))
        return started[-1]

    yield begin
    for process in started:
        process.end(signal.SIGKILL)


def drive(bus: BusABC, battery: ModelCell, scans: int) -> None:
    encoder = SampleEncoder()
    for _ in range(scans):
        for identifier, extended, data in encoder.encode(Sample(0, 1.0, battery.step(1.0, PERIOD_S), 25.0)):
            bus.send(Message(arbitration_id=identifier, is_extended_id=extended, data=data), timeout=5.0)
        time.sleep(PERIOD_S)


def told(bus: BusABC, message: str) -> list[dict[str, Any]]:
    wanted, found = own_matrix().message(message), []
    while (heard := bus.recv(0.2)) is not None and len(found) < 500:
        if heard.arbitration_id == wanted.frame_id:
            found.append(wanted.decode(bytes(heard.data)))
    return found


def test_killed_and_started_again_it_knows_what_it_knew(vcan, start, folder, cell):
    battery = ModelCell(cell, 0.7)
    first = start()
    assert first.capabilities() == 0
    with vcan.bus() as bus:
        drive(bus, battery, 40)
        known = told(bus, "SocEstimate")[-1]
        killed_ns = time.time_ns()
        first.end(signal.SIGKILL)
        assert killed_ns - slots.read(folder / "var" / "state")[0].wall_ns < 1_000_000_000
        second = start()
        told(bus, "SocDetail")
        time.sleep(1.0)
        state, detail = told(bus, "BmsState"), told(bus, "SocDetail")
    assert "state: used: " in second.said()
    assert str(state[-1]["StoredState"]) == "used"
    assert {str(row["Source"]) for row in detail} == {"stored"}
    assert detail[-1]["SocSlewed"] == pytest.approx(known["Soc"], abs=0.1)


def test_sigterm_stores_and_leaves_within_a_second(vcan, start, folder, cell):
    process = start()
    with vcan.bus() as bus:
        drive(bus, ModelCell(cell, 0.7), 20)
    code, took_s = process.end(signal.SIGTERM)
    assert code == 0
    assert took_s < 1.0
    assert "Traceback" not in process.said()
    assert time.time_ns() - slots.read(folder / "var" / "state")[0].wall_ns < 10_000_000_000


def test_sighup_takes_up_a_new_configuration_and_refuses_a_wrong_one(vcan, start, folder, cell):
    battery = ModelCell(cell, 0.7)
    process = start()
    with vcan.bus() as bus:
        drive(bus, battery, 20)
        known = told(bus, "SocEstimate")[-1]["Soc"]
        for text, line in (
            (CONFIG.replace("silence_s", "silense_s"), "not reloaded, and running as before"),
            (CONFIG.replace("format = 1", 'format = 1\ntransmit = "periodic"'), "reloaded: "),
        ):
            (folder / "bms.toml").write_text(text)
            process.signal(signal.SIGHUP)
            process.wait_for(line)
        told(bus, "SocEstimate")
        drive(bus, battery, 10)
        assert told(bus, "SocEstimate")[-1]["Soc"] == pytest.approx(known, abs=0.5)
    assert "Traceback" not in process.said()
