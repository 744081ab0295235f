"""The cell model, run open loop over a test, with its derivatives by every table entry.

    v = ocv - v_rc1 .. - v_hyst - r0 knee asinh(i / knee)
    d v_rcj / dt = (r_j i - v_rcj) / tau_j          d v_hyst / dt = rate |i| / charge (m sgn(i) - v_hyst)

Everything but the OCV is here, as a drop below it; the same equations and tables as `kernel.ecm`, written for whole
recordings. Tables hold logarithms: r = sum_s u_s exp(sum_T w_T log r_sT), with weights u over SoC and w over 1/T.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Channels of the tables; pairs of r_j, tau_j follow from R1.
R0, R0_CHARGE, KNEE, HYSTERESIS, R1 = range(5)


class Place(NamedTuple):
    """Where each row lies in the tables: left knots and the way to the next, 0..1."""

    temperature: Index
    temperature_part: Array
    soc: Index
    soc_part: Array


def between(x: Array, knots: Array) -> tuple[Index, Array]:
    """Left knot of each x and its part of the way to the next; held beyond the ends."""
    left = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, knots.size - 2).astype(np.int64)
    part = np.clip((x - knots[left]) / (knots[left + 1] - knots[left]), 0.0, 1.0)
    return left, part


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})  # type: ignore[untyped-decorator]
def drop(
    step_s: Array,
    current_A: Array,
    current_at_end_A: Array,
    place: Place,
    tables: Array,
    hysteresis_rate: float,
    stride: int,
    out: Array,
    by_table: Array,
) -> None:
    """Writes the drop below the OCV at every row to `out` (n,), V.

    `tables` holds logarithms, shape (channels, temperatures, soc); `hysteresis_rate` is per ampere second, 0 for none.
    `by_table`, shape (ceil(n / stride), tables.size + 1), receives the derivatives of every stride-th row by all table
    entries and by the logarithm of the rate, in that order; with no rows, nothing is differentiated.
    """
    channels, rows, knots = tables.shape
    size = rows * knots
    pairs = (channels - R1) // 2
    differentiate = by_table.shape[0] > 0
    value = np.zeros(channels)
    part = np.zeros((channels, 2))
    v = np.zeros(pairs)
    by_r = np.zeros((pairs, size))
    by_tau = np.zeros((pairs, size))
    h, by_rate = 0.0, 0.0
    by_max = np.zeros(size)
    w = np.zeros(2)
    at = np.zeros((2, 2), dtype=np.int64)
    for k in range(step_s.size):
        T, s = place.temperature[k], place.soc[k]
        w[0], w[1] = 1.0 - place.temperature_part[k], place.temperature_part[k]
        for c in range(channels):
            for g in range(2):
                u = place.soc_part[k] if g else 1.0 - place.soc_part[k]
                part[c, g] = u * np.exp(w[0] * tables[c, T, s + g] + w[1] * tables[c, T + 1, s + g])
            value[c] = part[c, 0] + part[c, 1]
        for g in range(2):
            for e in range(2):
                at[g, e] = (T + e) * knots + s + g
        i, dt = current_A[k], step_s[k]
        total = 0.0
        for j in range(pairs):
            r, tau = value[R1 + 2 * j], value[R1 + 2 * j + 1]
            a = np.exp(-dt / tau)
            turn = a * dt / (tau * tau) * (v[j] - r * i)
            v[j] = a * v[j] + (1.0 - a) * r * i
            total += v[j]
            if differentiate:
                for p in range(size):
                    by_r[j, p] *= a
                    by_tau[j, p] *= a
                for g in range(2):
                    for e in range(2):
                        by_r[j, at[g, e]] += (1.0 - a) * i * part[R1 + 2 * j, g] * w[e]
                        by_tau[j, at[g, e]] += turn * part[R1 + 2 * j + 1, g] * w[e]
        if hysteresis_rate > 0.0:
            moved = hysteresis_rate * abs(i) * dt
            a = np.exp(-moved)
            goal = value[HYSTERESIS] * np.sign(i)
            if differentiate:
                by_rate = a * by_rate - moved * a * (h - goal)
                for p in range(size):
                    by_max[p] *= a
                for g in range(2):
                    for e in range(2):
                        by_max[at[g, e]] += (1.0 - a) * np.sign(i) * part[HYSTERESIS, g] * w[e]
            h = a * h + (1.0 - a) * goal
            total += h
        ohmic = R0_CHARGE if current_at_end_A[k] < 0.0 else R0
        x = current_at_end_A[k] / value[KNEE]
        bent = value[KNEE] * np.arcsinh(x)
        out[k] = total + value[ohmic] * bent
        if differentiate and k % stride == 0:
            row = by_table[k // stride]
            row[:] = 0.0
            by_log_knee = value[ohmic] * (np.arcsinh(x) - x / np.sqrt(1.0 + x * x))
            for g in range(2):
                for e in range(2):
                    row[ohmic * size + at[g, e]] += bent * part[ohmic, g] * w[e]
                    row[KNEE * size + at[g, e]] += by_log_knee * part[KNEE, g] * w[e]
            row[HYSTERESIS * size : R1 * size] = by_max
            for j in range(pairs):
                first = (R1 + 2 * j) * size
                row[first : first + size] = by_r[j]
                row[first + size : first + 2 * size] = by_tau[j]
            row[channels * size] = by_rate


@njit(cache=True)  # type: ignore[untyped-decorator]
def lowpass(step_s: Array, drive: Array, tau_s: float) -> Array:
    """First-order low-pass from 0; the drive is constant over the interval that ends at each row."""
    out = np.empty_like(drive)
    y = 0.0
    for k in range(drive.size):
        a = np.exp(-step_s[k] / tau_s)
        y = a * y + (1.0 - a) * drive[k]
        out[k] = y
    return out
