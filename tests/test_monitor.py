"""The monitor shows what is on the bus, fits 80 by 24 characters with 1, 96 and 400 cells, and owns up to silence."""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Iterable

import can
import numpy as np
import pytest
from drives import CELL
from rich.console import Console

from bms_ukf import ConfigError, Estimate, Estimator, Fault, Sample, Status
from bms_ukf.bus import open_bus
from bms_ukf.config import Bus
from bms_ukf.decoder import Decoder
from bms_ukf.encoder import HEALTH, Encoder
from bms_ukf.frames import Frame
from bms_ukf.health_encoder import HealthEncoder
from bms_ukf.monitor import command, view
from bms_ukf.monitor.watch import Protection, Watch
from bms_ukf.node import SampleEncoder
from bms_ukf.pack import Health, PackEstimate
from bms_ukf.pack_encoder import PackEncoder
from bms_ukf.records import Detail, Source, Stored

STEP_NS = 100_000_000
ALL = Fault(sum(Fault))


PACK = PackEstimate(
    soc=0.555,
    soc_sigma=0.012,
    remaining_Ah=61.2,
    remaining_Wh=21_300.0,
    time_to_empty_s=5_500.0,
    discharge_A=320.0,
    discharge_W=99_500.0,
    discharge_cell=41,
    charge_A=-110.0,
    charge_W=-41_000.0,
    charge_cell=6,
    silent=3,
    silent_cell=16,
)


class Told:
    """A daemon's frames, and its vehicle's, as a watch takes them."""

    pack = PACK

    def __init__(self, cells: int = 1) -> None:
        self.watch, self.cells, self.t_ns = Watch(Decoder(cells=cells)), cells, 0
        self._out, self._in, self._steps = Encoder(), SampleEncoder(cells), itertools.count(1)
        self._pack = PackEncoder(cells, 10.0)

    def take(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            self.watch.take(*frame, self.t_ns)

    def step(self, times: int = 1, faults: Fault = Fault.NONE, status: Status = Status.OK, soc: float = 0.6) -> None:
        for _ in range(times):
            self.t_ns += STEP_NS
            n = next(self._steps)
            each = np.linspace(soc - 0.02, soc + 0.02, self.cells) if self.cells > 1 else soc
            all_of = (lambda v: np.full(self.cells, v)) if self.cells > 1 else (lambda v: v)
            known = Estimate(
                self.t_ns, each, all_of(0.01), all_of(3.7), all_of(0.002), all_of(1e-6), all_of(1.5), all_of(0.0)
            )
            known.status, known.faults = status, faults
            known.soc_low, known.soc_high = each - 0.024, each + 0.024
            self.take(self._in.encode(Sample(0, 1.0, all_of(3.7), 25.0)))
            if self.cells > 1:
                self.take(self._pack.encode(self.t_ns, known, self.pack, n))
            self.take(self._out.encode(known, Detail(soc, Source.REST, 0.05, Stored.STALE), n))
            self.take([self._out.health([0] * len(HEALTH), n)])

    def shown(self, later_ns: int = 0) -> str:
        """The picture, as a terminal of 80 by 24 shows it."""
        console = Console(width=80, height=24, file=io.StringIO(), record=True, force_terminal=True)
        console.print(view.panel(self.watch, "socketcan:can0", self.t_ns + later_ns))
        return console.export_text()


@pytest.mark.parametrize("cells", [1, 96, 400])
@pytest.mark.parametrize("faults", [Fault.NONE, ALL])
def test_it_fits_the_terminal_with_any_number_of_cells_and_faults(cells, faults):
    told = Told(cells)
    told.step(150, faults)
    lines = told.shown().splitlines()
    assert len(lines) <= 23
    assert max(map(len, lines)) <= 80
    assert "…" not in "".join(lines[:6])
    assert "PackMeasurement" in "".join(lines[-6:])


@pytest.mark.parametrize("cells", [1, 96, 400])
def test_health_is_shown_when_it_is_told_and_said_to_be_unknown_before(cells):
    told, health = Told(cells), Health(Estimator(CELL, cells))
    encoder = HealthEncoder(health)
    told.take(encoder.encode(0, 1))
    told.step(150, ALL)
    assert "capacity not told yet   r0 not told yet" in told.shown()
    health.capacity, health.segments = np.linspace(0.9, 1.0, cells), np.full(cells, 4)
    health.resistance, health.told_s = np.linspace(1.2, 1.0, cells), np.full(cells, 60.0)
    health.resistance_sigma = np.full(cells, 0.2)
    told.take(encoder.encode(2 * 10**9, 2))
    lines = told.shown().splitlines()
    (line,) = [line for line in lines if "health" in line]
    assert "capacity 90.0 ± 19.6 %" in line
    assert "r0 120.0 ± 39.2 %" in line
    assert line.count("(cell 1)") == (2 if cells > 1 else 0)
    assert len(lines) <= 23
    assert max(map(len, lines)) <= 80


def test_every_fault_source_and_status_has_words():
    assert set(view.FAULTS) == set(Fault)
    assert set(view.SOURCES) == set(Source)
    assert set(view.STATUS_STYLE) == set(Status)
    assert set(view.COUNTS) == set(HEALTH)


def test_what_was_published_is_what_is_shown():
    told = Told()
    told.step(100, Fault.CURRENT_SIGN, Status.DEGRADED)
    text = told.shown()
    for words in (
        "60.00 % 95 % 57.6–62.4 %",
        "status degraded",
        "by a voltage at rest",
        "predicted    3.7000 V",
        "innovation   2.0 mV",
        "sensor bias  0.05 A",
        "the sign of the current is wrong",
        "the stored state was refused: stale",
        "10 Hz ok",
    ):
        assert words in text


def test_each_cell_has_its_mark_and_the_extremes_their_numbers():
    told = Told(96)
    told.step(100)
    text = told.shown()
    assert "58.0 % (1) to 62.0 % (96)" in text
    marks = "".join(c for line in text.splitlines() if line[2:11].strip().isdigit() for c in line if c in view.BARS)
    assert len(marks) == 96
    assert list(marks) == sorted(marks)


def test_what_a_pack_gives_and_which_cells_are_silent_is_shown():
    told = Told(96)
    told.step(100)
    text = told.shown()
    for words in (
        "55.5 % ± 2.4 %  left 61.2 Ah, 21.3 kWh",
        "empty in 1 h 32 min",
        "320 A, 99.5 kW (cell 42)",
        "-110 A, -41.0 kW (cell 7)",
        "96 cells, 67 a line  3 silent (17)",
    ):
        assert words in text
    told.pack = PackEstimate()
    told.step(15, status=Status.INVALID)
    assert "usable   – ± –" in told.shown()


def test_a_message_that_comes_seldom_is_not_silent():
    """Two pages in ten seconds."""
    told = Told(6)
    told.pack = PackEstimate()
    told.step(120)
    assert "silent" not in told.shown(later_ns=400_000_000)


def test_messages_in_trouble_are_never_those_left_out():
    told = Told(400)
    told.step(50)
    number, extended, data = PackEncoder(1, 10.0).encode(0, Estimate(), PACK, 1)[-1]
    told.take([(number, extended, bytes([data[0] ^ 1]) + data[1:])])
    text = told.shown()
    assert "wrong CRC" in text
    assert "more" in text


def test_a_cell_that_was_never_heard_of_is_no_zero():
    told = Told(6)
    told.step(20)
    told.watch.of_cells_pct["CellSoc"][2] = math.nan
    assert "?" in told.shown()
    assert "58.0 % (1)" in told.shown()


def test_silence_is_not_shown_as_a_soc():
    told = Told()
    assert "no SoC frames yet" in told.shown()
    told.step(50)
    text = told.shown(later_ns=8 * 10**9)
    assert "60.00 % 95 %" not in text
    assert "not available" in text
    assert "no new SoC for 8 s" in text
    assert "silent" in text


def test_a_daemon_whose_counter_stands_still_is_found_out():
    told, encoder = Told(), Encoder()
    told.step(10)
    for _ in range(80):
        told.t_ns += STEP_NS
        told.take(encoder.encode(Estimate(status=Status.OK, soc=0.9, soc_sigma=0.01), Detail(), 5))
    assert told.watch.values["Soc"] != pytest.approx(90.0) or told.watch.silent_s(told.t_ns) > 5
    assert "stands still" in told.shown()
    assert "90.00 %" not in told.shown()


def test_frames_that_were_changed_on_the_way_are_told_and_not_shown():
    told, encoder = Told(), Encoder()
    told.step(10)
    number, extended, data = encoder.soc(Estimate(status=Status.OK, soc=0.9, soc_sigma=0.01), 1)
    told.take([(number, extended, bytes([data[0] ^ 1]) + data[1:])])
    assert "wrong CRC" in told.shown()
    assert "90.00 %" not in told.shown()
    told.take([(number, extended, data[:4])])
    assert next(iter(told.watch.tracks.values())).state is Protection.SHORT


def test_the_history_is_that_of_ten_minutes():
    told = Told()
    for k in range(8000):
        told.step(soc=0.9 - k * 5e-5)
    known = [value for value in told.watch.history_pct if not math.isnan(value)]
    assert len(known) == 60
    assert known == sorted(known, reverse=True)
    assert known[-1] - known[0] == pytest.approx(-0.005 * 6000, rel=0.1)


def test_foreign_frames_change_nothing():
    told = Told()
    told.step(10)
    before = told.shown()
    told.take([(0x7FF, False, b"12345678"), (0x220, True, b"12345678"), (0x1FFFFFFF, True, b"")])
    assert told.shown() == before


def test_on_a_bus_without_a_terminal_it_prints_a_line_a_second(monkeypatch, capsys):
    settings = Bus(interface="virtual", channel="test-monitor")
    daemon, encoder = open_bus(settings, "daemon"), Encoder()
    monkeypatch.setattr(command, "open_bus", lambda *_: open_bus(settings, "monitor"))
    opened = command.open_bus(settings, "now", None)
    monkeypatch.setattr(command, "open_bus", lambda *_: opened)
    known = Estimate(status=Status.OK, soc=0.5, soc_sigma=0.01, soc_low=0.48, soc_high=0.52)
    for frame in encoder.encode(known, Detail(), 1):
        daemon.send(can.Message(0.0, *frame[:2], data=frame[2]))
    command.monitor(None, "socketcan", "can0", seconds=1.3)
    daemon.shutdown()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "no SoC frames"
    assert lines[-1] == "SoC 50.00 % (95 %: 48.0–52.0 %)  ok"


@pytest.mark.parametrize(
    ("interface", "channel", "told"),
    [(None, None, "a CONFIG, or --interface and --channel"), ("virtual", "x", "virtual is for demo and cosim")],
)
def test_a_bus_that_is_not_named_or_in_process_is_one_line(interface, channel, told):
    with pytest.raises(ConfigError, match=told):
        command.monitor(None, interface, channel)
