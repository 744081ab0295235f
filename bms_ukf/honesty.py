"""The one judge of published intervals: is the truth inside, and how far outside may it not be.

SoC, bounds and truth are 0..1, arrays of one shape; NaN means that no SoC was published. A truth outside 0..1 is
compared clamped. `ref_sigma` is the reference's own standard deviation, 0 for a simulated truth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIGMAS_95 = 1.96  # half of a 95 % interval, in standard deviations of a normal distribution
FAR_SIGMAS = 3.0 - SIGMAS_95  # from the bound to three standard deviations
FAR_HALF_WIDTHS = 0.53  # the same in half-widths of the interval

INSIDE_AT_LEAST = 0.93  # share of rows with a SoC, in every class of situation
BEYOND_AT_MOST = 0.02  # share of ok rows beyond three sigmas, in every class
BEYOND_ON_AVERAGE = 0.005  # the same, on average over the classes


def bounds(soc: Array, soc_sigma: Array) -> tuple[Array, Array]:
    """Return the lower and the upper bound of the 95 % interval of a normal distribution, clipped to 0..1."""
    return np.clip(soc - SIGMAS_95 * soc_sigma, 0.0, 1.0), np.clip(soc + SIGMAS_95 * soc_sigma, 0.0, 1.0)


def outside(low: Array, high: Array, truth: Array, ref_sigma: float = 0.0) -> Array:
    """Return how far the truth lies outside the interval, 0 if it is inside, NaN without an interval."""
    true = np.clip(truth, 0.0, 1.0)
    return np.maximum(np.maximum(low - true, true - high) - SIGMAS_95 * ref_sigma, 0.0)


def inside(low: Array, high: Array, truth: Array, ref_sigma: float = 0.0) -> Mask:
    """Return the rows with a SoC whose interval holds the truth."""
    return np.asarray(outside(low, high, truth, ref_sigma) == 0.0)


def beyond(low: Array, high: Array, truth: Array, ref_sigma: float = 0.0) -> Mask:
    """Return the rows with a SoC whose truth is beyond three sigmas: a lie, if the status is ok."""
    far = FAR_HALF_WIDTHS * (high - low) / 2 + FAR_SIGMAS * ref_sigma
    return np.asarray(outside(low, high, truth, ref_sigma) > far)
