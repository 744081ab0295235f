"""The expectations `coverage` and `never_valid_and_wrong` of a scenario, held against the published interval."""

import numpy as np
import pytest

from bms_ukf import Estimate, Sample, Status
from bms_ukf.expectations.record import Record
from bms_ukf.expectations.soc import Coverage, NeverValidAndWrong
from bms_ukf.plant import PlantState

SECOND_NS = 1_000_000_000


def record_of(errors, sigma=0.01, status=Status.OK):
    """A run of a row a second with these errors of SoC; NaN: no SoC is published."""
    record = Record([])
    for k, error in enumerate(errors, start=1):
        low, high = (0.5 + error + side * 1.96 * sigma for side in (-1, 1))
        answer = Estimate(k * SECOND_NS, 0.5 + error, sigma, status=status, soc_low=low, soc_high=high)
        true = PlantState(k * SECOND_NS, 3.7, 25.0, 0.5)
        record.append(Sample(k * SECOND_NS, 0.0, 3.7, 25.0), answer, true)
    return record


def coverage(at_least):
    return Coverage(kind="coverage", at_least=at_least)


def never_wrong(**keys):
    return NeverValidAndWrong(kind="never_valid_and_wrong", **keys)


def test_coverage_counts_rows_whose_interval_holds_the_truth():
    record = record_of([0.0, 0.019, 0.021, np.nan])  # half of the interval is 0.0196
    assert coverage(0.66).judge(record) == (True, "66.7 %")
    assert not coverage(0.67).judge(record)[0]


def test_coverage_without_a_soc_fails():
    assert coverage(0.1).judge(record_of([np.nan, np.nan])) == (False, "no SoC")


@pytest.mark.parametrize(("error", "passed"), [(0.0299, True), (0.0301, False), (-0.0301, False)])
def test_an_ok_row_is_wrong_beyond_three_sigmas_if_no_error_is_given(error, passed):
    assert never_wrong().judge(record_of([0.0, error]))[0] is passed


def test_an_ok_row_is_wrong_above_the_error_that_is_given_whatever_its_interval():
    assert not never_wrong(above=0.02).judge(record_of([0.025], sigma=0.1))[0]
    assert never_wrong(above=0.03).judge(record_of([0.025], sigma=0.001))[0]


def test_a_wrong_row_that_is_not_ok_is_no_lie():
    assert never_wrong().judge(record_of([0.2], status=Status.DEGRADED)) == (True, "none in 0")


def test_the_words_say_what_is_judged():
    assert "beyond three sigmas" in never_wrong().wanted()
    assert "above 3.00 %" in never_wrong(above=0.03).wanted()
