"""What a Gaussian becomes under a non-linear function: by sigma points, by the tangent line, and truly.

The textbook's formulas for any function, in plain numpy, for `diagnose` and for whoever wants to see them at work; the
estimator runs on its own form of the first, `kernel.srukf`.

Functions `f` are vectorised: points of shape (m, n) in, values of shape (m,) or (m, k) out. A mean is a number or
(n,), a covariance a number or (n, n), positive definite. Results are a mean (k,) and a covariance (k, k).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Function = Callable[[Array], Array]

REACH_SIGMAS = 8.0  # beyond lies 1e-15 of a Gaussian
NODES = 8001
DIFFERENCE_SIGMAS = 1e-4  # half of a central difference: its error is far below a curve's own, and above rounding


class Scaled(NamedTuple):
    """The scaled unscented transform of n dimensions; the central point comes first, then n above, then n below."""

    spread: float  # n + lambda: points lie sqrt(spread) sigmas from the mean
    w_mean: Array  # (2n + 1,), sums to 1
    w_cov: Array  # (2n + 1,)


def scaled(n: int, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0) -> Scaled:
    """Weights of 2n + 1 points, with lambda = alpha^2 (n + kappa) - n.

    Van der Merwe, "Sigma-point Kalman filters" (PhD thesis, Oregon Health & Science University, 2004), section 3.2;
    Julier, "The scaled unscented transformation" (ACC 2002). ValueError unless n + lambda > 0.
    """
    spread = alpha**2 * (n + kappa)
    if not spread > 0:
        raise ValueError(f"alpha^2 (n + kappa) is {spread:g}; expected above 0")
    w_mean = np.full(2 * n + 1, 1 / (2 * spread))
    w_mean[0] = 1 - n / spread
    w_cov = w_mean.copy()
    w_cov[0] += 1 - alpha**2 + beta
    return Scaled(spread, w_mean, w_cov)


def sigma_points(mean: ArrayLike, covariance: ArrayLike, spread: float) -> Array:
    """(2n + 1, n): the mean, then the mean plus and minus the columns of the Cholesky root of spread * covariance.

    Julier & Uhlmann, "Unscented filtering and nonlinear estimation", Proc. IEEE 92(3), 2004, equation 12.
    """
    centre, P = _gaussian(mean, covariance)
    offsets = np.linalg.cholesky(spread * P).T
    return np.vstack([centre, centre + offsets, centre - offsets])


def transform(f: Function, mean: ArrayLike, covariance: ArrayLike, weights: Scaled) -> tuple[Array, Array]:
    """Mean and covariance of f by sigma points."""
    points = sigma_points(mean, covariance, weights.spread)
    return _moments(_values(f, points), weights.w_mean, weights.w_cov)


def tangent_line(f: Function, mean: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    """Mean f(mean) and covariance J P J^T, as an extended Kalman filter has them; J by central differences."""
    centre, P = _gaussian(mean, covariance)
    steps = np.diag(DIFFERENCE_SIGMAS * np.sqrt(np.diag(P)))
    rise = _values(f, centre + steps) - _values(f, centre - steps)
    J = rise.T / (2 * np.diag(steps))
    return _values(f, centre[None])[0], J @ P @ J.T


def quadrature(f: Function, mean: float, sigma: float) -> tuple[Array, Array]:
    """The true mean and covariance of f of one number: a dense trapezoidal rule over +-8 sigma."""
    xi = np.linspace(-REACH_SIGMAS, REACH_SIGMAS, NODES)
    density = np.exp(-(xi**2) / 2)  # at both ends too small for the rule's half weights to matter
    weights = density / density.sum()
    return _moments(_values(f, (mean + sigma * xi)[:, None]), weights, weights)


def _gaussian(mean: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    return np.atleast_1d(np.asarray(mean, float)), np.atleast_2d(np.asarray(covariance, float))


def _values(f: Function, points: Array) -> Array:
    return np.asarray(f(points), float).reshape(len(points), -1)


def _moments(values: Array, w_mean: Array, w_cov: Array) -> tuple[Array, Array]:
    # About the first value: where w_mean[0] is near -1e6 the plain sum would lose six digits.
    mean = values[0] + w_mean @ (values - values[0])
    away = values - mean
    return mean, (w_cov * away.T) @ away
