"""A dense, independent posterior of SoC: the oracle of `kernel.parts`.

Each start is one hypothesis of SoC at the first voltage and of the history before it. Given the hypothesis all else is
Gaussian to first order, so each has an extended Kalman filter of its own, in plain covariances: deviation of SoC, RC
voltages, hysteresis, slow voltage error, r0 error, bias of the current sensor. The voltages weigh the hypotheses.
Hypotheses are never merged, moved or placed again. SoC is 0..1, voltages are in V, currents in A.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from bms_ukf import CellParams, Tuning
from bms_ukf.kernel import histories
from bms_ukf.kernel import layout as k
from bms_ukf.kernel.adapt import FAST_S
from bms_ukf.kernel.ohmic import SMALL_LOAD
from bms_ukf.kernel.params import params

Array = NDArray[np.float64]
RECENT_S = 3.0
REPEATS_S = 60.0


class DenseBelief:
    """The posterior after a first sample and those that `step` adds; `bounds` are its 2.5 % and 97.5 % quantiles."""

    def __init__(
        self, cell: CellParams, current_A: float, voltage_V: float, degC: float, points: int = 2001, **prior: float
    ) -> None:
        """`prior`: `mean` and `sigma` of SoC, if anything is known of it."""
        self.cell, p = cell, params(cell, Tuning())
        self.p = p
        one = (np.arange(points) + 0.5) / points
        self.start = np.concatenate([one, one])
        loaded = np.repeat([0.0, 1.0], points)
        n_rc = cell.dynamics.n_rc
        hysteresis = int(cell.hysteresis is not None)
        self.n_rc, self.n = n_rc, 1 + n_rc + hysteresis + 3
        self.x = np.zeros((2 * points, self.n))
        self.P = np.zeros((2 * points, self.n, self.n))
        self.recent, self.seen = np.nan, False
        self.last, self.same = np.nan, 0.0
        self.polarised = [0.0] * n_rc
        self._tables(degC)
        r = self.r
        error2 = self.error**2
        history = np.where(loaded, p[k.P_HISTORY], p[k.P_INITIAL_CURRENT])
        for j in range(n_rc):
            self.x[:, 1 + j] = loaded * r[j] * current_A / 2
            self.P[:, 1 + j, 1 + j] = error2 * p[k.P_VAR_V + j] + (r[j] * history) ** 2
        if hysteresis:
            self.P[:, 1 + n_rc, 1 + n_rc] = error2 * p[k.P_VAR_V + n_rc] + self.largest**2 / 3
        slow = self.n - 3
        slow_var = np.maximum(error2, 1) * error2 * p[k.P_SLOW_VAR] + self.offset_V**2
        self.P[:, slow, slow] = slow_var * np.where(loaded, histories.LOADED_SLOW**2, 1)
        self.P[:, slow + 1, slow + 1] = p[k.P_R0_VAR]
        self.P[:, slow + 2, slow + 2] = p[k.P_BIAS_SIGMA] ** 2
        mean, sigma = prior.get("mean", p[k.P_INITIAL_SOC]), prior.get("sigma", p[k.P_INITIAL_SIGMA])
        idle = abs(current_A) <= p[k.P_EXCITED] / 2
        parked = histories.PARKED if idle else histories.LOADED_YET_PARKED
        density = np.exp(-(((self.start - mean) / sigma) ** 2) / 2) / (sigma * np.sqrt(2 * np.pi))
        belief = histories.STRAY + (1 - histories.STRAY) * density
        self.log_weight = np.log(belief * np.where(loaded, 1 - parked, parked))
        self._fuse(current_A, voltage_V, degC)

    def step(self, dt: float, current_A: float, voltage_V: float, degC: float) -> None:
        p, n_rc, n = self.p, self.n_rc, self.n
        charge = p[k.P_CHARGE_COULOMB]
        self._tables(degC, -current_A * dt / charge)
        error2 = self.error**2
        A = np.zeros((len(self.x), n, n))
        Q = np.zeros((len(self.x), n))
        move = np.zeros((len(self.x), n))
        A[:, 0, 0] = 1
        A[:, 0, -1] = dt / charge
        self.start = self.start - current_A * dt / charge
        Q[:, 0] = p[k.P_SOC_WALK_GAIN] * abs(current_A) * dt + dt * p[k.P_SOC_WALK_OFFSET]
        for j in range(n_rc):
            a = np.exp(-dt / self.tau[j])
            A[:, 1 + j, 1 + j] = a
            move[:, 1 + j] = self.r[j] * current_A * (1 - a)
            self.polarised[j] = a * self.polarised[j] + move[:, 1 + j]
            stationary = error2 * (p[k.P_VAR_V + j] + (p[k.P_RC_REL] * self.r[j] * current_A) ** 2)
            Q[:, 1 + j] = (1 - a**2) * stationary
        if n > n_rc + 4:
            a = np.exp(-p[k.P_HYSTERESIS_RATE] * abs(current_A) * dt)
            A[:, 1 + n_rc, 1 + n_rc] = a
            move[:, 1 + n_rc] = (1 - a) * self.largest * (1 if current_A >= 0 else -1)
            Q[:, 1 + n_rc] = (1 - a**2) * error2 * p[k.P_VAR_V + n_rc]
        slow_var = (
            error2 * p[k.P_SLOW_VAR] + self.offset_V**2 + (p[k.P_SLOW_REL] * self._common(sum(self.polarised))) ** 2
        )
        stationaries = (slow_var, p[k.P_R0_VAR], p[k.P_BIAS_SIGMA] ** 2)
        moved = abs(current_A)
        slow, r0 = p[k.P_SLOW_RATE] * moved + 1 / p[k.P_SLOW_TAU], p[k.P_R0_RATE] * moved + 1 / p[k.P_R0_TAU]
        rates = slow, r0, 1 / p[k.P_BIAS_TAU]
        for row, rate, stationary in zip(range(n - 3, n), rates, stationaries, strict=True):
            a = np.exp(-dt * rate)
            A[:, row, row] = a
            Q[:, row] = (1 - a**2) * stationary
        self.x = np.einsum("pij,pj->pi", A, self.x) + move
        self.P = A @ self.P @ A.transpose(0, 2, 1)
        self.P[:, np.arange(n), np.arange(n)] += Q
        self._fuse(current_A, voltage_V, degC, dt)

    def bounds(self) -> tuple[float, float]:
        weight = np.exp(self.log_weight - self.log_weight.max())
        soc, sigma = self.start + self.x[:, 0], np.sqrt(self.P[:, 0, 0])
        grid = np.linspace(0, 1, 4001)
        below = np.array([weight @ ndtr((s - soc) / np.maximum(sigma, 1e-6)) for s in grid])
        below = (below - below[0]) / (below[-1] - below[0])
        return float(np.interp(0.025, below, grid)), float(np.interp(0.975, below, grid))

    def _tables(self, degC: float, ahead: float = 0.0) -> None:
        soc = np.clip(self.start + self.x[:, 0] + ahead, 0, 1)
        table = self.cell.dynamics_at(soc, degC)
        values = list(table.values())
        self.r0, self.r0_charge, self.knee, self.error = values[:4]
        self.r, self.tau = values[4 : 4 + 2 * self.n_rc : 2], values[5 : 4 + 2 * self.n_rc : 2]
        self.largest = values[-1] if self.cell.hysteresis else None
        self.offset_V = self.p[k.P_BIAS_SIGMA] * (self.r0 + sum(self.r))

    def _common(self, values: Array) -> float:
        """What one Gaussian of all hypotheses would read: `values` at their mean SoC."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        soc = self.start + self.x[:, 0]
        half = len(soc) // 2
        return float(np.interp(weight @ soc / weight.sum(), soc[:half], np.broadcast_to(values, soc.shape)[:half]))

    def _fuse(self, current_A: float, voltage_V: float, degC: float, dt: float = 1.0) -> None:
        p, n = self.p, self.n
        r0 = self.r0 if current_A >= 0 else self.r0_charge
        drop = r0 * self.knee * np.arcsinh(current_A / self.knee)
        common, common_r0 = (self._common(values) for values in (drop, r0)) if self.seen else (drop, r0)
        self.recent = self.recent if self.seen else drop
        small = SMALL_LOAD * p[k.P_STILL] * common_r0
        drop = common + beyond(self.recent, small) * (r0 / common_r0 - 1)
        soc, h = self.start + self.x[:, 0], 1e-4
        ocv = self.cell.ocv_V(soc, degC)
        H = np.full((len(soc), n), -1.0)
        H[:, 0] = (self.cell.ocv_V(soc + h, degC) - self.cell.ocv_V(soc - h, degC)) / (2 * h)
        polarised = self._common(sum(self.polarised)) if self.seen else 0.0
        H[:, -2], H[:, -1] = -(beyond(self.recent, small) + polarised), 0.0
        now = beyond(drop, small) + polarised
        expected = ocv - drop - now * self.x[:, -2] - self.x[:, 1 : n - 2].sum(axis=1)
        fast = p[k.P_FAST_REL] * (common - self.recent)
        self.recent = self.recent + (common - self.recent) * dt / (dt + RECENT_S)
        self.same += (float(voltage_V == self.last) - self.same) * dt / (dt + REPEATS_S)
        self.last = voltage_V
        crowd = FAST_S / dt if self.seen else 1.0
        r = self.error**2 * (p[k.P_VAR_VOLTAGE] + crowd * p[k.P_FAST_VAR]) + fast**2
        r /= 1 + 1 / 300 - self.same
        PH, self.P0 = np.einsum("pij,pj->pi", self.P, H), self.P[:, 0, 0].copy()
        S = np.einsum("pi,pi->p", H, PH) + r
        innovation = voltage_V - expected
        self.x += PH * (innovation / S)[:, None]
        self.P -= PH[:, :, None] * PH[:, None, :] / S[:, None, None]
        if self.seen:  # all hypotheses share the variance that is not of their own SoC (`gaussian_sum.weigh`)
            by_soc = PH[:, 0] ** 2 / np.maximum(self.P0, 1e-30)
            weight = np.exp(self.log_weight - self.log_weight.max())
            total = weight @ (S - by_soc) / weight.sum() + by_soc
            self.log_weight -= 0.5 * (innovation**2 / total + np.log(total))
        else:
            self.log_weight -= 0.5 * (innovation**2 / S + np.log(S))
        self.log_weight -= self.log_weight.max()
        self.seen = True


def beyond(drop: Array, small: Array) -> Array:
    return drop - np.clip(drop, -small, small)
