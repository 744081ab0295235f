"""A short soak of every form of the filter, in both precisions; `make soak` is the long one."""

from __future__ import annotations

import pytest
import soak

STEPS = 90_000  # of twelve: a million together


@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("name", soak.cells())
def test_a_million_spoilt_samples_leave_every_belief_sound(name, precision):
    cell, tuning = soak.cells()[name]
    met = soak.soak(cell, tuning, precision, STEPS, seed=7)
    assert met["steps"] >= STEPS
    assert met["refused voltages"] > 0
    assert met["gaps"] > 0
