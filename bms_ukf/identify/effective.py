"""How many independent observations correlated residuals are worth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WINDOW = 5.0  # correlation times after which the rest of the autocorrelation is taken for noise (Sokal's rule)


def rows(residual: NDArray[np.float64]) -> float:
    """n over the integrated autocorrelation time 1 + 2 sum_k rho(k), from 1 to n.

    Not about the mean: a model's bias is an error that all rows share.
    """
    n = residual.size
    power = float(np.sum(residual**2))
    if n < 3 or power == 0:
        return float(max(n, 1))
    padded = np.fft.rfft(residual, 2 * n)
    autocorrelation = np.fft.irfft(np.abs(padded) ** 2)[:n] / power
    correlation_rows = 2 * np.cumsum(autocorrelation) - 1
    settled = np.arange(n) >= WINDOW * correlation_rows
    cut = int(np.argmax(settled)) if settled.any() else n - 1
    return float(np.clip(n / max(correlation_rows[cut], 1.0), 1.0, n))
