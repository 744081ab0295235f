"""The r0 error is found from a load and nothing else; the size of the fast voltage error follows the innovations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import steady, terminal
from scipy.signal import lfilter

from bms_ukf import CellParams, Estimator, Sample, Tuning
from bms_ukf.kernel import layout
from bms_ukf.kernel.params import params

CELL = steady()
R0 = float(CELL.dynamics_at(0.6, 25.0)["r0_ohm"])
NAN = math.nan


def aged(times: float) -> CellParams:
    """CELL with all its resistances `times` those of its file, as an aged or a misjudged cell has them."""
    data = CELL.model_dump(exclude_none=True)
    for key in ("r0_ohm", "r1_ohm", "r2_ohm"):
        data["dynamics"][key] = [[times * value for value in row] for row in data["dynamics"][key]]
    return CellParams.model_validate(data)


def load(steps: int, seed: int = 4) -> np.ndarray:
    """A current that changes every few seconds, by a normal of 2 A, and draws 0.4 A in the mean."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.normal(0.4, 2.0, steps // 4 + 1), 4)[:steps]


def driven(
    steps: int, times: float = 1.0, offset_A: float = 0.0, noise_V: float = 0.002, rate_hz: int = 1, seed: int = 4
) -> tuple[np.ndarray, ...]:
    """t_ns, current shown, voltage and temperature; and the true SoC. The resting cell was at 80 %."""
    current = np.repeat(load(steps, seed), rate_hz)
    soc, voltage = terminal(aged(times), 0.8, current, rate_hz)
    voltage = voltage + noise_V * np.random.default_rng(seed + 1).standard_normal(current.size)
    t_ns = np.arange(current.size) * (10**9 // rate_hz)
    return t_ns, current + offset_A, voltage, np.full(current.size, 25.0), soc


def held(estimator: Estimator, slot: int) -> float:
    return float(estimator._state[0, slot, 0])


@pytest.mark.parametrize("rate_hz", [1, 10])
@pytest.mark.parametrize("times", [0.5, 0.7, 1.3, 2.0])
def test_resistances_of_half_to_twice_the_files_are_found_within_minutes_of_a_drive(times, rate_hz):
    *sample, soc = driven(1200, times, rate_hz=rate_hz)
    got = Estimator(CELL).replay(*sample)
    assert abs(got["r0_ohm"][0] / R0 - 1) < 0.1  # it did start from the file's
    # r0_error is drawn to 0, that is to the file's, all the time: some 5 % of the difference are never found.
    assert got["r0_ohm"][-300 * rate_hz :] / R0 == pytest.approx(times, abs=0.1 * abs(times - 1))
    assert np.abs(got["soc"] - soc)[-300 * rate_hz :].max() < 0.005


@pytest.mark.parametrize("rate_hz", [1, 10])
@pytest.mark.parametrize("steady_A", [0.0, 1.0])
def test_noise_of_the_current_sensor_at_a_current_that_stands_still_does_not_move_r0(steady_A, rate_hz):
    """The noise moves the prediction and not the cell: learnt from, it would be evidence of no resistance."""
    steps, rng = 3600 * rate_hz, np.random.default_rng(7)
    current = np.full(steps, steady_A)
    _, voltage = terminal(CELL, 0.8, current, rate_hz)
    voltage = voltage + 0.002 * rng.standard_normal(steps)
    shown = current + 0.02 * rng.standard_normal(steps)  # C/250
    got = Estimator(CELL).replay(np.arange(steps) * (10**9 // rate_hz), shown, voltage, np.full(steps, 25.0))
    assert np.abs(got["r0_ohm"] / R0 - 1).max() < 0.05


@pytest.mark.parametrize("rate_hz", [2, 10, 50])
def test_a_charge_transfer_of_some_tenths_of_a_second_stays_a_part_of_r0_however_fast_voltages_come(rate_hz):
    """Half of r0 shows at once, half with a time constant of 0.3 s, as in real cells; the cell file knows the sum."""
    current = np.repeat(load(1800), rate_hz)
    soc, voltage = terminal(CELL, 0.8, current, rate_hz, 0.5)
    a = math.exp(-1 / rate_hz / 0.3)
    voltage -= 0.5 * R0 * lfilter([1 - a], [1, -a], current)
    voltage += 0.002 * np.random.default_rng(2).standard_normal(current.size)
    t_ns = np.arange(current.size) * (10**9 // rate_hz)
    got = Estimator(CELL).replay(t_ns, current, voltage, np.full(current.size, 25.0))
    assert got["r0_ohm"][300 * rate_hz :] / R0 == pytest.approx(1.0, abs=0.1)
    assert np.abs(got["soc"] - soc)[300 * rate_hz :].max() < 0.01


@pytest.mark.parametrize("offset_A", [-0.1, 0.1])
def test_an_offset_of_the_current_does_not_move_r0(offset_A):
    shown = [Estimator(CELL).replay(*driven(1800, 1.3, offset)[:4])["r0_ohm"] for offset in (0.0, offset_A)]
    assert np.abs(shown[1] - shown[0])[300:].max() < 0.01 * R0


@pytest.mark.parametrize("offset_A", [-0.1, 0.1])
@pytest.mark.parametrize("times", [0.7, 1.3])
def test_resistances_and_an_offset_wrong_at_once_are_told_apart_and_stay_so(times, offset_A):
    """Together they are bilinear: both change the level of the voltage. Six hours, most of a charge and back.

    An offset shows in the voltage by way of SoC only, and the bias takes a small share of that gain: two sigmas of an
    offset are hardly found in six hours. What is found must have its sign, and none of it may be an error of r0.
    """
    steps = 6 * 3600
    current = load(steps) - 0.4 + 1.2 * np.sin(2 * np.pi * np.arange(steps) / 7200)
    soc, voltage = terminal(aged(times), 0.6, current)
    voltage = voltage + 0.002 * np.random.default_rng(1).standard_normal(steps)
    t_ns = np.arange(steps) * 10**9
    got = Estimator(CELL).replay(t_ns, current + offset_A, voltage, np.full(steps, 25.0))
    last = slice(-7200, None)
    assert got["r0_ohm"][last] / R0 == pytest.approx(times, abs=0.06)
    found = got["current_bias_A"][last] / offset_A
    assert found.min() > 0
    assert found.max() < 1.0
    assert np.ptp(found) < 0.1
    assert np.abs(got["soc"] - soc)[last].max() < 0.02


def test_a_lost_frame_of_the_current_does_not_move_r0():
    """The voltage after it was made by another current than the one held."""
    t_ns, current, voltage, temperature, _ = driven(1200)
    current = current.copy()
    current[600::4] = NAN  # the first second of every new current
    got = Estimator(CELL).replay(t_ns, current, voltage, temperature)["r0_ohm"]
    assert np.abs(got[600:] / R0 - 1).max() < 0.05


def scales(estimator: Estimator, steps: int, noise_V: float, start: int) -> list[float]:
    found = []
    rng = np.random.default_rng(start)
    for k in range(start, start + steps):
        voltage = float(CELL.ocv_V(0.6, 25.0)) + noise_V * rng.standard_normal()
        estimator.step(Sample(k * 10**9, 0.0, voltage, 25.0))
        found.append(held(estimator, layout.H_VOLTAGE_SCALE))
    return found


def test_the_voltage_error_grows_while_the_model_errs_more_and_comes_back():
    estimator = Estimator(CELL, tuning=Tuning(current_bias=False))
    told = params(CELL, Tuning())
    own = math.sqrt(told[layout.P_VAR_VOLTAGE] + told[layout.P_FAST_VAR])  # of one reading
    as_told, worse = scales(estimator, 1800, own, 0), scales(estimator, 1800, 4 * own, 1800)
    after = scales(estimator, 1800, own, 3600)
    assert max(as_told) < 2
    assert 10 < np.mean(worse[900:]) < 25  # 16
    assert np.mean(after[900:]) < 2
    assert min(as_told + worse + after) == 1.0


def test_a_quiet_voltage_never_makes_the_error_smaller_than_the_cell_file_says():
    estimator = Estimator(CELL)
    assert set(scales(estimator, 600, 0.0, 0)) == {1.0}


def test_the_voltage_error_is_not_adapted_if_that_is_not_wanted():
    estimator = Estimator(CELL, tuning=Tuning(adaptive=False))
    estimator.replay(*driven(600, noise_V=0.05)[:4])
    assert held(estimator, layout.H_VOLTAGE_SCALE) == 1.0


def test_float32_finds_the_same_r0_and_offset():
    f64, f32 = (Estimator(CELL, precision=bits).replay(*driven(3600, 1.3, 0.1)[:4]) for bits in ("f64", "f32"))
    assert np.abs(f64["r0_ohm"] - f32["r0_ohm"]).max() < 1e-3 * R0
    assert np.abs(f64["current_bias_A"] - f32["current_bias_A"]).max() < 1e-4


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("noise_V", [0.02, 0.04])
@pytest.mark.parametrize("charged", [0.5, 0.85])
def test_a_noisy_voltage_does_not_keep_a_wrong_soc_alive(seed, noise_V, charged):
    """The voltage error has grown to 40 mV; then a belief is wrong by less than that of one reading, for minutes."""
    cell, dice = CellParams.load("lgm50_chen2020"), np.random.default_rng(seed)
    estimator = Estimator(cell)
    for second in range(1500):
        soc = 0.7 if second < 900 else charged
        voltage_V = float(cell.ocv_V(soc, 25.0)) + dice.normal(0.0, noise_V)
        estimate = estimator.step(Sample((second + 1) * 10**9, 0.0, voltage_V, 25.0))
    assert estimate.soc_low < charged < estimate.soc_high
    assert estimate.soc == pytest.approx(charged, abs=0.02)
