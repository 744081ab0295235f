"""What balancing takes from each cell: from the frames that say so into the charge balance, and not for longer."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from drives import CELL

from bms_ukf import ConfigError, Estimator, Sample
from bms_ukf.alignment import Alignment
from bms_ukf.dbc import Matrix
from bms_ukf.decoder import Decoder
from bms_ukf.intake import Intake
from bms_ukf.signals import SignalMap

NAN = math.nan
SECOND_NS = 10**9
DBC = """
VERSION ""
BU_: A
BO_ 16 Pack: 8 A
 SG_ Current : 0|16@1- (0.01,0) [0|0] "A" A
 SG_ Warm : 16|8@1+ (1,-40) [0|0] "degC" A
 SG_ V1 : 24|16@1+ (0.001,0) [0|0] "V" A
 SG_ V2 : 40|16@1+ (0.001,0) [0|0] "V" A
BO_ 17 Balancers: 8 A
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" A
 SG_ On1 m0 : 8|2@1+ (1,0) [0|0] "" A
 SG_ On2 m1 : 8|2@1+ (1,0) [0|0] "" A
 SG_ Bleed1 m2 : 8|8@1+ (10,0) [0|0] "mA" A
 SG_ Bleed2 m2 : 16|8@1+ (10,0) [0|0] "mA" A
 SG_ Duty1 m3 : 8|8@1+ (1,0) [0|0] "%" A
VAL_ 17 On1 0 "Off" 1 "On" 3 "Unknown" ;
"""
FLAGS = SignalMap(
    "Pack.Current", "discharge", ["Pack.V1", "Pack.V2"], temperature=["Pack.Warm"],
    balancing=["Balancers.On1", "Balancers.On2"], bleed_A=0.1,
)  # fmt: skip
CURRENTS = replace(FLAGS, balancing=["Balancers.Bleed1", "Balancers.Bleed2"], bleed_A=None)


class Bus:
    """The way in for the frames of that DBC."""

    def __init__(self, folder: Path, signals: SignalMap, alignment: Alignment | None = None) -> None:
        (folder / "x.dbc").write_text(DBC)
        self.intake = Intake(Decoder(signals, Matrix([folder / "x.dbc"]), cells=2), alignment=alignment)

    def balancers(self, second: int, page: int, first: int, second_byte: int = 0) -> None:
        data = bytes([page, first, second_byte, 0, 0, 0, 0, 0])
        assert self.intake.take(17, False, data, second * SECOND_NS) == (), "nothing measured: no sample"

    def measured(self, second: int) -> list[Sample]:
        volts = (3700).to_bytes(2, "little")
        data = (100).to_bytes(2, "little") + bytes([65]) + volts + volts + b"\0"
        return list(self.intake.take(16, False, data, second * SECOND_NS))

    def bleed(self, second: int) -> Any:
        (sample,) = self.measured(second)
        assert sample.bleed_A is not None
        return sample.bleed_A.tolist()


def same(got: list[float], expected: list[float]) -> None:
    assert got == pytest.approx(expected, nan_ok=True)


def test_flags_of_cells_in_several_frames_are_kept_until_they_are_heard_again_or_too_old(tmp_path):
    bus = Bus(tmp_path, FLAGS)
    same(bus.bleed(0), [NAN, NAN])
    bus.balancers(1, 0, 1)
    same(bus.bleed(1), [0.1, NAN])
    bus.balancers(3, 1, 0)
    same(bus.bleed(6), [0.1, 0.0])
    same(bus.bleed(7), [NAN, 0.0])
    same(bus.bleed(9), [NAN, NAN])


@pytest.mark.parametrize("raw", [2, 3])
def test_a_flag_that_is_neither_0_nor_1_is_not_known(tmp_path, raw):
    bus = Bus(tmp_path, FLAGS)
    bus.balancers(1, 0, 1)
    bus.balancers(2, 0, raw)
    same(bus.bleed(2), [NAN, NAN])


def test_a_flag_that_is_said_to_mean_nothing_is_not_known(tmp_path):
    bus = Bus(tmp_path, replace(FLAGS, not_available={"Balancers.On1": [1]}))
    bus.balancers(1, 0, 1)
    same(bus.bleed(1), [NAN, NAN])


def test_currents_are_read_in_their_unit_and_shared_by_parallel_cells_as_flags_are(tmp_path):
    bus = Bus(tmp_path, replace(CURRENTS, plausible={"Balancers.Bleed2": [0, 500]}, parallel_cells=2))
    bus.balancers(1, 2, 20, 50)
    same(bus.bleed(1), [0.1, 0.25])
    bus.balancers(2, 2, 20, 51)
    same(bus.bleed(2), [0.1, NAN])
    bus = Bus(tmp_path, replace(FLAGS, parallel_cells=2))
    bus.balancers(1, 0, 1)
    same(bus.bleed(1), [0.05, NAN])


def test_samples_that_were_held_back_for_late_signals_say_it_too(tmp_path):
    bus = Bus(tmp_path, FLAGS, Alignment(voltage_s=2.0))
    bus.balancers(0, 0, 1)
    assert bus.measured(0)[0].voltage_V[0] == 3.7, "measured two seconds before"
    bus.balancers(2, 1, 1)
    samples = [*bus.measured(2), *bus.intake.due(3 * SECOND_NS)]
    assert len(samples) > 1
    for sample in samples:
        same(sample.bleed_A.tolist(), [0.1, 0.1])


def test_what_the_frames_say_is_taken_from_the_charge_of_its_cell(tmp_path):
    bus, estimator = Bus(tmp_path, replace(FLAGS, bleed_A=0.5)), Estimator(CELL, 2)
    for second in range(600):
        bus.balancers(second, 0, 0)
        bus.balancers(second, 1, int(second > 1))
        (sample,) = bus.measured(second)
        if second > 1:
            sample.voltage_V = NAN
        estimate = estimator.step(sample)
    assert estimator.bleed_A.tolist() == [0.0, 0.5]
    fell = float(estimate.soc[0] - estimate.soc[1])
    assert fell == pytest.approx(0.5 * 598 / 3600 / CELL.cell.capacity_Ah, rel=0.02)


@pytest.mark.parametrize(
    ("signals", "told"),
    [
        (replace(FLAGS, bleed_A=None), "pack.bleed_A: expected what is taken from a cell while Balancers.On1, a flag"),
        (replace(FLAGS, balancing=["Balancers.On1"]), "signals.balancing is .*; expected one signal for each of 2"),
        (replace(FLAGS, balancing=["Balancers.Duty1"] * 2), "its unit in the DBC is '%'"),
        (replace(FLAGS, plausible={"Balancers.On1": [0, 1]}), "signals.plausible is 'Balancers.On1'"),
    ],
)
def test_balancing_that_cannot_be_read_is_one_line(tmp_path, signals, told):
    with pytest.raises(ConfigError, match=told) as caught:
        Bus(tmp_path, signals)
    assert "\n" not in str(caught.value)
