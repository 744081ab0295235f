"""Slow tests that hold polarisation, and the rests of pulses that show it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bms_ukf.identify import ocv, ocv_rests
from bms_ukf.manifest import MeasuredTest
from bms_ukf.recordings import Recording

Array = NDArray[np.float64]

CAPACITY_AH = 3.0


def curve_V(soc: Array) -> Array:
    return 3.4 + 0.75 * soc - 0.5 * np.exp(-25 * soc) + 0.05 * np.tanh((soc - 0.6) / 0.08)


def pulses(hysteresis_V: float, early: bool, wrong_V: float = 0.0) -> tuple[MeasuredTest, Recording, Array]:
    """Discharges of 5 % with rests of half an hour, whose last row may have the voltage of the next load."""
    current_A = np.tile(np.concatenate([np.zeros(180), np.full(54, 1.0 * CAPACITY_AH)]), 19)
    soc = np.asarray(1 - np.cumsum(current_A) * 10 / 3600 / CAPACITY_AH)
    slow_V, decay = np.zeros(soc.size), np.exp(-10 / 300)
    for k in range(1, soc.size):
        slow_V[k] = decay * slow_V[k - 1] + (1 - decay) * 0.02 * current_A[k]
    voltage_V = curve_V(soc) - hysteresis_V * (soc < 0.999) - 0.03 * current_A - slow_V + wrong_V
    if early:
        last = np.flatnonzero(np.diff(current_A) > 0)
        voltage_V[last] = voltage_V[last + 1]
    time_s = np.linspace(0.0, 10.0 * (soc.size - 1), soc.size)
    drawn_Ah = np.asarray((1 - soc) * CAPACITY_AH)
    recording = Recording("pulses", time_s, current_A, voltage_V, np.full(soc.size, 25.0), drawn_Ah)
    return MeasuredTest(role="pulse", file="p", temperature_degC=25.0), recording, soc


def slow(directions: tuple[str, ...], drop_V: float, hysteresis_V: float) -> ocv.Slow:
    """Branches that are off by a polarisation and half the hysteresis each."""
    off_V = drop_V + hysteresis_V
    voltage_V = curve_V(ocv.SOC)
    if len(directions) == 1:
        voltage_V = voltage_V + off_V * (1 if directions == ("charge",) else -1)
    half = np.full(ocv.SOC.size, off_V) if len(directions) == 2 else None
    curve = ocv.Curve(25.0, voltage_V, np.full(ocv.SOC.size, 1e-4), half, 0.3, directions)
    return ocv.Slow(CAPACITY_AH, [curve])


INSIDE = (ocv.SOC > 0.1) & (ocv.SOC < 0.95)


@settings(max_examples=25, deadline=None)
@given(drop_V=st.floats(0.008, 0.12), direction=st.sampled_from(["charge", "discharge"]), early=st.booleans())
def test_one_branch_is_moved_to_the_rests_and_said_to_be(drop_V: float, direction: str, early: bool) -> None:
    found = ocv_rests.reconcile(slow((direction,), drop_V, 0.0), ocv_rests.found([pulses(0.0, early)]))
    assert np.abs(found.curves[0].voltage_V - curve_V(ocv.SOC))[INSIDE].max() < 0.008
    assert "the rests are used" in found.warnings[0]
    assert f"the {direction} alone" in found.warnings[0]
    assert found.curves[0].sigma_V[INSIDE].min() >= ocv.REST_ERROR_V


@settings(max_examples=25, deadline=None)
@given(drop_V=st.floats(0.02, 0.1), hysteresis_V=st.floats(0.02, 0.05), ohmic=st.booleans())
def test_of_the_width_of_two_branches_only_what_rests_keep_is_hysteresis(
    drop_V: float, hysteresis_V: float, ohmic: bool
) -> None:
    """A part of both cannot be told from a rest that is not over, so that it is left alone: not tried here."""
    drop_V, hysteresis_V = (drop_V, 0.0) if ohmic else (0.0, hysteresis_V)
    before = slow(("charge", "discharge"), drop_V, hysteresis_V)
    found = ocv_rests.reconcile(before, ocv_rests.found([pulses(hysteresis_V, early=False)]))
    half_V = found.half_width_V
    assert half_V is not None
    if ohmic:
        assert half_V.max() < 0.3 * drop_V
        assert "polarisation" in found.warnings[0]
    else:
        np.testing.assert_array_equal(half_V, before.half_width_V)
        assert not found.warnings
    np.testing.assert_allclose(found.curves[0].voltage_V[INSIDE], curve_V(ocv.SOC)[INSIDE], atol=5e-3)


def test_a_curve_that_the_rests_contradict_is_given_up_and_one_they_confirm_is_not() -> None:
    rests = ocv_rests.found([pulses(0.0, early=False, wrong_V=0.06)])
    found = ocv_rests.reconcile(slow(("charge", "discharge"), 0.0, 0.0), rests)
    assert "differs from" in found.warnings[0]
    np.testing.assert_allclose(found.curves[0].voltage_V[INSIDE], curve_V(ocv.SOC)[INSIDE] + 0.06, atol=8e-3)
    confirmed = slow(("charge", "discharge"), 0.0, 0.0)
    assert ocv_rests.reconcile(confirmed, ocv_rests.found([pulses(0.0, early=True)])) == confirmed


def test_rests_at_another_temperature_say_nothing_of_a_slow_test() -> None:
    test, recording, soc = pulses(0.0, early=False)
    cold = ocv_rests.found([(test.model_copy(update={"temperature_degC": 0.0}), recording, soc)])
    before = slow(("discharge",), 0.05, 0.0)
    np.testing.assert_array_equal(ocv_rests.reconcile(before, cold).curves[0].voltage_V, before.curves[0].voltage_V)


@pytest.mark.parametrize("few", [3, 5])
def test_a_few_rests_move_no_curve(few: int) -> None:
    rests = ocv_rests.found([pulses(0.0, early=False)])
    before = slow(("discharge",), 0.05, 0.0)
    assert ocv_rests.reconcile(before, {25.0: rests[25.0][:few]}).warnings == []
