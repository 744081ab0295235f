"""A vehicle with messages of its own, as `models/configs/example.toml` maps them, answered at a steady period."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
import pytest
from can import BusABC, Message
from daemon_process import DaemonProcess
from e2e.crc import calculate_crc8_h2f
from model_cell import ModelCell

from bms_ukf import CellParams

pytestmark = pytest.mark.socketcan

ROOT = Path(__file__).resolve().parents[2]
PERIOD_S = 0.1
SOC_ESTIMATE = 0x220


def drive(bus: BusABC, battery: ModelCell, scans: int) -> None:
    """A rest of a second, then 5 A of discharge, negative there; four currents come with each voltage."""
    for k in range(scans):
        current_A = 5.0 if k >= 10 else 0.0
        for _ in range(4):
            send(bus, 0x200, round(-current_A / 0.05).to_bytes(2, "big", signed=True) + bytes(2))
            time.sleep(PERIOD_S / 4)
        millivolts = round(1000 * battery.step(current_A, PERIOD_S))
        body = millivolts.to_bytes(2, "big") + bytes([25 + 40, (k % 15) << 4 | 2])
        send(bus, 0x201, body + bytes([calculate_crc8_h2f(bytes([0x2A]) + body)]))


def send(bus: BusABC, arbitration_id: int, data: bytes) -> None:
    bus.send(Message(arbitration_id=arbitration_id, is_extended_id=False, data=data))


def test_any_vehicles_frames_go_in_and_soc_comes_out_at_a_steady_rate(vcan, candump, tmp_path):
    battery = ModelCell(CellParams.load("lgm50_chen2020"), soc=0.7)
    text = (ROOT / "models" / "configs" / "example.toml").read_text()
    text = text.replace('"on_update"', '"periodic"').replace('"can0"', f'"{vcan.channel}"')
    (tmp_path / "can.toml").write_text(text)
    (tmp_path / "example.dbc").write_bytes((ROOT / "models" / "configs" / "example.dbc").read_bytes())
    with DaemonProcess(tmp_path / "can.toml") as daemon, vcan.bus() as bus:
        daemon.begin()
        drive(bus, battery, scans=60)
        answers = candump.frames(at_least=50, ids={SOC_ESTIMATE})
        daemon.end(signal.SIGTERM)
        assert daemon.process.returncode == 0, daemon.said()
    gaps_s = np.diff([frame.timestamp_us for frame in answers[-45:-5]]) * 1e-6
    assert 0.8 * PERIOD_S < np.median(gaps_s) < 3 * PERIOD_S, "a guest on a busy machine is late, and never early"
    soc = int.from_bytes(answers[-3].data[2:4], "little") * 0.0025 / 100
    assert answers[-3].data[1] >> 4 == 1, f"status ok: {daemon.said()}"
    assert soc == pytest.approx(battery.soc, abs=0.02)
