"""A real vehicle's recording through the daemon, by the configuration `bms-ukf init` makes of its DBC."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from bms_ukf import Estimate, Estimator, Fault, Status
from bms_ukf.bus import SafeBus
from bms_ukf.config import Setup
from bms_ukf.daemon import Daemon
from bms_ukf.node import EstimateDecoder
from bms_ukf.replay.logs import LogClock
from bms_ukf.skeleton import propose

LEAF_E2E = """
[signals.e2e.x1DB]
counter = "LB_PRUN_1DB"
crc = { width = 8, polynomial = 0x85, byte = 7 }
"""


class Recording:
    """A bus on which a candump log is heard, and what is sent is kept."""

    def __init__(self, log: Path, without: str) -> None:
        self._lines: Iterator[str] = (line for line in log.read_text().splitlines() if f" {without}#" not in line)
        self.sent: list[can.Message] = []

    def recv(self, timeout: float) -> can.Message | None:
        line = next(self._lines, None)
        if line is None:
            return None
        stamp, _, frame = line.split()
        identifier, data = frame.split("#")
        payload = bytes.fromhex(data)
        return can.Message(float(stamp[1:-1]), int(identifier, 16), len(identifier) > 3, data=payload)

    def send(self, message: can.Message) -> None:
        self.sent.append(message)

    def shutdown(self) -> None:
        """Nothing to close."""


@pytest.fixture
def leaf(tmp_path: Path, third_party: Path) -> tuple[Setup, Path]:
    text, _ = propose([third_party / "can" / "EV-can_ZE1.dbc"], tmp_path / "can.toml")
    text = re.sub(r"^# (current_positive = \S+|series_cells = \d+)", r"\1", text, flags=re.MULTILINE)
    text = text.replace("# capacity_scale = 1.0", "capacity_scale = 34.0")
    (tmp_path / "can.toml").write_text(text + LEAF_E2E)
    return Setup.load(tmp_path / "can.toml"), third_party / "can" / "leaf_ZE1_62kWh_EV-CANeplus2.candump.log"


def driven(setup: Setup, log: Path, without: str) -> tuple[Daemon, list[Estimate]]:
    """What is told while the log is heard, except for the frames of one identifier."""
    recording, monitor = Recording(log, without), EstimateDecoder()
    estimator = Estimator(setup.cell, tuning=setup.config.estimator)
    bus = SafeBus(lambda: recording)  # type: ignore[arg-type, return-value]
    daemon = Daemon(bus, estimator, setup.intake(), clock=LogClock(), pace=setup.pace)
    while daemon.poll(0.0):
        pass
    told = [monitor.decode(m.arbitration_id, False, bytes(m.data), 0) for m in recording.sent]
    return daemon, [estimate for estimate in told if estimate is not None]


def test_with_what_the_vehicle_sends_a_soc_comes_out_ten_times_a_second(leaf) -> None:
    """The car says 93.5 % of another cell, by a scale of its own; more than the neighbourhood cannot be asked for."""
    daemon, told = driven(*leaf, without="none")
    known = [estimate for estimate in told if estimate.status in {Status.OK, Status.DEGRADED}]
    assert 170 < len(told) < 200
    assert len(known) > 0.8 * len(told)
    assert known[-1].soc == pytest.approx(0.935, abs=0.1)
    assert known[-1].soc_sigma > 0.003
    assert daemon.commissioning.fault is Fault.NONE
    counters = daemon.intake.counters
    assert counters.accepted > 1500
    assert (counters.crc, counters.counter, counters.short) == (0, 0, 0)


def test_without_its_temperature_no_soc_is_made_up(leaf) -> None:
    _, told = driven(*leaf, without="5C0")
    assert {estimate.status for estimate in told} == {Status.INITIALISING}
    assert all(Fault.TEMPERATURE_MISSING in estimate.faults for estimate in told)
    assert all(estimate.soc != estimate.soc for estimate in told)


def test_without_its_current_and_voltage_it_says_nothing_that_could_be_taken_for_a_soc(leaf) -> None:
    _, told = driven(*leaf, without="1DB")
    assert {estimate.status for estimate in told} == {Status.INITIALISING}
