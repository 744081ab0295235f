"""An unscented Kalman filter as the textbook has it, over the same cell model: what the production filter must equal.

Wan & van der Merwe, "The unscented Kalman filter" (in Haykin, Kalman Filtering and Neural Networks, 2001, ch. 7), with
additive noise: 2n + 1 sigma points from a Cholesky factor of the full covariance, redrawn after the time update. The
bias takes part of its gain only (Brink, "Partial-update Schmidt-Kalman filter", J. Guid. Control Dyn. 40(9), 2017). It
uses no structure of the model, and of the production filter only the cell's tables and the figures of its model errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_ukf import CellParams, Tuning
from bms_ukf.kernel import params as figures

Array = NDArray[np.float64]
RECENT_S = 3.0  # how long a change of the current leaves a fast voltage error
FAST_S = 40.0  # how long a fast error of the model lasts: readings that crowd in so long are together worth one
SMALL_LOAD_PER_H = 0.01  # of the capacity: the drop of less says nothing of r0
REPEATS_S = 60.0  # over which the share of repeated readings is taken
REPEATS_MOST = 300.0  # readings that count as one at most


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

    def update(self, h: Callable[[Array], float], z: float, R: float, trust: float = 1.0) -> None:
        """`trust`: the share of its gain that the last state takes; what it does not learn stays in its variance."""
        points = self.sigma_points()
        seen = np.array([h(point) for point in points])
        expected = self._wm @ seen
        away = seen - expected
        self.S = float(self._wc @ away**2 + R)
        cross = (self._wc * away) @ (points - self.x)
        gain = cross / self.S
        self.innovation = z - float(expected)
        refused = np.zeros_like(gain)
        refused[-1] = (1 - trust) * gain[-1]
        self.x = self.x + (gain - refused) * self.innovation
        self.P = self.P - (np.outer(gain, gain) - np.outer(refused, refused)) * self.S

    def explained(self, h: Callable[[float], float]) -> float:
        """Variance of `h`, a function of the first state, as far as it goes with that state."""
        points = self.sigma_points()[:, 0]
        seen = np.array([h(point) for point in points])
        cross = (self._wc * (seen - self._wm @ seen)) @ (points - self.x[0])
        return float(cross**2 / self.P[0, 0])


@dataclass
class Cell:
    """The cell with the noise that a cell file and a tuning ask for, and the filter of its state.

    x = [soc, v_rc1.., v_hyst?, v_slow, r0_error, bias?]: `n_pol` polarisation voltages, then the slow voltage error.
    """

    params: CellParams
    tuning: Tuning
    ocv: Callable[[float, float], float]  # of SoC and temperature, V
    dynamics: Callable[[float, float], dict[str, float]]  # of the same
    ukf: Ukf | None = None
    age: float = 1.0  # s since the last voltage; before the first, none was near
    own_var: float = math.nan  # of the last innovation, V^2, had its voltage been alone

    def __post_init__(self) -> None:
        cell, noise, spec = self.params.cell, self.params.noise, self.tuning.sensor_spec
        self.n_rc = self.params.dynamics.n_rc
        self.n_pol = self.n_rc + (self.params.hysteresis is not None)
        self.slow, self.r0 = 1 + self.n_pol, 2 + self.n_pol
        self.sigmas = [getattr(noise, f"v_rc{j}_sigma_V") for j in range(1, self.n_rc + 1)]
        self.charge = 3600 * cell.capacity_Ah
        self.offset = spec.current_offset_sigma_A(cell.capacity_Ah)
        self.gain = math.hypot(spec.current_gain / 1.96, self.tuning.capacity_doubt)
        nominal = float(self.params.ocv_V(0.5, 25.0))
        self.slow_var = figures.SLOW_SIGMA_V**2 + spec.voltage_offset_sigma_V(nominal) ** 2
        self.r0_var = noise.r0_rel_sigma**2 + figures.R0_AGED_SIGMA**2
        self.r0_var += (figures.R0_PER_K * spec.temperature_sigma_K) ** 2
        self.white = noise.voltage_sigma_V**2 + self.tuning.voltage_white_var_V2
        self.fast_var = figures.FAST_SIGMA_V**2
        if self.params.hysteresis:
            self.fast_var += (figures.FAST_HYSTERESIS * float(np.median(self.params.hysteresis.max_V))) ** 2
        self.fast_rel = math.hypot(figures.FAST_REL, spec.skew_sigma_s)
        self.repeats, self.last = 0.0, math.nan

    def start(self, i: float, voltage: float, temperature: float) -> None:
        """At `tuning.initial_soc`; current i, and C/20 more or less of it, may have flowed for long or not at all."""
        soc, tuning = self.tuning.initial_soc, self.tuning
        at, halfway = self.dynamics(soc, temperature), self.dynamics(0.5, temperature)
        before = math.hypot(self.params.cell.capacity_Ah / 20, i / 2)
        x, variances = [soc], [tuning.initial_soc_sigma**2]
        for j, sigma in enumerate(self.sigmas, 1):
            r = halfway[f"r{j}_ohm"]
            x.append(r * i / 2)
            variances.append((at["error_scale"] * sigma) ** 2 + (r * before) ** 2)
        if self.params.hysteresis:
            x.append(0.0)
            own = at["error_scale"] * self.params.noise.hysteresis_sigma_V
            variances.append(own**2 + at["hysteresis_V"] ** 2 / 3)
        x += [0.0, 0.0]
        variances += [at["error_scale"] ** 2 * self.slow_var, self.r0_var]
        if tuning.current_bias:
            x.append(0.0)
            variances.append(self.offset**2)
        self.ukf = Ukf(np.array(x), np.diag(variances), tuning.alpha, tuning.beta, tuning.kappa)
        self.recent = self.drop(at, i)
        self.polarised = np.zeros(self.n_rc)  # by the current alone, from here on
        self.age, self.last = 0.0, voltage

    def drop(self, at: dict[str, float], i: float) -> float:
        """The ohmic drop by the cell file's r0, V."""
        r0, knee = at["r0_ohm"] if i >= 0 else at["r0_charge_ohm"], at["r0_knee_A"]
        return r0 * knee * math.asinh(i / knee)

    def scaled(self, drop: float, at: dict[str, float], i: float) -> float:
        """The part of an ohmic drop that the r0 error scales, V: that beyond the drop of a small load."""
        small = (at["r0_ohm"] if i >= 0 else at["r0_charge_ohm"]) * SMALL_LOAD_PER_H * self.params.cell.capacity_Ah
        return drop - min(max(drop, -small), small)

    def predict(self, dt: float, i: float, temperature: float) -> None:
        assert self.ukf is not None
        self.age += dt
        self.dt = dt
        noise, tuning, charge = self.params.noise, self.tuning, self.charge
        efficiency = self.params.cell.coulombic_efficiency if i < 0 else 1.0
        mean_i = i - self.ukf.x[-1] if tuning.current_bias else i
        at = self.dynamics(float(self.ukf.x[0] - efficiency * mean_i * dt / charge), temperature)  # at the mean to come
        decays = np.array([math.exp(-dt / at[f"tau{j}_s"]) for j in range(1, self.n_rc + 1)])
        resistances = np.array([at[f"r{j}_ohm"] for j in range(1, self.n_rc + 1)])
        n_rc, hysteresis, horizon = self.n_rc, self.params.hysteresis, tuning.current_error_horizon_s
        unseen = 0.0 if tuning.current_bias else self.offset  # of the charge counted
        a_slow = self.kept(dt, i, figures.SLOW_TAU_S, figures.SLOW_SOC)
        a_r0 = self.kept(dt, i, figures.R0_TAU_S, figures.R0_SOC)
        drop = self.drop(at, i)
        # The lead is that before this sample's noise.
        self.lead = self.scaled(self.recent, at, i) + self.polarised.sum()
        self.drop_sigma = self.fast_rel * (drop - self.recent)
        self.recent += (drop - self.recent) * dt / (dt + RECENT_S)
        self.polarised = decays * self.polarised + (1 - decays) * resistances * i

        def f(x: Array) -> Array:
            true_i = i - x[-1] if tuning.current_bias else i
            after = [x[0] - efficiency * true_i * dt / charge]
            after += [a * v + (1 - a) * r * i for a, v, r in zip(decays, x[1:], resistances, strict=False)]
            if hysteresis:
                a = math.exp(-hysteresis.rate * abs(i) * dt / charge)
                after.append(a * x[1 + n_rc] + (1 - a) * math.copysign(at["hysteresis_V"], i))
            after += [a_slow * x[self.slow], a_r0 * x[self.r0]]
            if tuning.current_bias:
                after.append(math.exp(-dt / horizon) * x[-1])
            return np.array(after)

        walk = unseen**2 * horizon / charge**2 + self.gain**2 * figures.MOVED * abs(i) / charge
        q = [walk * dt]
        for a, r, sigma in zip(decays, resistances, self.sigmas, strict=True):
            q.append((1 - a**2) * at["error_scale"] ** 2 * (sigma**2 + (noise.rc_rel_sigma * r * i) ** 2))
        if hysteresis:
            own = at["error_scale"] * noise.hysteresis_sigma_V
            q.append(-math.expm1(-2 * hysteresis.rate * abs(i) * dt / charge) * own**2)
        slow_var = at["error_scale"] ** 2 * self.slow_var
        slow_var += (self.offset * (at["r0_ohm"] + resistances.sum())) ** 2  # what the offset drops, a state or not
        slow_var += (figures.SLOW_REL * self.polarised.sum()) ** 2
        q += [(1 - a_slow**2) * slow_var, (1 - a_r0**2) * self.r0_var]
        if tuning.current_bias:
            q.append(-math.expm1(-2 * dt / horizon) * self.offset**2)
        self.ukf.predict(f, np.diag(q))

    def kept(self, dt: float, i: float, tau_s: float, soc: float) -> float:
        """Of an error that is another after `tau_s`, and after a charge of `soc`."""
        return math.exp(-dt / tau_s - abs(i) * dt / (soc * self.charge))

    def update(self, voltage: float, i: float, temperature: float) -> None:
        """Fuse the voltage of the instant to which `predict` led."""
        assert self.ukf is not None
        at = self.dynamics(float(self.ukf.x[0]), temperature)
        drop = self.drop(at, i)
        self.repeats += (float(voltage == self.last) - self.repeats) * self.dt / (self.dt + REPEATS_S)
        self.last = voltage
        noise, fast = at["error_scale"] ** 2 * self.white + self.drop_sigma**2, at["error_scale"] ** 2 * self.fast_var
        # Neither noise nor the fast error is new at every voltage: those that crowd count for less.
        variance = noise * max(1 / self.age, 1.0) + fast * max(FAST_S / self.age, 1.0)
        variance /= 1 + 1 / REPEATS_MOST - self.repeats
        self.age = 0.0
        error = self.ukf.x[self.r0]
        now = self.scaled(drop, at, i) + self.polarised.sum()

        def h(x: Array) -> float:
            # The prediction has the current of now, its slope over the r0 error that of before.
            ohmic = drop + now * error + self.lead * (x[self.r0] - error)
            return self.ocv(x[0], temperature) - float(x[1 : self.r0].sum()) - ohmic

        trust = self.trust(variance, at["error_scale"], temperature) if self.tuning.current_bias else 1.0
        self.ukf.update(h, voltage, variance, trust)
        self.own_var = self.ukf.S - variance + noise + fast

    def trust(self, variance: float, error_scale: float, temperature: float) -> float:
        """Share of its gain that the bias takes, of a voltage of `variance`."""
        assert self.ukf is not None
        noise = self.params.noise
        lasting = sum(sigma**2 for sigma in self.sigmas)
        lasting += noise.hysteresis_sigma_V**2 if self.params.hysteresis and noise.hysteresis_sigma_V else 0.0
        by_soc = self.ukf.explained(lambda soc: self.ocv(soc, temperature))
        return by_soc / (by_soc + variance + error_scale**2 * lasting)
