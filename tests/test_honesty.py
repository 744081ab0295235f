"""The judge of intervals: inside, beyond three sigmas, and what a truth out of range is compared as."""

import numpy as np
import pytest

from bms_ukf import honesty


def of(*values):
    return np.array(values, dtype=float)


def test_bounds_are_1_96_sigmas_apart_from_the_mean_and_end_at_0_and_1():
    low, high = honesty.bounds(of(0.5, 0.01, 0.99), of(0.1, 0.1, 0.1))
    assert low == pytest.approx([0.304, 0.0, 0.794])
    assert high == pytest.approx([0.696, 0.206, 1.0])


def test_a_truth_on_a_bound_is_inside_and_one_behind_it_is_not():
    low, high = of(0.4, 0.4, 0.4, 0.4), of(0.6, 0.6, 0.6, 0.6)
    assert honesty.inside(low, high, of(0.4, 0.6, 0.399, 0.601)).tolist() == [True, True, False, False]


def test_beyond_begins_0_53_half_widths_behind_the_nearer_bound():
    low, high = of(0.4, 0.4, 0.4), of(0.6, 0.6, 0.6)
    assert honesty.beyond(low, high, of(0.652, 0.654, 0.346)).tolist() == [False, True, True]


def test_a_wrong_interval_without_width_is_beyond():
    assert honesty.beyond(of(0.5), of(0.5), of(0.51)).all()
    assert not honesty.beyond(of(0.5), of(0.5), of(0.5)).any()


def test_a_truth_out_of_range_is_compared_as_the_end_of_the_range():
    assert honesty.inside(of(0.0, 0.9), of(0.1, 1.0), of(-0.05, 1.05)).all()


def test_the_doubt_of_the_reference_widens_the_interval():
    low, high, truth = of(0.4), of(0.6), of(0.615)
    assert not honesty.inside(low, high, truth)
    assert honesty.inside(low, high, truth, ref_sigma=0.01)
    assert not honesty.beyond(low, high, of(0.682), ref_sigma=0.01)
    assert honesty.beyond(low, high, of(0.684), ref_sigma=0.01)


def test_a_row_without_a_soc_is_neither_inside_nor_beyond():
    assert not honesty.inside(of(np.nan), of(np.nan), of(0.5)).any()
    assert not honesty.beyond(of(np.nan), of(np.nan), of(0.5)).any()
