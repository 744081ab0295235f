"""A row of zero current that has the voltage of the load after it: found, and the charge left as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf.recordings import read
from bms_ukf.recordings.edges import early_voltages


@given(
    current_A=st.sampled_from([-3.0, -0.5, 1.0, 4.0]),
    early=st.booleans(),
    rest_step_s=st.sampled_from([1.0, 10.0, 600.0]),
    relaxing_mV=st.floats(-20.0, 20.0),
    lag=st.booleans(),
    noise_mV=st.sampled_from([0.0, 0.3]),
)
def test_only_a_rest_with_the_voltage_of_the_load_after_it_is_found(
    current_A: float, early: bool, rest_step_s: float, relaxing_mV: float, lag: bool, noise_mV: float
) -> None:
    """Three rests that relax, each before two minutes of load; a voltage column a row late is no early voltage."""
    stretch_A = np.concatenate([np.zeros(8), np.full(120, current_A), np.zeros(1)])
    step_s = np.concatenate([np.full(8, rest_step_s), np.ones(121)])
    current, time_s = np.tile(stretch_A, 3), np.cumsum(np.tile(step_s, 3))
    since_s = np.tile(np.concatenate([np.cumsum(step_s[:8]), np.zeros(121)]), 3)
    slow_V, decay = np.zeros(current.size), np.exp(-np.diff(time_s, prepend=0.0) / 60)
    for k in range(1, current.size):
        slow_V[k] = decay[k] * slow_V[k - 1] + (1 - decay[k]) * 0.02 * current[k]
    voltage = 3.7 - 0.03 * current - slow_V + 1e-3 * relaxing_mV * np.exp(-since_s / 300)
    voltage = voltage + np.random.default_rng(3).normal(0, 1e-3 * noise_mV, voltage.size)
    if lag:
        voltage = np.concatenate([voltage[:1], voltage[:-1]])
    last = np.flatnonzero(np.diff((current == 0).astype(int)) < 0)
    if early and not lag:
        voltage[last] = voltage[last + 1]
    found = early_voltages(current, voltage, current == 0)
    expected = last[: last.size * (early and not lag)]
    np.testing.assert_array_equal(np.flatnonzero(found), expected)


@pytest.mark.parametrize("spacing_s", [0.002, 0.5, 10.0])
def test_a_recording_rests_at_the_voltage_before_the_edge(tmp_path: Path, spacing_s: float) -> None:
    """However close the record of the edge is to the first of the load."""
    rest = [(10.0 * k, 0.0, 3.36) for k in range(6)] + [(60.0, 0.0, 3.41)]
    load = [(60.0 + spacing_s + k, 1.5, 3.41 + 1e-4 * k) for k in range(600)]
    after = [(load[-1][0] + 1 + k, 0.0, load[-1][2] - 0.05) for k in range(60)]
    rows = "\n".join(f"{t},{i},{v}" for t, i, v in [*rest, *load, *after])
    (tmp_path / "a.csv").write_text(f"time_s,current_A,voltage_V\n{rows}\n")
    found = read(tmp_path / "a.csv", current_positive="charge", temperature_degC=25.0)
    last = int(np.argmax(~found.at_rest)) - 1
    assert found.voltage_V[last] == 3.36
    assert any("1 rests end with a voltage of the load" in warning for warning in found.warnings)
    assert -3600 * found.drawn_Ah[-1] == pytest.approx(1.5 * 600, rel=0.02)
