"""Two unequal strings share a load over the bus: physics-based cells, a sensor with an offset on each string."""

from __future__ import annotations

from contextlib import closing
from typing import NamedTuple

import can
import numpy as np
import pytest
from daemon_rig import message, read

from bms_ukf import CellParams, Estimate, Estimator, Fault, Sample, Status
from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.clock import LockstepClock
from bms_ukf.config import Setup
from bms_ukf.core import Core
from bms_ukf.daemon import Daemon
from bms_ukf.decoder import Decoder
from bms_ukf.flight import Recorder
from bms_ukf.intake import Intake
from bms_ukf.node import SampleEncoder
from bms_ukf.open_circuit import OpenCircuit
from bms_ukf.pace import Pace
from bms_ukf.plant import open_plant
from bms_ukf.records import NAN
from bms_ukf.replay import canlog, flight
from bms_ukf.signals import SignalMap
from bms_ukf.wiring import Wiring

SECOND_NS = 10**9
OFFSETS_A = np.array([0.12, -0.08])
OPEN_S, DRIVE_S, DEAD_S = 120, 1800, 200
FIRST, SECOND = slice(0, 3), slice(3, 6)


class Drive(NamedTuple):
    """Every second: true currents (n, 2), voltages and SoC of a cell of either string (n, 2)."""

    current_A: np.ndarray
    voltage_V: np.ndarray
    soc: np.ndarray


@pytest.fixture(scope="module")
def shared() -> Drive:
    """A fresh string beside one with 15 % less capacity and 10 mOhm more a cell: the load divides so that both have the
    voltage of the bus. It is found by one correction a second, as it lags behind in a pack by its inductance.
    """
    of_fresh = {"soc_initial": 0.9}
    of_aged = of_fresh | {"capacity_factor": 0.85, "resistance_ohm": 0.01}
    with (
        open_plant("lgm50_spme", parameters=of_fresh) as fresh,
        open_plant("lgm50_spme", parameters=of_aged) as aged,
    ):
        share_A, rows = 0.0, []
        for t in range(OPEN_S + DRIVE_S + DEAD_S):
            load_A = 0.0 if t < OPEN_S else 4.0 + 3.0 * np.sin(0.05 * t) + (2.0 if t // 60 % 2 else -2.0)
            share_A += 0.0 if t < OPEN_S else (fresh.state.voltage_V - aged.state.voltage_V) / 0.1
            currents = (load_A / 2 + share_A, load_A / 2 - share_A)
            states = [plant.step(current, SECOND_NS) for plant, current in zip((fresh, aged), currents, strict=True)]
            rows.append((currents, [s.voltage_V for s in states], [s.soc for s in states]))
    return Drive(*(np.array(column) for column in zip(*rows, strict=True)))


class Bus:
    """The daemon but for its bus, and a vehicle that sends by the project's own DBC; three cells are a string."""

    def __init__(self, cell: CellParams, strings: int) -> None:
        string_of = np.repeat(range(strings), 3)
        self.decoder = Decoder(SignalMap.default(len(string_of), 1, strings), cells=len(string_of))
        self.estimator = Estimator(cell, len(string_of), wiring=Wiring(string_of=string_of) if strings > 1 else None)
        self.core = Core(self.estimator, Intake(self.decoder, OpenCircuit(0.3)), Pace(10.0))
        self._encoder = SampleEncoder(len(string_of), 1, strings)

    def feed(self, t: int, current_A: np.ndarray, voltage_V: np.ndarray) -> Estimate:
        t_ns = (t + 1) * SECOND_NS
        self.decoder.contactor.is_open, self.decoder.contactor.t_ns = t < OPEN_S, t_ns
        sample = Sample(t_ns, float(current_A[0]), np.repeat(voltage_V, 3), 25.0)
        sample.string_current_A = current_A if len(current_A) > 1 else None
        for frame in self._encoder.encode(sample):
            self.core.hear(*frame, t_ns)
        return self.core.estimate


@pytest.mark.parametrize("dead", [False, True])
def test_each_string_counts_its_own_current_and_a_dead_sensor_degrades_its_own_cells_only(cell, shared, dead):
    """Each is known as well as by a daemon of its own."""
    pack, alone, errors = Bus(cell, 2), [Bus(cell, 1), Bus(cell, 1)], []
    for t, (current_A, voltage_V, soc) in enumerate(zip(*shared, strict=True)):
        shown_A = current_A + OFFSETS_A + np.array([0.0, NAN if dead and t >= OPEN_S + DRIVE_S else 0.0])
        estimate = pack.feed(t, shown_A, voltage_V)
        known = [alone[s].feed(t, shown_A[[s]], voltage_V[[s]]).soc for s in (0, 1)]
        np.testing.assert_allclose(estimate.soc, np.ravel(known), rtol=0, atol=1e-9)
        errors.append(estimate.soc - np.repeat(soc, 3))
        if t == OPEN_S - 1:
            np.testing.assert_allclose(estimate.current_bias_A, np.repeat(OFFSETS_A, 3), atol=0.01)
    worst = np.abs(errors[: OPEN_S + DRIVE_S])
    assert worst[:, FIRST].max() < 0.01
    assert worst[600:, SECOND].max() < 0.04
    missing = (pack.estimator.cell_faults & Fault.CURRENT_MISSING > 0).tolist()
    assert missing == [False] * 3 + [dead] * 3
    assert (pack.estimator.cell_status == Status.OK).tolist() == [True] * 3 + [not dead] * 3
    assert estimate.status is (Status.DEGRADED if dead else Status.OK)


CONFIG = """
format = 1
cell = "lgm50_chen2020"
cells = 6
[bus]
interface = "virtual"
channel = "strings"
[pack]
string_of = [1, 1, 1, 2, 2, 2]
[recorder]
folder = "."
"""


def test_a_daemon_publishes_what_both_strings_give_and_its_log_and_its_flight_run_again(tmp_path, shared):
    (tmp_path / "can.toml").write_text(CONFIG)
    setup, clock = Setup.load(tmp_path / "can.toml"), LockstepClock()
    estimator, encoder, log = setup.estimator(), SampleEncoder(6, 1, 2), can.Logger(tmp_path / "drive.log")
    recorder, pack = Recorder(estimator, tmp_path), setup.pack_output(estimator)
    minute = Drive(*(column[OPEN_S : OPEN_S + 60] for column in shared))
    settings = setup.config.bus
    with (
        open_bus(settings, "vehicle") as vehicle,
        closing(SafeBus(lambda: open_bus(settings, "daemon"))) as bus,
    ):
        daemon = Daemon(bus, estimator, setup.intake(), clock=clock, pace=setup.pace, pack=pack)
        daemon.witness = recorder
        for t, (current_A, voltage_V, _) in enumerate(zip(*minute, strict=True)):
            clock.set((t + 1) * SECOND_NS)
            sample = Sample(0, NAN, np.repeat(voltage_V, 3), 25.0, string_current_A=current_A)
            for frame in encoder.encode(sample):
                sent = message(*frame, stamp_s=t + 1.0)
                vehicle.send(sent)
                log(sent)
            while daemon.poll(0.0):
                pass
        log.stop()
        heard = read(list(iter(lambda: vehicle.recv(0.0), None)))
    together_A = heard["StringBias"]["String1"] + heard["StringBias"]["String2"]
    assert together_A == pytest.approx(heard["SocDetail"]["CurrentBias"], abs=0.01)
    assert heard["PackState"]["RemainingCharge"] == pytest.approx(2 * 0.9 * 5.0, rel=0.1)
    power_W = 3 * (minute.current_A * minute.voltage_V).sum(axis=1)
    assert pack.estimate.power_W == pytest.approx(power_W.mean(), rel=0.3)
    (tmp_path / "x.flight").write_bytes(recorder.file(Fault.NONE))
    assert flight.rerun(tmp_path / "x.flight")[1]["identical"] is True
    trace, summary = canlog.rerun(tmp_path / "drive.log", tmp_path / "can.toml")
    assert summary["frames"]["accepted"] == 60 * 4, "PackMeasurement is not mapped"
    assert trace["soc"][-1] == pytest.approx(float(np.mean(daemon.estimate.soc)), abs=1e-3)
    assert trace["current_A"][-1] == pytest.approx(minute.current_A[-1].sum(), abs=2e-3)
