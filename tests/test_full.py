"""The structure-blind filter: against a Kalman filter, the textbook, the production filter; and what it refuses."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numba
import numpy as np
import pytest
import synthetic_cell
from drives import CELL, PLAIN, drive, exact
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_ukf import Tuning
from bms_ukf.kernel import full, layout
from bms_ukf.kernel.adapt import FAST_S
from bms_ukf.kernel.memory import pointer
from bms_ukf.kernel.ohmic import SMALL_LOAD

N = 3
Array = np.ndarray


@numba.njit
def _draw(x: int, root: int, gamma: float, n: int, points: int) -> None:
    full.draw(pointer(x, 64), pointer(root, 64), gamma, n, pointer(points, 64))


@numba.njit
def _predict(x: int, root: int, points: int, q: int, n: int, w: float, w_cov0: float) -> int:
    return full.predict(pointer(x, 64), pointer(root, 64), pointer(points, 64), pointer(q, 64), n, w, w_cov0)


@numba.njit
def _update(
    x: int, root: int, points: int, seen: int, z: float, r: float, n: int, w: float, w_cov0: float, out: int
) -> int:
    return full.update(
        pointer(x, 64), pointer(root, 64), pointer(points, 64), pointer(seen, 64), z, r, n, w, w_cov0, pointer(out, 64)
    )


@numba.njit
def _downdate(root: int, v: int, n: int) -> bool:
    return full.downdate(pointer(root, 64), pointer(v, 64), n)


class Filter:
    """`kernel.full` over Python functions of one sigma point."""

    def __init__(self, x: Array, P: Array, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0) -> None:
        self.n = len(x)
        self.x, self.root = np.array(x, float), np.ascontiguousarray(np.linalg.cholesky(P))
        spread = alpha**2 * (self.n + kappa)
        self.gamma, self.w = math.sqrt(spread), 1 / (2 * spread)
        self.w_cov0 = 1 - 2 * self.n * self.w + 1 - alpha**2 + beta
        self.points = np.zeros((2 * self.n + 1, self.n))
        self.out = np.zeros(3)

    @property
    def P(self) -> Array:
        return self.root @ self.root.T

    def belief(self) -> bytes:
        return self.x.tobytes() + self.root.tobytes()

    def predict(self, f: Callable[[Array], Array], Q: Array) -> int:
        self._draw()
        self.points[:] = [f(point) for point in self.points]
        q = np.ascontiguousarray(np.linalg.cholesky(Q))
        return _predict(*self._addresses(), q.ctypes.data, self.n, self.w, self.w_cov0)

    def update(self, h: Callable[[Array], float], z: float, r: float) -> int:
        self._draw()
        seen = np.array([h(point) for point in self.points], float)
        out = self.out.ctypes.data
        return _update(*self._addresses(), seen.ctypes.data, z, r, self.n, self.w, self.w_cov0, out)

    def _draw(self) -> None:
        x, root, points = self._addresses()
        _draw(x, root, self.gamma, self.n, points)

    def _addresses(self) -> tuple[int, int, int]:
        return self.x.ctypes.data, self.root.ctypes.data, self.points.ctypes.data


class Past(NamedTuple):
    """What the currents so far have left behind: low-pass of the ohmic drop and the RC voltages by it alone, V."""

    recent: float
    polarised: Array

    def after(self, record, dt: float, i: float, T: float, mean: float) -> Past:
        here = record.dynamics(mean, T)
        a = np.array([math.exp(-dt / here["tau1_s"]), math.exp(-dt / here["tau2_s"])])
        charged = (1 - a) * i * np.array([here["r1_ohm"], here["r2_ohm"]])
        drop = record.drop(mean, T, i)
        return Past(self.recent + (drop - self.recent) * dt / (dt + 3.0), a * self.polarised + charged)


def over(drop: float, small: float) -> float:
    """The part of a drop beyond that of a small load."""
    return drop - min(max(drop, -small), small)


def cell_model(record, dt: float, i: float, T: float, before: Array, past: Past, scheduled: bool):
    """Process, its noise and measurement of CELL from `before`, the mean; tables at the mean SoC, or at each point."""
    efficiency = 0.99 if i < 0 else 1.0
    mean = before[0] - efficiency * i * dt / 18000
    p = record.params
    moved = abs(i) * dt
    kept = [
        math.exp(-dt / p[tau] - p[rate] * moved)
        for tau, rate in ((layout.P_SLOW_TAU, layout.P_SLOW_RATE), (layout.P_R0_TAU, layout.P_R0_RATE))
    ]

    def at(soc: float) -> dict[str, float]:
        return record.dynamics(mean if scheduled else soc, T)

    def f(x: Array) -> Array:
        soc = x[0] - efficiency * i * dt / 18000
        here = at(soc)
        a1, a2 = math.exp(-dt / here["tau1_s"]), math.exp(-dt / here["tau2_s"])
        v1, v2 = a1 * x[1] + (1 - a1) * here["r1_ohm"] * i, a2 * x[2] + (1 - a2) * here["r2_ohm"] * i
        return np.array([soc, v1, v2, kept[0] * x[3], kept[1] * x[4]])

    here = record.dynamics(mean, T)
    q = [dt * p[layout.P_SOC_WALK_OFFSET] + p[layout.P_SOC_WALK_GAIN] * moved]
    for j in (1, 2):
        error = p[layout.P_RC_REL] * here[f"r{j}_ohm"] * i
        variance = p[layout.P_VAR_V + j - 1] + error**2
        q.append(-math.expm1(-2 * dt / here[f"tau{j}_s"]) * variance)
    polarised = past.after(record, dt, i, T, mean).polarised.sum()
    offset = p[layout.P_BIAS_SIGMA] * (here["r0_ohm"] + here["r1_ohm"] + here["r2_ohm"])
    slow = p[layout.P_SLOW_VAR] + offset**2 + (p[layout.P_SLOW_REL] * polarised) ** 2
    q += [(1 - a**2) * variance for a, variance in zip(kept, (slow, p[layout.P_R0_VAR]), strict=True)]
    drop = record.drop(mean, T, i)
    fast = (p[layout.P_FAST_REL] * (drop - past.recent)) ** 2
    r = (p[layout.P_VAR_VOLTAGE] + p[layout.P_FAST_VAR] * FAST_S / dt + fast) / (1 + 1 / 300)
    small = SMALL_LOAD * p[layout.P_STILL] * here["r0_ohm"]
    lead = over(past.recent, small) + past.polarised.sum()
    now = over(drop, small) + polarised
    error = kept[1] * before[4]

    def h(x: Array) -> float:
        return record.ocv(x[0], T) - x[1] - x[2] - x[3] - drop - now * error - lead * (x[4] - error)

    return f, np.diag(q), h, r, mean


def over_a_drive(alpha: float, scheduled: bool, steps: int) -> tuple[Array, Array]:
    """Largest differences of x and of P from the production filter's, and the largest of each."""
    record = exact(CELL, Tuning(initial_soc=0.8, initial_soc_sigma=0.1, alpha=alpha, **PLAIN))
    worst, largest, blind, past = np.zeros(2), np.zeros(2), None, None
    for k, (dt, current, voltage, T) in enumerate(drive(steps, varying_dt=False, seed=5)):
        if k > 0:
            f, Q, h, r, mean = cell_model(record, dt, current, T, blind.x, past, scheduled)
            past = past.after(record, dt, current, T, mean)
            assert blind.predict(f, Q) == 0
            assert blind.update(h, voltage, r) == full.FUSED
        record.tick(dt, current, voltage, T)
        if blind is None:
            x, sigma = np.array([0.8, 0.01, -0.01, 0.0, 0.0]), np.array([0.1, 0.01, 0.01, 0.005, 0.2])
            blind, past = Filter(x, np.diag(sigma**2), alpha), Past(record.drop(0.8, T, current), np.zeros(2))
            record.x, record.root, record["parts"] = x, np.diag(sigma), 0.0  # one Gaussian from here on
        worst = np.maximum(worst, [np.abs(record.x - blind.x).max(), np.abs(record.P - blind.P).max()])
        largest = np.maximum(largest, [1.0, np.abs(record.P).max()])
    assert record.root[0, 0] < 0.02
    return worst, largest


@pytest.mark.parametrize(("alpha", "tolerance"), [(1.0, 1e-9), (1e-3, 1e-7)])
def test_over_a_drive_it_is_the_production_filter(alpha, tolerance):
    worst, _ = over_a_drive(alpha, scheduled=True, steps=1500)
    assert worst.max() < tolerance, worst


def test_reading_the_rc_tables_at_the_mean_soc_costs_less_than_a_twentieth_of_a_percent():
    """Against each sigma point reading them for itself, over a drive that starts with 10 % sigma."""
    worst, _ = over_a_drive(1.0, scheduled=False, steps=1500)
    assert 1e-9 < worst[0] < 5e-4, worst


def test_on_a_linear_system_with_a_full_matrix_it_is_a_kalman_filter():
    rng = np.random.default_rng(8)
    for alpha in (1.0, 0.1):
        n = 5
        A, H = rng.standard_normal((n, n)), rng.standard_normal(n)
        A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
        G = rng.standard_normal((n, n))
        Q, r = G @ G.T / 10 + 1e-3 * np.eye(n), 0.1
        x, P = rng.standard_normal(n), np.eye(n)
        blind = Filter(x, P, alpha)
        for _ in range(200):
            z = float(rng.standard_normal())
            assert blind.predict(lambda v, A=A: A @ v, Q) == 0
            assert blind.update(lambda v, H=H: float(H @ v), z, r) == full.FUSED
            x, P = A @ x, A @ P @ A.T + Q
            S = H @ P @ H + r
            K = P @ H / S
            assert blind.out == pytest.approx([H @ x, z - H @ x, S], rel=1e-9, abs=1e-9)
            x, P = x + K * (z - H @ x), P - np.outer(K, K) * S
            np.testing.assert_allclose(blind.x, x, rtol=0, atol=1e-9 * max(1, np.abs(x).max()))
            np.testing.assert_allclose(blind.P, P, rtol=0, atol=1e-9 * np.abs(P).max())


@settings(deadline=None, max_examples=80)
@given(st.integers(1, layout.N_MAX), st.integers(0, 10**6), st.floats(0.0, 0.999))
def test_a_downdate_is_the_factor_of_the_difference(n, seed, share):
    rng = np.random.default_rng(seed)
    G = rng.standard_normal((n, n + 2))
    root = np.ascontiguousarray(np.linalg.cholesky(G @ G.T))
    direction = rng.standard_normal(n)
    v = root @ (share * direction / np.linalg.norm(direction))
    expected = root @ root.T - np.outer(v, v)
    assert _downdate(root.ctypes.data, v.ctypes.data, n)
    assert np.diag(root).min() > 0
    np.testing.assert_allclose(root @ root.T, expected, rtol=0, atol=1e-9 * np.abs(G @ G.T).max())


def test_more_cannot_be_taken_than_there_is():
    root, v = np.eye(3), np.array([0.0, 1.0 + 1e-9, 0.0])
    assert not _downdate(root.ctypes.data, v.ctypes.data, 3)


def test_a_downdate_that_fails_leaves_the_time_update_wider_and_is_counted():
    """With beta = -1 the first point of a process with a kink takes more off than the others give."""
    blind = Filter(np.zeros(N), np.eye(N), alpha=0.1, beta=-1.0)
    left_out = blind.predict(lambda x: np.abs(x) * 5, 1e-12 * np.eye(N))
    assert left_out == 1
    assert np.diag(blind.root).min() > 0
    assert np.isfinite(blind.P).all()


def test_a_measurement_that_takes_more_than_there_is_leaves_the_belief_bit_identical():
    blind = Filter(np.zeros(N), np.eye(N), alpha=0.1, beta=-1.0)
    before = blind.belief()
    assert blind.update(lambda x: abs(x[0]) * 5, 1.0, 1e-9) == full.DOWNDATE_FAILED
    assert blind.belief() == before
    assert blind.update(lambda x: x[0], 1.0, 1e-3) == full.FUSED


@pytest.mark.parametrize("poison", [math.nan, math.inf])
def test_what_is_not_finite_leaves_the_belief_bit_identical(poison):
    blind = Filter(np.zeros(N), np.eye(N))
    before = blind.belief()
    assert blind.predict(lambda x: x + poison, np.eye(N)) == -1
    assert blind.update(lambda x: poison, 1.0, 1e-3) == full.NOT_FINITE
    assert blind.update(lambda x: x[0], poison, 1e-3) == full.NOT_FINITE
    assert blind.belief() == before


def test_a_voltage_that_is_not_linear_in_the_rest_is_met_too():
    """Where `srukf` may not go: a product of two states, against the textbook's covariance form."""
    from ukf_textbook import Ukf

    x, P = np.array([0.5, 0.2, -0.1]), np.diag([0.04, 0.01, 0.02])
    blind, textbook = Filter(x, P), Ukf(x, P, 1.0, 2.0, 0.0)
    for z in (0.3, 0.1, 0.4):

        def f(v: Array) -> Array:
            return np.array([v[0] + 0.1 * math.sin(v[1]), 0.9 * v[1] + 0.1 * v[0] * v[2], 0.8 * v[2]])

        def h(v: Array) -> float:
            return float(v[0] * v[1] + v[2] ** 2)

        blind.predict(f, 1e-3 * np.eye(3))
        textbook.predict(f, 1e-3 * np.eye(3))
        blind.update(h, z, 1e-2)
        textbook.update(h, z, 1e-2)
        np.testing.assert_allclose(blind.x, textbook.x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(blind.P, textbook.P, rtol=0, atol=1e-12)


def test_the_cell_has_tables_over_soc():
    """Else the comparison of reading them at the mean would be of nothing."""
    assert len(set(synthetic_cell.nonlinear()["dynamics"]["r1_ohm"][2])) > 2
