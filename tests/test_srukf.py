"""The filter against filters written otherwise, and the properties that no sequence of inputs may break."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Iterator

import numba
import numpy as np
import pytest
import synthetic_cell
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_record import ROOT, N, Record
from ukf_textbook import Cell

from bms_ukf import Fault, Tuning
from bms_ukf.kernel import layout, srukf
from bms_ukf.kernel.memory import pointer_f64
from bms_ukf.kernel.step import TINY_ROOT

CELL = synthetic_cell.cell_of(synthetic_cell.nonlinear())
LINEAR = synthetic_cell.cell_of(synthetic_cell.linear())
# Sigma points alone: neither the gate nor the quadrature for wide beliefs (`test_wide`) steps in.
PLAIN = {"gate_sigmas": 1e6, "wide_soc_sigma": 0.5}


@numba.njit
def triangularise(root: int, q: int, n: int) -> None:
    srukf.triangularise(pointer_f64(root), n, pointer_f64(root), pointer_f64(q))


@numba.njit
def innovate_and_update(
    params: int, state: int, z: float, drop: float, g0: float, g_plus: float, g_minus: float, r: float
) -> bool:
    s = pointer_f64(state)
    return srukf.innovate(pointer_f64(params), s, 0, N, z, drop, g0, g_plus, g_minus, r) and srukf.update(s, 0, N)


@numba.njit
def predict(state: int, a: int, c: int, q: int) -> bool:
    return srukf.predict(pointer_f64(state), 0, N, pointer_f64(a), pointer_f64(c), pointer_f64(q))


def drive(steps: int, varying_dt: bool, seed: int) -> Iterator[tuple[float, float, float, float]]:
    """(dt, current, voltage, temperature) of a noisy drive from 90 % that warms up, voltage from a cell of its own."""
    rng = np.random.default_rng(seed)
    model = Record(CELL)
    soc, v1, v2, current = 0.9, 0.0, 0.0, 0.0
    for k in range(steps):
        dt = float(rng.choice([0.01, 0.1, 0.7, 1.0, 3.3])) if varying_dt else 1.0
        temperature = 10.0 + 20.0 * k / steps
        current = 0.9 * current + 0.1 * 2.5 + rng.standard_normal() - (0.8 if k % 97 > 85 else 0.0)
        _, r1, tau1, r2, tau2, _ = model.dynamics(soc, temperature)
        soc -= current * dt / 18000
        v1 += (r1 * current - v1) * -math.expm1(-dt / tau1)
        v2 += (r2 * current - v2) * -math.expm1(-dt / tau2)
        voltage = model.ocv(soc, temperature) - v1 - v2 - model.drop(soc, temperature, current)
        voltage += 0.004 * rng.standard_normal()
        yield dt, current, voltage, temperature + 0.2 * rng.standard_normal()


@pytest.mark.parametrize("varying_dt", [False, True], ids=["1 Hz", "any dt"])
# At alpha = 1e-3 the textbook's weights are near 1e6, which costs it, not the production form, six digits.
@pytest.mark.parametrize(("alpha", "tolerance"), [(1.0, 1e-10), (1e-3, 1e-8)])
def test_every_step_of_a_drive_equals_the_textbook_filter(alpha, tolerance, varying_dt):
    tuning = Tuning(initial_soc=0.6, initial_soc_sigma=0.2, alpha=alpha, **PLAIN)
    record = Record(CELL, tuning)
    twin = Cell(CELL, tuning, record.ocv, record.dynamics)
    worst = np.zeros(4)
    for k, (dt, current, voltage, temperature) in enumerate(drive(3000, varying_dt, seed=7)):
        _, faults = record.tick(dt, current, voltage, temperature)
        assert not faults & (Fault.NUMERIC | Fault.VOLTAGE_IMPLAUSIBLE | Fault.CURRENT_IMPLAUSIBLE)
        if k == 0:
            twin.start(current, temperature)
        else:
            twin.predict(dt, current, temperature)
        twin.update(voltage, current, temperature)
        ukf = twin.ukf
        differences = (
            record.x - ukf.x,
            record.P - ukf.P,
            record["innovation"] - ukf.innovation,
            record["innovation_var"] - ukf.S,
        )
        worst = np.maximum(worst, [np.abs(difference).max() for difference in differences])
    assert worst.max() < tolerance, worst
    assert record.root[0, 0] < 0.01  # the voltages did correct it


@pytest.mark.parametrize("alpha", [1.0, 0.1])
def test_on_a_linear_cell_it_is_a_kalman_filter(alpha):
    tuning = Tuning(initial_soc=0.6, initial_soc_sigma=0.2, alpha=alpha, **PLAIN)
    record = Record(LINEAR, tuning)
    rng = np.random.default_rng(3)
    noise, charge = LINEAR.noise, 18000.0
    r0, r1, tau1, r2, tau2 = 0.02, 0.012, 15.0, 0.015, 400.0
    H = np.array([1.0, -1.0, -1.0])
    for k in range(2000):
        current, voltage = 2.0 * rng.standard_normal(), 3.7 + 0.05 * rng.standard_normal()
        dt = rng.uniform(0.01, 3.0)
        record.tick(dt, current, voltage, 25.0)
        if k == 0:
            x = np.array([0.6, r1 * current / 2, r2 * current / 2])
            before = 1.0 + (current / 2) ** 2  # C/5 is 1 A
            P = np.diag([0.04, noise.v_rc1_sigma_V**2 + r1**2 * before, noise.v_rc2_sigma_V**2 + r2**2 * before])
        else:
            a1, a2 = math.exp(-dt / tau1), math.exp(-dt / tau2)
            efficiency = 0.99 if current < 0 else 1.0
            walk = (0.05**2 + (0.01 * current) ** 2) * tuning.current_error_horizon_s / charge**2
            q = np.array(
                [
                    walk * dt,
                    (1 - a1**2)
                    * (noise.v_rc1_sigma_V**2 + (noise.rc_rel_sigma * r1 * current) ** 2 + (0.05 * r1) ** 2),
                    (1 - a2**2)
                    * (noise.v_rc2_sigma_V**2 + (noise.rc_rel_sigma * r2 * current) ** 2 + (0.05 * (r2 + r0)) ** 2),
                ]
            )
            A = np.diag([1.0, a1, a2])
            c = [-efficiency * current * dt / charge, (1 - a1) * r1 * current, (1 - a2) * r2 * current]
            x = A @ x + c
            P = A @ P @ A.T + np.diag((np.sqrt(q) + TINY_ROOT) ** 2)
        drop = record.drop(x[0], 25.0, current)
        R = noise.voltage_sigma_V**2 + tuning.voltage_sensor_sigma_V**2 + (noise.r0_rel_sigma * drop) ** 2
        R /= 1.0 if k == 0 else min(dt, 1.0)  # voltages that come faster than one a second count for less
        S = H @ P @ H + R
        K = P @ H / S
        innovation = voltage - (3.0 + H @ x - drop)
        x, P = x + K * innovation, P - np.outer(K, K) * S
        assert record.x == pytest.approx(x, rel=0, abs=1e-12)
        np.testing.assert_allclose(record.P, P, rtol=0, atol=1e-12)
        assert [record["innovation"], record["innovation_var"]] == pytest.approx([innovation, S], rel=0, abs=1e-12)


def lower(n: int) -> st.SearchStrategy[np.ndarray]:
    """Lower-triangular n x n factors whose diagonal spans ten decades."""
    diagonal = st.lists(st.floats(1e-9, 10), min_size=n, max_size=n)
    below = st.lists(st.floats(-3, 3), min_size=n * n, max_size=n * n)
    return st.builds(lambda d, b: np.tril(np.reshape(b, (n, n)), -1) + np.diag(d), diagonal, below)


@settings(deadline=None, max_examples=100)
@given(st.data(), st.integers(1, layout.N_MAX))
def test_triangularise_is_the_cholesky_factor_of_the_sum(data, n):
    L = data.draw(lower(n))
    q = np.array(data.draw(st.lists(st.floats(1e-9, 10), min_size=n, max_size=n)))
    packed = L[np.tril_indices(n)].copy()
    triangularise(packed.ctypes.data, q.ctypes.data, n)
    root = np.zeros((n, n))
    root[np.tril_indices(n)] = packed
    total = L @ L.T + np.diag(q**2)
    assert np.diag(root).min() > 0
    assert np.abs(root @ root.T - total).max() <= 1e-14 * np.abs(total).max()


@settings(deadline=None, max_examples=100)
@given(lower(N), st.floats(0.5, 5.0), st.floats(-2, 2), st.floats(-2, 2), st.floats(1e-10, 1.0), st.floats(-1, 1))
def test_a_measurement_never_raises_a_variance(L, g0, up, down, r, innovation):
    record = Record(CELL)
    record.state[:N] = 0.5, 0.01, -0.01
    record.state[ROOT] = L[np.tril_indices(N)]
    z = g0 + innovation
    assert innovate_and_update(record.params.ctypes.data, record.state.ctypes.data, z, 0.0, g0, g0 + up, g0 + down, r)
    after = record.P
    assert (np.diag(after) <= np.diag(L @ L.T) * (1 + 1e-13)).all()
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
        assert 0 < record.root[0, 0] <= 0.5


@pytest.mark.parametrize("poison", [math.nan, math.inf, 1e308])
def test_a_prediction_that_is_not_finite_leaves_the_record_bit_identical(poison):
    record = Record(CELL)
    record.tick(0.0, 1.0, 3.6, 25.0)
    before = record.state.tobytes()
    good = {"a": np.ones(N), "c": np.zeros(N), "q": np.full(N, 1e-3)}
    for name in good:
        a, c, q = ({**good, name: np.full(N, poison)}[key] for key in "acq")
        if name == "c" and poison == 1e308:
            continue  # 1e308 added to a state is finite
        assert not predict(record.state.ctypes.data, a.ctypes.data, c.ctypes.data, q.ctypes.data), name
        assert record.state.tobytes() == before
    a, c, q = good.values()
    assert predict(record.state.ctypes.data, a.ctypes.data, c.ctypes.data, q.ctypes.data)
    assert record.state.tobytes() != before


@pytest.mark.parametrize("slot", range(6), ids=["z", "drop", "g0", "g_plus", "g_minus", "r"])
def test_an_innovation_that_is_not_finite_leaves_the_record_bit_identical(slot):
    record = Record(CELL)
    record.tick(0.0, 1.0, 3.6, 25.0)
    before = record.state.tobytes()
    inputs = [3.6, 0.1, 3.7, 3.8, 3.6, 1e-5]
    for poison in (math.nan, math.inf):
        spoilt = [poison if k == slot else value for k, value in enumerate(inputs)]
        assert not innovate_and_update(record.params.ctypes.data, record.state.ctypes.data, *spoilt)
        assert record.state.tobytes() == before
    assert innovate_and_update(record.params.ctypes.data, record.state.ctypes.data, *inputs)


REPLAY = """
import sys
import numpy as np
from bms_ukf import CellParams, Estimator, Sample, Tuning
rows = np.load(sys.argv[2])
estimator, out = Estimator(CellParams.load(sys.argv[1]), tuning=Tuning(initial_soc=0.7)), []
for t_ns, (_, current, voltage, temperature) in zip(rows[:, 0].cumsum() * 1e9, rows.tolist(), strict=True):
    estimator.step(Sample(int(t_ns), current, voltage, temperature))
    out.append(np.frombuffer(estimator.snapshot()[-8 * estimator._state.size:]).copy())
np.save(sys.argv[3], out)
"""


def test_compiled_and_plain_python_runs_agree(tmp_path):
    rows = np.array(list(drive(400, varying_dt=True, seed=1)))
    rows[50:60, 2] = np.nan  # no voltage for a while
    rows[100:130, 1] = np.nan  # no current for longer than its timeout
    rows[200, 2] = 3.0  # an outlier for the gate
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
