from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from bms_ukf.sensors import CurrentSensor, Sensor, Sensors, SensorSet

VALUES = st.floats(-1e3, 1e3)


def sensor(**settings: object) -> Sensor:
    return Sensor(CurrentSensor.model_validate(settings), seed=1, name="current")


@given(true_A=VALUES)
def test_an_ideal_sensor_changes_nothing(true_A: float) -> None:
    assert sensor().measure(true_A) == true_A


def test_gain_comes_before_offset() -> None:
    assert sensor(gain=1.1, offset_A=0.5).measure(10.0) == pytest.approx(11.5)


@given(true_A=VALUES, resolution_A=st.sampled_from([0.001, 0.01, 0.1, 1.0]))
def test_quantisation_is_to_the_nearest_step(true_A: float, resolution_A: float) -> None:
    measured_A = sensor(resolution_A=resolution_A).measure(true_A)
    assert abs(measured_A - true_A) <= 0.5 * resolution_A * (1 + 1e-9)
    assert measured_A / resolution_A == pytest.approx(round(measured_A / resolution_A), abs=1e-6)


@given(true_A=VALUES)
def test_saturation_limits_what_offset_and_noise_make(true_A: float) -> None:
    measured_A = sensor(range_A=[-50, 100], offset_A=30, noise_A=5).measure(true_A)
    assert -50 <= measured_A <= 100
    assert sensor(range_A=[-50, 100]).measure(true_A) == min(max(true_A, -50), 100)


def test_noise_has_the_stated_sigma_and_no_mean() -> None:
    channel = sensor(noise_A=0.2)
    error_A = np.array([channel.measure(3.0) - 3.0 for _ in range(20_000)])
    assert error_A.std() == pytest.approx(0.2, rel=0.02)  # four standard errors of 20000 draws
    assert abs(error_A.mean()) < 4 * 0.2 / math.sqrt(error_A.size)
    assert abs(np.corrcoef(error_A[:-1], error_A[1:])[0, 1]) < 0.03


def test_missing_stays_missing_and_shifts_no_later_noise() -> None:
    whole, gapped = (
        sensor(noise_A=0.1, resolution_A=0.01, range_A=[0, 1]),
        sensor(noise_A=0.1, resolution_A=0.01, range_A=[0, 1]),
    )
    expected = [whole.measure(0.5) for _ in range(3)]
    assert gapped.measure(0.5) == expected[0]
    assert math.isnan(gapped.measure(math.nan))
    assert gapped.measure(0.5) == expected[2]


NOISY = {"seed": 7, "current": {"noise_A": 0.1}, "voltage": {"noise_V": 0.002}, "temperature": {"noise_degC": 0.3}}


def run(settings: dict[str, object], steps: int = 50) -> np.ndarray:
    sensors = SensorSet(Sensors.model_validate(settings))
    samples = [sensors.measure(k, 1.0, 3.7, 25.0) for k in range(steps)]
    return np.array([(s.t_ns, s.current_A, s.voltage_V, s.temperature_degC) for s in samples])


def test_the_same_seed_gives_the_same_samples() -> None:
    assert np.array_equal(run(NOISY), run(NOISY))
    assert not np.array_equal(run(NOISY), run(NOISY | {"seed": 8}))


def test_a_channel_does_not_change_another_channels_noise() -> None:
    both = run(NOISY)
    alone = run(NOISY | {"current": {}, "temperature": {}})
    assert np.array_equal(both[:, 2], alone[:, 2])
    assert np.all(alone[:, 1] == 1.0)


def test_channels_have_independent_noise() -> None:
    samples = run(NOISY, 4000)
    correlation = np.corrcoef(samples[:, 1:].T)
    assert np.abs(correlation - np.eye(3)).max() < 0.07


def test_the_time_stamp_is_passed_on() -> None:
    assert run(NOISY)[:, 0].tolist() == list(range(50))


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"current": {"noise": 0.1}}, "noise"),  # a key without its unit
        ({"current": {"noise_V": 0.1}}, "noise_V"),
        ({"voltage": {"noise_V": -0.1}}, "noise_V"),
        ({"voltage": {"range_V": [5, 0]}}, "lowest, highest"),
        ({"temperature": {"gain": 0}}, "gain"),
        ({"pressure": {}}, "pressure"),
        ({"seed": -1}, "seed"),
    ],
)
def test_wrong_settings_are_refused_by_name(settings: dict[str, object], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        Sensors.model_validate(settings)
