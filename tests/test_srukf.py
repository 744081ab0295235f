"""The filter against filters written otherwise, and the properties that no sequence of inputs may break."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numba
import numpy as np
import pytest
import synthetic_cell
from drives import CELL, PLAIN, drive, exact, variant
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_record import Record
from ukf_textbook import Cell

from bms_ukf import Fault, Tuning
from bms_ukf.kernel import layout, srukf
from bms_ukf.kernel import params as figures
from bms_ukf.kernel.layout import Form, form, form_at_compile_time
from bms_ukf.kernel.memory import pointer
from bms_ukf.kernel.process import TINY_ROOT

LINEAR = synthetic_cell.cell_of(synthetic_cell.linear())
VARIANTS = {
    "1 RC": (1, False, False, False),
    "2 RC": (2, False, False, False),
    "2 RC, uneven errors": (2, False, False, True),
    "3 RC": (3, False, False, False),
    "2 RC, hysteresis": (2, True, False, False),
    "2 RC, bias": (2, False, True, False),
    "3 RC, hysteresis, bias, uneven errors": (3, True, True, True),
}
variants = pytest.mark.parametrize(("n_rc", "hysteresis", "bias", "uneven"), VARIANTS.values(), ids=list(VARIANTS))


def predicted(w: np.ndarray, m: Form, lost: np.ndarray, g: np.ndarray, gain: np.ndarray, q: np.ndarray) -> None:
    """`srukf.predict` of the working copy `w`, in place."""
    addresses = [array.ctypes.data for array in (w, lost, g, gain, q)]
    _predict(*addresses, m.n_rc, m.hysteresis, m.bias)


@numba.njit
def _predict(w: int, lost: int, g: int, gain: int, q: int, n_rc: int, hysteresis: int, bias: int) -> None:
    m = form_at_compile_time(n_rc, hysteresis, bias, 0, 1, 0, 0)
    srukf.predict(pointer(w, 64), 0, m, pointer(lost, 64), pointer(g, 64), pointer(gain, 64), pointer(q, 64))


@numba.njit
def innovate_and_update(
    params: int, w: int, y: int, z: float, g0: float, g_plus: float, g_minus: float, r: float
) -> None:
    """Of two RC pairs without a bias; `y` must let the voltage through."""
    m = form_at_compile_time(2, 0, 0, 0, 1, 0, 0)
    p = pointer(params, 64)
    srukf.innovate(p, pointer(w, 64), pointer(y, 64), 0, m, z, 0.0, g0, g_plus, g_minus, r)
    srukf.update(pointer(w, 64), pointer(y, 64), 0, m)


def believe(record: Record, x: np.ndarray, P: np.ndarray) -> None:
    """Give the record one Gaussian in place of the components that its first voltage has left (`test_parts`)."""
    record.x, record.root, record["parts"] = x, np.linalg.cholesky(P), 0.0


def worst_difference(record: Record, twin: Cell, steps: int, varying_dt: bool) -> float:
    worst, before = np.zeros(4), math.nan
    for k, (dt, current, measured, temperature) in enumerate(drive(steps, varying_dt, seed=7)):
        voltage = before if k % 5 == 3 else measured  # readings that repeat count for less
        before = voltage
        _, faults = record.tick(dt, current, voltage, temperature)
        assert not faults & (Fault.NUMERIC | Fault.VOLTAGE_IMPLAUSIBLE | Fault.CURRENT_IMPLAUSIBLE)
        if k == 0:
            twin.start(current, voltage, temperature)
            believe(record, twin.ukf.x, twin.ukf.P)
            continue
        twin.predict(dt, current, temperature)
        twin.update(voltage, current, temperature)
        ukf = twin.ukf
        differences = (
            record.x - ukf.x,
            record.P - ukf.P,
            record["innovation"] - ukf.innovation,
            record["innovation_var"] - twin.own_var,
        )
        worst = np.maximum(worst, [np.abs(difference).max() for difference in differences])
    assert record.root[0, 0] < 0.02  # the voltages did correct it
    return float(worst.max())


@pytest.mark.parametrize("varying_dt", [False, True], ids=["1 Hz", "any dt"])
# At alpha = 1e-3 the textbook's weights are near 1e6, which costs it, not the production form, six digits.
@pytest.mark.parametrize(("alpha", "tolerance"), [(1.0, 1e-9), (1e-3, 1e-8)])
def test_every_step_of_a_drive_equals_the_textbook_filter(alpha, tolerance, varying_dt):
    tuning = Tuning(initial_soc=0.8, initial_soc_sigma=0.2, alpha=alpha, **PLAIN)
    record = exact(CELL, tuning)
    assert worst_difference(record, Cell(CELL, tuning, record.ocv, record.dynamics), 3000, varying_dt) < tolerance


@variants
def test_every_variant_equals_the_textbook_filter(n_rc, hysteresis, bias, uneven):
    cell = variant(n_rc, hysteresis, uneven=uneven)
    tuning = Tuning(initial_soc=0.8, initial_soc_sigma=0.2, **PLAIN | {"current_bias": bias})
    record = exact(cell, tuning)
    assert record.n == 3 + n_rc + hysteresis + bias
    assert worst_difference(record, Cell(cell, tuning, record.ocv, record.dynamics), 1500, True) < 1e-9


@pytest.mark.parametrize("alpha", [1.0, 0.1])
def test_on_a_linear_cell_it_is_a_kalman_filter(alpha):
    tuning = Tuning(initial_soc=0.6, initial_soc_sigma=0.2, alpha=alpha, **PLAIN)
    record = exact(LINEAR, tuning)
    rng = np.random.default_rng(3)
    noise, charge = LINEAR.noise, 18000.0
    offset, gain = 0.1 / 1.96, math.hypot(0.005 / 1.96, tuning.capacity_doubt)  # bounds of C/50 and 0.5 %
    slow_var = figures.SLOW_SIGMA_V**2 + (0.005**2 + (0.001 * 3.5) ** 2) / 1.96**2  # bounds of 5 mV and 0.1 % of 3.5 V
    r0_var = 0.1**2 + figures.R0_AGED_SIGMA**2 + (figures.R0_PER_K * 2 / 1.96) ** 2  # a bound of 2 K
    fast_rel = math.hypot(figures.FAST_REL, 0.2 / 1.96)  # a bound of 0.2 s
    r0, r1, tau1, r2, tau2 = 0.02, 0.012, 15.0, 0.015, 400.0
    small = 0.05 * r0  # the drop of C/100

    def beyond(drop: float) -> float:
        return drop - min(max(drop, -small), small)

    x, P = np.array([0.6, 0.01, -0.01, 0.0, 0.0]), np.diag([0.04, 1e-4, 1e-4, slow_var, r0_var])
    for k in range(2000):
        current, voltage = 2.0 * rng.standard_normal(), 3.7 + 0.05 * rng.standard_normal()
        dt = rng.uniform(0.01, 3.0)
        record.tick(dt, current, voltage, 25.0)
        drop = record.drop(x[0], 25.0, current)
        if k == 0:
            believe(record, x, P)
            recent, polarised = drop, np.zeros(2)
            continue
        a1, a2 = math.exp(-dt / tau1), math.exp(-dt / tau2)
        moved = abs(current) * dt / charge
        a_slow = math.exp(-dt / figures.SLOW_TAU_S - moved / figures.SLOW_SOC)
        a_r0 = math.exp(-dt / figures.R0_TAU_S - moved / figures.R0_SOC)
        efficiency = 0.99 if current < 0 else 1.0
        walk = offset**2 * tuning.current_error_horizon_s / charge**2 * dt + gain**2 * figures.MOVED * moved
        q1 = noise.v_rc1_sigma_V**2 + (noise.rc_rel_sigma * r1 * current) ** 2
        q2 = noise.v_rc2_sigma_V**2 + (noise.rc_rel_sigma * r2 * current) ** 2
        kept = np.array([1.0, a1, a2, a_slow, a_r0])
        charged = [(1 - a1) * r1 * current, (1 - a2) * r2 * current]
        lead = beyond(recent) + polarised.sum()  # of the sample before
        polarised = kept[1:3] * polarised + charged
        q_slow = slow_var + (offset * (r0 + r1 + r2)) ** 2 + (figures.SLOW_REL * polarised.sum()) ** 2
        q = np.array([walk, q1, q2, q_slow, r0_var]) * np.append(1.0, 1 - kept[1:] ** 2)
        x = kept * x + [-efficiency * current * dt / charge, *charged, 0.0, 0.0]
        P = np.outer(kept, kept) * P + np.diag((np.sqrt(q) + TINY_ROOT) ** 2)
        H = np.array([1.0, -1.0, -1.0, -1.0, -lead])
        white = noise.voltage_sigma_V**2 + tuning.voltage_noise_V**2 + (fast_rel * (drop - recent)) ** 2
        fast = figures.FAST_SIGMA_V**2
        # Voltages that crowd count for less: noise lasts 1 s, the fast error 40 s. None repeats.
        R = (white * max(1 / dt, 1.0) + fast * max(40.0 / dt, 1.0)) / (1 + 1 / 300)
        recent += (drop - recent) * dt / (dt + 3.0)
        S = H @ P @ H + R
        K = P @ H / S
        innovation = voltage - (3.0 + H[:4] @ x[:4] - drop - (beyond(drop) + polarised.sum()) * x[4])
        x, P = x + K * innovation, P - np.outer(K, K) * S
        assert record.x == pytest.approx(x, rel=0, abs=1e-11)
        np.testing.assert_allclose(record.P, P, rtol=0, atol=1e-12)
        alone = S - R + white + fast  # the variance of this voltage by itself
        assert [record["innovation"], record["innovation_var"]] == pytest.approx([innovation, alone], rel=0, abs=1e-11)


def lower(n: int) -> st.SearchStrategy[np.ndarray]:
    """Lower-triangular n x n factors whose diagonal spans ten decades."""
    diagonal = st.lists(st.floats(1e-9, 10), min_size=n, max_size=n)
    below = st.lists(st.floats(-3, 3), min_size=n * n, max_size=n * n)
    return st.builds(lambda d, b: np.tril(np.reshape(b, (n, n)), -1) + np.diag(d), diagonal, below)


@settings(deadline=None, max_examples=150)
@given(st.data(), st.integers(1, 3), st.booleans(), st.booleans())
def test_the_time_update_is_the_cholesky_factor_of_the_sum(data, n_rc, hysteresis, bias):
    m = form(n_rc, hysteresis, bias, False, 1, False)
    n = m.n

    def numbers(low: float, high: float) -> np.ndarray:
        return np.array(data.draw(st.lists(st.floats(low, high), min_size=n, max_size=n)))

    L, q, lost, g = data.draw(lower(n)), numbers(1e-9, 10), numbers(0, 1), numbers(-2, 2) * bias
    g[-1] = 0
    w = np.zeros(m.carry)
    w[m.root :] = L[np.tril_indices(n)]
    predicted(w, m, lost, g, np.zeros(n), q)
    root = np.zeros((n, n))
    root[np.tril_indices(n)] = w[m.root :]
    A = np.diag(1 - lost)
    A[:, -1] += g
    total = A @ L @ L.T @ A.T + np.diag(q**2)
    assert np.diag(root).min() > 0
    assert np.abs(root @ root.T - total).max() <= 1e-14 * np.abs(A @ L).max() ** 2 * n + 1e-14 * np.abs(total).max()


@settings(deadline=None, max_examples=100)
@given(
    lower(5),
    st.floats(0.5, 5.0),
    st.floats(-2, 2),
    st.floats(-2, 2),
    st.floats(1e-10, 1.0),
    st.floats(-1, 1),
    st.floats(-1, 1),
)
def test_a_measurement_never_raises_a_variance(L, g0, up, down, r, innovation, lead):
    record = Record(CELL, Tuning(**PLAIN))
    record.x, record.root = [0.5, 0.01, -0.01, 0.0, 0.0], L
    record.state[layout.H_POLARISED : layout.HELD] = 0.0
    y = np.zeros(layout.VALUES)
    y[layout.Y_FUSE], y[layout.Y_LEAD] = layout.BY_SIGMA_POINTS, lead
    buffers = record.params.ctypes.data, record.state.ctypes.data, y.ctypes.data
    innovate_and_update(*buffers, g0 + innovation, g0, g0 + up, g0 + down, r)
    assert (np.diag(record.P) <= np.diag(L @ L.T) * (1 + 1e-13)).all()
    assert np.diag(record.root).min() > 0


anything = st.tuples(
    st.one_of(st.sampled_from([0.0, 1e-9, 1.0, 60.0, 1e6]), st.floats(0, 1e9)),
    st.one_of(st.floats(-60, 120), st.floats()),
    st.one_of(st.floats(2.0, 5.0), st.floats()),
    st.one_of(st.floats(-60, 120), st.floats()),
)


@settings(deadline=None, max_examples=60)
@given(st.lists(anything, min_size=1, max_size=80), st.sampled_from([1.0, 1e-3]))
def test_no_sequence_of_inputs_makes_the_belief_infinite_or_its_root_improper(inputs, alpha):
    record = Record(CELL, Tuning(alpha=alpha))
    record.tick(0.0, 1.0, 3.6, 25.0)
    for dt, current, voltage, temperature in inputs:
        record.tick(dt, current, voltage, temperature)
        assert np.isfinite(record.x).all()
        assert np.isfinite(record.root).all()
        assert np.diag(record.root).min() > 0
        assert 0 < record.root[0, 0] <= figures.SOC_SIGMA_MAX
        assert 0 <= record["soc_low"] <= record["soc"] <= record["soc_high"] <= 1
        if record["parts"]:
            weights = record.state[-layout.PARTS :]
            assert np.isfinite(weights).all()
            assert weights.min() >= 0
            assert weights.sum() > 0


@pytest.mark.parametrize("held", ["by components", "by one Gaussian"])
@pytest.mark.parametrize("poisoned", [layout.P_CHARGE_COULOMB, layout.P_VAR_VOLTAGE, layout.P_W, layout.P_VAR_V])
@pytest.mark.parametrize("poison", [math.nan, math.inf])
def test_a_step_that_is_not_finite_leaves_the_record_bit_identical(poisoned, poison, held):
    """Spoilt parameters stand for whatever may overflow. Components and their weights are part of the record.

    The row of a table that it keeps is not: another SoC may ask for another row, whatever comes of the step.
    """
    record = Record(CELL)
    record.tick(0.0, 1.0, 3.6, 25.0)
    record.tick(1.0, 1.0, 3.6, 25.0)
    if held == "by one Gaussian":
        believe(record, record.x, np.diag([0.01, *np.diag(record.root)[1:]]) ** 2)
    assert bool(record["parts"]) == (held == "by components")
    if poisoned == layout.P_CHARGE_COULOMB and poison == math.inf:
        poison = 0.0  # an infinite capacity would do no harm
    m = record.form
    kept = [slice(0, m.cache), slice(m.size, None)]
    good, before = record.params[poisoned], [record.state[part].tobytes() for part in kept]
    record.params[poisoned] = poison
    _, faults = record.tick(1.0, 1.5, 3.61, 25.0)
    assert faults & ~Fault.UNCERTAIN == Fault.NUMERIC  # the interval of a start is wide, and stays as wide
    assert [record.state[part].tobytes() for part in kept] == before
    assert math.isnan(record["innovation"])
    record.params[poisoned] = good
    assert record.tick(1.0, 1.5, 3.61, 25.0)[1] & ~Fault.UNCERTAIN == Fault.NONE


REPLAY = """
import sys
import numpy as np
from bms_ukf import CellParams, Estimator, Sample, Tuning
rows = np.load(sys.argv[2])
estimator, out = Estimator(CellParams.load(sys.argv[1]), tuning=Tuning(initial_soc=0.7)), []
for t_ns, (_, current, voltage, temperature) in zip(rows[:, 0].cumsum() * 1e9, rows.tolist(), strict=True):
    estimator.step(Sample(int(t_ns), current, voltage, temperature))
    out.append(estimator._state.ravel()[: estimator._form.cache].copy())
np.save(sys.argv[3], out)
"""


def test_compiled_and_plain_python_runs_agree(tmp_path):
    rows = np.array(list(drive(400, varying_dt=True, seed=1)))
    rows[50:60, 2] = np.nan  # no voltage for a while
    rows[100:130, 1] = np.nan  # no current for longer than its timeout
    rows[200, 2] = 3.0  # an outlier for the gate
    rows[150:360, 1] = 0.03  # two rests with a load between
    rows[250, 1] = 3.0
    np.save(tmp_path / "in.npy", rows)
    (tmp_path / "cell.toml").write_text(synthetic_cell.as_toml(synthetic_cell.nonlinear()))
    results = []
    for disable in ("0", "1"):
        out = tmp_path / f"out{disable}.npy"
        files = [str(tmp_path / "cell.toml"), str(tmp_path / "in.npy"), str(out)]
        environment = {**os.environ, "NUMBA_DISABLE_JIT": disable}
        subprocess.run([sys.executable, "-c", REPLAY, *files], check=True, env=environment)
        results.append(np.load(out))
    compiled, plain = results
    assert np.array_equal(np.isnan(compiled), np.isnan(plain))
    np.testing.assert_allclose(compiled, plain, rtol=1e-9, atol=1e-12)
