"""`bms-ukf run` as systemd runs it, without any privilege, on a real vcan0: killed, configured anew, ended."""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from can import BusABC, Message
from daemon_process import DaemonProcess
from model_cell import ModelCell

from bms_ukf import Sample, slots
from bms_ukf.dbc import own_matrix
from bms_ukf.node import SampleEncoder

pytestmark = pytest.mark.socketcan

PERIOD_S = 0.1
GUEST_SECOND_NS = 5_000_000_000  # what takes a tenth of a second on an idle host
CONFIG = """
format = 1
cell = "lgm50_chen2020"
silence_s = 0.5
bus = { interface = "socketcan", channel = "vcan0" }
state = { file = "state", period_s = 0.2 }
"""


NOBODY = 65534
# A process that begins with this has no capability, whoever it belongs to, and cannot gain one.
UNPRIVILEGED = ["setpriv", "--no-new-privs", "--bounding-set", "-all", "--inh-caps", "-all"]
AS_NOBODY = [f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]


def may_change_user() -> bool:
    """Root may, but for that of a user namespace, who is the user that made it and is no other."""
    return os.geteuid() == 0 and Path("/proc/self/uid_map").read_text().split()[2] != "1"


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """What systemd would make for the service: state and cache of its own, the configuration to be read."""
    folder = Path(os.environ.get("BMS_UKF_SERVICE_FOLDER", tmp_path)) / "service"
    folder.mkdir(mode=0o755)
    (folder / "bms.toml").write_text(CONFIG)
    (folder / "var").mkdir()
    shutil.copytree(os.environ["NUMBA_CACHE_DIR"], folder / "cache")
    if may_change_user():
        for path in [folder / "var", folder / "cache", *(folder / "cache").rglob("*")]:
            os.chown(path, NOBODY, NOBODY)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def daemon(vcan: Any, folder: Path) -> Iterator[DaemonProcess]:
    environment = {"STATE_DIRECTORY": str(folder / "var"), "NUMBA_CACHE_DIR": str(folder / "cache")}
    prefix = [*UNPRIVILEGED, *(AS_NOBODY if may_change_user() else [])]
    with DaemonProcess(folder / "bms.toml", prefix=prefix, environment=environment) as daemon:
        yield daemon.begin()


def test_the_service_belongs_to_nobody_and_may_do_nothing_but_its_work(vcan, daemon, folder):
    status = Path(f"/proc/{daemon.process.pid}/status").read_text()
    if may_change_user():
        assert f"Uid:\t{NOBODY}\t{NOBODY}" in status
    assert "NoNewPrivs:\t1" in status
    assert daemon.capabilities() == 0


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


def test_killed_and_started_again_it_knows_what_it_knew(vcan, daemon, folder, cell):
    battery = ModelCell(cell, 0.7)
    with vcan.bus() as bus:
        drive(bus, battery, 40)
        known = told(bus, "SocEstimate")[-1]
        killed_ns = time.time_ns()
        daemon.end(signal.SIGKILL)
        assert killed_ns - slots.read(folder / "var" / "state")[0].wall_ns < GUEST_SECOND_NS
        daemon.begin()
        told(bus, "SocDetail")
        time.sleep(1.0)
        state, detail = told(bus, "BmsState"), told(bus, "SocDetail")
    assert "state: used: " in daemon.said()
    assert str(state[-1]["StoredState"]) == "used"
    assert {str(row["Source"]) for row in detail} == {"stored"}
    assert detail[-1]["SocSlewed"] == pytest.approx(known["Soc"], abs=0.1)


def test_sigterm_stores_and_leaves_within_a_second(vcan, daemon, folder, cell):
    with vcan.bus() as bus:
        drive(bus, ModelCell(cell, 0.7), 20)
    took_s = daemon.end(signal.SIGTERM)
    assert daemon.process.returncode == 0
    assert took_s * 1e9 < GUEST_SECOND_NS
    assert "Traceback" not in daemon.said()
    assert time.time_ns() - slots.read(folder / "var" / "state")[0].wall_ns < 10_000_000_000


def test_sighup_takes_up_a_new_configuration_and_refuses_a_wrong_one(vcan, daemon, folder, cell):
    battery = ModelCell(cell, 0.7)
    with vcan.bus() as bus:
        drive(bus, battery, 20)
        known = told(bus, "SocEstimate")[-1]["Soc"]
        for text, line in (
            (CONFIG.replace("silence_s", "silense_s"), "not reloaded, and running as before"),
            (CONFIG.replace("format = 1", 'format = 1\ntransmit = "periodic"'), "reloaded: "),
        ):
            (folder / "bms.toml").write_text(text)
            daemon.process.send_signal(signal.SIGHUP)
            daemon.wait_for(line)
        told(bus, "SocEstimate")
        drive(bus, battery, 10)
        assert told(bus, "SocEstimate")[-1]["Soc"] == pytest.approx(known, abs=0.5)
    assert "Traceback" not in daemon.said()
