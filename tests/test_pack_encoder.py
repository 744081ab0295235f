"""What is known of a pack on the bus, with cantools as the independent reader."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from bms_ukf.dbc import own_matrix
from bms_ukf.frames import Frame, Inbox
from bms_ukf.pack import PackEstimate
from bms_ukf.pack_encoder import OF_CELLS, OFTEN, SELDOM, PackEncoder
from bms_ukf.records import NAN, Estimate, Status

SECOND_NS = 1_000_000_000
SCAN_NS = 100_000_000
PACK = PackEstimate(
    soc=0.4321,
    soc_sigma=0.0125,
    remaining_Ah=12.345,
    remaining_Wh=4321.05,
    chargeable_Wh=6789.05,
    time_to_empty_s=3600.4,
    soc_spread=0.013,
    discharge_A=150.02,
    discharge_W=51000.04,
    discharge_cell=0,
    charge_A=-75.04,
    charge_W=-27000.06,
    charge_cell=95,
    silent=2,
    silent_cell=7,
)
MATRIX = [own_matrix().message(name) for name in (*OFTEN, *SELDOM, *OF_CELLS)]


def known(cells: int, status: Status = Status.OK) -> Estimate:
    soc, sigma = np.linspace(0.4, 0.6, cells), np.linspace(0.01, 0.03, cells)
    return Estimate(soc=soc, soc_sigma=sigma, soc_low=soc - 1.96 * sigma, soc_high=soc + 1.96 * sigma, status=status)


def shown(frames: list[Frame]) -> dict[str, Any]:
    """All signals of frames, as cantools reads them."""
    by_id = {message.frame_id: message for message in MATRIX}
    return {k: v for number, _, data in frames for k, v in by_id[number].decode(data).items()}  # type: ignore[union-attr]


def names(frames: list[Frame]) -> list[str]:
    return [next(message.name for message in MATRIX if message.frame_id == number) for number, *_ in frames]


def test_what_is_known_of_a_pack_comes_back_within_half_a_bit():
    told = shown(PackEncoder(1, 10.0).encode(0, Estimate(soc=0.5), PACK, 1))
    for name, value, bit in (
        ("UsableSoc", 43.21, 0.025),
        ("UsableSocSigma", 1.25, 0.025),
        ("SocSpread", 1.3, 0.1),
        ("RemainingCharge", 12.345, 0.001),
        ("RemainingEnergy", 4321.05, 0.1),
        ("ChargeableEnergy", 6789.05, 0.1),
        ("TimeToEmpty", 3600.4, 2),
        ("DischargeCurrent", 150.02, 0.05),
        ("ChargeCurrent", -75.04, 0.05),
        ("DischargePower", 51000.04, 0.1),
        ("ChargePower", -27000.06, 0.1),
        ("DischargeCell", 1, 1),
        ("ChargeCell", 96, 1),
        ("SilentCells", 2, 1),
        ("FirstSilentCell", 8, 1),
    ):
        assert told[name] == pytest.approx(value, abs=0.501 * bit), name
    assert told["TimeToFull"] == "NotAvailable"


def test_what_is_not_known_is_not_available_and_no_cell_is_named():
    told = shown(PackEncoder(1, 10.0).encode(0, Estimate(), PackEstimate(), 0))
    assert told.pop("SilentCells") == 0
    measured = {name: value for name, value in told.items() if name not in {"Crc", "AliveCounter"}}
    assert len(measured) == 15
    assert {str(value) for value in measured.values()} == {"NotAvailable"}


def test_the_slow_messages_go_once_a_second_and_the_fast_ones_with_every_set():
    encoder = PackEncoder(1, 10.0)
    sent = [name for k in range(30) for name in names(encoder.encode(k * SCAN_NS, Estimate(), PACK, k))]
    assert {name: sent.count(name) for name in sent} == dict.fromkeys(OFTEN, 30) | dict.fromkeys(SELDOM, 3)


@pytest.mark.parametrize(("cells", "scan_ns"), [(2, SCAN_NS), (96, SCAN_NS), (400, SCAN_NS), (96, SECOND_NS)])
def test_every_cell_is_told_once_a_period_and_accepted_by_a_receiver(cells: int, scan_ns: int):
    """With 400 cells pages go two at a time, now and then: their alive counters move by one all the same."""
    encoder, told = PackEncoder(cells, 10.0), known(cells)
    pages = {name: np.full(402, math.nan) for name in OF_CELLS}
    seen: list[str] = []

    def reader(name: str) -> Any:
        def read(data: bytes, _: int) -> bool:
            values = own_matrix().message(name).decode(data)
            for signal, value in values.items():  # type: ignore[union-attr]
                if signal.startswith("Cell") and not isinstance(value, str) and hasattr(value, "real"):
                    pages[name][int(signal[4:]) - 1] = value
            seen.append(name)
            return True

        return read

    inbox = Inbox({own_matrix().message(name): reader(name) for name in pages})
    most = 0
    for k in range(10 * SECOND_NS // scan_ns + 1):
        frames = encoder.encode(k * scan_ns, told, PACK, k + 1)
        most = max(most, len(frames))
        for frame in frames:
            inbox.decode(*frame, k * scan_ns)
    count = -(-cells // 3)
    assert {seen.count(name) for name in OF_CELLS} == {count + 1}, "and the next round begun"
    assert (inbox.counters.refused, inbox.counters.lost) == (0, 0)
    assert pages["CellSoc"][:cells] == pytest.approx(100 * np.linspace(0.4, 0.6, cells), abs=0.00501)
    assert pages["CellSigma"][:cells] == pytest.approx(100 * np.linspace(0.01, 0.03, cells), abs=0.00501)
    assert pages["CellLow"][:cells] == pytest.approx(100 * np.asarray(told.soc_low), abs=0.00501)
    assert pages["CellHigh"][:cells] == pytest.approx(100 * np.asarray(told.soc_high), abs=0.00501)
    assert np.isnan(pages["CellSoc"][cells:]).all()
    assert most <= 5 + 4 * math.ceil(count * scan_ns / 10 / SECOND_NS), "spread over the period"


def test_after_a_silence_no_page_is_made_up_for():
    encoder = PackEncoder(6, 10.0)
    encoder.encode(0, known(6), PACK, 1)
    assert names(encoder.encode(100 * SECOND_NS, known(6), PACK, 2)).count("CellSoc") == 2


def test_pages_stand_still_while_the_estimator_does():
    encoder = PackEncoder(400, 1.0)
    frames = [f for k in range(5) for f in encoder.encode(k * SCAN_NS, known(400), PACK, 0) if f[0] == 0x223]
    assert len({data[1] & 15 for _, _, data in frames}) == 1


def test_a_soc_that_is_not_trusted_is_of_no_cell():
    told = shown(PackEncoder(3, 10.0).encode(0, known(3, Status.INVALID), PackEstimate(), 1))
    assert {str(told[f"Cell{k}"]) for k in (1, 2, 3)} == {"NotAvailable"}


def test_nothing_wraps():
    most = PackEstimate(
        **dict.fromkeys(("soc", "soc_sigma", "soc_spread", "remaining_Ah", "remaining_Wh", "discharge_A"), 1e12),
        **dict.fromkeys(("charge_A", "charge_W"), -1e12),
        time_to_full_s=1e12,
        silent=1000,
    )
    told = shown(PackEncoder(1, 10.0).encode(0, Estimate(soc=NAN), most, 1))
    assert told["UsableSoc"] == 100
    assert told["ChargeCurrent"] == pytest.approx(-6553.4)
    assert (told["TimeToFull"], told["SilentCells"]) == (262138, 509)
