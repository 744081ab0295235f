from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from bms_ukf import ConfigError
from bms_ukf.sensors import CurrentSensor, Sensor, Sensors, SensorSet

VALUES = st.floats(-1e3, 1e3)


class Every10ms:
    """A current sensor asked every 10 ms."""

    def __init__(self, **settings: object) -> None:
        self.sensor = Sensor(CurrentSensor.model_validate(settings), seed=1, name="current")
        self.t_ns = 0

    def measure(self, true_A, plant_degC: float = 25.0):
        self.t_ns += 10_000_000
        return self.sensor.measure(self.t_ns, true_A, plant_degC)


def sensor(**settings: object) -> Every10ms:
    return Every10ms(**settings)


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


def test_offset_and_gain_drift_with_temperature_from_25_degC() -> None:
    channel = sensor(offset_A=0.1, offset_A_per_degC=0.01, gain=1.01, gain_per_degC=0.001)
    assert channel.measure(10.0) == pytest.approx(10.1 + 0.1)
    assert channel.measure(10.0, plant_degC=45.0) == pytest.approx(10.0 * (1.01 + 0.02) + 0.1 + 0.2)
    assert channel.measure(10.0, plant_degC=-15.0) == pytest.approx(10.0 * (1.01 - 0.04) + 0.1 - 0.4)
    assert channel.measure(10.0, plant_degC=math.nan) == pytest.approx(10.2)


def test_an_offset_drifts_by_the_hour_from_the_first_value_on() -> None:
    channel = Sensor(CurrentSensor.model_validate({"offset_A_per_h": 0.6}), seed=1, name="current")
    start_ns = 5 * HOUR_NS
    measured_A = [channel.measure(start_ns + k * HOUR_NS // 2, 1.0) for k in range(3)]
    assert measured_A == pytest.approx([1.0, 1.3, 1.6])


@pytest.mark.parametrize("steps", [1, 9])
def test_a_random_walk_has_its_sigma_after_an_hour_however_often_it_is_asked(steps: int) -> None:
    settings = CurrentSensor.model_validate({"offset_walk_A_per_sqrt_h": 0.2})
    channel = Sensor(settings, seed=3, name="current")
    cells = np.zeros(4000)
    first = channel.measure(0, cells)
    last = [channel.measure(k * HOUR_NS // steps, cells) for k in range(1, steps + 1)][-1]
    assert np.all(first == 0)
    assert last.std() == pytest.approx(0.2, rel=0.05)
    assert abs(last.mean()) < 4 * 0.2 / math.sqrt(cells.size)


def test_a_lag_answers_a_step_with_its_time_constant_at_any_rate() -> None:
    channel = sensor(lag_s=0.05)
    assert channel.measure(2.0) == 2.0  # settled at first
    answer = [channel.measure(3.0) for _ in range(20)]
    assert answer == pytest.approx([3 - math.exp(-0.01 * k / 0.05) for k in range(1, 21)])
    slow = Sensor(CurrentSensor.model_validate({"lag_s": 0.05}), seed=1, name="current")
    slow.measure(0, 2.0)
    assert slow.measure(200_000_000, 3.0) == pytest.approx(answer[-1])


def test_a_lag_stays_where_it_was_over_a_gap() -> None:
    channel = sensor(lag_s=0.05)
    channel.measure(np.array([1.0, 5.0]))
    gapped = channel.measure(np.array([math.nan, 5.0]))
    assert math.isnan(gapped[0])
    assert gapped[1] == 5.0
    assert channel.measure(np.array([1.0, 5.0])).tolist() == [1.0, 5.0]


@pytest.mark.parametrize(
    ("delay_s", "expected"),
    [(0.0, [1, 2, 3, 4, 5]), (0.01, [1, 1, 2, 3, 4]), (0.03, [1, 1, 1, 1, 2]), (0.025, [1, 1, 1, 1.5, 2.5])],
)
def test_a_delay_shifts_the_signal(delay_s, expected) -> None:
    channel = sensor(delay_s=delay_s)
    assert [channel.measure(float(k)) for k in range(1, 6)] == pytest.approx(expected)


@given(delay_s=st.floats(0.0, 0.2), currents_A=st.lists(st.floats(-100, 100), min_size=30, max_size=30))
def test_a_delay_loses_no_charge(delay_s: float, currents_A: list[float]) -> None:
    channel = sensor(delay_s=delay_s)
    padded = [0.0, *currents_A, *[0.0] * 25]
    assert sum(channel.measure(a) for a in padded) == pytest.approx(sum(padded), abs=1e-6)


def test_every_cell_has_a_sensor_of_its_own() -> None:
    channel = sensor(noise_A=0.1, offset_sigma_A=0.3, gain_sigma=0.01)
    cells = np.full(2000, 10.0)
    errors = np.array([channel.measure(cells) - 10.0 for _ in range(200)])
    constant = errors.mean(axis=0)
    assert constant.std() == pytest.approx(math.hypot(0.3, 0.01 * 10.0), rel=0.07)
    assert (errors - constant).std() == pytest.approx(0.1, rel=0.02)
    assert abs(np.corrcoef((errors - constant)[:, :2].T)[0, 1]) < 0.3


def test_offsets_and_gains_may_be_given_cell_by_cell() -> None:
    channel = sensor(offset_A=[0.1, -0.2, 0.0], gain=[1.0, 1.0, 1.1])
    assert channel.measure(np.array([1.0, 2.0, 3.0])) == pytest.approx([1.1, 1.8, 3.3])
    for wrong in (1.0, np.ones(4)):
        with pytest.raises(ConfigError, match=r"current\.offset_A is 'a list of 3'; expected one value") as refused:
            sensor(offset_A=[0.1, -0.2, 0.0]).measure(wrong)
        assert "\n" not in str(refused.value)


def test_what_is_drawn_at_the_start_changes_no_noise() -> None:
    plain, spread = sensor(noise_A=0.1), sensor(noise_A=0.1, offset_sigma_A=1.0, offset_walk_A_per_sqrt_h=0.0)
    difference = [spread.measure(1.0) - plain.measure(1.0) for _ in range(10)]
    assert difference == pytest.approx([difference[0]] * 10)
    assert difference[0] != 0


def test_a_pack_gives_one_sample_of_arrays() -> None:
    settings = {"seed": 2, "voltage": {"noise_V": 0.001, "resolution_V": 0.01, "range_V": [0, 4.0]}}
    sample = SensorSet(Sensors.model_validate(settings)).measure(7, 1.0, np.array([3.501, 4.2, math.nan]), 25.0)
    assert (sample.t_ns, sample.current_A, sample.temperature_degC) == (7, 1.0, 25.0)
    assert sample.voltage_V == pytest.approx([3.5, 4.0, math.nan], nan_ok=True)


HOUR_NS = 3_600_000_000_000
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
        ({"voltage": {"gain": [1.0, 0]}}, "gain"),
        ({"voltage": {"lag_V": 1}}, "lag_V"),
        ({"current": {"offset_per_h": 1}}, "offset_per_h"),
        ({"current": {"delay_s": -1}}, "delay_s"),
        ({"pressure": {}}, "pressure"),
        ({"seed": -1}, "seed"),
    ],
)
def test_wrong_settings_are_refused_by_name(settings: dict[str, object], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        Sensors.model_validate(settings)
