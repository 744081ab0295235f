"""What one sample does to one cell: every branch of the policy, seen in the status, the faults and the belief."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import synthetic_cell
from kernel_record import Record

from bms_ukf import Fault, Status, Tuning

CELL = synthetic_cell.cell_of(synthetic_cell.nonlinear())
RC = ("r1_ohm", "tau1_s", "r2_ohm", "tau2_s")
CHARGE = 18000.0  # A s
CURRENT_RANGE = 7.5  # A: half of -5..10
HELD_A, HELD_S = 1.0, 5.0  # the current that `running` leaves, and its timeout
NAN = math.nan


PLAIN = {"adaptive": False, "current_bias": False}  # what is expected can be worked out by hand


class Cell(Record):
    """A record and the cell that it watches: SoC and the two RC voltages as they are, whatever is believed of them."""

    def __init__(self, tuning: Tuning | None = None, soc: float = 0.6) -> None:
        super().__init__(CELL, tuning)
        self.truth = soc, 0.0, 0.0

    def flow(self, current: float, dt: float) -> None:
        soc, *voltages = self.truth
        soc -= current * dt / CHARGE
        r1, tau1, r2, tau2 = (self.dynamics(soc, 25.0)[key] for key in RC)
        v1, v2 = (
            v + (r * current - v) * -math.expm1(-dt / tau)
            for v, r, tau in zip(voltages, (r1, r2), (tau1, tau2), strict=True)
        )
        self.truth = soc, v1, v2

    def agree(self, current: float = 1.0, dt: float = 1.0) -> tuple[Status, Fault]:
        """A step with what the cell has under `current`."""
        self.flow(current, dt)
        soc, v1, v2 = self.truth
        return self.tick(dt, current, predicted(self, soc, current) - v1 - v2, 25.0)

    def become_gaussian(self, sigma: float = 0.01) -> None:
        """One Gaussian at the truth takes over, without components."""
        root = np.diag(np.sqrt(np.diag(self.P)))
        root[0, 0] = sigma
        self.root, self.x = root, np.array([*self.truth, *self.x[3:]])
        self["parts"] = 0.0
        self["voltage_scale"] = 1.0


def running(soc: float = 0.6, current: float = 1.0, **tuning: object) -> Cell:
    """A record after a minute of samples of its cell."""
    record = Cell(Tuning(**{"initial_soc": soc, "initial_soc_sigma": 0.02, **tuning}), soc)
    record.agree(current, 0.0)
    for _ in range(60):
        status, _ = record.agree(current)
    assert status is Status.OK
    return record


def predicted(record: Record, soc: float, current: float) -> float:
    return record.ocv(soc, 25.0) - record.drop(soc, 25.0, current)


def agree(record: Cell, current: float = 1.0, dt: float = 1.0) -> tuple[Status, Fault]:
    return record.agree(current, dt)


def copied(record: Cell) -> Cell:
    twin = Cell()
    twin.truth = record.truth
    twin.params[:], twin.state[:] = record.params, record.state
    return twin


@pytest.mark.parametrize("order", list(itertools.permutations(["current", "voltage", "temperature"])))
def test_it_initialises_until_each_of_the_three_has_been_seen_in_any_order(order):
    record = Record(CELL, Tuning(initial_soc=0.6, initial_soc_sigma=0.02))
    values = {"current": 1.0, "voltage": predicted(record, 0.6, 1.0), "temperature": 25.0}
    missing = {"current": Fault.CURRENT_MISSING, "temperature": Fault.TEMPERATURE_MISSING}
    seen: list[str] = []
    for name in order[:2]:
        status, faults = record.tick(0.1, **{name: values[name]})
        seen.append(name)
        assert status is Status.INITIALISING
        assert faults == Fault.VOLTAGE_MISSING | sum((missing[k] for k in missing if k not in seen), Fault.NONE)
    status, faults = record.tick(0.1, **{order[2]: values[order[2]]})
    if order[2] == "voltage":
        assert (status, faults) == (Status.OK, Fault.NONE)
    else:  # a voltage is not held: it was of another moment
        assert status is Status.INITIALISING
        assert record.tick(0.1, voltage=values["voltage"]) == (Status.OK, Fault.NONE)


@pytest.mark.parametrize(("soc", "current"), [(0.05, 0.0), (0.4, 2.0), (0.7, 0.0), (0.95, -1.0)])
def test_without_an_opinion_the_first_voltage_decides_the_soc(soc, current):
    record = Record(CELL)
    _, faults = record.tick(0.0, current, predicted(record, soc, current), 25.0)
    assert not faults & ~Fault.UNCERTAIN
    assert abs(record.x[0] - soc) < 2 * record.root[0, 0]
    assert record.root[0, 0] < 0.2


@pytest.mark.parametrize("current", [10.0, 5.0, -3.0])
@pytest.mark.parametrize("minutes", [0, 60])
def test_a_start_under_load_is_honest_whether_the_load_is_new_or_old(current, minutes):
    record, soc = Record(CELL), 0.6
    r1, tau1, r2, tau2 = (record.dynamics(soc, 25.0)[key] for key in RC)
    begun = [r * current * -math.expm1(-60 * minutes / tau) for r, tau in ((r1, tau1), (r2, tau2))]
    record.tick(0.0, current, predicted(record, soc, current) - sum(begun), 25.0)
    assert abs(record.x[0] - soc) < 2 * record.root[0, 0]


def test_the_first_soc_is_the_one_told_as_finely_as_components_can_tell():
    """They begin on intervals of 1 / 48 of SoC, and a twentieth of their weight is for any other."""
    record = Record(CELL, Tuning(initial_soc=0.35, initial_soc_sigma=0.001))
    record.tick(0.0, 0.0, record.ocv(0.35, 25.0), 25.0)
    assert abs(record.x[0] - 0.35) < 1 / 96
    assert record["soc_low"] < 0.35 < record["soc_high"]
    assert record["soc_high"] - record["soc_low"] < 2 / 48


@pytest.mark.parametrize("bad", [math.inf, -math.inf, 1e6, -1e6])
@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("current", Fault.CURRENT_IMPLAUSIBLE),
        ("voltage", Fault.VOLTAGE_IMPLAUSIBLE),
        ("temperature", Fault.TEMPERATURE_IMPLAUSIBLE),
    ],
)
def test_an_implausible_value_sets_its_fault_and_counts_as_not_measured(name, fault, bad):
    spoilt, without = running(), running()
    good = {"current": 2.0, "voltage": 3.5, "temperature": 26.0}
    status, faults = spoilt.tick(1.0, **{**good, name: bad})
    expected_status, expected_faults = without.tick(1.0, **{**good, name: NAN})
    assert (status, faults) == (Status.DEGRADED, expected_faults | fault)
    assert expected_faults & fault == 0
    assert expected_status is not Status.INVALID
    assert spoilt.belief == without.belief
    assert agree(spoilt) == (Status.OK, Fault.NONE)  # recovered at the next good sample


def test_without_a_voltage_the_belief_is_predicted_only():
    record = running(**PLAIN)
    before = record.root[0, 0]
    status, faults = record.tick(1.0, 2.0, NAN, 25.0)
    assert (status, faults) == (Status.OK, Fault.NONE)
    assert math.isnan(record["innovation"])
    assert math.isnan(record["voltage_pred"])
    assert record.root[0, 0] > before
    assert record["voltage_age"] == 1.0


def test_an_outlier_leaves_the_belief_as_if_it_had_not_come():
    record = running()
    without = copied(record)
    status, faults = record.tick(1.0, 1.0, 3.1, 25.0)
    without.tick(1.0, 1.0, NAN, 25.0)
    assert (status, faults) == (Status.DEGRADED, Fault.INNOVATION_REJECTED)
    assert record.belief == without.belief
    assert abs(record["innovation"]) > 5 * math.sqrt(record["innovation_var"])  # published all the same
    assert agree(record) == (Status.OK, Fault.NONE)


def refused_and_believed(
    believed: float, truth: float, current: float, steps: int, **tuning: object
) -> list[tuple[float, float, Status, Fault]]:
    """Error of SoC, its sigma, status and faults over a record that is wrong by far more than its sigma."""
    record = running(soc=believed, current=current, **tuning)
    _, v1, v2 = record.x[:3]
    rows = []
    for _ in range(steps):
        truth -= current / CHARGE
        if truth < 0.03:
            break
        r1, tau1, r2, tau2 = (record.dynamics(truth, 25.0)[key] for key in RC)
        v1 += (r1 * current - v1) * -math.expm1(-1 / tau1)
        v2 += (r2 * current - v2) * -math.expm1(-1 / tau2)
        said = record.tick(1.0, current, predicted(record, truth, current) - v1 - v2, 25.0)
        rows.append((abs(record.x[0] - truth), record.root[0, 0], *said))
    return rows


@pytest.mark.parametrize("plain", [{}, PLAIN], ids=["default", "nothing adapted"])
@pytest.mark.parametrize(
    ("believed", "truth", "current"),
    [(0.9, 0.6, 1.0), (0.6, 0.9, 1.0), (0.9, 0.6, 10.0), (0.6, 0.9, 10.0), (0.3, 0.7, -3.0)],
)
def test_voltages_refused_for_reject_s_are_believed_in_the_end_and_the_sigma_is_honest(believed, truth, current, plain):
    """It must not come to rest at another SoC with a small sigma."""
    rows = refused_and_believed(believed, truth, current, 600, **plain)
    for k, (error, sigma, status, _) in enumerate(rows):
        if k > 60 and status is not Status.INVALID:
            assert error < 3 * sigma, k
    refused = [bool(faults & Fault.INNOVATION_REJECTED) for *_, faults in rows]
    assert all(refused[:20] if plain == {} else refused[:30])  # a voltage error that grows opens the gate sooner
    assert not any(refused[60:])
    assert not rows[-1][3] & ~Fault.UNCERTAIN
    assert rows[-1][0] < 0.1


@pytest.mark.parametrize("plain", [{}, PLAIN], ids=["default", "nothing adapted"])
@pytest.mark.parametrize(("believed", "truth"), [(0.6, 0.1), (0.1, 0.6), (0.8, 0.05)])
def test_a_belief_wrong_by_fifty_sigmas_never_goes_the_other_way_and_comes_back(believed, truth, plain):
    """Along a plateau half a cell makes 80 mV: that takes its time, but no doubt may throw SoC off the curve's end."""
    rows = refused_and_believed(believed, truth, 1.0, 1200, **plain)
    wrong = abs(believed - truth)
    assert max(error for error, *_ in rows) < wrong + 0.02
    assert rows[-1][0] < 0.55 * wrong


def test_one_outlier_long_after_another_does_not_widen_the_belief():
    record = running()
    record.tick(1.0, 1.0, 3.1, 25.0)
    for _ in range(40):
        record.tick(1.0, 1.0, NAN, 25.0)
    without = copied(record)
    record.tick(1.0, 1.0, 3.1, 25.0)
    without.tick(1.0, 1.0, NAN, 25.0)
    assert record.belief == without.belief


def test_charge_is_counted_for_the_timeout_of_the_current_and_no_longer():
    for steps in (1, 4, 40):
        record = running(current=2.0, current_timeout_s=5.0, **PLAIN)
        before = record.x[0]
        for _ in range(steps):
            record.tick(20.0 / steps)
        assert (before - record.x[0]) * CHARGE == pytest.approx(2.0 * 5.0, rel=1e-9)


@pytest.mark.parametrize("steps", [1, 7, 100])
def test_soc_sigma_grows_in_proportion_to_the_gap_of_the_current(steps):
    """sigma^2 = before^2 + (range gap / charge)^2 + the walk of the known sensor errors, however the gap is cut."""
    for span in (105.0, 205.0):
        record = running(**PLAIN)
        record.become_gaussian()
        before = record.P[0, 0]
        for _ in range(steps):
            status, faults = record.tick(span / steps, temperature=25.0)
        assert faults & ~Fault.UNCERTAIN == Fault.CURRENT_MISSING | Fault.VOLTAGE_MISSING
        assert status is Status.DEGRADED
        offset, gain = 0.1 / 1.96, math.hypot(0.005 / 1.96, 0.05)
        walk = span * (offset / CHARGE) ** 2 * Tuning().current_error_horizon_s
        walk += gain**2 * 0.5 * HELD_A * HELD_S / CHARGE  # of the charge that is counted, over half the capacity
        expected = math.sqrt(before + walk + (CURRENT_RANGE * (span - 5.0) / CHARGE) ** 2)
        assert record.root[0, 0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("steps", [2, 10])
def test_the_rc_voltages_decay_in_a_gap_alike_however_it_is_cut(steps):
    once, often = running(current=4.0), running(current=4.0)
    once.tick(20.0)
    for _ in range(steps):
        often.tick(20.0 / steps)
    assert often.x == pytest.approx(once.x, rel=1e-3)  # the tables are read at another SoC


def test_a_second_gap_starts_from_no_doubt_of_the_first():
    record = running()
    record.tick(100.0)
    assert record["gap_s"] == pytest.approx(95.0)
    record.tick(1.0, 1.0)
    assert record["gap_s"] == 0.0


def test_a_current_that_comes_after_the_voltage_of_its_moment_ends_the_gap_too():
    record = running()
    record.tick(100.0, voltage=predicted(record, *record.x[:1], 0.0))
    record.tick(0.0, 1.0)
    assert record["gap_s"] == 0.0


def test_an_interval_longer_than_the_timeout_of_the_current_is_not_passed_over_in_silence():
    """Its charge is counted in part only, even though the current that closes it is new."""
    record = running(current_timeout_s=5.0)
    assert agree(record, dt=5.0) == (Status.OK, Fault.NONE)
    assert agree(record, dt=6.0) == (Status.DEGRADED, Fault.CURRENT_MISSING)


@pytest.mark.parametrize(
    ("present", "after_s", "fault"),
    [
        ({"current": 1.0, "temperature": 25.0}, 5.0, Fault.VOLTAGE_MISSING),
        ({"current": 1.0, "voltage": 3.4}, 60.0, Fault.TEMPERATURE_MISSING),
        ({"voltage": 3.4, "temperature": 25.0}, 5.0, Fault.CURRENT_MISSING),
    ],
    ids=["voltage", "temperature", "current"],
)
def test_an_input_is_missing_once_it_is_older_than_its_timeout(present, after_s, fault):
    record = running()
    flagged = [bool(record.tick(1.0, **present)[1] & fault) for _ in range(70)]
    assert flagged == [k + 1 > after_s for k in range(70)]
    status, faults = agree(record)
    assert not faults & fault
    assert status is not Status.INVALID


def test_a_gap_without_end_leaves_no_soc_out_is_invalid_and_comes_back():
    record = running(soc=0.05, current=0.0)
    statuses = [record.tick(100.0)[0] for _ in range(30)]
    assert statuses[0] is Status.DEGRADED
    assert statuses[-1] is Status.INVALID
    assert record["soc_high"] - record["soc_low"] > 0.9
    assert record["soc_sigma"] < 0.3  # a uniform distribution over 0..1 has 0.289
    for _ in range(60):
        status, _ = agree(record, 0.0)
    assert status is Status.OK
    assert record.root[0, 0] < 0.05


def test_soc_is_not_clamped_inside_and_beyond_the_table_is_said():
    record = running(soc=0.02)
    faults = Fault.NONE
    while record.x[0] > -0.05:
        assert bool(faults & Fault.OUT_OF_TABLE) == (record.x[0] < -0.02)
        _, faults = record.tick(1.0, 10.0, NAN, 25.0)
    assert faults & Fault.OUT_OF_TABLE


@pytest.mark.parametrize("temperature", [-20.0, 60.0])
def test_a_temperature_beyond_the_cell_files_range_is_used_and_said(temperature):
    record = running()
    _, faults = record.tick(1.0, 1.0, NAN, temperature)
    assert faults == Fault.OUT_OF_TABLE
    assert record["temperature"] == temperature


@pytest.mark.parametrize("gaussian", [False, True])
def test_two_samples_of_one_moment_move_no_time(gaussian):
    record = running()
    if gaussian:
        record.become_gaussian()
    before = record.belief
    status, _ = record.tick(0.0, 5.0)
    assert status is Status.OK
    assert record.belief == before
    assert record["current"] == 5.0


@pytest.mark.parametrize("voltage", [NAN, 3.5], ids=["no voltage", "voltage"])
def test_a_step_that_overflows_is_refused_whole_and_the_next_one_works(voltage):
    record = running()
    before = record.belief
    status, faults = record.tick(math.inf, 1.0, voltage, 25.0)
    assert faults & Fault.NUMERIC
    assert status is Status.DEGRADED
    assert record.belief == before
    assert agree(record) == (Status.OK, Fault.NONE)


def test_model_error_of_the_rc_voltages_is_the_same_at_any_sample_rate():
    variances = []
    for rate_hz in (0.5, 10.0):
        record = Record(CELL, Tuning(initial_soc=0.6, **PLAIN))
        record.tick(0.0, 2.0, 3.5, 25.0)
        for _ in range(int(1000 * rate_hz)):
            record.tick(1 / rate_hz, 2.0, NAN, 25.0)
        variances.append(np.diag(record.P))
    assert variances[0] == pytest.approx(variances[1], rel=2e-3)


def test_components_that_are_not_finite_give_way_to_the_cells_own_gaussian():
    record = running()
    assert record["parts"] == 1.0
    record.state[record.form.size :] = NAN
    assert agree(record) == (Status.OK, Fault.NONE)
    assert np.isfinite(record.state[record.form.size :]).any()
    assert abs(record.x[0] - record.truth[0]) < 2 * record.root[0, 0]


@pytest.mark.parametrize(("soc", "current", "edge"), [(0.01, 10.0, 0.0), (0.99, -5.0, 1.0)])
def test_components_beyond_an_end_of_soc_publish_that_end_and_are_never_sure_to_the_digit(soc, current, edge):
    record = Record(CELL, Tuning(initial_soc=soc, initial_soc_sigma=0.01))
    record.tick(0.0, 0.0, record.ocv(soc, 25.0), 25.0)
    for _ in range(150):  # as long as some mass is within 0..1, it is what is published
        record.tick(4.0, current, NAN, 25.0)
    assert record["parts"] == 1.0
    assert record["soc"] == pytest.approx(edge, abs=1e-3)
    assert record["soc_low"] <= record["soc"] <= record["soc_high"]
    assert record["soc_sigma"] >= 0.99e-4


def test_a_voltage_that_repeats_counts_the_same_if_the_current_of_its_instant_came_before():
    """As it does on a bus: a sample of the current moves the time, one of the voltage does not."""
    shares = []
    for apart in (False, True):
        record = Record(CELL)
        for _ in range(30):
            if apart:
                record.tick(1.0, 1.0, NAN, 25.0)
                record.tick(0.0, NAN, 3.5, NAN)
            else:
                record.tick(1.0, 1.0, 3.5, 25.0)
        shares.append(record["repeats"])
    assert shares[0] > 0.3
    assert shares[1] == pytest.approx(shares[0], rel=1e-9)
