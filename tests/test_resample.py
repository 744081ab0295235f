"""A recording at another rate: no charge is lost, and nothing is made up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf.recordings import Recording, resample


def recording(time_s: np.ndarray, current_A: np.ndarray, voltage_V: np.ndarray | None = None) -> Recording:
    n = time_s.size
    drawn_Ah = np.cumsum(current_A * np.diff(time_s, prepend=time_s[0])) / 3600
    voltage_V = np.full(n, 3.7) if voltage_V is None else voltage_V
    return Recording("made", time_s, current_A, voltage_V, np.full(n, 25.0), drawn_Ah, np.linspace(1, 0, n))


@given(
    steps=st.lists(st.floats(0.01, 70.0), min_size=2, max_size=60),
    step_s=st.sampled_from([0.1, 1.0, 3.0]),
    seed=st.integers(0, 99),
)
def test_no_charge_is_lost_whatever_the_rows(steps: list[float], step_s: float, seed: int) -> None:
    time_s = 100 + np.concatenate([[0.0], np.cumsum(steps)])
    current_A = np.random.default_rng(seed).normal(0, 5, time_s.size)
    even = resample(recording(time_s, current_A), step_s)
    assert np.allclose(np.diff(even.time_s), step_s)
    charge_As = np.concatenate([[0.0], np.cumsum(current_A[1:] * np.diff(time_s))])
    moved_As = np.concatenate([[0.0], np.cumsum(even.current_A[1:] * step_s)])
    assert moved_As == pytest.approx(np.interp(even.time_s, time_s, charge_As), abs=1e-6)


def test_an_even_recording_stays_as_it_is() -> None:
    rng = np.random.default_rng(2)
    time_s = np.arange(1000) * 0.1
    given_ = recording(time_s, rng.normal(0, 3, 1000), rng.normal(3.7, 0.1, 1000))
    same = resample(given_, 0.1)
    for name in ("time_s", "current_A", "voltage_V", "temperature_degC", "soc_ref", "drawn_Ah"):
        assert getattr(same, name) == pytest.approx(getattr(given_, name), abs=1e-9), name


def test_a_voltage_is_the_mean_of_its_interval_and_missing_where_none_was_measured() -> None:
    time_s = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 5.0])
    even = resample(recording(time_s, np.ones(6), np.array([3.0, 3.1, 3.2, 3.3, 3.4, 3.5])), 1.0)
    assert even.voltage_V == pytest.approx([3.0, 3.15, 3.35, np.nan, np.nan, 3.5], nan_ok=True)
    assert even.current_A == pytest.approx(np.ones(6))
    assert np.isfinite(even.temperature_degC).all()
