"""Parallel strings with a current sensor each, layer by layer: configuration, frames, sensors' faults, what is sent."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from drives import CELL
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from model_cell import ModelCell

from bms_ukf import CellParams, ConfigError, Estimator, Fault, Sample, Status, failed, service
from bms_ukf.alignment import Alignment
from bms_ukf.config import Setup
from bms_ukf.core import Core
from bms_ukf.dbc import own_matrix
from bms_ukf.decoder import Decoder
from bms_ukf.flight import FORMAT, Recorder
from bms_ukf.frames import Inbox
from bms_ukf.intake import Intake
from bms_ukf.monitor import view
from bms_ukf.monitor.watch import Watch
from bms_ukf.node import SampleEncoder
from bms_ukf.open_circuit import SETTLE_NS, OpenCircuit
from bms_ukf.pace import Pace
from bms_ukf.pack import PackEstimate
from bms_ukf.pack_encoder import PackEncoder
from bms_ukf.publication import Publication
from bms_ukf.records import NAN, Estimate
from bms_ukf.replay import flight
from bms_ukf.replay.rows import Rows
from bms_ukf.scan import TOGETHER_NS, Scan
from bms_ukf.signals import SignalMap
from bms_ukf.skeleton import propose
from bms_ukf.strings import CommissioningStrings, StuckStrings
from bms_ukf.wiring import Wiring

SECOND_NS = 10**9
WIRING = Wiring(string_of=[0, 0, 1, 1])
DBC = """
VERSION ""
BU_: A
BO_ 1 First: 8 A
 SG_ String1Current : 0|16@1- (0.01,0) [0|0] "A" A
 SG_ String1Cell1 : 16|16@1+ (0.0001,0) [0|0] "V" A
 SG_ String1Cell2 : 32|16@1+ (0.0001,0) [0|0] "V" A
 SG_ Temperature : 48|8@1+ (1,-40) [0|0] "degC" A
BO_ 2 Second: 8 A
 SG_ String2Current : 0|16@1- (0.01,0) [0|0] "A" A
 SG_ String2Cell1 : 16|16@1+ (0.0001,0) [0|0] "V" A
 SG_ String2Cell2 : 32|16@1+ (0.0001,0) [0|0] "V" A
"""
CURRENTS = '["First.String1Current", "Second.String2Current"]'
CONFIG = f"""
format = 1
cell = "lgm50_chen2020"
cells = 4
[bus]
interface = "virtual"
channel = "strings"
[signals]
dbc = ["car.dbc"]
current = {CURRENTS}
current_positive = "charge"
cell_voltage = ["First.String1Cell1", "First.String1Cell2", "Second.String2Cell1", "Second.String2Cell2"]
temperature = ["First.Temperature"]
[pack]
string_of = [1, 1, 2, 2]
"""


@pytest.fixture
def config(tmp_path):
    """The setup of a CONFIG beside the DBC above."""
    (tmp_path / "car.dbc").write_text(DBC)

    def load(text: str) -> Setup:
        (tmp_path / "can.toml").write_text(text)
        return Setup.load(tmp_path / "can.toml")

    return load


def frame(current_A: float, *volts: float, temperature: int = 65) -> bytes:
    """First or Second; charge is positive there."""
    numbers = [round(-100 * current_A), *(round(1e4 * volt) for volt in volts)]
    return b"".join(n.to_bytes(2, "little", signed=n < 0) for n in numbers) + bytes([temperature, 0])


def driven(cell: CellParams, seconds: int) -> list[Sample]:
    """Two strings of two cells in a city drive, each with a current of its own."""
    dice, batteries = np.random.default_rng(3), (ModelCell(cell, 0.7), ModelCell(cell, 0.6))
    currents = np.repeat(dice.choice([-2.0, 0.0, 1.5, 5.0, 10.0], (-(-seconds // 5), 2)), 5, axis=0)
    samples = []
    for k, pair in enumerate(currents.tolist()):
        volts = [battery.step(i, 1.0) for battery, i in zip(batteries, pair, strict=True)]
        measured = np.round(np.repeat(volts, 2) + dice.normal(0.0, 0.002, 4), 3)
        samples.append(Sample(k * SECOND_NS, NAN, measured, 25.0, string_current_A=np.array(pair)))
    return samples


# --- configuration --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("string_of = [1, 1, 2, 2]", "", "pack.string_of: expected the string of each cell, for the 2 currents"),
        ("[1, 1, 2, 2]", "[1, 1, 2]", "pack.string_of: expected the number of a string for each of 4 cells, not of 3"),
        ("[1, 1, 2, 2]", "[1, 1, 2, 3]", "pack.string_of is [1, 2, 3]; expected strings 1 to 2, as many as"),
        ("[1, 1, 2, 2]", "[2, 2, 2, 2]", "pack.string_of is [2]; expected strings 1 to 2"),
        ("[1, 1, 2, 2]", "[0, 0, 1, 1]", "pack.string_of.0 is 0; expected greater than or equal to 1"),
        (CURRENTS, '"First.String1Current"', "pack.string_of is [1, 2]; expected strings 1 to 1, as many as"),
        (CURRENTS, "[]", "signals.current: expected List should have at least 1 item"),
        (CURRENTS, "7", "signals.current is 7; expected a valid list"),
        ("Second.String2Current", "First.String1Current", "expected another signal for each string"),
        ("Second.String2Current", "Second.String3Current", "Second.String2Current"),
        (
            '"charge"',
            '["charge", "charge", "charge"]',
            "current_positive is ['charge', 'charge', 'charge']; expected",
        ),
        ('"charge"', '["charge", "in"]', "signals.current_positive.1 is 'in'; expected 'charge' or 'discharge'"),
        ("cells = 4", "cells = 1", "cells is 1; expected more than one, measured one by one, for 2 strings"),
        (
            "[pack]",
            'unit = { "Second.String2Current" = "kA" }\n[pack]',
            "signals.current is 'Second.String2Current'; expected 0 to 0.51532 A in bits below",
        ),
    ],
)
def test_currents_and_strings_that_do_not_fit_each_other_are_one_line(config, old, new, told):
    with pytest.raises(ConfigError) as refused:
        config(CONFIG.replace(old, new))
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_one_current_in_a_list_and_one_string_are_what_they_are_without(config):
    one = CONFIG.replace(CURRENTS, '["First.String1Current"]')
    for text in (one.replace("[1, 1, 2, 2]", "[1, 1, 1, 1]"), one.replace("string_of = [1, 1, 2, 2]", "")):
        setup = config(text)
        assert setup.wiring.string_of is None
        assert setup.decoder.decode(1, False, frame(2.5, 3.7, 3.7), 0).current_A == 2.5


def test_without_signals_the_strings_are_those_of_our_own_message(config):
    head, _, pack = CONFIG.partition("[signals]")
    setup = config(head + pack[pack.index("[pack]") :])
    sent = Sample(0, NAN, np.full(4, 3.7), 25.0, string_current_A=np.array([1.5, -0.25]))
    first, second, *_ = SampleEncoder(4, 1, 2).encode(sent)
    np.testing.assert_allclose(setup.decoder.decode(*first, 0).string_current_A, [1.5, -0.25])
    assert setup.decoder.decode(*second, 0) is None, "PackMeasurement is not for the estimator"
    shown = own_matrix().message("PackMeasurement").decode(second[2])
    assert (shown["PackCurrent"], shown["PackVoltage"]) == (1.25, 7.4)


def test_check_tells_of_each_string_and_a_reload_does_not_rewire_the_estimator(config, tmp_path):
    setup = config(CONFIG + 'power_tau_s = 30.0\n[recorder]\nfolder = "f"\n')
    text = service._explanation(setup)
    assert "current 1: First.String1Current (0x001" in text
    assert "current 2: Second.String2Current (0x002" in text
    assert "; 2 strings by string_of" in text
    assert service._fixed(setup) == service._fixed(config(CONFIG))
    assert service._fixed(setup) != service._fixed(config(CONFIG.replace("[1, 1, 2, 2]", "[1, 2, 1, 2]")))


def test_sign_share_range_and_codes_hold_for_every_string(config):
    keys = 'parallel_cells = 2\nplausible = { "Second.String2Current" = [-50, 50] }\n'
    keys += 'not_available = { "First.String1Current" = [0x7FFF] }\n[pack]'
    decoder = config(CONFIG.replace("[pack]", keys)).decoder
    np.testing.assert_array_equal(decoder.decode(1, False, frame(5.0, 3.7, 3.7), 0).string_current_A, [2.5, NAN])
    np.testing.assert_array_equal(decoder.decode(2, False, frame(5.0, 3.7, 3.7), 0).string_current_A, [NAN, 2.5])
    np.testing.assert_array_equal(decoder.decode(2, False, frame(60.0, 3.7, 3.7), 0).string_current_A, [NAN, math.inf])
    unknown = (0x7FFF).to_bytes(2, "little") + bytes(6)
    assert np.isnan(decoder.decode(1, False, unknown, 0).string_current_A).all()


def test_a_sensor_the_other_way_round_has_a_sign_of_its_own_and_check_tells_it(config):
    setup = config(CONFIG.replace('"charge"', '["charge", "discharge"]'))
    np.testing.assert_array_equal(setup.decoder.decode(2, False, frame(5.0, 3.7, 3.7), 0).string_current_A, [NAN, -5.0])
    lines = [line.strip() for line in service._explanation(setup).splitlines()]
    told = {line.partition(":")[0]: line for line in lines if line.startswith("current ")}
    assert "positive on the bus is charge" in told["current 1"]
    assert "positive on the bus is discharge" in told["current 2"]


def test_init_proposes_the_currents_of_strings_in_the_order_of_their_numbers(tmp_path):
    two = DBC.replace("String1Current", "BattString1Current").replace("String2Current", "BattString2Current")
    (tmp_path / "car.dbc").write_text(two)
    text, _ = propose([tmp_path / "car.dbc"], tmp_path / "can.toml")
    assert "#   or, of parallel strings" not in text, "of two messages: not known to belong together"
    (tmp_path / "car.dbc").write_text(two.replace("First:", "String1:").replace("Second:", "String2:"))
    text, _ = propose([tmp_path / "car.dbc"], tmp_path / "can.toml")
    assert (
        "#   or, of parallel strings, with pack.string_of: "
        'current = ["String1.BattString1Current", "String2.BattString2Current"]'
    ) in text


# --- frames to samples ----------------------------------------------------------------------------------------------


def test_strings_that_come_late_meet_the_voltages_of_their_instant_and_none_is_overwritten():
    alignment, shown_A = Alignment(voltage_s=0.1), np.array([1.0, NAN])
    alignment.put(Sample(0, string_current_A=shown_A))
    shown_A[:] = NAN, 2.0
    alignment.put(Sample(1, string_current_A=shown_A))
    late = alignment.put(Sample(10**8, voltage_V=np.full(4, 3.7)))
    assert [sample.t_ns for sample in late] == [0, 0]
    np.testing.assert_array_equal(late[0].string_current_A, [1.0, NAN])
    (second,) = alignment.due(10**8 + 1)
    np.testing.assert_array_equal(second.string_current_A, [NAN, 2.0])


def test_a_string_that_carries_a_current_behind_open_contactors_contradicts_for_all_once():
    circuit, told = OpenCircuit(0.3), []
    for k in range(10):
        for reading_A in ([5.0, NAN], [NAN, 0.1]):
            t_ns = SETTLE_NS + k * SECOND_NS
            told.append(circuit.nothing_flows(np.array(reading_A), 0 if k == 0 else t_ns, True, t_ns))
    assert not any(told)
    assert circuit.contradictions == 1
    assert not circuit.nothing_flows(NAN, 2 * SETTLE_NS + 9 * SECOND_NS, True, 2 * SETTLE_NS + 9 * SECOND_NS)
    assert circuit.nothing_flows(np.array([0.1, 0.1]), 20 * SECOND_NS, True, 20 * SECOND_NS)


def test_strings_whose_frames_come_apart_are_known_as_if_they_came_together(config, cell):
    """The current of either is held meanwhile: it is never the other's, and never 0 for want of one."""
    setup = config(CONFIG)
    core, together = Core(setup.estimator(), setup.intake(), setup.pace), setup.estimator()
    for sample in driven(cell, 600):
        currents, volts = sample.string_current_A, sample.voltage_V
        core.hear(1, False, frame(currents[0], *volts[:2]), sample.t_ns)
        core.hear(2, False, frame(currents[1], *volts[2:], temperature=0), sample.t_ns)
        known = together.step(sample)
    assert core.estimate.status is Status.OK
    np.testing.assert_allclose(core.estimate.soc, known.soc, atol=1e-6)


MS = 10**6


@pytest.mark.parametrize(
    ("parts", "made"),
    [
        ([(0, [1, NAN], []), (1, [NAN, 2], [])], [([1, 2], [])]),  # pages of currents
        ([(0, [1, 2], []), (1, [3, 4], [])], [([1, 2], []), ([3, 4], [])]),
        ([(0, [1, NAN], []), (1, [NAN, 2], [2, 3])], [([1, 2], [2, 3])]),  # voltages are not lost
        ([(0, [1, NAN], [0, 1]), (1, [NAN, 2], [2, 3])], [([1, 2], [0, 1, 2, 3])]),  # a frame for each string
        ([(0, [1, NAN], [0, 1]), (1, [NAN, NAN], [2, 3])], [([1, NAN], [0, 1, 2, 3])]),  # a sensor is dead
        ([(0, [1, NAN], [0, 1]), (100, [NAN, 2], [2, 3])], [([1, NAN], [0, 1]), ([NAN, 2], [2, 3])]),
        ([(0, [1, NAN], []), (1, [3, NAN], []), (2, [NAN, 2], [])], [([1, NAN], []), ([3, 2], [])]),  # again
        ([(0, [1, NAN], []), (1, None, [0, 1]), (2, None, [2, 3])], [([1, NAN], [0, 1, 2, 3])]),
    ],
)
def test_what_comes_of_strings_within_20_ms_is_one_sample_and_nothing_of_it_is_lost_or_counted_twice(parts, made):
    """Currents of two strings, and the cells that have a voltage, in frames at so many ms."""
    steps: list[Sample] = []
    scan = Scan(4, steps.append, lambda _: None)
    for t_ms, currents, cells in parts:
        sample = Sample(t_ms * MS)
        if currents is not None:
            sample.string_current_A = np.array(currents, dtype=float)
        if cells:
            sample.voltage_V = np.full(4, NAN)
            sample.voltage_V[cells] = 3.7
        scan.take(sample)
    scan.flush()
    assert len(steps) == len(made)
    for step, (currents, cells) in zip(steps, made, strict=True):
        np.testing.assert_array_equal(step.string_current_A, currents)
        assert np.flatnonzero(np.isfinite(np.broadcast_to(step.voltage_V, 4))).tolist() == cells


def test_currents_alone_are_a_measurement_and_none_of_any_string_is_not():
    core = Core(Estimator(CELL, 4, wiring=WIRING), Intake(Decoder(SignalMap.default(4, 1, 2), cells=4)), Pace(10.0))
    encoder = SampleEncoder(4, 1, 2)
    for k, (currents, accepted) in enumerate([([1.0, NAN], 1), ([NAN, NAN], 1), ([NAN, 1.0], 2)]):
        (page,) = encoder.strings(Sample(0, string_current_A=np.array(currents)))
        core.hear(*page, k * SECOND_NS)
        core.idle(k * SECOND_NS + TOGETHER_NS)
        assert core.estimator.accepted == accepted


@pytest.fixture(scope="module")
def wired(tmp_path_factory):
    """Setups of the CONFIG above, for a test that is run many times."""
    folder = tmp_path_factory.mktemp("wired")
    (folder / "car.dbc").write_text(DBC)
    (folder / "can.toml").write_text(CONFIG)
    return lambda: Setup.load(folder / "can.toml")


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.tuples(st.integers(1, 2), st.binary(max_size=9), st.integers(-50, 4000)), max_size=40))
def test_no_frame_of_a_string_whatever_is_in_it_ends_the_daemon_or_makes_a_soc_that_is_none(wired, frames):
    setup, t_ns = wired(), 0
    core = Core(setup.estimator(), setup.intake(), setup.pace)
    for k in range(5):
        core.hear(1, False, frame(1.0, 3.7, 3.7), k * SECOND_NS)
        core.hear(2, False, frame(1.0, 3.7, 3.7), k * SECOND_NS)
    for identifier, data, apart_ms in frames:
        t_ns += apart_ms * MS
        core.hear(identifier, False, data, 5 * SECOND_NS + t_ns)
        soc = core.estimate.soc
        assert ((soc >= 0) & (soc <= 1) | np.isnan(soc)).all()


# --- what is published and kept -------------------------------------------------------------------------------------


def test_a_set_has_the_mean_of_each_string_and_a_string_that_is_missing_makes_no_sum():
    publication = Publication(capacity_Ah=5.0)
    blank = {name: np.full(4, NAN) for name in ("soc", "voltage_pred_V", "innovation_V", "nis", "age_s")}
    estimate = Estimate(status=Status.OK, **blank)
    for k, currents in enumerate([[1.0, NAN], [3.0, -1.0], [NAN, NAN]]):
        publication.follow(Sample(k * SECOND_NS, string_current_A=np.array(currents)), estimate)
    whole = publication.whole(estimate, 0)
    np.testing.assert_array_equal(whole.string_current_A, [2.0, -1.0])
    assert whole.current_A == 1.0
    publication.follow(Sample(5 * SECOND_NS, string_current_A=np.array([1.0, NAN])), estimate)
    whole = publication.whole(estimate, 0)
    np.testing.assert_array_equal(whole.string_current_A, [1.0, NAN])
    assert math.isnan(whole.current_A)


def test_the_bias_of_each_string_goes_out_on_pages_that_no_receiver_refuses():
    message, heard = own_matrix().message("StringBias"), []
    inbox = Inbox({message: lambda data, _: heard.append(message.decode(data))})
    pack, encoder = PackEstimate(current_bias_A=np.array([0.1, -0.2, 0.3])), PackEncoder(6, 10.0, 3)
    estimate = Estimate(soc=np.full(6, 0.5), soc_sigma=np.full(6, 0.01), status=Status.OK)
    for k in range(5):
        for told in encoder.encode(k * SECOND_NS, estimate, pack, k):
            inbox.decode(*told, k * SECOND_NS)
    assert inbox.counters.refused == 1, "the second page while nothing had been accepted"
    told = {k: v for page in heard[-2:] for k, v in page.items() if k.startswith("String")}
    assert str(told.pop("String4")) == "NotAvailable"
    assert told == pytest.approx({"String1": 0.1, "String2": -0.2, "String3": 0.3})
    alone = [frame[0] for frame in PackEncoder(6, 10.0).encode(0, estimate, pack, 1)]
    assert message.frame_id not in alone


@pytest.mark.parametrize("wiring", [WIRING, None], ids=["two strings", "one string"])
def test_a_flight_with_strings_runs_again_bit_for_bit_as_does_one_without(tmp_path, wiring):
    estimator = Estimator(CELL, 4, wiring=wiring)
    recorder, estimate = Recorder(estimator, tmp_path), estimator.coast(0)
    recorder.coasted(0, estimate)  # as the daemon does: the first step has a length from here on
    for k in range(1, 50):
        sample = Sample(k * SECOND_NS, 1.0, np.full(4, 3.7 + 0.001 * k), 25.0, k % 5 == 0)
        if wiring is not None:
            sample.string_current_A = np.array([1.0, NAN if k % 3 else 2.0])
        estimator.step(sample, out=estimate)
        recorder.stepped(sample, estimate)
    (tmp_path / "x.flight").write_bytes(recorder.file(Fault.NONE))
    trace, summary = flight.rerun(tmp_path / "x.flight")
    assert summary["identical"] is True
    assert trace["current_A"][-1] == (3.0 if wiring is not None else 1.0)


@pytest.mark.parametrize("other", [FORMAT - 1, FORMAT + 1], ids=["older", "later"])
def test_a_flight_of_an_older_or_a_later_format_is_one_line(tmp_path, other):
    """The snapshots in an older file are those of another filter."""
    head, _, body = Recorder(Estimator(CELL, 4, wiring=WIRING), tmp_path).file(Fault.NONE).partition(b"\n")
    head = json.dumps(json.loads(head) | {"format": other}).encode()
    (tmp_path / "x.flight").write_bytes(head + b"\n" + body)
    with pytest.raises(ConfigError, match="of another format") as refused:
        flight.rerun(tmp_path / "x.flight")
    assert "\n" not in str(refused.value)


def test_rows_of_a_trace_have_the_sum_of_what_each_string_carried_last():
    rows = Rows()
    for k, currents in enumerate([[1.0, NAN], [NAN, 2.0], [-1.0, NAN]]):
        rows.measured(Sample(k, string_current_A=np.array(currents)))
        rows.add(k, Estimate())
    np.testing.assert_array_equal(rows.trace()["current_A"], [NAN, 3.0, 1.0])


def test_what_was_learnt_of_sensors_is_not_taken_up_by_strings_that_are_wired_otherwise():
    stored = Estimator(CELL, 4, wiring=WIRING).snapshot()
    Estimator(CELL, 4, wiring=Wiring(string_of=[0, 0, 1, 1])).restore(stored)
    for other in (Wiring(string_of=[0, 1, 0, 1]), None):
        with pytest.raises(ValueError, match="another"):
            Estimator(CELL, 4, wiring=other).restore(stored)


# --- sensors that lie -----------------------------------------------------------------------------------------------


def test_the_sensor_with_the_wrong_sign_is_named_and_the_other_is_not_accused(cell, caplog):
    commissioning = CommissioningStrings(cell, WIRING)
    for sample in driven(cell, 600):
        sample.string_current_A *= [1.0, -1.0]
        commissioning.see(sample)
    assert commissioning.fault is Fault.CURRENT_SIGN
    (told,) = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert told.startswith("current of string 2: ")
    assert "its sign is wrong" in told


def test_a_current_that_stands_still_is_missing_for_its_own_string(cell, caplog):
    estimator, missing = Estimator(cell, 4, wiring=WIRING), np.zeros(2)
    # The intervals say nothing: this is about the sensor.
    watch = failed.Watch(estimator)
    estimate = Estimate(soc=np.full(4, 0.6), soc_low=np.zeros(4), soc_high=np.ones(4))
    for sample in driven(cell, 400):
        if sample.t_ns > 200 * SECOND_NS:
            sample.string_current_A[1] = 1.5
        given = sample.string_current_A.copy(), sample.string_current_A
        watch.take(sample, estimate)
        missing += np.isnan(sample.string_current_A)
        np.testing.assert_array_equal(*given, err_msg="the array is the decoder's")
    assert missing[0] == 0
    assert missing[1] > 100
    assert watch.fault is Fault.CURRENT_FAILED
    (told,) = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert told.startswith("current of string 2: ")


def test_a_voltage_that_stands_still_is_judged_by_the_current_of_its_own_string(cell):
    """String 1 rests, and its voltages stand still as they should; in string 2 one does while its current moves."""
    stuck = StuckStrings(cell, WIRING)
    for sample in driven(cell, 60):
        sample.string_current_A[0] = 0.0
        sample.voltage_V[:3] = 3.7
        kept = sample.voltage_V
        stuck.take(sample)
    np.testing.assert_array_equal(np.isnan(sample.voltage_V), [False, False, True, False])
    assert kept[2] == 3.7, "the array is the decoder's"
    assert stuck.fault is Fault.VOLTAGE_IMPLAUSIBLE


def test_a_frame_of_one_string_leaves_what_is_known_of_the_other(cell):
    stuck = StuckStrings(cell, WIRING)
    for sample in driven(cell, 60):
        for string in (0, 1):
            part = Sample(sample.t_ns, NAN, sample.voltage_V.copy(), 25.0, string_current_A=np.full(2, NAN))
            part.string_current_A[string] = sample.string_current_A[string]
            part.voltage_V[2 - 2 * string : 4 - 2 * string] = NAN
            stuck.take(part)
            assert np.isfinite(part.voltage_V).sum() == 2
            assert stuck.fault is Fault.NONE


def test_the_monitor_shows_the_bias_of_each_string_and_none_of_a_single_one():
    watch = Watch()
    assert view._strings(watch) == []
    pack, encoder = PackEstimate(current_bias_A=np.array([0.1, -0.2])), PackEncoder(4, 10.0, 2)
    estimate = Estimate(soc=np.full(4, 0.5), soc_sigma=np.full(4, 0.01), status=Status.OK)
    for told in encoder.encode(0, estimate, pack, 1):
        watch.take(*told, 0)
    (line,) = view._strings(watch)
    assert "0.10 A (1), -0.20 A (2)" in line.plain
    view.panel(watch, "vcan0", 0)
