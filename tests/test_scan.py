"""Pages of a scan are one sample; it ends when every cell has been read, and a silent one does not hold it up."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bms_ukf.records import Sample
from bms_ukf.scan import TOGETHER_NS, Scan

MS = 1_000_000


class Follower:
    """What a scan of six cells made of the samples: steps as (time, cells read), and the times of its ends."""

    def __init__(self, cells: int = 6) -> None:
        self.steps: list[tuple[int, list[int]]] = []
        self.ends: list[int] = []
        self.samples: list[Sample] = []
        self.scan = Scan(cells, self._step, self.ends.append)

    def _step(self, sample: Sample) -> None:
        voltage = np.atleast_1d(sample.voltage_V)
        self.steps.append((sample.t_ns, np.flatnonzero(~np.isnan(voltage)).tolist()))
        self.samples.append(sample)


def page(t_ns: int, *cells: int, **others: float) -> Sample:
    voltage = np.full(6, math.nan)
    voltage[list(cells)] = [3.0 + cell for cell in cells]
    return Sample(t_ns, voltage_V=voltage, **others)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("pages", "ends"),
    [
        ([(0, 1, 2), (3, 4, 5)] * 2, [1, 3]),
        ([(3, 4, 5), (0, 1, 2)] * 2, [1, 3]),  # whichever page comes last
        ([(0, 1, 2), (3, 4)] * 3, [2, 4]),  # the last cell is dead
        ([(1, 2), (3, 4, 5)] * 3, [2, 4]),  # the first one is
        ([(0, 1, 2), (0, 1, 2), (3, 4, 5)], [1, 2]),  # a page was lost
        ([(), (0,), ()], []),
    ],
)
def test_the_end_of_a_scan(pages: list[tuple[int, ...]], ends: list[int]) -> None:
    follower = Follower()
    for t, cells in enumerate(pages):
        follower.scan.take(page(t, *cells))
    assert follower.ends == ends


def test_the_pages_of_a_scan_are_one_sample_at_the_time_of_the_last() -> None:
    follower = Follower()
    follower.scan.take(page(1 * MS, 0, 1, 2))
    assert follower.steps == []
    follower.scan.take(page(2 * MS, 3, 4, 5))
    assert follower.steps == [(2 * MS, [0, 1, 2, 3, 4, 5])]
    assert np.array_equal(follower.samples[0].voltage_V, [3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
    assert follower.ends == [2 * MS]


def test_a_page_is_copied_as_its_decoder_overwrites_it() -> None:
    follower = Follower()
    reused = page(0, 0, 1, 2)
    follower.scan.take(reused)
    reused.voltage_V[:] = math.nan  # type: ignore[index]
    follower.scan.take(page(1, 3, 4, 5))
    assert follower.steps == [(1, [0, 1, 2, 3, 4, 5])]


def test_a_current_between_two_pages_flows_after_the_first_and_before_the_second() -> None:
    follower = Follower()
    follower.scan.take(page(1, 0, 1, 2))
    follower.scan.take(Sample(2, 5.0))
    follower.scan.take(page(3, 3, 4, 5))
    assert follower.steps == [(1, [0, 1, 2]), (2, []), (3, [3, 4, 5])]
    assert follower.ends == [3]


@pytest.mark.parametrize("other", [{"current_A": 1.0}, {"temperature_degC": 25.0}])
def test_a_frame_with_more_than_voltages_is_a_sample_of_its_own(other: dict[str, float]) -> None:
    follower = Follower()
    follower.scan.take(page(1, 0, 1, 2))
    follower.scan.take(page(2, 3, **other))
    assert follower.steps == [(1, [0, 1, 2]), (2, [3])]


def test_pages_that_are_far_apart_are_not_of_one_instant() -> None:
    follower = Follower()
    for k in range(3):
        follower.scan.take(page(k * 15 * MS, 2 * k, 2 * k + 1))
    assert follower.steps == [(15 * MS, [0, 1, 2, 3]), (30 * MS, [4, 5])]


def test_a_page_is_not_held_for_longer_though_nothing_follows_it() -> None:
    follower = Follower()
    follower.scan.take(page(5, 0))
    follower.scan.due(5 + TOGETHER_NS - 1)
    assert follower.steps == []
    assert follower.scan.held_ns == 5
    follower.scan.due(5 + TOGETHER_NS)
    assert follower.steps == [(5, [0])]
    assert follower.scan.held_ns is None


def test_a_page_that_is_older_than_the_one_before_keeps_its_time() -> None:
    follower = Follower()
    follower.scan.take(page(9, 0))
    follower.scan.take(page(4, 1))
    follower.scan.flush()
    assert follower.steps == [(9, [0]), (4, [1])]


def test_pages_before_and_after_the_contactors_open_are_not_mixed() -> None:
    follower = Follower()
    follower.scan.take(page(1, 0))
    follower.scan.take(page(2, 1, open_circuit=True))
    follower.scan.flush()
    assert [sample.open_circuit for sample in follower.samples] == [False, True]


def test_what_is_bled_is_that_of_the_last_page() -> None:
    follower = Follower()
    for t in range(2):
        sample = page(t, t)
        sample.bleed_A = np.full(6, 0.1 * t)
        follower.scan.take(sample)
    follower.scan.flush()
    assert np.array_equal(follower.samples[0].bleed_A, np.full(6, 0.1))  # type: ignore[arg-type]


def test_every_voltage_of_a_single_cell_is_a_scan() -> None:
    follower = Follower(cells=1)
    for t, voltage in enumerate((3.7, math.nan, 3.7)):
        follower.scan.take(Sample(t, voltage_V=voltage))
    assert follower.ends == [0, 2]
    assert [t for t, _ in follower.steps] == [0, 1, 2]
