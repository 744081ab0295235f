"""Shape-preserving piecewise cubic interpolation: where the data rise, so does the curve (Fritsch & Butland, 1984).

The same curve as scipy's PchipInterpolator, against which it is tested. Written here because importing that was the
longest part of the daemon's start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def coefficients(x: ArrayLike, y: ArrayLike) -> Array:
    """Shape (n - 1, 4): the cubic of each interval in powers of the distance from its left knot, constant term first.

    `x` must increase strictly; at least two knots.
    """
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    h = np.diff(x)
    secant = np.diff(y) / h
    slope = _slopes(h, secant)
    left, right = slope[:-1], slope[1:]
    return np.column_stack([y[:-1], left, (3 * secant - 2 * left - right) / h, (left + right - 2 * secant) / h**2])


def interpolate(x: ArrayLike, y: ArrayLike, at: ArrayLike) -> Array:
    """The curve through (x, y) at `at`, which must lie within the knots; shape of `at`."""
    x, at = np.asarray(x, dtype=np.float64), np.asarray(at, dtype=np.float64)
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    c, d = coefficients(x, y)[k], at - x[k]
    return np.asarray(c[..., 0] + d * (c[..., 1] + d * (c[..., 2] + d * c[..., 3])))


def _slopes(h: Array, secant: Array) -> Array:
    """Slope at every knot: weighted harmonic mean of the secants beside it, 0 at a peak; three points at the ends."""
    slope = np.zeros(len(h) + 1)
    if len(h) == 1:
        slope[:] = secant
        return slope
    before, after = secant[:-1], secant[1:]
    monotone = before * after > 0
    w_before, w_after = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    weights = (w_before + w_after)[monotone]
    slope[1:-1][monotone] = weights / (w_before[monotone] / before[monotone] + w_after[monotone] / after[monotone])
    slope[0] = _end_slope(h[0], h[1], secant[0], secant[1])
    slope[-1] = _end_slope(h[-1], h[-2], secant[-1], secant[-2])
    return slope


def _end_slope(h0: float, h1: float, secant0: float, secant1: float) -> float:
    """Three-point slope at an end, held to what keeps the shape."""
    slope = ((2 * h0 + h1) * secant0 - h0 * secant1) / (h0 + h1)
    if slope * secant0 <= 0:
        return 0.0
    if secant0 * secant1 <= 0 and abs(slope) > 3 * abs(secant0):
        return 3 * secant0
    return slope
