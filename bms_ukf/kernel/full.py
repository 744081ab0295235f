"""The square-root UKF for any model: nothing is assumed of the process or of the measurement.

Van der Merwe & Wan, "The square-root unscented Kalman filter for state and parameter-estimation" (ICASSP 2001), with
additive noise, a scalar measurement, and sigma points redrawn after the time update. It is what `srukf` is measured
against, and the way for a model whose process is not affine or whose voltage is non-linear in more than SoC.

The caller draws sigma points, passes each through his own process or measurement, and hands the results back:

    draw(x, root, gamma, n, points)
    points <- f(points)
    count = predict(x, root, points, q, n, w, w_cov0)
    draw(x, root, gamma, n, points)
    seen <- h(points)
    status = update(x, root, points, seen, z, r, n, w, w_cov0, out)

x (n,), root (n, n) lower triangular with a positive diagonal, q (n, n) such a root of the process noise, points
(2n + 1, n) flat by rows: the mean, then n above, then n below; n <= N_MAX. `w` is the weight of every point but the
first, `w_cov0` that of the first in covariances; gamma^2 = alpha^2 (n + kappa), w = 1 / (2 gamma^2), w_cov0 = 1 - 2 n w
+ 1 - alpha^2 + beta.

A negative w_cov0 asks for a downdate of the root, and so does every measurement; rounding may make it impossible. Then
predict leaves the downdate out, which only widens the belief, and counts it; update leaves the belief as it was.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import DENSE_MAX, N_MAX
from bms_ukf.kernel.memory import real, vector

# Results of `update`.
FUSED = 0
NOT_FINITE = 1  # nothing was changed
DOWNDATE_FAILED = 2  # the same: what the measurement takes away is more than there is, to rounding

WIDE = 3 * N_MAX + 1
PRE_ARRAY = N_MAX * WIDE


@inline
def draw(x: Any, root: Any, gamma: Any, n: int, points: Any) -> None:
    """Write the 2n + 1 sigma points."""
    for j in range(n):
        points[j] = x[j]
        for i in range(n):
            offset = gamma * root[n * j + i]
            points[n * (1 + i) + j] = x[j] + offset
            points[n * (1 + n + i) + j] = x[j] - offset


@inline
def predict(x: Any, root: Any, points: Any, q: Any, n: int, w: Any, w_cov0: Any) -> int:
    """Make mean and root of propagated points, with noise; returns the downdates left out.

    -1: the result is not finite, nothing was changed. The first point's own deviation counts as a column of the
    pre-array, or is taken off afterwards.
    """
    mean = vector(x, N_MAX)
    pre = vector(x, PRE_ARRAY)
    first = vector(x, N_MAX)
    result = vector(x, DENSE_MAX)
    for j in range(n):
        # About the first point: with alpha = 1e-3 the plain sum would lose six digits.
        shift = real(x, 0)
        for i in range(1, 2 * n + 1):
            shift += points[n * i + j] - points[j]
        mean[j] = points[j] + w * shift
    for j in range(n):
        for i in range(2 * n):
            pre[WIDE * j + i] = math.sqrt(w) * (points[n * (1 + i) + j] - mean[j])
        for i in range(n):
            pre[WIDE * j + 2 * n + i] = q[n * j + i]
        first[j] = math.sqrt(abs(w_cov0)) * (points[j] - mean[j])
        pre[WIDE * j + 3 * n] = first[j] if w_cov0 > real(x, 0) else real(x, 0)
    qr(pre, n, 3 * n + 1, result)
    left_out = 0
    if w_cov0 < real(x, 0) and not downdate(result, first, n):
        left_out = 1
    if not _sound(mean, result, n):
        return -1
    _commit(x, root, mean, result, n)
    return left_out


@inline
def update(x: Any, root: Any, points: Any, seen: Any, z: Any, r: Any, n: int, w: Any, w_cov0: Any, out: Any) -> int:
    """Fuse the measurement `z` of variance `r` that the points make look like `seen` (2n + 1,); returns a status.

    Writes out = [predicted, innovation, its variance].
    """
    mean = vector(x, N_MAX)
    gain = vector(x, N_MAX)
    result = vector(x, DENSE_MAX)
    shift = real(x, 0)
    for i in range(1, 2 * n + 1):
        shift += seen[i] - seen[0]
    z_pred = seen[0] + w * shift
    variance = r + w_cov0 * (seen[0] - z_pred) * (seen[0] - z_pred)
    for i in range(1, 2 * n + 1):
        variance += w * (seen[i] - z_pred) * (seen[i] - z_pred)
    if not (math.isfinite(z - z_pred) and math.isfinite(variance)):
        return NOT_FINITE
    out[0], out[1], out[2] = z_pred, z - z_pred, variance
    if variance <= real(x, 0):
        return DOWNDATE_FAILED
    for j in range(n):
        cross = real(x, 0)
        for i in range(1, 2 * n + 1):
            cross += w * (points[n * i + j] - x[j]) * (seen[i] - z_pred)
        gain[j] = cross / math.sqrt(variance)  # times the root of the variance: what the root is downdated by
        mean[j] = x[j] + gain[j] / math.sqrt(variance) * (z - z_pred)
    for k in range(n * n):
        result[k] = root[k]
    if not downdate(result, gain, n):
        return DOWNDATE_FAILED
    if not _sound(mean, result, n):
        return NOT_FINITE
    _commit(x, root, mean, result, n)
    return FUSED


@inline
def qr(pre: Any, n: int, columns: int, root: Any) -> None:
    """The lower triangle with the product that `pre` (n rows, WIDE apart, destroyed) has with its transpose."""
    for j in range(n):
        squares = real(pre, 0)
        for k in range(j, columns):
            squares += pre[WIDE * j + k] * pre[WIDE * j + k]
        norm = math.sqrt(squares)
        sign = real(pre, 1) if pre[WIDE * j + j] >= real(pre, 0) else real(pre, -1)
        away = pre[WIDE * j + j] + sign * norm
        for i in range(j + 1, n):
            dot = real(pre, 0)
            for k in range(j, columns):
                dot += pre[WIDE * j + k] * pre[WIDE * i + k]
            along = dot / norm
            d = (pre[WIDE * i + j] + sign * along) / away
            for k in range(j + 1, columns):
                pre[WIDE * i + k] -= d * pre[WIDE * j + k]
            root[n * i + j] = along
        root[n * j + j] = norm
        for k in range(j + 1, n):
            root[n * j + k] = real(pre, 0)


@inline
def downdate(root: Any, v: Any, n: int) -> bool:
    """Take v v^T off the product of `root` with its transpose; False, and `root` spoilt, if less than nothing is left.

    By hyperbolic rotations (Golub & Van Loan, Matrix Computations, 4th ed., section 6.5.4); `v` is destroyed.
    """
    for j in range(n):
        left = (root[n * j + j] - v[j]) * (root[n * j + j] + v[j])
        if not left > real(root, 0):
            return False
        kept = math.sqrt(left)
        c = kept / root[n * j + j]
        s = v[j] / root[n * j + j]
        root[n * j + j] = kept
        for i in range(j + 1, n):
            root[n * i + j] = (root[n * i + j] - s * v[i]) / c
            v[i] = c * v[i] - s * root[n * i + j]
    return True


@inline
def _sound(mean: Any, root: Any, n: int) -> bool:
    total = real(mean, 0)
    for j in range(n):
        total += abs(mean[j])
        for i in range(j + 1):
            total += abs(root[n * j + i])
    return math.isfinite(total)


@inline
def _commit(x: Any, root: Any, mean: Any, result: Any, n: int) -> None:
    for j in range(n):
        x[j] = mean[j]
        for i in range(n):
            root[n * j + i] = result[n * j + i] if i <= j else real(x, 0)
