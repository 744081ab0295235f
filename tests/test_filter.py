"""The three public steps: together they are the estimator's, and a refused one changes nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import CELL, drive, variant

from bms_ukf import ConfigError, Estimator, Fault, Filter, Sample, Tuning
from bms_ukf.kernel import layout

X = [0.8, 0.01, 0.005, 0.0, 0.0, 0.0]  # soc, v_rc1, v_rc2, v_slow, r0_error, bias
SIGMA = [0.015, 0.005, 0.005, 0.005, 0.2, 0.05]


def belief(filter_: Filter) -> bytes:
    return filter_._state.tobytes()


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_predict_innovate_update_are_what_the_estimator_does(precision):
    """To the last digits: the compiler fuses other operations. In float32 every step may round a variance anew."""
    samples = list(drive(300, varying_dt=True, seed=3))
    tuning = Tuning(initial_soc=0.9, initial_soc_sigma=0.01, gate_sigmas=1e6, adaptive=False)
    estimator = Estimator(CELL, tuning=tuning, precision=precision)
    t_ns, (_, current, voltage, temperature) = 0, samples[0]
    estimator.step(Sample(t_ns, current, voltage, temperature))
    m = estimator._form
    record = estimator._state[0, :, 0]
    record[layout.H_PARTS] = 0  # `Filter` has one Gaussian from the start
    filter_ = Filter(CELL, X, SIGMA, tuning, precision)
    filter_._state[:] = record
    close = 1e-9 if precision == "f64" else len(samples) * 2.0**-23
    for dt, current, voltage, temperature in samples[1:]:
        t_ns += round(dt * 1e9)
        estimate = estimator.step(Sample(t_ns, current, voltage, temperature))
        assert filter_.predict(dt, current, temperature) == Fault.NONE
        assert filter_.innovate(voltage) == Fault.NONE
        assert [filter_.voltage_pred_V, filter_.innovation_V] == pytest.approx(
            [estimate.voltage_pred_V, estimate.innovation_V], rel=1e-5, abs=1e-12 if precision == "f64" else 1e-6
        )  # in float32 4 V is known to 2.4e-7, and the prediction is a sum of seven voltages
        assert filter_.innovation_var_V2 == pytest.approx(estimate.innovation_var_V2, rel=close)
        assert filter_.update() == Fault.NONE
        np.testing.assert_allclose(filter_.x, record[m.x : m.root], rtol=0, atol=1e-11 if precision == "f64" else 1e-5)
    assert estimate.soc_sigma == pytest.approx(filter_.sqrt_P[0, 0], rel=close)


def test_the_states_have_names():
    plain = Filter(CELL, X[:5], SIGMA[:5], Tuning(current_bias=False))
    assert plain.states == ("soc", "v_rc1_V", "v_rc2_V", "v_slow_V", "r0_error")
    cell, tuning = variant(3, hysteresis=True, core=True), Tuning()
    names = ("soc", "v_rc1_V", "v_rc2_V", "v_rc3_V", "v_hyst_V", "v_slow_V", "r0_error", "current_bias_A")
    assert Filter(cell, [0.5] + [0.0] * 7, [0.1] * 8, tuning).states == names


def test_between_innovate_and_update_a_gate_may_stand():
    filter_ = Filter(CELL, X, SIGMA)
    filter_.predict(1.0, 1.0, 25.0)
    before = belief(filter_)
    assert filter_.innovate(3.0) == Fault.INNOVATION_REJECTED
    assert abs(filter_.innovation_V) > 0.3
    assert belief(filter_) == before
    assert filter_.predict(1.0, 1.0, 25.0) == Fault.NONE
    assert math.isnan(filter_.innovation_V)  # that of another belief


def test_a_voltage_is_fused_once():
    filter_ = Filter(CELL, X, SIGMA)
    before = belief(filter_)
    assert filter_.update() == Fault.NUMERIC  # none was compared
    filter_.predict(1.0, 1.0, 25.0)
    filter_.innovate(3.9)
    assert filter_.update() == Fault.NONE
    after = belief(filter_)
    assert after != before
    assert filter_.update() == Fault.NUMERIC
    assert belief(filter_) == after


@pytest.mark.parametrize("poison", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_leaves_the_belief_bit_identical(poison):
    filter_ = Filter(CELL, X, SIGMA)
    filter_.predict(1.0, 1.0, 25.0)
    before = belief(filter_)
    for dt, current, temperature in ((poison, 1.0, 25.0), (1.0, poison, 25.0)):
        assert filter_.predict(dt, current, temperature) == Fault.NUMERIC
        assert belief(filter_) == before
    assert filter_.innovate(poison) == Fault.NUMERIC
    assert filter_.update() == Fault.NUMERIC
    assert belief(filter_) == before
    assert filter_.predict(1.0, 1.0, 25.0) == Fault.NONE
    assert filter_.innovate(3.85) == Fault.NONE


@pytest.mark.parametrize("dt", [0.0, -1.0])
def test_time_that_does_not_pass_predicts_nothing(dt):
    filter_ = Filter(CELL, X, SIGMA)
    before = belief(filter_)
    assert filter_.predict(dt, 1.0, 25.0) == Fault.NUMERIC
    assert belief(filter_) == before


@pytest.mark.parametrize(
    ("x", "sigma"),
    [([0.5], [0.1]), (X, [0.1, 0.01]), ([0.5, math.nan, *X[2:]], SIGMA), (X, [0.1, 0.0, *SIGMA[2:]])],
)
def test_a_start_that_is_none_is_refused(x, sigma):
    with pytest.raises(ValueError, match="x"):
        Filter(CELL, x, sigma)


@pytest.mark.parametrize(
    ("precision", "weights", "says"),
    [
        ("f64", {"kappa": -6.0}, ["kappa is -6.0", "above -6", "6 states"]),
        ("f64", {"beta": -6.0}, ["beta is -6.0", "negative"]),
        ("f64", {"alpha": 1e-6}, ["alpha is 1e-06", "rounding"]),
        ("f32", {"alpha": 1e-3}, ["alpha is 0.001", "float32"]),
    ],
)
def test_weights_that_are_unsound_are_refused_with_the_reason(precision, weights, says):
    with pytest.raises(ConfigError) as refused:
        Estimator(CELL, tuning=Tuning(**weights), precision=precision)
    assert [text for text in says if text not in str(refused.value)] == [], str(refused.value)


@pytest.mark.parametrize(
    ("precision", "weights"),
    [
        ("f64", {"alpha": 1e-3, "beta": 2.0, "kappa": 0.0}),  # the classic set
        ("f64", {"alpha": 1.0, "beta": 0.0, "kappa": 0.0}),  # the cubature filter's
        ("f64", {"alpha": 1.0, "beta": 0.0, "kappa": -1.0}),
        ("f32", {"alpha": 0.1}),
        ("f32", {"alpha": 1.0}),
    ],
)
def test_weights_that_are_sound_are_taken(precision, weights):
    estimator = Estimator(CELL, tuning=Tuning(initial_soc=0.9, **weights), precision=precision)
    for k, (_, current, voltage, temperature) in enumerate(drive(400, varying_dt=False, seed=2)):
        estimate = estimator.step(Sample(k * 10**9, current, voltage, temperature))
    assert estimate.soc == pytest.approx(0.9 - 1.1 * 400 / 18000, abs=0.05)


def test_a_voltage_before_any_prediction_is_refused():
    filter_ = Filter(CELL, X, SIGMA)
    before = belief(filter_)
    assert filter_.innovate(3.8) == Fault.NUMERIC
    assert filter_.update() == Fault.NUMERIC
    assert belief(filter_) == before


def test_an_unseen_current_leaves_the_hysteresis_anywhere_between_its_branches():
    cell = variant(2, hysteresis=True)
    estimator = Estimator(cell, tuning=Tuning(initial_soc=0.6, initial_soc_sigma=0.01))
    m = estimator._form
    diagonal = m.root + (m.n_rc + 1) * (m.n_rc + 4) // 2
    for k in range(1200):
        estimator.step(Sample(k * 10**9, 2.0, float("nan") if k else 3.5, 25.0))
    record = estimator._state[0, :, 0]
    discharged = record[m.x + m.n_rc + 1]
    assert discharged > 0.01
    for k in range(1200, 4800, 60):
        estimator.step(Sample(k * 10**9, float("nan"), float("nan"), 25.0))
    largest = float(cell.dynamics_at(0.5, 25.0)["hysteresis_V"])
    sigma = np.linalg.norm(record[diagonal - m.n_rc - 1 : diagonal + 1])
    assert abs(record[m.x + m.n_rc + 1]) < 0.1 * discharged
    assert sigma > largest / 2


def test_a_current_that_timed_out_heats_no_core():
    estimator = Estimator(variant(2, hysteresis=False, core=True), tuning=Tuning(initial_soc=0.8))
    for k in range(600):
        estimator.step(Sample(k * 10**9, 5.0, 3.6 if k == 0 else float("nan"), 25.0))
    warm = estimator._state[0, layout.H_CORE_RISE, 0]
    assert warm > 0.5
    for k in range(600, 1800, 10):
        estimator.step(Sample(k * 10**9, float("nan"), float("nan"), 25.0))
    assert estimator._state[0, layout.H_CORE_RISE, 0] < 0.01 * warm
