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


def between(x: Array, knots: Array, reach: tuple[float, float] | None = None) -> tuple[Index, Array]:
    """Return the left knot of each x and its part of the way to the next, below 0 or above 1 beyond the ends.

    The parts go on as far as `reach`, and are held there; without one, at the ends.
    """
    x = np.clip(x, *(reach or (knots[0], knots[-1])))
    left = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, knots.size - 2).astype(np.int64)
    return left, (x - knots[left]) / (knots[left + 1] - knots[left])


FAST = {"reassoc", "contract", "nsz"}  # what lets the sums over sensitivities be vectorised, and no more


@njit(cache=True, fastmath=FAST)
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
    value, part = np.zeros(channels), np.zeros((channels, 2))
    at, w = np.zeros((2, 2), dtype=np.int64), np.zeros(2)
    v, by_r, by_tau = np.zeros(pairs), np.zeros((pairs, size)), np.zeros((pairs, size))
    h, by_rate, by_max = 0.0, 0.0, np.zeros(size)
    for k in range(step_s.size):
        _look_up(tables, place, k, value, part, at, w)
        total = 0.0
        for j in range(pairs):
            _relax(j, step_s[k], current_A[k], value, part, at, w, v, by_r, by_tau, differentiate)
            total += v[j]
        if hysteresis_rate > 0.0:
            moved = hysteresis_rate * abs(current_A[k]) * step_s[k]
            a, sign = np.exp(-moved), np.sign(current_A[k])
            goal = value[HYSTERESIS] * sign
            if differentiate:
                by_rate = a * by_rate - moved * a * (h - goal)
                _decay_and_add(by_max, a, (1.0 - a) * sign, part[HYSTERESIS], at, w)
            h = a * h + (1.0 - a) * goal
            total += h
        ohmic = R0_CHARGE if current_at_end_A[k] < 0.0 else R0
        x = current_at_end_A[k] / value[KNEE]
        bent = value[KNEE] * np.arcsinh(x)
        out[k] = total + value[ohmic] * bent
        if differentiate and k % stride == 0:
            row = by_table[k // stride]
            row[:] = 0.0
            _decay_and_add(row[ohmic * size : (ohmic + 1) * size], 1.0, bent, part[ohmic], at, w)
            by_log_knee = value[ohmic] * (np.arcsinh(x) - x / np.sqrt(1.0 + x * x))
            _decay_and_add(row[KNEE * size : (KNEE + 1) * size], 1.0, by_log_knee, part[KNEE], at, w)
            row[HYSTERESIS * size : R1 * size] = by_max
            for j in range(pairs):
                first = (R1 + 2 * j) * size
                row[first : first + size] = by_r[j]
                row[first + size : first + 2 * size] = by_tau[j]
            row[channels * size] = by_rate


@njit(cache=True, fastmath=FAST)
def _look_up(tables: Array, place: Place, k: int, value: Array, part: Array, at: Index, w: Array) -> None:
    """Values of all channels at row k, the part of each that either SoC knot gives, and the entries they are of."""
    T, s = place.temperature[k], place.soc[k]
    w[0], w[1] = 1.0 - place.temperature_part[k], place.temperature_part[k]
    for c in range(tables.shape[0]):
        for g in range(2):
            u = place.soc_part[k] if g else 1.0 - place.soc_part[k]
            part[c, g] = u * np.exp(w[0] * tables[c, T, s + g] + w[1] * tables[c, T + 1, s + g])
        value[c] = part[c, 0] + part[c, 1]
    for g in range(2):
        for e in range(2):
            at[g, e] = (T + e) * tables.shape[2] + s + g


@njit(cache=True, fastmath=FAST)
def _relax(
    j: int,
    step_s: float,
    current_A: float,
    value: Array,
    part: Array,
    at: Index,
    w: Array,
    v: Array,
    by_r: Array,
    by_tau: Array,
    differentiate: bool,
) -> None:
    """Pair j over one step: its voltage in `v`, and the derivatives of that by the tables of r_j and tau_j."""
    r, tau = value[R1 + 2 * j], value[R1 + 2 * j + 1]
    a = np.exp(-step_s / tau)
    if differentiate:
        by_log_tau = a * step_s / (tau * tau) * (v[j] - r * current_A)
        _decay_and_add(by_r[j], a, (1.0 - a) * current_A, part[R1 + 2 * j], at, w)
        _decay_and_add(by_tau[j], a, by_log_tau, part[R1 + 2 * j + 1], at, w)
    v[j] = a * v[j] + (1.0 - a) * r * current_A


@njit(cache=True, fastmath=FAST)
def _decay_and_add(derivative: Array, decay: float, by_value: float, part: Array, at: Index, w: Array) -> None:
    """derivative = decay derivative + by_value d(value)/d(entry), for the four entries a value is made of."""
    if decay != 1.0:
        for p in range(derivative.size):
            derivative[p] *= decay
    for g in range(2):
        for e in range(2):
            derivative[at[g, e]] += by_value * part[g] * w[e]


@njit(cache=True)
def lowpass(step_s: Array, drive: Array, tau_s: float) -> Array:
    """First-order low-pass from 0; the drive is constant over the interval that ends at each row."""
    out = np.empty_like(drive)
    y = 0.0
    for k in range(drive.size):
        a = np.exp(-step_s[k] / tau_s)
        y = a * y + (1.0 - a) * drive[k]
        out[k] = y
    return out
