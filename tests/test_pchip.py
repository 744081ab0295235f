"""The project's PCHIP against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from bms_ukf import pchip

MOVES = st.floats(-5, 5).map(lambda move: round(move, 6))  # none so small that scipy's own arithmetic overflows


@given(
    steps=st.lists(st.tuples(st.floats(0.01, 10), MOVES), min_size=1, max_size=30),
    where=st.lists(st.floats(0, 1), min_size=1, max_size=20),
)
def test_curve_and_coefficients_are_scipy_s(steps, where):
    x, y = (np.concatenate([[0.0], np.cumsum(column)]) for column in zip(*steps, strict=True))
    theirs = PchipInterpolator(x, y)
    scale = 1 + np.abs(y).max()
    at = x[0] + np.array(where) * (x[-1] - x[0])
    np.testing.assert_allclose(pchip.interpolate(x, y, at), theirs(at), atol=1e-10 * scale)
    np.testing.assert_allclose(pchip.coefficients(x, y), theirs.c[::-1].T, rtol=1e-7, atol=1e-7 * scale)


def test_the_knots_themselves_are_on_the_curve():
    x, y = [0.0, 0.1, 0.5, 1.0], [3.0, 3.4, 3.6, 4.2]
    assert pchip.interpolate(x, y, x) == pytest.approx(y)


def test_a_rising_curve_rises_everywhere():
    rng = np.random.default_rng(2)
    x, y = np.cumsum(rng.uniform(0.01, 1, 40)), np.cumsum(rng.exponential(1, 40))
    assert np.all(np.diff(pchip.interpolate(x, y, np.linspace(x[0], x[-1], 5000))) > 0)
