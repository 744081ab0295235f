"""Scenarios of the library in real time on a real vcan0, with `bms-ukf run` as a process of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from bms_ukf import scenario
from bms_ukf.hil import runner

pytestmark = pytest.mark.socketcan

FILES = sorted((Path(__file__).resolve().parents[1] / "hil").glob("realtime_*.toml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_daemon_process_meets_what_a_scenario_expects_of_it(vcan, path):
    found, _ = scenario.load(path)
    result = runner.run(found, path, vcan.interface, vcan.channel)
    assert result.reason is None
    assert not [f"{verdict.wanted}; found {verdict.found}" for verdict in result.verdicts if not verdict.passed]
    assert result.duration_s <= 15.0
    assert result.wall_s > 0.95 * result.duration_s, "in real time"
    assert result.frames_in > 0
    assert result.frames_out > 0
