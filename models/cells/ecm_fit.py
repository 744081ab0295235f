"""Fits the tables of the 2-RC equivalent circuit to recordings, by least squares of the open-loop voltage error.

Model (i positive on discharge): v = ocv(soc) - v_rc1 - v_rc2 - r0 knee asinh(i / knee);  dv_rcj/dt = (i r_j - v_rcj)
/ tau_j. Below the knee current r0 is the resistance; above it the drop grows with the logarithm of the current, as that
of a charge transfer does (Butler-Volmer with equal coefficients). Tables are over SoC (linear) and temperature (linear
in log over 1/T), as a cell file has them; the knee is over temperature, the time constants are the same everywhere.
Unknowns are logarithms, so that nothing can turn negative.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]
ZERO_CELSIUS_K = 273.15


@dataclass(slots=True)
class Recording:
    """One test, from rest. Row k holds the mean current of the interval of length step_s[k] that ends with it."""

    ambient_degC: float
    step_s: Array
    current_A: Array  # positive = discharge
    voltage_V: Array
    temperature_degC: Array
    soc: Array  # counted from the start


@dataclass(slots=True)
class Tables:
    """Resistances r0, r1, r2, shape (3, temperatures, soc knots); a knee for each temperature; time constants."""

    soc: Array
    temperature_degC: Array
    r_ohm: Array
    knee_A: Array
    tau_s: Array

    def weights(self, record: Recording) -> tuple[Array, Array]:
        """Interpolation weights of every row: (n, temperatures) over 1/T, held at the ends, and (n, soc knots)."""
        inverse_K = -1 / (self.temperature_degC + ZERO_CELSIUS_K)
        return hats(-1 / (record.temperature_degC + ZERO_CELSIUS_K), inverse_K), hats(record.soc, self.soc)

    def resistances(self, record: Recording) -> Array:
        """r0, r1, r2 at every row, shape (3, n)."""
        along_T, along_soc = self.weights(record)
        return np.stack([np.sum(np.exp(along_T @ np.log(table)) * along_soc, axis=1) for table in self.r_ohm])

    def simulate(self, record: Recording, ocv: Callable[[Array], Array]) -> Array:
        """Predicted terminal voltage of every row, V; open loop from rest."""
        r0, r1, r2 = self.resistances(record)
        slow = sum(
            lowpass(np.exp(-record.step_s / tau), (r * record.current_A)[:, None])[:, 0]
            for r, tau in zip((r1, r2), self.tau_s, strict=True)
        )
        return np.asarray(ocv(record.soc) - slow - r0 * self.bent_current(record))

    def bent_current(self, record: Recording) -> Array:
        """What r0 is multiplied with, A: the current below the knee, its logarithm above."""
        knee_A = np.exp(self.weights(record)[0] @ np.log(self.knee_A))
        return np.asarray(knee_A * np.arcsinh(record.current_A / knee_A))


def hats(x: Array, knots: Array) -> Array:
    """Weights of linear interpolation at x, held beyond the ends; shape (len(x), len(knots)), rows sum to 1."""
    return np.stack([np.interp(x, knots, row) for row in np.eye(len(knots))], axis=1)


@njit(cache=True)
def lowpass(decay: Array, drive: Array) -> Array:
    """y[k] = decay[k] y[k-1] + (1 - decay[k]) drive[k] from y = 0, for each column of `drive`, shape (n, m)."""
    out = np.empty_like(drive)
    y = np.zeros(drive.shape[1])
    for k in range(drive.shape[0]):
        for j in range(drive.shape[1]):
            y[j] = decay[k] * y[j] + (1.0 - decay[k]) * drive[k, j]
            out[k, j] = y[j]
    return out


def fit(
    recordings: Sequence[Recording], ocv: Callable[[Array], Array], start: Tables, *, keep: int, roughness_mV: float
) -> Tables:
    """Tables of least squared voltage error over the recordings, mV, from the knots and the guess in `start`.

    Every `keep`-th row counts. `roughness_mV` is what a unit of curvature in log resistance along SoC costs: it decides
    only where the recordings say little.
    """
    shape = start.r_ohm.shape
    curvature = np.diff(np.eye(shape[2]), 2, axis=0)

    def unpack(theta: Array) -> Tables:
        r, knee, tau = np.split(np.exp(theta), [start.r_ohm.size, -2])
        return Tables(start.soc, start.temperature_degC, r.reshape(shape), knee, tau)

    def residuals(theta: Array) -> Array:
        tables = unpack(theta)
        errors = [1e3 * (tables.simulate(record, ocv) - record.voltage_V)[::keep] for record in recordings]
        rough = roughness_mV * theta[: start.r_ohm.size].reshape(-1, shape[2]) @ curvature.T
        return np.concatenate([*errors, rough.ravel()])

    def jacobian(theta: Array) -> Array:
        blocks = [1e3 * _sensitivities(unpack(theta), record)[::keep] for record in recordings]
        rough = roughness_mV * np.kron(np.eye(shape[0] * shape[1]), curvature)
        return np.vstack([*blocks, np.hstack([rough, np.zeros((len(rough), len(guess) - start.r_ohm.size))])])

    guess = np.log(np.concatenate([start.r_ohm.ravel(), start.knee_A, start.tau_s]))
    return unpack(least_squares(residuals, guess, jac=jacobian, method="trf", tr_solver="exact", ftol=1e-5).x)


def _sensitivities(tables: Tables, record: Recording) -> Array:
    """d(voltage)/d(unknowns), shape (n, unknowns): log r0, r1, r2 tables, log knees, then log tau1, tau2."""
    along_T, along_soc = tables.weights(record)
    bent_A = tables.bent_current(record)
    knee_A = np.exp(along_T @ np.log(tables.knee_A))
    by_log_knee = bent_A - record.current_A / np.hypot(1.0, record.current_A / knee_A)
    by_knee = -along_T * (tables.resistances(record)[0] * by_log_knee)[:, None]
    columns = []
    by_tau = []
    for j, table in enumerate(tables.r_ohm):
        at_knots = np.exp(along_T @ np.log(table)) * along_soc
        # r = sum_m u_m exp(sum_k w_k log r_km): the derivative by log r_km is w_k u_m times that exponential.
        current_A = bent_A if j == 0 else record.current_A
        drive = (along_T[:, :, None] * (at_knots * current_A[:, None])[:, None, :]).reshape(len(record.soc), -1)
        if j == 0:
            columns.append(-drive)
            continue
        tau = tables.tau_s[j - 1]
        columns.append(-lowpass(np.exp(-record.step_s / tau), drive))
        total = drive.sum(axis=1, keepdims=True)
        shifted = [lowpass(np.exp(-record.step_s / (tau * factor)), total) for factor in (1.001, 1 / 1.001)]
        by_tau.append(-(shifted[0] - shifted[1]) / (2 * np.log(1.001)))
    return np.hstack([*columns, by_knee, *by_tau])
