"""Estimates to frames and back, with cantools as the independent reader."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf.dbc import own_matrix
from bms_ukf.decoder import Decoder
from bms_ukf.encoder import Encoder
from bms_ukf.frames import Frame
from bms_ukf.node import EstimateDecoder, SampleEncoder
from bms_ukf.records import NAN, Detail, Estimate, Fault, Sample, Source, Status

# Made with cantools' encoder and the autosar-e2e package from SAMPLE and ESTIMATE: the first frame of each message.
RECORDED = {
    "PackMeasurement": "f40039427a940000",
    "CellTemperatures": "e5000053f7ffffff",
    "CellVoltages": "c300003af7ffffff",
    "SocDetail": "7e2018570102f47f",
    "SocInterval": "8500e4528c5a0000",
    "BmsState": "ac004000b856b856",
    "SocQuality": "3710800839f82d01",
    "SocEstimate": "bd10b856f4010a00",
}
SAMPLE = Sample(t_ns=0, current_A=12.345, voltage_V=3.7, temperature_degC=25.0)
ESTIMATE = Estimate(
    soc=0.555,
    soc_sigma=0.0125,
    voltage_pred_V=3.7,
    innovation_V=-0.0123,
    nis=0.75,
    age_s=0.1,
    status=Status.OK,
    faults=Fault.E2E,
    soc_low=0.5305,
    soc_high=0.5795,
)
DETAIL = Detail(soc_slewed=0.5574, source=Source.START, current_bias_A=-0.01)


def estimate(**values: Any) -> Estimate:
    return replace(ESTIMATE, **values)


def shown(frame: Frame) -> dict[str, Any]:
    """The signals of a frame of ours as cantools reads them."""
    names = ["PackMeasurement", "SocEstimate", "SocQuality", "BmsState", "SocDetail", "SocInterval", "BusHealth"]
    return next(m for m in map(own_matrix().message, names) if m.frame_id == frame[0]).decode(frame[2])


def test_what_is_nan_is_sent_as_not_available() -> None:
    got = Decoder().decode(*SampleEncoder().pack(replace(SAMPLE, current_A=NAN)), 0)
    assert got is not None
    assert math.isnan(got.current_A)
    assert shown(SampleEncoder().pack(replace(SAMPLE, current_A=NAN)))["PackCurrent"] == "NotAvailable"


def test_recorded_good_frames_are_made_again_to_the_byte() -> None:
    made = [*SampleEncoder().encode(SAMPLE), *Encoder().encode(ESTIMATE, DETAIL, accepted=1)]
    assert [frame[2].hex() for frame in made] == list(RECORDED.values())
    assert [frame[0] for frame in made] == [own_matrix().message(name).frame_id for name in RECORDED]


def test_an_estimate_comes_back_as_it_was_sent() -> None:
    decoder = EstimateDecoder()
    _, interval, state, quality, soc = Encoder().encode(ESTIMATE, DETAIL, accepted=1)
    assert decoder.decode(*interval, 4) is None
    assert decoder.decode(*state, 5) is None
    assert decoder.decode(*quality, 6) is None
    got = decoder.decode(*soc, 7)
    assert got is not None
    assert (got.status, got.faults) == (ESTIMATE.status, ESTIMATE.faults)
    names = ["soc", "soc_sigma", "voltage_pred_V", "innovation_V", "nis", "age_s", "soc_low", "soc_high"]
    assert [getattr(got, name) for name in names] == pytest.approx(
        [getattr(ESTIMATE, name) for name in names], abs=5e-6
    )
    assert decoder.counters.accepted == 4


def test_an_estimate_holds_only_what_was_received_since_the_one_before() -> None:
    decoder, encoder = EstimateDecoder(), Encoder()
    for frame in encoder.encode(ESTIMATE, DETAIL, accepted=1):
        decoder.decode(*frame, 0)
    got = decoder.decode(*encoder.soc(ESTIMATE, accepted=2), 0)
    assert got is not None
    assert math.isnan(got.innovation_V)
    assert got.faults is Fault.NONE


@given(soc=st.floats(0, 1), sigma=st.floats(0, 1), age=st.floats(0, 600))
def test_soc_round_trip_is_within_half_a_bit(soc: float, sigma: float, age: float) -> None:
    got = EstimateDecoder().decode(*Encoder().soc(estimate(soc=soc, soc_sigma=sigma, age_s=age), accepted=1), 0)
    assert got is not None
    assert (got.soc, got.soc_sigma) == (pytest.approx(soc, abs=1.26e-5), pytest.approx(sigma, abs=1.26e-5))
    assert got.age_s == pytest.approx(age, abs=0.00501)


@pytest.mark.parametrize("status", [Status.INITIALISING, Status.INVALID])
def test_a_soc_that_is_not_trusted_is_not_on_the_bus(status: Status) -> None:
    for soc in (0.5, np.full(4, 0.5)):
        frames = Encoder().encode(estimate(soc=soc, status=status), Detail(), accepted=1)
        values = [(name, str(value)) for frame in frames for name, value in shown(frame).items()]
        socs = {value for name, value in values if name.startswith(("Soc", "Cell"))}
        assert socs == {"NotAvailable"}
        assert shown(frames[-1])["Status"] == status.word


ANY = st.floats()


@given(soc=ANY, sigma=ANY, pred=ANY, innovation=ANY, nis=ANY, age=ANY, faults=st.sampled_from(Fault))
def test_any_estimate_can_be_sent_and_nothing_wraps(
    soc: float, sigma: float, pred: float, innovation: float, nis: float, age: float, faults: Fault
) -> None:
    values = Estimate(0, soc, sigma, pred, innovation, NAN, nis, age, Status.OK, faults)
    decoder = EstimateDecoder()
    _, _, state, quality, last = Encoder().encode(values, DETAIL, accepted=1)
    decoder.decode(*state, 0)
    decoder.decode(*quality, 0)
    got = decoder.decode(*last, 0)
    assert got is not None
    assert got.faults is faults
    for sent, received, low, high, bit in (
        (soc, got.soc, 0.0, 1.0, 2.5e-5),
        (sigma, got.soc_sigma, 0.0, 1.0, 2.5e-5),
        (pred, got.voltage_pred_V, 0.0, 6.553, 2e-4),
        (innovation, got.innovation_V, -0.819, 0.819, 1e-4),
        (nis, got.nis, 0.0, 163.81, 0.01),
        (age, got.age_s, 0.0, 655.33, 0.01),
    ):
        assert received == pytest.approx(min(max(sent, low), high), abs=0.501 * bit, nan_ok=True)


def test_counter_stands_still_while_the_estimator_does() -> None:
    encoder, decoder = Encoder(), EstimateDecoder()
    accepted = [1, 2, 2, 2, 3, 7]
    got = [decoder.decode(*encoder.soc(ESTIMATE, n), 0) is not None for n in accepted]
    assert got == [True, True, False, False, True, True]
    assert decoder.counters.lost == 0, "by one per frame, however many samples were accepted"


def test_each_message_counts_its_own_frames() -> None:
    encoder, decoder = Encoder(), EstimateDecoder()
    for n in range(1, 40):
        decoder.decode(*encoder.soc(ESTIMATE, n), 0)
        if n % 5 == 0:
            for frame in (encoder.quality(ESTIMATE, n), encoder.state(ESTIMATE, DETAIL, n)):
                decoder.decode(*frame, 0)
    assert decoder.counters.lost == decoder.counters.refused == 0


def test_an_estimator_that_never_accepted_anything_does_not_move_a_counter() -> None:
    encoder = Encoder()
    assert len({frame for _ in range(4) for frame in encoder.encode(Estimate(), Detail(), accepted=0)}) == 5


def test_a_pack_publishes_mean_spread_and_worst_of_the_cells_that_are_known() -> None:
    pack = Estimate(
        soc=np.array([NAN, 0.50, 0.52, 0.51, 0.49]),
        soc_sigma=np.array([NAN, 0.01, 0.02, 0.01, 0.01]),
        voltage_pred_V=np.array([3.6, 3.6, 3.7, 3.6, 3.6]),
        innovation_V=np.array([NAN, 0.001, -0.02, NAN, NAN]),
        nis=np.array([NAN, 0.1, 9.0, NAN, NAN]),
        age_s=np.array([NAN, 0.0, 0.0, 1.0, 1.0]),
        soc_low=np.array([NAN, 0.48, 0.47, 0.49, 0.47]),
        soc_high=np.array([NAN, 0.52, 0.56, 0.53, 0.51]),
        status=Status.DEGRADED,
    )
    detail, interval, state, quality, last = Encoder().encode(pack, DETAIL, accepted=1)
    assert (shown(state)["SocMin"], shown(state)["SocMax"]) == (pytest.approx(49.0), pytest.approx(52.0))
    assert (shown(interval)["SocLow"], shown(interval)["SocHigh"]) == (pytest.approx(47.0), pytest.approx(56.0))
    assert (shown(detail)["MinCell"], shown(detail)["MaxCell"]) == (5, 3)
    assert (shown(quality)["WorstCell"], shown(quality)["Innovation"]) == (3, pytest.approx(-0.02))
    assert (shown(last)["Soc"], shown(last)["SocSigma"]) == (pytest.approx(50.5, abs=0.0013), pytest.approx(2.0))
    assert shown(last)["InformationAge"] == pytest.approx(1.0)


def test_detail_says_by_what_the_soc_was_corrected_and_what_is_not_known_is_not_available() -> None:
    got = shown(Encoder().detail(ESTIMATE, DETAIL, accepted=1))
    assert (str(got["Source"]), got["MinCell"], got["MaxCell"]) == ("start", 1, 1)
    assert (got["SocSlewed"], got["CurrentBias"]) == (pytest.approx(55.74), pytest.approx(-0.01))
    got = shown(Encoder().detail(estimate(status=Status.INVALID), Detail(), accepted=1))
    names = ["SocSlewed", "MinCell", "MaxCell", "CurrentBias"]
    assert {str(got[name]) for name in names} == {"NotAvailable"}


def test_source_words_and_numbers_are_those_of_the_records() -> None:
    choices = own_matrix().find("SocDetail.Source")[1].choices
    assert choices is not None
    assert {int(number): str(word) for number, word in choices.items()} == {s.value: s.word for s in Source}


def test_counts_on_the_bus_stop_at_their_largest_and_do_not_start_over() -> None:
    names = ["FramesDropped", "FramesRefused", "FramesNotSent", "ClockSteps", "Reopened", "Contradictions"]
    got = shown(Encoder().health([1, 2047, 2048, 5, 10**9, 2], accepted=1))
    assert [got[name] for name in names] == [1, 2047, 2047, 5, 63, 2]
