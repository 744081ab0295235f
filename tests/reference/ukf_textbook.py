"""An unscented Kalman filter as the textbook has it, over the same cell model: what the production filter must equal.

Wan & van der Merwe, "The unscented Kalman filter" (in Haykin, Kalman Filtering and Neural Networks, 2001, ch. 7), with
additive noise: 2n + 1 sigma points from a Cholesky factor of the full covariance, redrawn after the time update. It
knows nothing of the structure of the model and uses nothing of the production filter but the cell's tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_ukf import CellParams, Tuning

Array = NDArray[np.float64]


class Ukf:
    """Mean `x` (n,) and covariance `P` (n, n); `innovation` and `S`, its variance, are those of the last `update`."""

    def __init__(self, x: Array, P: Array, alpha: float, beta: float, kappa: float) -> None:
        self.x, self.P = x, P
        self.innovation = self.S = math.nan
        n = len(x)
        lam = alpha**2 * (n + kappa) - n
        self._spread = n + lam
        self._wm = np.full(2 * n + 1, 1 / (2 * (n + lam)))
        self._wc = self._wm.copy()
        self._wm[0] = lam / (n + lam)
        self._wc[0] = self._wm[0] + 1 - alpha**2 + beta

    def sigma_points(self) -> Array:
        offsets = np.linalg.cholesky(self._spread * self.P).T
        return np.vstack([self.x, self.x + offsets, self.x - offsets])

    def predict(self, f: Callable[[Array], Array], Q: Array) -> None:
        points = np.array([f(point) for point in self.sigma_points()])
        self.x = self._wm @ points
        away = points - self.x
        self.P = (self._wc * away.T) @ away + Q

    def update(self, h: Callable[[Array], float], z: float, R: float) -> None:
        points = self.sigma_points()
        seen = np.array([h(point) for point in points])
        expected = self._wm @ seen
        away = seen - expected
        self.S = float(self._wc @ away**2 + R)
        cross = (self._wc * away) @ (points - self.x)
        gain = cross / self.S
        self.innovation = z - float(expected)
        self.x = self.x + gain * self.innovation
        self.P = self.P - np.outer(gain, gain) * self.S


@dataclass
class Cell:
    """The two-RC cell with the noise that a cell file and a tuning ask for, and the filter of its state."""

    params: CellParams
    tuning: Tuning
    ocv: Callable[[float, float], float]  # of SoC and temperature, V
    dynamics: Callable[[float, float], tuple[float, ...]]  # of the same: r0, r1, tau1, r2, tau2, knee
    ukf: Ukf | None = None
    age: float = 1.0  # s since the last voltage; before the first, none was near

    def start(self, i: float, temperature: float) -> None:
        """At `tuning.initial_soc`; current i, and C/5 more or less of it, may have flowed for long or not at all."""
        soc, tuning, noise = self.tuning.initial_soc, self.tuning, self.params.noise
        assert soc is not None
        _, r1, _, r2, _, _ = self.dynamics(soc, temperature)
        before = math.hypot(self.params.cell.capacity_Ah / 5, i / 2)
        variances = [
            tuning.initial_soc_sigma**2,
            noise.v_rc1_sigma_V**2 + (r1 * before) ** 2,
            noise.v_rc2_sigma_V**2 + (r2 * before) ** 2,
        ]
        x = np.array([soc, r1 * i / 2, r2 * i / 2])
        self.ukf = Ukf(x, np.diag(variances), tuning.alpha, tuning.beta, tuning.kappa)

    def predict(self, dt: float, i: float, temperature: float) -> None:
        assert self.ukf is not None
        self.age += dt
        noise, tuning = self.params.noise, self.tuning
        charge = 3600 * self.params.cell.capacity_Ah
        efficiency = self.params.cell.coulombic_efficiency if i < 0 else 1.0
        r0, r1, tau1, r2, tau2, _ = self.dynamics(float(self.ukf.x[0]), temperature)  # scheduled at the mean
        a1, a2 = math.exp(-dt / tau1), math.exp(-dt / tau2)
        offset = self.params.cell.capacity_Ah / 100
        walk = (offset**2 + (tuning.current_gain_sigma * i) ** 2) * tuning.current_error_horizon_s / charge**2

        def f(x: Array) -> Array:
            soc, v1, v2 = x
            return np.array(
                [soc - efficiency * i * dt / charge, a1 * v1 + (1 - a1) * r1 * i, a2 * v2 + (1 - a2) * r2 * i]
            )

        variance1 = noise.v_rc1_sigma_V**2 + (noise.rc_rel_sigma * r1 * i) ** 2 + (offset * r1) ** 2
        variance2 = noise.v_rc2_sigma_V**2 + (noise.rc_rel_sigma * r2 * i) ** 2 + (offset * (r2 + r0)) ** 2
        q1, q2 = (1 - a1**2) * variance1, (1 - a2**2) * variance2
        self.ukf.predict(f, np.diag([walk * dt, q1, q2]))

    def update(self, voltage: float, i: float, temperature: float) -> None:
        assert self.ukf is not None
        noise = self.params.noise
        r0, *_, knee = self.dynamics(float(self.ukf.x[0]), temperature)
        drop = r0 * knee * math.asinh(i / knee)
        variance = noise.voltage_sigma_V**2 + self.tuning.voltage_sensor_sigma_V**2
        variance += (noise.r0_rel_sigma * drop) ** 2
        variance /= min(self.age, 1.0)  # voltages that come faster than one a second count for less
        self.age = 0.0

        def h(x: Array) -> float:
            soc, v1, v2 = x
            return self.ocv(soc, temperature) - v1 - v2 - drop

        self.ukf.update(h, voltage, variance)
