"""What the flight recorder writes on a fault runs again bit for bit, and a fault that lasts is written once."""

from __future__ import annotations

import json
import struct
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drives import CELL

from bms_ukf import ConfigError, Estimator, Fault, Sample
from bms_ukf.flight import AFTER_NS, Recorder
from bms_ukf.records import Detail
from bms_ukf.replay import flight

SECOND_NS = 10**9


class Flown:
    """An estimator, watched by a recorder, as the daemon drives both."""

    def __init__(self, folder: Path, cells: int = 1, keep: int = 3) -> None:
        self.estimator = Estimator(CELL, cells)
        self.recorder = Recorder(self.estimator, folder, span_s=40.0, keep=keep)
        self.estimate = self.estimator.coast(0)
        self.cells = cells

    def fly(self, start: int, seconds: int, voltage: float = 3.7) -> None:
        for k in range(start, start + seconds):
            pattern = np.full(self.cells, voltage)
            if self.cells > 1:
                pattern[k % self.cells] = np.nan
            sample = Sample(k * SECOND_NS, 1.0, voltage if self.cells == 1 else pattern, 25.0, k % 7 == 0)
            self.estimator.step(sample, out=self.estimate)
            self.recorder.stepped(sample, self.estimate)
            if k % 5 == 0:
                later_ns = sample.t_ns + SECOND_NS // 2
                self.estimator.coast(later_ns, out=self.estimate)
                self.recorder.coasted(later_ns, self.estimate)
            self.recorder.published(sample.t_ns, self.estimate, Detail())
        for thread in threading.enumerate():
            if thread.name == "flight":
                thread.join()


def written(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.flight"))


@pytest.mark.parametrize("cells", [1, 20])
def test_what_led_to_a_fault_and_what_followed_runs_again_bit_for_bit(tmp_path, cells):
    flown = Flown(tmp_path, cells)
    flown.fly(1, 200)
    assert written(tmp_path) == []
    flown.fly(201, 3, voltage=9.0)
    flown.fly(204, 20)
    (file,) = written(tmp_path)
    trace, summary = flight.rerun(file)
    assert summary["identical"] is True
    assert summary["warnings"] == []
    assert "voltage_implausible" in summary["reason"]
    assert 40 <= summary["duration_s"] <= 51
    assert (trace.faults & int(Fault.VOLTAGE_IMPLAUSIBLE)).any()
    fault_ns = trace.t_ns[(trace.faults & int(Fault.VOLTAGE_IMPLAUSIBLE)) != 0][0]
    assert trace.t_ns[-1] >= fault_ns + AFTER_NS


def test_a_capacity_that_was_written_back_while_it_flew_is_in_the_file_from_then_on(tmp_path):
    """As `pack.Health` does between a step and what is recorded of it."""
    flown = Flown(tmp_path)
    flown.fly(1, 60)
    sample = Sample(61 * SECOND_NS, 1.0, 3.7, 25.0)
    flown.estimator.step(sample, out=flown.estimate)
    flown.estimator.capacity_scale = 0.8
    flown.recorder.stepped(sample, flown.estimate)
    flown.fly(62, 10)
    (tmp_path / "x.flight").write_bytes(flown.recorder.file(Fault.BUS))
    assert flight.rerun(tmp_path / "x.flight")[1]["identical"] is True


def test_what_balancing_takes_is_in_the_file_from_when_it_was_told(tmp_path):
    """By a sample or by hand, taken back, unknown, and told by a sample too old to be taken."""
    flown = Flown(tmp_path, 3)
    flown.fly(1, 30)
    for second, bleed_A in ((30, [0.5, np.nan, 0.0]), (50, [np.nan, 0.25, 0.5]), (12, [9.0, 9.0, 9.0])):
        sample = Sample(second * SECOND_NS + 7, 1.0, bleed_A=np.array(bleed_A))
        flown.estimator.step(sample, out=flown.estimate)
        flown.recorder.stepped(sample, flown.estimate)
        flown.fly(flown.estimator.t_ns // SECOND_NS + 1, 5)
    flown.estimator.bleed_A = np.nan
    flown.estimator.coast(70 * SECOND_NS, out=flown.estimate)
    flown.recorder.coasted(70 * SECOND_NS, flown.estimate)
    flown.fly(71, 5)
    (tmp_path / "x.flight").write_bytes(flown.recorder.file(Fault.NONE))
    _, summary = flight.rerun(tmp_path / "x.flight")
    assert summary["warnings"] == []
    assert summary["identical"] is True


def test_a_difference_is_told_with_its_row(tmp_path):
    flown = Flown(tmp_path)
    flown.fly(1, 100)
    data = flown.recorder.file(Fault.BUS)
    head, _, body = data.partition(b"\n")
    changed = json.loads(head)
    changed["tuning"] = changed["tuning"].replace('"gate_sigmas":5.0', '"gate_sigmas":5.5')
    (tmp_path / "x.flight").write_bytes(json.dumps(changed).encode() + b"\n" + body)
    with pytest.raises(ConfigError, match="another cell file or tuning"):
        flight.rerun(tmp_path / "x.flight")
    (tmp_path / "x.flight").write_bytes(changed_at(data, struct.pack("<dd", 1.0, 3.7), struct.pack("<dd", 1.0, 3.71)))
    _, summary = flight.rerun(tmp_path / "x.flight")
    assert summary["identical"] is False
    assert "not what was said then, from row " in summary["warnings"][0]


def test_a_fault_that_comes_and_goes_does_not_fill_the_medium(tmp_path):
    flown = Flown(tmp_path)
    flown.fly(1, 60)
    for k in range(60, 100, 2):
        flown.fly(k, 1, voltage=9.0)
        flown.fly(k + 1, 1)
    assert len(written(tmp_path)) == 1


def test_only_the_newest_files_are_kept(tmp_path):
    for k in range(5):
        (tmp_path / f"2020010{k}T000000Z.flight").write_bytes(b"old")
    flown = Flown(tmp_path, keep=2)
    flown.fly(1, 60)
    flown.fly(61, 1, voltage=9.0)
    flown.fly(62, 10)
    names = [path.name for path in written(tmp_path)]
    assert len(names) == 2
    assert names[0] == "20200104T000000Z.flight"


def test_nothing_is_written_while_it_has_not_started(tmp_path):
    flown = Flown(tmp_path)
    for k in range(1, 60):
        flown.estimator.coast(k * SECOND_NS, out=flown.estimate)
        flown.recorder.published(k * SECOND_NS, flown.estimate, Detail())
    assert written(tmp_path) == []


def test_memory_stays_flat(tmp_path):
    flown = Flown(tmp_path)
    flown.fly(1, 100)
    size = len(flown.recorder.file(Fault.NONE))
    flown.fly(101, 1000)
    assert len(flown.recorder.file(Fault.NONE)) < 1.5 * size


@pytest.mark.parametrize("content", [b"", b"{}\n", b"no json\n", b'{"format": 2}\n'])
def test_what_is_no_flight_is_one_line(tmp_path, content):
    (tmp_path / "x.flight").write_bytes(content)
    with pytest.raises(ConfigError, match="a file of the flight recorder"):
        flight.rerun(tmp_path / "x.flight")


def test_a_file_that_was_cut_off_is_refused(tmp_path):
    flown = Flown(tmp_path)
    flown.fly(1, 20)
    (tmp_path / "x.flight").write_bytes(flown.recorder.file(Fault.NONE)[:-30])
    with pytest.raises(ConfigError, match="cut off"):
        flight.rerun(tmp_path / "x.flight")


def test_another_cell_is_tried_on_the_same_samples(tmp_path):
    flown = Flown(tmp_path)
    flown.fly(1, 60)
    (tmp_path / "x.flight").write_bytes(flown.recorder.file(Fault.NONE))
    other = CELL.model_copy(update={"cell": replace_capacity(CELL)})
    _, summary = flight.rerun(tmp_path / "x.flight", other)
    assert summary["identical"] is None
    assert summary["final_soc"] is not None


def changed_at(data: bytes, old: bytes, new: bytes) -> bytes:
    """With the last `old` replaced."""
    at = data.rindex(old)
    return data[:at] + new + data[at + len(old) :]


def replace_capacity(cell):
    return cell.cell.model_copy(update={"capacity_Ah": 2 * cell.cell.capacity_Ah})


def test_the_daemon_keeps_the_same_estimate_with_and_without_a_recorder(tmp_path):
    flown, alone = Flown(tmp_path), Estimator(CELL)
    flown.fly(1, 30)
    for k in range(1, 31):
        known = replace(alone.step(Sample(k * SECOND_NS, 1.0, 3.7, 25.0, k % 7 == 0)))
        if k % 5 == 0:
            known = replace(alone.coast(k * SECOND_NS + SECOND_NS // 2))
    assert flown.estimate.soc == known.soc
