"""The daemon as an operating system has it: stored and taken up, configured anew while it runs, watched by systemd."""

from __future__ import annotations

import itertools
import logging
import math
import re
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import can
import pytest
from model_cell import ModelCell

from bms_ukf import ConfigError, Fault, Sample, Status, service
from bms_ukf.bus import open_bus
from bms_ukf.config import Bus
from bms_ukf.dbc import own_matrix
from bms_ukf.node import SampleEncoder
from bms_ukf.records import Source, Stored
from bms_ukf.replay import flight
from bms_ukf.service import Service

UNIT = Path(__file__).resolve().parents[1] / "can" / "bms-ukf.service"
CONFIG = """
format = 1
cell = "lgm50_chen2020"
silence_s = 5.0
estimator = { initial_soc = 0.7, initial_soc_sigma = 0.01 }
[bus]
interface = "socketcan"
channel = "can0"
[state]
file = "state"
period_s = 0.1
"""

BALANCING = f"""
[signals]
dbc = ["{Path(__file__).resolve().parents[1] / "models" / "configs" / "example.dbc"}"]
current = "BatteryStatus.Current"
current_positive = "charge"
cell_voltage = ["CellStatus.Voltage"]
temperature = ["CellStatus.Temperature"]
balancing = ["CellStatus.Balancing"]
[pack]
bleed_A = 0.1
"""

_channels = (f"test-service-{k}" for k in itertools.count())


class Vehicle:
    """The other end of the bus a service is given, whatever its configuration names."""

    def __init__(self, cell: Any) -> None:
        self.channel = next(_channels)
        self.opened: list[Bus] = []
        self.bus = open_bus(Bus(interface="virtual", channel=self.channel), "vehicle")
        self._battery, self._encoder = ModelCell(cell, 0.7), SampleEncoder()

    def open(self, settings: Bus, source: str, ids: Any) -> can.BusABC:
        self.opened.append(settings)
        return open_bus(Bus(interface="virtual", channel=self.channel), source, ids)

    def drive(self, service: Service, scans: int) -> None:
        for _ in range(scans):
            voltage_V = self._battery.step(1.0, 0.1)
            for frame in self._encoder.encode(Sample(0, 1.0, voltage_V, 25.0)):
                self.bus.send(can.Message(0.0, *frame[:2], data=frame[2]))
            while service.daemon.poll(0.0):
                pass

    def told(self, message: str) -> list[dict[str, Any]]:
        """The signals of all frames of one message since the last call."""
        wanted = own_matrix().message(message)
        heard = list(iter(lambda: self.bus.recv(0.0), None))
        return [wanted.decode(bytes(m.data)) for m in heard if m.arbitration_id == wanted.frame_id]


@pytest.fixture
def vehicle(cell: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Vehicle]:
    vehicle = Vehicle(cell)
    monkeypatch.setattr(service, "open_bus", vehicle.open)
    yield vehicle
    vehicle.bus.shutdown()


@pytest.fixture
def started(tmp_path: Path, vehicle: Vehicle) -> Iterator[Callable[..., Service]]:
    """Starts a service by a configuration of this text; all are closed at the end."""
    services: list[Service] = []

    def start(text: str = CONFIG) -> Service:
        (tmp_path / "bms.toml").write_text(text)
        services.append(Service(tmp_path / "bms.toml"))
        services[-1].start()
        return services[-1]

    yield start
    for each in services:
        each.close()


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], list[str]]]:
    """A service manager's socket; gives what it was told since the last call."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "10000000")

        def heard() -> list[str]:
            lines = []
            while True:
                try:
                    lines.append(listening.recv(4096).decode())
                except BlockingIOError:
                    return lines

        yield heard


# --- stored and taken up ------------------------------------------------------------------------------------------


def test_what_was_known_when_it_stopped_is_known_when_it_starts(started, vehicle):
    first = started()
    assert vehicle.told("BmsState") == []
    vehicle.drive(first, 100)
    soc = first.daemon.estimate.soc
    assert str(vehicle.told("BmsState")[-1]["StoredState"]) == "none"
    first.close()
    second = started()
    assert second.daemon.publication.detail.stored is Stored.USED
    assert second.daemon.publication.detail.source is Source.STORED
    second.daemon.estimator.coast(10**9, out=second.daemon.estimate)
    assert second.daemon.estimate.soc == pytest.approx(soc, abs=1e-3)
    vehicle.drive(second, 1)
    assert str(vehicle.told("BmsState")[-1]["StoredState"]) == "used"


def test_what_was_learnt_of_the_cell_outlives_a_kill_and_agrees_with_the_belief(started, vehicle):
    """Nothing is stored at a kill: what was in the file is what counts."""
    first = started()
    vehicle.drive(first, 10)
    health = first.daemon.health
    health.capacity = first.daemon.estimator.capacity_scale = [0.93]
    health.segments[:] = 5
    first.chores()
    first._keeper.close()
    first._keeper = None
    health.capacity = first.daemon.estimator.capacity_scale = [0.5]
    second = started()
    assert second.daemon.publication.detail.stored is Stored.USED
    assert second.daemon.health.told_capacity[0] == 0.93
    assert second.daemon.estimator.capacity_scale[0] == pytest.approx(0.93)
    vehicle.told("CapacityHealth")
    vehicle.drive(second, 1)
    (told,) = vehicle.told("CapacityHealth")
    assert told["CapacityMin"] == pytest.approx(93.0, abs=0.026)
    assert told["CapacitySegments"] == 5


def test_without_health_nothing_is_told_of_it_and_the_state_is_kept(started, vehicle):
    text = CONFIG.replace("format = 1", "format = 1\nhealth = false")
    running = started(text)
    vehicle.drive(running, 20)
    assert vehicle.told("CapacityHealth") == []
    running.close()
    assert started(text).daemon.publication.detail.stored is Stored.USED


def test_a_state_that_is_refused_is_told_on_the_bus_and_in_the_log(started, vehicle, tmp_path, caplog):
    (tmp_path / "state").write_bytes(b"nothing of ours")
    with caplog.at_level(logging.WARNING):
        damaged = started()
    vehicle.drive(damaged, 1)
    assert str(vehicle.told("BmsState")[-1]["StoredState"]) == "corrupt"
    assert [line for line in caplog.messages if "state: corrupt: " in line]


def test_a_start_without_a_voltage_leaves_the_stored_state_alone(started, tmp_path):
    (tmp_path / "state").write_bytes(b"nothing of ours")
    empty = started()
    empty.chores()
    empty.close()
    assert (tmp_path / "state").read_bytes() == b"nothing of ours"


def test_a_state_folder_that_is_not_there_is_one_line(started):
    with pytest.raises(ConfigError, match=r"state\.file is 'no/state'; expected a file in a folder that exists"):
        started(CONFIG.replace('"state"', '"no/state"'))


def test_under_systemd_the_state_is_in_the_folder_it_gives(started, vehicle, tmp_path, monkeypatch):
    (tmp_path / "var").mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "var"))
    running = started()
    vehicle.drive(running, 3)
    running.close()
    assert (tmp_path / "var" / "state").exists()
    assert not (tmp_path / "state").exists()


def test_the_recorder_writes_what_led_to_a_fault_and_it_can_be_run_again(started, vehicle, tmp_path):
    running = started(CONFIG + '[recorder]\nfolder = "flights"\n')
    vehicle.drive(running, 3)
    data = running.daemon.witness.file(Fault.BUS)
    (tmp_path / "flights" / "x.flight").write_bytes(data)
    assert flight.rerun(tmp_path / "flights" / "x.flight")[1]["identical"] is True


def test_what_is_recorded_after_a_restart_begins_with_the_belief_that_was_taken_up(started, vehicle, tmp_path):
    text = CONFIG + '[recorder]\nfolder = "flights"\n'
    before = started(text)
    vehicle.drive(before, 20)
    before.close()
    running = started(text)
    assert running.daemon.publication.detail.stored is Stored.USED
    vehicle.drive(running, 3)
    (tmp_path / "flights" / "x.flight").write_bytes(running.daemon.witness.file(Fault.BUS))
    assert flight.rerun(tmp_path / "flights" / "x.flight")[1]["identical"] is True


def test_every_frame_is_written_where_it_is_asked_for(tmp_path, vehicle):
    (tmp_path / "bms.toml").write_text(CONFIG)
    running = Service(tmp_path / "bms.toml", tmp_path / "frames.log")
    running.start()
    vehicle.drive(running, 3)
    running.close()
    log = (tmp_path / "frames.log").read_text()
    assert [log.count(f" {number}#") for number in ("120", "121", "220")] == [3, 3, 3]


# --- configured anew ----------------------------------------------------------------------------------------------


def reloaded(running: Service, tmp_path: Path, text: str) -> None:
    (tmp_path / "bms.toml").write_text(text)
    running.reload()


def test_another_pace_is_taken_up_without_losing_what_is_known_or_the_bus(started, vehicle, tmp_path):
    running = started()
    vehicle.drive(running, 20)
    running.daemon.health.segments[:] = 3
    counter = vehicle.told("SocEstimate")[-1]["AliveCounter"]
    soc = running.daemon.estimate.soc
    reloaded(running, tmp_path, CONFIG.replace("silence_s = 5.0", "silence_s = 4.0\nsoc_slew_per_s = 0.5"))
    assert running.daemon.publication.slew_per_s == 0.5
    vehicle.drive(running, 1)
    after = vehicle.told("SocEstimate")[-1]
    assert after["AliveCounter"] == (counter + 1) % 15
    assert after["Soc"] == pytest.approx(100 * soc, abs=0.1)
    assert str(after["Status"]) == "ok", "no fault of counters that begin anew"
    assert len(vehicle.opened) == 1
    assert running.daemon.health.segments[0] == 3, "what was learnt, too"


def test_another_bus_is_opened_before_the_old_one_is_closed(started, vehicle, tmp_path):
    running = started()
    vehicle.drive(running, 5)
    reloaded(running, tmp_path, CONFIG.replace("can0", "can1"))
    vehicle.drive(running, 1)
    assert [bus.channel for bus in vehicle.opened] == ["can0", "can1"]
    assert running.daemon.estimate.status is Status.OK


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (CONFIG.replace("format = 1", "format = 1\nsilense_s = 3.0"), "did you mean silence_s"),
        (CONFIG.replace("lgm50_chen2020", "a123_lfp"), "restart to change them"),
        (CONFIG.replace("format = 1", "format = 1\ncells = 3"), "restart to change them"),
        (CONFIG.replace("initial_soc = 0.7", "initial_soc = 0.7, gate_sigmas = 4.0"), "restart to change them"),
        (CONFIG + "[sensor_spec]\ncurrent_gain = 0.01", "restart to change them"),
        (CONFIG + BALANCING, "restart to change them"),
        (CONFIG.replace("format = 1", "format = 1\nhealth = false"), "restart to change them"),
        ("", "format"),
    ],
)
def test_a_configuration_that_cannot_be_used_changes_nothing(started, vehicle, tmp_path, caplog, text, told):
    running = started()
    vehicle.drive(running, 5)
    reloaded(running, tmp_path, text)
    assert "not reloaded, and running as before" in caplog.messages[-1]
    assert told in caplog.messages[-1]
    vehicle.told("SocEstimate")
    vehicle.drive(running, 3)
    assert [str(row["Status"]) for row in vehicle.told("SocEstimate")] == ["ok"] * 3
    assert len(vehicle.opened) == 1


def test_a_bus_that_cannot_be_opened_changes_nothing(started, vehicle, tmp_path, monkeypatch, caplog):
    running = started()

    def fails(*_: object) -> None:
        raise ConfigError("bms.toml", key="bus.channel", expected="a CAN interface that exists and is up")

    monkeypatch.setattr(service, "open_bus", fails)
    reloaded(running, tmp_path, CONFIG.replace("can0", "can1"))
    assert "a CAN interface that exists and is up" in caplog.messages[-1]
    vehicle.drive(running, 3)
    assert running.daemon.estimate.status is Status.OK


# --- metrics ------------------------------------------------------------------------------------------------------


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def scraped(port: int) -> dict[str, float]:
    with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5.0) as answer:
        lines = answer.read().decode().splitlines()
    return {line.rpartition(" ")[0]: float(line.rpartition(" ")[2]) for line in lines if not line.startswith("#")}


def test_metrics_say_what_is_published_and_only_to_this_machine(started, vehicle):
    port = free_port()
    running = started(CONFIG + f"[metrics]\nport = {port}\n")
    assert math.isnan(scraped(port)["bms_ukf_soc_ratio"])
    vehicle.drive(running, 20)
    told = scraped(port)
    assert told["bms_ukf_soc_ratio"] == running.daemon.estimate.soc
    assert told["bms_ukf_soc_low_ratio"] == running.daemon.estimate.soc_low
    assert told["bms_ukf_soc_high_ratio"] == running.daemon.estimate.soc_high
    assert told['bms_ukf_status{status="ok"}'] == 1.0
    assert told['bms_ukf_fault{fault="e2e"}'] == 0.0
    assert told['bms_ukf_received_frames_total{outcome="accepted"}'] == 60.0
    assert told["bms_ukf_answers_total"] == running.daemon.published
    assert math.isnan(told["bms_ukf_capacity_ratio"])
    running.daemon.health.segments[:] = 2
    assert scraped(port)["bms_ukf_capacity_ratio"] == 1.0
    assert scraped(port)["bms_ukf_capacity_segments"] == 2.0
    assert running._exporter._server.server_address[0] == "127.0.0.1"


def test_a_port_that_is_taken_is_one_line_and_another_one_is_taken_up_on_reload(started, tmp_path, caplog):
    ports = free_port(), free_port()
    running = started(CONFIG + f"[metrics]\nport = {ports[0]}\n")
    with socket.create_server(("127.0.0.1", ports[1])):
        reloaded(running, tmp_path, CONFIG + f"[metrics]\nport = {ports[1]}\n")
        assert "metrics.port" in caplog.messages[-1]
        assert "free (Address already in use)" in caplog.messages[-1]
        assert scraped(ports[0])
    reloaded(running, tmp_path, CONFIG + f"[metrics]\nport = {ports[1]}\n")
    assert scraped(ports[1])


# --- systemd ------------------------------------------------------------------------------------------------------


def test_systemd_is_told_when_it_is_ready_alive_reloading_and_stopping(manager, started, tmp_path):
    running = started()
    (ready,) = manager()
    assert re.fullmatch(r"READY=1\nSTATUS=initialising; 0 frames accepted, 0 answers", ready)
    running.chores()
    running.chores()
    told = manager()
    assert told.count("WATCHDOG=1") == 1, "twice in its time is enough"
    assert any(line.startswith("STATUS=") for line in told)
    reloaded(running, tmp_path, CONFIG)
    reloading, ready = manager()
    assert re.fullmatch(r"RELOADING=1\nMONOTONIC_USEC=\d+", reloading)
    assert ready.startswith("READY=1")
    running.close()
    assert manager() == ["STOPPING=1"]


def test_a_service_manager_that_is_gone_does_not_end_the_daemon(started, monkeypatch, tmp_path):
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    started().chores()


def test_the_chores_are_done_while_frames_come_and_while_none_do(started, vehicle):
    running = started()
    asked = iter([False] * 3 + [True])

    class ThreeTurns:
        def is_set(self) -> bool:
            return next(asked)

    done = []
    running.daemon.run(ThreeTurns(), lambda: done.append(1))  # type: ignore[arg-type]
    assert done


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_finds_no_fault_with_the_unit(tmp_path):
    text = UNIT.read_text().replace("/opt/bms-ukf/bin/bms-ukf", shutil.which("true") or "")
    (tmp_path / "bms-ukf.service").write_text(text.replace("User=bms-ukf", "DynamicUser=yes"))
    command = ["systemd-analyze", "verify", str(tmp_path / "bms-ukf.service")]
    checked = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stderr) == (0, "")


def test_the_unit_lets_the_compiler_work_and_the_can_socket_open():
    lines = UNIT.read_text().splitlines()
    settings = dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))
    assert "MemoryDenyWriteExecute" not in settings
    assert {"AF_CAN", "AF_UNIX", "AF_INET"} <= set(settings["RestrictAddressFamilies"].split())
    assert settings["Type"] == "notify"
    assert f"NUMBA_CACHE_DIR=%C/{settings['CacheDirectory']}" in settings["Environment"].split()
