"""`Estimator`: time, publication, packs, snapshots. What a step does to the belief is in `test_step`."""

from __future__ import annotations

import dataclasses
import math
import sys

import numpy as np
import pytest
import synthetic_cell
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.runtime import _nrt_python, rtsys

from bms_ukf import Estimate, Estimator, Fault, Sample, Status, Tuning, shown
from bms_ukf.kernel import layout

CELL = synthetic_cell.cell_of(synthetic_cell.nonlinear())
SECOND = 10**9
NAN = math.nan
NEVER = 1 << 62  # how often the cells agree on the offset of their sensor: each is for itself
PER_CELL = (
    "soc",
    "soc_sigma",
    "voltage_pred_V",
    "innovation_V",
    "innovation_var_V2",
    "nis",
    "age_s",
    "current_bias_A",
    "r0_ohm",
    "soc_low",
    "soc_high",
)


def drive(steps: int, cells: int = 1, seed: int = 0, step_ns: int = SECOND) -> list[Sample]:
    """Noisy samples whose voltages a cell near 60 % could show; arrays for a pack."""
    rng = np.random.default_rng(seed)
    samples = []
    for k in range(steps):
        current = float(1.5 + 2 * rng.standard_normal())
        voltages = 3.45 - 0.03 * current - 1e-5 * k + 0.01 * rng.standard_normal(cells)
        temperatures = 20 + 0.01 * k + rng.standard_normal(cells)
        if cells == 1:
            samples.append(Sample(k * step_ns, current, float(voltages[0]), float(temperatures[0])))
        else:
            samples.append(Sample(k * step_ns, current, voltages, temperatures))
    return samples


def started(**tuning: object) -> Estimator:
    estimator = Estimator(CELL, tuning=Tuning(initial_soc=0.6, initial_soc_sigma=0.02, **tuning))
    for sample in drive(10):
        estimator.step(sample)
    return estimator


def values(estimate: Estimate) -> list[bytes]:
    """All fields, comparable bit for bit: NaN equals itself."""
    return [np.asarray(value).tobytes() for value in dataclasses.astuple(estimate)]


def alike(one: Estimate, other: Estimate) -> None:
    """All fields, to rounding: the mean SoC to come and the SoC that came are sums of another order with a bias."""
    for name, value in dataclasses.asdict(one).items():
        np.testing.assert_allclose(value, getattr(other, name), rtol=1e-9, atol=1e-13, err_msg=name)


@pytest.mark.parametrize("voltage_last", [True, False])
def test_a_sample_in_parts_of_one_time_gives_the_estimate_of_the_whole_if_the_current_comes_first(voltage_last):
    """The current closes the interval that ends then; whichever part comes first moves the belief across it."""
    whole, parts = Estimator(CELL), Estimator(CELL)
    for sample in drive(50):
        sample.temperature_degC = 20.0
        expected = whole.step(sample)
        parts.step(Sample(sample.t_ns, current_A=sample.current_A))
        if voltage_last or sample.t_ns == 0:  # the first time of all ends with the voltage: it is not held
            parts.step(Sample(sample.t_ns, temperature_degC=sample.temperature_degC))
            got = parts.step(Sample(sample.t_ns, voltage_V=sample.voltage_V))
        else:
            between = parts.step(Sample(sample.t_ns, voltage_V=sample.voltage_V))
            alike(between, expected)
            got = parts.step(Sample(sample.t_ns, temperature_degC=sample.temperature_degC))
        assert (got.status, got.faults) == (expected.status, expected.faults)
        assert [got.soc, got.soc_sigma, got.current_bias_A] == pytest.approx(
            [expected.soc, expected.soc_sigma, expected.current_bias_A], rel=1e-9, abs=1e-15
        )
        for slot in (layout.H_REPEATS, layout.H_POLARISED, layout.H_VOLTAGE_SCALE, layout.H_STILL_S):
            assert parts._state[0, slot, 0] == pytest.approx(whole._state[0, slot, 0], rel=1e-9), slot


def test_a_sample_from_the_past_is_refused_whole():
    estimator = started()
    before, accepted = estimator.snapshot(), estimator.accepted
    estimate = estimator.step(Sample(3 * SECOND, 9.0, 3.0, 40.0))
    assert estimate.faults & Fault.TIME_REVERSED
    assert estimate.status is Status.DEGRADED
    assert estimate.t_ns == 9 * SECOND
    assert estimator.snapshot() == before
    assert estimator.accepted == accepted
    assert not estimator.step(Sample(10 * SECOND, 1.0, 3.4, 25.0)).faults & ~Fault.UNCERTAIN


def test_dt_is_the_difference_of_the_times_wherever_they_start():
    """Any clock: seconds since boot, since 1970, or since an event that is still to come."""
    estimates = []
    for origin in (0, 1_790_000_000 * SECOND, -5 * SECOND):
        estimator = Estimator(CELL)
        for sample in drive(20):
            sample.t_ns += origin
            estimate = estimator.step(sample)
        assert estimate.t_ns == origin + 19 * SECOND
        estimates.append(values(dataclasses.replace(estimate, t_ns=0)))
    assert estimates[0] == estimates[1] == estimates[2]


def test_nothing_is_published_until_initialised_and_what_is_invalid_is_not():
    estimator = Estimator(CELL, tuning=Tuning(invalid_half_width=0.1))
    first = estimator.step(Sample(0, 1.0))
    assert first.status is Status.INITIALISING
    assert math.isnan(first.soc)
    assert math.isnan(first.soc_sigma)
    assert math.isnan(first.age_s)
    wide = estimator.step(Sample(1, 1.0, 3.42, 25.0))  # on the flat part, where a voltage says little
    assert wide.status is Status.INVALID
    assert math.isnan(wide.soc)
    assert math.isnan(wide.soc_sigma)
    assert math.isnan(wide.soc_low)
    assert math.isnan(wide.soc_high)
    for k in range(600):
        narrow = estimator.step(Sample(k * SECOND, 1.0, 3.01, 25.0))
    assert narrow.status is Status.OK
    assert 0 <= narrow.soc <= 1
    assert 0 < narrow.soc_sigma <= 0.05
    assert 0 <= narrow.soc_low < narrow.soc < narrow.soc_high <= 1


@pytest.mark.parametrize(("start", "current", "published"), [(0.01, 10.0, 0.0), (0.99, -5.0, 1.0)])
def test_soc_is_truncated_for_publication_only(start, current, published):
    estimator = Estimator(CELL, tuning=Tuning(initial_soc=start, initial_soc_sigma=0.01))
    ocv = float(CELL.ocv_V(start, 25.0))
    estimator.step(Sample(0, 0.0, ocv, 25.0))
    estimator._state[0, layout.H_PARTS, 0] = 0  # components would find the 5 % that SoC was another all along
    for k in range(1, 200):
        estimate = estimator.step(Sample(k * SECOND, current, NAN, 25.0))
    assert abs(estimate.soc - published) < estimate.soc_high - estimate.soc_low < 0.02
    inside = estimator._state[0, estimator._form.x, 0]
    assert abs(inside - published) > 0.01
    for k in range(200, 300):  # were it clamped inside, this charge would move it off the edge
        estimate = estimator.step(Sample(k * SECOND, -0.1 * current, NAN, 25.0))
    assert abs(estimate.soc - published) < estimate.soc_high - estimate.soc_low < 0.02


def test_an_estimate_says_why():
    estimator = started()
    estimate = estimator.step(Sample(10 * SECOND, 1.5, 3.42, 25.0))
    assert estimate.innovation_V == 3.42 - estimate.voltage_pred_V
    assert estimate.nis == pytest.approx(estimate.innovation_V**2 / estimate.innovation_var_V2)
    assert estimate.age_s == 0.0
    estimate = estimator.step(Sample(12 * SECOND, 1.5, NAN, 25.0))
    assert math.isnan(estimate.innovation_V)
    assert math.isnan(estimate.nis)
    assert estimate.age_s == 2.0


def test_only_samples_that_were_not_refused_count_as_accepted():
    estimator = started()
    accepted = estimator.accepted
    estimator.coast(20 * SECOND)
    estimator.step(Sample(SECOND, 1.0))
    assert estimator.accepted == accepted
    estimator.step(Sample(21 * SECOND, 1.0))
    assert estimator.accepted == accepted + 1


def test_coasting_is_a_step_with_nothing_measured():
    coasting, stepping = started(), started()
    assert values(coasting.coast(30 * SECOND)) == values(stepping.step(Sample(30 * SECOND)))


def test_reset_forgets_everything():
    estimator, new = started(), Estimator(CELL, tuning=Tuning(initial_soc=0.6, initial_soc_sigma=0.02))
    estimator.reset()
    assert estimator.snapshot() == new.snapshot()


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 40), st.integers(0, 2**32 - 1), st.sampled_from([1, 3]))
def test_a_restored_run_goes_on_bit_for_bit(cut, seed, cells):
    samples = drive(60, cells, seed)
    uninterrupted, other = Estimator(CELL, cells), Estimator(CELL, cells)
    for sample in samples[:cut]:
        uninterrupted.step(sample)
    snapshot = uninterrupted.snapshot()
    for sample in samples[:7]:
        other.step(sample)
    other.restore(snapshot)
    for sample in samples[cut:]:
        assert values(other.step(sample)) == values(uninterrupted.step(sample))
    assert other.snapshot() == uninterrupted.snapshot()
    assert other.accepted == 60


def test_a_snapshot_keeps_a_time_before_zero():
    estimator, other = Estimator(CELL), Estimator(CELL)
    estimator.step(Sample(-5 * SECOND, 1.0, 3.4, 25.0))
    other.restore(estimator.snapshot())
    assert other.t_ns == -5 * SECOND


def test_a_foreign_or_damaged_snapshot_is_refused_and_changes_nothing():
    estimator = started()
    snapshot = estimator.snapshot()
    foreign = {
        "another tuning": Estimator(CELL, tuning=Tuning(alpha=0.5)).snapshot(),
        "another cell": Estimator(synthetic_cell.cell_of(synthetic_cell.linear()), tuning=estimator.tuning).snapshot(),
        "a pack": Estimator(CELL, 2, estimator.tuning).snapshot(),
        "nothing": b"",
        "cut short": snapshot[:-1],
        "too long": snapshot + b"\0",
    }
    for position in range(0, len(snapshot), 7):
        damaged = bytearray(snapshot)
        damaged[position] ^= 0x40
        foreign[f"byte {position} damaged"] = bytes(damaged)
    taken = [name for name, bad in foreign.items() if not refuses(estimator, bad)]
    assert estimator.snapshot() == snapshot
    assert not taken


def refuses(estimator: Estimator, snapshot: bytes) -> bool:
    """Whether it is refused with one line and without a trace; if it is not, what was before is put back."""
    before = estimator.snapshot()
    try:
        estimator.restore(snapshot)
    except ValueError as error:
        return "\n" not in str(error) and estimator.snapshot() == before
    estimator.restore(before)
    return False


@pytest.mark.parametrize("cells", [2, 3, 17])
def test_a_pack_is_that_many_single_estimators_but_for_the_order_of_rounding(cells):
    pack = Estimator(CELL, cells)
    pack._share_ns = NEVER
    singles = [Estimator(CELL) for _ in range(cells)]
    rng = np.random.default_rng(5)
    for sample in drive(80, cells):
        if sample.t_ns > 0:
            sample.voltage_V[rng.random(cells) < 0.3] = NAN
            sample.temperature_degC[rng.random(cells) < 0.3] = NAN
        of_pack = pack.step(sample)
        of_singles = [
            single.step(
                Sample(sample.t_ns, sample.current_A, float(sample.voltage_V[k]), float(sample.temperature_degC[k]))
            )
            for k, single in enumerate(singles)
        ]
        for name in PER_CELL:
            expected = np.array([getattr(estimate, name) for estimate in of_singles])
            np.testing.assert_allclose(getattr(of_pack, name), expected, rtol=1e-9, atol=1e-13, err_msg=name)
        assert of_pack.status == max(estimate.status for estimate in of_singles)
        faults = Fault.NONE
        for estimate in of_singles:
            faults |= estimate.faults
        assert of_pack.faults == faults


def test_cells_heard_a_few_at_a_time_end_as_each_would_alone():
    """Blocks without news are not stepped within an instant; a refusal there was of the part before, and is over."""
    cells, tuning = 40, Tuning(initial_soc=0.6, initial_soc_sigma=0.05)
    pack, alone = Estimator(CELL, cells, tuning), [Estimator(CELL, tuning=tuning) for _ in range(cells)]
    pack._share_ns = NEVER
    for k, whole in enumerate(drive(8, cells, seed=3)):
        voltage = np.where((np.arange(cells) == 39) & (k == 6), 4.1, whole.voltage_V)
        parts = [Sample(whole.t_ns, whole.current_A, np.full(cells, NAN), 25.0)]
        for first in reversed(range(0, cells, 8)):
            here = np.arange(cells) // 8 == first // 8
            parts.append(Sample(whole.t_ns, NAN, np.where(here, voltage, NAN), NAN))
        for part in parts:
            together = pack.step(part)
            each = [
                one.step(Sample(part.t_ns, part.current_A, float(part.voltage_V[c]), part.temperature_degC))
                for c, one in enumerate(alone)
            ]
            assert list(pack.cell_faults) == [one.faults for one in each]
            assert list(pack.cell_status) == [one.status for one in each]
            for name in PER_CELL if k > 0 else ():  # before, a pack hides what part of it knows
                values = np.array([getattr(one, name) for one in each])
                if name != "r0_ohm" or part is parts[0]:  # later, in a block that is not stepped, as used last
                    np.testing.assert_allclose(getattr(together, name), values, rtol=1e-9, atol=1e-9, err_msg=name)
    assert Fault.INNOVATION_REJECTED not in together.faults


def test_a_pack_takes_one_value_for_all_its_cells():
    pack, same = Estimator(CELL, 3), Estimator(CELL, 3)
    got = pack.step(Sample(0, 1.0, np.full(3, 3.5), 25.0))
    assert values(got) == values(same.step(Sample(0, 1.0, np.full(3, 3.5), np.full(3, 25.0))))
    with pytest.raises(ValueError, match="shape"):
        pack.step(Sample(1, 1.0, np.full(4, 3.5), 25.0))


def test_a_pack_is_initialising_until_each_of_its_cells_has_been_seen():
    pack = Estimator(CELL, 2, Tuning(initial_soc=0.7, initial_soc_sigma=0.02))
    volts = float(CELL.ocv_V(0.7, 25.0))
    assert pack.step(Sample(0, 0.0, np.array([volts, NAN]), 25.0)).status is Status.INITIALISING
    assert pack.step(Sample(1, 0.0, np.array([NAN, volts]), 25.0)).status is Status.OK


def test_no_cells_is_refused():
    with pytest.raises(ValueError, match="at least 1"):
        Estimator(CELL, 0)


@pytest.mark.parametrize("cells", [1, 4])
def test_out_is_filled_and_returned(cells):
    filling, making = Estimator(CELL, cells), Estimator(CELL, cells)
    out = shown.blank(filling.cells)
    for sample in drive(5, cells):
        assert filling.step(sample, out=out) is out
        assert values(out) == values(making.step(sample))


def test_a_step_into_out_leaves_no_object_behind_and_allocates_nothing_in_the_kernel():
    estimator, out = started(), Estimate()
    sample = Sample(100 * SECOND, 1.0, 3.4, 25.0)

    def run(steps: int) -> int:
        for _ in range(steps):
            sample.t_ns += SECOND
            estimator.step(sample, out=out)
        return sys.getallocatedblocks()

    _nrt_python.memsys_enable_stats()
    run(1000)  # caches warm up
    kernel_before = rtsys.get_allocation_stats()
    baseline = run(1000)
    growth = run(1_000_000) - baseline
    assert growth <= 10  # a block a step would be a million; other threads may own a few
    assert rtsys.get_allocation_stats() == kernel_before


def test_a_cell_of_a_pack_is_forgotten_only_by_a_voltage_that_is_refused():
    """Not because another cell of its block needs care while its own voltage fails to come."""
    pack, alone = Estimator(CELL, 2), Estimator(CELL)
    pack._share_ns = NEVER
    ocv, wrong = float(CELL.ocv_V(0.6, 25.0)), float(CELL.ocv_V(0.9, 25.0))
    for k in range(120):
        voltage = ocv if k < 80 else wrong if k < 109 else NAN
        of_pack = pack.step(Sample(k * SECOND, 0.0, np.array([voltage, NAN if k < 111 else ocv]), 25.0))
        estimate = alone.step(Sample(k * SECOND, 0.0, voltage, 25.0))
    assert alone.tuning.reject_s == 30
    assert of_pack.soc[0] == pytest.approx(estimate.soc, abs=1e-12)
    assert of_pack.soc_sigma[0] == pytest.approx(estimate.soc_sigma, abs=1e-12)


@pytest.mark.parametrize("cells", [1, 3])
def test_after_a_restore_a_sample_from_the_past_shows_what_was_restored(cells):
    first, second = Estimator(CELL, cells), Estimator(CELL, cells)
    for sample in drive(20, cells):
        shown = first.step(sample)
    second.restore(first.snapshot())
    again = second.step(Sample(-SECOND, 1.0, 3.6, 25.0))
    assert again.faults & Fault.TIME_REVERSED
    np.testing.assert_array_equal(again.soc, shown.soc)
    np.testing.assert_array_equal(again.soc_sigma, shown.soc_sigma)
