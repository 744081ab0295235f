"""What is stored of a belief is taken up after a restart, aged; what is not fit for it is refused by name."""

from __future__ import annotations

import logging
import re
import time
from dataclasses import replace

import numpy as np
import pytest
from drives import CELL

from bms_ukf import Estimator, Sample, Status, Tuning, slots
from bms_ukf import state as state_module
from bms_ukf.pack import Health
from bms_ukf.records import Stored
from bms_ukf.scaling import scaled
from bms_ukf.slots import Slot
from bms_ukf.state import Keeper, content, resume

NOW_NS = 1_800_000_000 * 10**9
HOUR_NS = 3600 * 10**9
MAX_AGE_S = 30 * 86400.0


def driven(cells: int = 1) -> Estimator:
    estimator = Estimator(CELL, cells)
    voltage = 3.6 if cells == 1 else np.full(cells, 3.6)
    for k in range(300):
        estimator.step(Sample(k * 10**9, 1.0, voltage, 25.0))
    return estimator


@pytest.fixture
def stored(tmp_path):
    """A file with what was known an hour ago."""
    path = tmp_path / "state"
    slots.write(path, Slot(NOW_NS - HOUR_NS, driven().snapshot()))
    return path


def taken_up(estimator: Estimator, path, now_ns: int = NOW_NS) -> Stored:
    stored, line = resume(estimator, path, now_ns, 7, MAX_AGE_S)
    assert str(path) in line
    return stored


def refused(path, now_ns: int = NOW_NS, estimator: Estimator | None = None) -> Stored:
    """What is said, having checked that the estimator knows nothing of it."""
    estimator = estimator or Estimator(CELL)
    stored = taken_up(estimator, path, now_ns)
    assert estimator.coast(10**9).status is Status.INITIALISING
    return stored


def spread(estimator: Estimator) -> float:
    """One sigma of SoC by the covariance, whatever the shape of the belief."""
    return float(estimator._state[0, estimator._form.root, 0])


def test_a_belief_comes_back_as_it_was_but_for_what_the_time_off_did(stored):
    """The sum of components comes back as one Gaussian of its mean and covariance: bounds move by the shape alone."""
    estimator, before = Estimator(CELL), driven()
    known = before.coast(300 * 10**9)
    assert taken_up(estimator, stored) is Stored.USED
    now = estimator.coast(10**9)
    assert estimator.t_ns == 10**9
    assert now.status is Status.DEGRADED, "nothing has been measured yet"
    assert now.soc == pytest.approx(known.soc, abs=2e-3)
    assert spread(estimator) >= spread(before)
    assert now.soc_sigma == pytest.approx(known.soc_sigma, rel=0.1)
    assert now.age_s > 3600


def test_the_doubt_is_that_of_the_time_off(stored):
    variances = []
    for days in (0, 1, 10):
        estimator = Estimator(CELL)
        assert taken_up(estimator, stored, NOW_NS - HOUR_NS + days * 24 * HOUR_NS) is Stored.USED
        variances.append(estimator.coast(10**9).soc_sigma ** 2)
    grown = variances[1] - variances[0]
    assert grown > 0.01**2
    assert variances[2] - variances[0] > 25 * grown


def test_without_a_file_it_is_the_first_start(tmp_path):
    assert refused(tmp_path / "none") is Stored.NONE


def test_a_clock_set_back_is_no_reason_to_believe_a_state_of_the_future(stored):
    assert refused(stored, NOW_NS - 2 * HOUR_NS) is Stored.FUTURE


def test_a_state_too_old_is_refused(stored):
    assert refused(stored, NOW_NS + round(MAX_AGE_S * 1e9)) is Stored.STALE


@pytest.mark.parametrize(
    "other",
    [
        lambda: Estimator(scaled(CELL, 2.0)),
        lambda: Estimator(CELL, cells=2),
        lambda: Estimator(CELL, tuning=Tuning(voltage_noise_V=0.005)),
    ],
)
def test_the_state_of_another_cell_tuning_or_pack_is_refused(stored, other):
    assert refused(stored, estimator=other()) is Stored.FOREIGN


def test_a_damaged_state_is_refused_and_half_a_damage_is_not_the_end(stored):
    data = stored.read_bytes()
    stored.write_bytes(data[:100] + bytes([data[100] ^ 1]) + data[101:])
    assert refused(stored) is Stored.CORRUPT
    stored.write_bytes(data[:100] + bytes([data[100] ^ 1]) + data[101:] + data)
    assert taken_up(Estimator(CELL), stored) is Stored.USED


def test_content_that_is_whole_and_no_belief_is_refused(stored):
    slots.write(stored, Slot(NOW_NS, b"anything"))
    assert refused(stored) is Stored.FOREIGN


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "state").mkdir()
    assert refused(tmp_path / "state") is Stored.UNREADABLE


def test_the_keeper_writes_the_newest_and_keeps_the_one_before(tmp_path):
    path = tmp_path / "state"
    slots.write(path, Slot(1, b"before"))
    keeper = Keeper(path)
    keeper.keep(b"now", 2)
    assert keeper.close()
    assert slots.read(path) == [Slot(2, b"now"), Slot(1, b"before")]


def test_a_medium_that_is_slow_or_full_holds_nobody_up(tmp_path, monkeypatch, caplog):
    attempts = []

    def slow_and_full(*_: object) -> None:
        attempts.append(1)
        time.sleep(0.1)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(state_module.slots, "write", slow_and_full)
    keeper = Keeper(tmp_path / "state")
    began_s = time.monotonic()
    with caplog.at_level(logging.WARNING):
        for k in range(1000):
            keeper.keep(b"x", k)
        assert time.monotonic() - began_s < 0.1
        assert keeper.close()
    assert 1 <= len(attempts) < 5
    assert len(caplog.messages) == 1
    assert "No space left on device" in caplog.messages[0]


def test_balancing_is_not_taken_to_go_on_after_a_restart(tmp_path):
    path, pack = tmp_path / "state", driven(cells=2)
    pack.bleed_A = [0.1, 0.0]
    slots.write(path, Slot(NOW_NS, pack.snapshot()))
    back = Estimator(CELL, 2)
    assert taken_up(back, path) is Stored.USED
    assert np.isnan(back.bleed_A).all()


def test_a_pack_is_stored_whole(tmp_path):
    path, pack = tmp_path / "state", driven(cells=20)
    slots.write(path, Slot(NOW_NS, pack.snapshot()))
    back = Estimator(CELL, 20)
    assert taken_up(back, path) is Stored.USED
    known, now = replace(pack.coast(300 * 10**9)), back.coast(10**9)
    np.testing.assert_allclose(now.soc, known.soc, atol=2e-3)


def aged(estimator: Estimator) -> Health:
    """Of a cell that has lost a tenth."""
    health = Health(estimator)
    health.capacity = estimator.capacity_scale = np.full(estimator.cells, 0.9)
    health.segments[:] = 4
    return health


@pytest.fixture
def stored_aged(tmp_path):
    path, estimator = tmp_path / "state", driven()
    slots.write(path, Slot(NOW_NS - HOUR_NS, content(estimator, aged(estimator))))
    return path


def test_health_outlives_the_process_and_agrees_with_the_belief(stored_aged):
    back = Health(Estimator(CELL))
    stored, _ = resume(back.estimator, stored_aged, NOW_NS, 7, MAX_AGE_S, back)
    assert stored is Stored.USED
    assert back.told_capacity[0] == pytest.approx(0.9)
    assert back.estimator.capacity_scale[0] == pytest.approx(0.9)
    assert back.estimator.coast(10**9).status is Status.DEGRADED


def test_a_state_of_before_there_was_health_is_taken_up_for_its_belief(stored, caplog):
    back = Health(Estimator(CELL))
    told, _ = resume(back.estimator, stored, NOW_NS, 7, MAX_AGE_S, back)
    assert told is Stored.USED
    assert np.isnan(back.told_capacity[0])
    assert caplog.messages == []


@pytest.mark.parametrize("spoil", [lambda data: data[:-8], lambda data: data[:-1] + b"\x55", lambda data: data + b"X"])
def test_a_health_that_is_damaged_costs_a_line_and_not_the_belief(tmp_path, caplog, spoil):
    path, estimator = tmp_path / "state", driven()
    slots.write(path, Slot(NOW_NS - HOUR_NS, spoil(content(estimator, aged(estimator)))))
    back = Health(Estimator(CELL))
    told, _ = resume(back.estimator, path, NOW_NS, 7, MAX_AGE_S, back)
    assert told is Stored.USED
    (line,) = caplog.messages
    assert "the health stored is not used" in line
    assert np.isnan(back.told_capacity[0])
    assert back.capacity[0] == back.estimator.capacity_scale[0] == pytest.approx(0.9), "that of the belief"


def test_what_months_have_told_does_not_go_stale_with_the_belief(stored_aged):
    """Nor is it lost with a tuning that makes the belief another's."""
    for estimator, now_ns, said in (
        (Estimator(CELL), NOW_NS + 40 * 24 * HOUR_NS, Stored.STALE),
        (Estimator(CELL, tuning=Tuning(gate_sigmas=4.0)), NOW_NS, Stored.FOREIGN),
    ):
        back = Health(estimator)
        told, _ = resume(estimator, stored_aged, now_ns, 7, MAX_AGE_S, back)
        assert told is said
        assert back.told_capacity[0] == pytest.approx(0.9)
        estimator.step(Sample(10**9, 0.0, 3.6, 25.0))
        assert estimator.capacity_scale[0] == pytest.approx(0.9), "by which SoC is counted from the first voltage on"


def test_health_of_another_cell_is_refused(stored_aged, caplog):
    for other in (Estimator(scaled(CELL, 2.0)), Estimator(CELL, 2)):
        back = Health(other)
        told, _ = resume(other, stored_aged, NOW_NS, 7, MAX_AGE_S, back)
        assert told is Stored.FOREIGN
        assert np.isnan(back.told_capacity).all()
        assert "or of another cell file" in caplog.messages[-1]


def test_a_belief_of_the_version_before_is_refused_by_name_and_the_health_beside_it_is_kept(stored_aged):
    slot = slots.read(stored_aged)[0]
    magic = re.compile(rb"BMSUKF(\d\d)")
    (version,) = (int(number) for number in magic.findall(slot.content))
    older = slot.content.replace(b"BMSUKF%02d" % version, b"BMSUKF%02d" % (version - 1))
    slots.write(stored_aged, slot._replace(content=older), None)
    estimator = Estimator(CELL)
    back = Health(estimator)
    told, line = resume(estimator, stored_aged, NOW_NS, 7, MAX_AGE_S, back)
    assert told is Stored.FOREIGN
    assert f"a snapshot of another version (BMSUKF{version - 1:02d}, not BMSUKF{version:02d})" in line
    assert back.told_capacity[0] == pytest.approx(0.9)
