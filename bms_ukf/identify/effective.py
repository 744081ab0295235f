"""How many independent observations correlated residuals are worth, and the errors of a fit to them."""

from __future__ import annotations

from collections.abc import Sequence

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


def standard_errors(
    jacobians: Sequence[NDArray[np.float64]], residuals: Sequence[NDArray[np.float64]], prior: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Of the unknowns of a least squares over several tests and a prior, each test with errors of its own.

    H^-1 (sum_t f_t J_t' J_t + f P' P) H^-1, with H = sum_t J_t' J_t + P' P, f_t the sum of a test's squared residuals
    over its independent rows, and f the same of all tests: what only the prior knows is as doubtful as the model is.
    """
    independent = np.array([rows(residual) for residual in residuals])
    squares = np.array([float(np.sum(residual**2)) for residual in residuals])
    own = np.maximum(squares / independent, 1.0)
    products = np.array([jacobian.T @ jacobian for jacobian in jacobians])
    belief = prior.T @ prior
    spread = np.tensordot(own, products, 1) + max(float(squares.sum() / independent.sum()), 1.0) * belief
    inverse = np.linalg.pinv(products.sum(axis=0) + belief, hermitian=True)
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ki->i", inverse, spread, inverse, optimize=True), 0.0)))
