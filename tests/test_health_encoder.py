"""State of health on the bus, with cantools as the independent reader."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from drives import CELL

from bms_ukf import Estimator
from bms_ukf.dbc import own_matrix
from bms_ukf.frames import Frame, Inbox
from bms_ukf.health_encoder import EACH, TOGETHER, HealthEncoder
from bms_ukf.pack import Health

SCAN_NS = 100_000_000
NAMES = (*TOGETHER, "CellHealth")
MATRIX = [own_matrix().message(name) for name in NAMES]


def aged(cells: int) -> Health:
    """The first cell is told nothing of, the others have ever less capacity and more resistance."""
    health = Health(Estimator(CELL, cells))
    health.capacity = np.linspace(1.0, 0.8, cells)
    health.segments[1:], health.told_s[1:] = 7, 60.0
    health.resistance = np.linspace(1.0, 1.6, cells)
    health.resistance_sigma[:] = 0.05
    return health


def shown(frames: list[Frame]) -> dict[str, Any]:
    by_id = {message.frame_id: message for message in MATRIX}
    return {k: v for number, _, data in frames for k, v in by_id[number].decode(data).items()}  # type: ignore[union-attr]


@pytest.mark.parametrize("cells", [1, 3])
def test_what_nothing_has_told_of_is_not_available_and_never_a_hundred_percent(cells):
    told = shown(HealthEncoder(Health(Estimator(CELL, cells))).encode(0, 1))
    assert told.pop("CapacitySegments") == 0
    if cells > 1:
        assert told.pop("HealthCell") == 1
    values = {str(value) for name, value in told.items() if name not in {"Crc", "AliveCounter"}}
    assert values == {"NotAvailable"}


def test_the_weakest_and_the_mean_of_the_cells_that_are_told_come_back_within_half_a_bit():
    health = aged(3)
    told = shown(HealthEncoder(health).encode(0, 1))
    for name, value, bit in (
        ("CapacityMin", 80.0, 0.05),
        ("CapacityMean", 85.0, 0.05),
        ("CapacitySigma", 100 * health.capacity_sigma[2], 0.1),
        ("CapacityCell", 3, 1),
        ("CapacitySegments", 7, 1),
        ("ResistanceMax", 160.0, 0.1),
        ("ResistanceMean", 145.0, 0.1),
        ("ResistanceSigma", 5.0, 0.1),
        ("ResistanceCell", 3, 1),
    ):
        assert told[name] == pytest.approx(value, abs=0.501 * bit), name


@pytest.mark.parametrize("cells", [2, 96, 400])
def test_every_cell_is_told_and_accepted_by_a_receiver(cells):
    encoder, health, told = HealthEncoder(aged(cells)), aged(cells), {}
    message = own_matrix().message("CellHealth")

    def read(data: bytes, _: int) -> bool:
        values: dict[str, Any] = message.decode(data)  # type: ignore[assignment]
        told[int(values["HealthCell"])] = values
        return True

    inbox = Inbox({message: read})
    for k in range(900):
        frames = encoder.encode(k * SCAN_NS, k + 1)
        assert [number for number, *_ in frames].count(message.frame_id) <= 1
        for frame in frames:
            inbox.decode(*frame, k * SCAN_NS)
    assert sorted(told) == list(range(1, cells + 1))
    assert (inbox.counters.refused, inbox.counters.lost) == (0, 0)
    assert str(told[1]["CellCapacity"]) == str(told[1]["CellResistanceSigma"]) == "NotAvailable"
    for cell in range(1, cells):
        assert told[cell + 1]["CellCapacity"] == pytest.approx(100 * health.capacity[cell], abs=0.026)
        assert told[cell + 1]["CellResistance"] == pytest.approx(100 * health.resistance[cell], abs=0.051)


def test_what_all_cells_are_goes_once_a_second_and_a_single_cell_is_told_of_by_that():
    encoder = HealthEncoder(aged(1))
    sent = [number for k in range(30) for number, *_ in encoder.encode(k * SCAN_NS, k)]
    ids = {own_matrix().message(name).frame_id: 3 for name in TOGETHER}
    assert {number: sent.count(number) for number in sent} == ids


def test_the_messages_carry_what_is_encoded_and_no_more():
    for name, signals in (*TOGETHER.items(), ("CellHealth", EACH)):
        named = {signal.name for signal in own_matrix().message(name).signals}
        assert named == {"Crc", "AliveCounter", *signals}
