"""The filter: a square-root unscented Kalman filter, written for the structure of the cell model.

Assumes (and is the textbook SR-UKF of van der Merwe & Wan, ICASSP 2001, exactly, when it holds):
  1. the process is affine with a diagonal matrix:  x' = diag(a) x + c + noise of covariance diag(q)^2;
  2. the measurement is scalar and non-linear in SoC only:  z = ocv(soc) - drop - v_rc1 - v_rc2 + noise of variance r;
  3. SoC is the first state, sqrt_P lower triangular, and sigma points are redrawn after the time update.
Then every sigma point but the two along the first column of sqrt_P meets the OCV at the mean SoC, so three look-ups
stand for 2n + 1, the innovation variance is a sum of squares and the measurement update needs no downdate: sqrt_P
cannot lose its positive diagonal. With gamma^2 = alpha^2 (n + kappa), w = 1 / (2 gamma^2) and g0, g+, g- the OCV at
the mean and at +-gamma sqrt_P[0, 0]:
  mean shift        e = w (g+ + g- - 2 g0)
  sqrt_P^-1 Pxz     b_0 = w gamma (g+ - g-) + (H sqrt_P)_0,   b_j = (H sqrt_P)_j,   H = [0, -1, -1]
  Pzz               b.b + r + e^2 (beta + alpha^2 (n + kappa - 1))

Each function computes aside and commits last: if a result is not finite, `state` is untouched and the answer is False.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel.layout import (
    DENSE_MAX,
    H_ALPHA,
    H_B,
    H_INNOVATION,
    H_INNOVATION_VAR,
    H_VOLTAGE_PRED,
    N_MAX,
    P_E2,
    P_GAMMA,
    P_W,
    PACKED_MAX,
    SOC,
    V_RC1,
    held_at,
    root_at,
    tri,
)
from bms_ukf.kernel.memory import inline, real, vector


@inline
def predict(s: Any, o: int, n: int, a: Any, c: Any, q: Any) -> bool:
    """Time update of the record at `o`: x <- a x + c, sqrt_P <- tria([diag(a) sqrt_P, diag(q)]); n numbers each."""
    x = vector(s, N_MAX)
    root = vector(s, PACKED_MAX)
    for j in range(n):
        x[j] = a[j] * s[o + j] + c[j]
        for k in range(j + 1):
            root[tri(j, k)] = a[j] * s[o + root_at(n) + tri(j, k)]
    triangularise(s, n, root, q)
    return commit(s, o, n, x, root)


@inline
def triangularise(s: Any, n: int, root: Any, q: Any) -> None:
    """Replace the lower-triangular `root` by that of root root^T + diag(q)^2, with Householder reflections.

    The reflection for column j touches only that column and the noise columns 0..j, the others being zero below row j
    (`noise` keeps what earlier reflections spilled into them). A zero variance would divide 0 by 0: q is positive.
    """
    noise = vector(s, DENSE_MAX)
    for j in range(n):
        for k in range(n):
            noise[n * j + k] = real(s, 0)
        noise[n * j + j] = q[j]
    for j in range(n):
        pivot = root[tri(j, j)]
        squares = pivot * pivot
        for k in range(j + 1):
            squares += noise[n * j + k] * noise[n * j + k]
        norm = math.sqrt(squares)
        # Reflecting to -norm and flipping the sign keeps the diagonal positive and pivot + norm free of cancellation.
        u = pivot + norm
        t = real(s, 1) / (norm * u)
        for i in range(j + 1, n):
            below = root[tri(i, j)]
            dot = pivot * below
            for k in range(j + 1):
                dot += noise[n * j + k] * noise[n * i + k]
            reflected = dot * t * u
            d = (reflected + below) * t * norm
            root[tri(i, j)] = reflected
            for k in range(j + 1):
                noise[n * i + k] -= d * noise[n * j + k]
        root[tri(j, j)] = norm


@inline
def innovate(p: Any, s: Any, o: int, n: int, z: Any, drop: Any, g0: Any, g_plus: Any, g_minus: Any, r: Any) -> bool:
    """Predict the measurement and compare; leaves prediction, innovation (z minus it) and its variance in the record.

    `g0, g_plus, g_minus`: OCV at SoC x[0] and at x[0] +- gamma sqrt_P[0, 0]; `drop`: the ohmic drop; `r`: variance of
    the measurement. The belief (x, sqrt_P) is not touched, so a gate can stand between this and `update`.
    """
    b = vector(s, N_MAX)
    e = p[P_W] * (g_plus + g_minus - g0 - g0)
    z_pred = g0 + e - drop
    for j in range(V_RC1, n):
        z_pred -= s[o + j]
    bb = real(s, 0)
    for k in range(n):
        b[k] = real(s, 0)
        for j in range(max(V_RC1, k), n):
            b[k] -= s[o + root_at(n) + tri(j, k)]
        if k == SOC:
            b[k] += p[P_W] * p[P_GAMMA] * (g_plus - g_minus)
        bb += b[k] * b[k]
    alpha = r + e * e * p[P_E2]
    if not (math.isfinite(z - z_pred) and math.isfinite(alpha + bb)):
        return False
    h = o + held_at(n)
    s[h + H_VOLTAGE_PRED] = z_pred
    s[h + H_INNOVATION] = z - z_pred
    s[h + H_INNOVATION_VAR] = alpha + bb
    s[h + H_ALPHA] = alpha
    for k in range(n):
        s[h + H_B + k] = b[k]
    return True


@inline
def update(s: Any, o: int, n: int) -> bool:
    """Measurement update of the record at `o` with the innovation that `innovate` left there.

    Carlson's triangular update (AIAA Journal 11(9), 1973, pp. 1259-1265), from the last column to the first: sums of
    squares only. Variances shrink or stay.
    """
    x = vector(s, N_MAX)
    root = vector(s, PACKED_MAX)
    gain = vector(s, N_MAX)
    h = o + held_at(n)
    for j in range(n):
        gain[j] = real(s, 0)
        for k in range(j + 1):
            root[tri(j, k)] = s[o + root_at(n) + tri(j, k)]
    alpha = s[h + H_ALPHA]
    for step in range(n):
        j = n - 1 - step
        b = s[h + H_B + j]
        alpha_next = alpha + b * b
        inverse = real(s, 1) / math.sqrt(alpha_next * alpha)
        keep = alpha * inverse
        take = b * inverse
        for i in range(j, n):
            old = root[tri(i, j)]
            root[tri(i, j)] = keep * old - take * gain[i]
            gain[i] += b * old
        alpha = alpha_next
    weight = s[h + H_INNOVATION] / alpha
    for j in range(n):
        x[j] = s[o + j] + gain[j] * weight
    return commit(s, o, n, x, root)


@inline
def commit(s: Any, o: int, n: int, x: Any, root: Any) -> bool:
    """Make `x` and `root` the belief of the record at `o`, if all of them are finite."""
    total = real(s, 0)
    for j in range(n):
        total += abs(x[j])
        for k in range(j + 1):
            total += abs(root[tri(j, k)])
    if not math.isfinite(total):
        return False
    for j in range(n):
        s[o + j] = x[j]
        for k in range(j + 1):
            s[o + root_at(n) + tri(j, k)] = root[tri(j, k)]
    return True
