"""The filter: a square-root unscented Kalman filter, written for the structure of the cell model.

Assumes, and is the textbook SR-UKF of van der Merwe & Wan (ICASSP 2001) exactly when it holds:
  1. the process is affine:  x_j' = a_j x_j + g_j bias + c_j, with noise of covariance diag(q)^2;
  2. the measurement is scalar and non-linear in SoC only:  z = ocv(soc) + (linear in the rest) + noise of variance r;
  3. SoC is the first state, sqrt_P lower triangular, and sigma points are redrawn after the time update.
DERIVATION.md has the proof. Three OCV look-ups stand for 2n + 1, the innovation variance is a sum of squares and the
measurement update needs no downdate: sqrt_P cannot lose its positive diagonal.

Every function works on lane `c` of a working copy `w` (see `layout`) and changes nothing else. What may come of
overflow is caught where the copy is committed.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import (
    BY_SIGMA_POINTS,
    DENSE_MAX,
    H_POLARISED,
    N_MAX,
    P_E2,
    P_GAMMA,
    P_W,
    SOC,
    V_RC1,
    Y_ALPHA,
    Y_B,
    Y_FUSE,
    Y_INNOVATION,
    Y_LEAD,
    Y_NOISE,
    Y_PER_VARIANCE,
    Y_PREDICTED,
    Y_SCALED,
    Y_TRUST,
    Y_VARIANCE,
    tri,
)
from bms_ukf.kernel.memory import real, vector

SIX = 6  # states of two RC pairs and a bias
DENSE_SIX = SIX * SIX


@inline
def add(w: Any, c: int, m: Any, j: int, increment: Any) -> None:
    """Add to x[j]; compensated (Kahan), what rounding takes off is carried on.

    In float32 a SoC near 1 cannot be moved by less than 3e-8, which is 10 mA over 50 s on 5 Ah.
    """
    W = m.lanes
    here = W * (m.x + j) + c
    old = w[here]
    if m.compensated:
        there = W * (m.carry + j) + c
        carry = w[there]
        whole = increment + carry
        new = old + whole
        w[there] = whole - (new - old)
        w[here] = new
    else:
        w[here] = old + increment


@inline
def by_belief(w: Any, c: int, m: Any, of_file: Any) -> Any:
    """What is in proportion to r0, `of_file` by the cell file's, by that of the belief."""
    return of_file * (real(w, 1) + w[m.lanes * (m.x + m.r0) + c])


@inline
def predict(w: Any, c: int, m: Any, lost: Any, g: Any, gain: Any, q: Any) -> None:
    """Time update: x <- A x + gain, sqrt_P <- tria([A sqrt_P, diag(q)]), A = I - diag(lost) + g e_bias^T; (n,) each.

    Given as what is lost of each state, 1 - a, because 1 - 1e-5 has half the digits of 1e-5.
    """
    W = m.lanes
    move = vector(w, N_MAX)
    last = m.n - 1
    for j in range(m.n):
        here = W * (m.x + j) + c
        move[j] = gain[j] - lost[j] * w[here]
        if m.bias:
            move[j] += g[j] * w[W * (m.x + last) + c]
    for j in range(m.n):
        add(w, c, m, j, move[j])
    triangularise(w, c, m, lost, g, q)


@inline
def triangularise(w: Any, c: int, m: Any, lost: Any, g: Any, q: Any) -> None:
    """Replace sqrt_P by the lower triangle of [A sqrt_P, diag(q)]."""
    W = m.lanes
    n = m.n
    # Of two sizes: on a microcontroller they lie in memory.
    root = vector(w, DENSE_SIX) if n <= SIX else vector(w, DENSE_MAX)
    noise = vector(w, DENSE_SIX) if n <= SIX else vector(w, DENSE_MAX)
    for j in range(n):
        for k in range(n):
            # One loop of a fixed length: of another length for each row, LLVM would leave `root` in memory.
            old = w[W * (m.root + tri(j, k)) + c] if k <= j else real(w, 0)
            root[n * j + k] = old - lost[j] * old
            if m.bias:
                root[n * j + k] += g[j] * w[W * (m.root + tri(n - 1, k)) + c]
            noise[n * j + k] = q[j] if k == j else real(w, 0)
    # Written out, as LLVM does not unroll a loop with so large a body; what is beyond n vanishes.
    reflect_row(root, noise, m, 0)
    reflect_row(root, noise, m, 1)
    reflect_row(root, noise, m, 2)
    reflect_row(root, noise, m, 3)
    reflect_row(root, noise, m, 4)
    reflect_row(root, noise, m, 5)
    reflect_row(root, noise, m, 6)
    reflect_row(root, noise, m, 7)
    for j in range(n):
        for k in range(j + 1):
            w[W * (m.root + tri(j, k)) + c] = root[n * j + k]


@inline
def reflect_row(root: Any, noise: Any, m: Any, j: int) -> None:
    """`reflect` row j if there is one; without a bias A sqrt_P is lower triangular."""
    if j < m.n:
        reflect(root, noise, m.n, j, m.n if m.bias else j + 1)


@inline
def reflect(root: Any, noise: Any, n: int, j: int, end: int) -> None:
    """The Householder reflection that leaves row j of [root, noise] (n x 2n) its diagonal element only.

    Rows above j are done. Row j of `root` is zero from column `end` on, row j of `noise` beyond column j: without a
    bias A sqrt_P is lower triangular, and `noise` keeps what earlier reflections spilled into its first columns.
    A row of zeros would divide 0 by 0: q is positive.
    """
    squares = real(root, 0)
    for k in range(j, end):
        squares += root[n * j + k] * root[n * j + k]
    for k in range(j + 1):
        squares += noise[n * j + k] * noise[n * j + k]
    norm = math.sqrt(squares)
    # Away from the pivot, so that nothing cancels; then the column's sign is flipped to keep the diagonal positive.
    pivot = root[n * j + j]
    sign = real(root, 1) if pivot >= real(root, 0) else real(root, -1)
    away = pivot + sign * norm
    inverse = real(root, 1) / (norm * away)  # divisions are what takes longest here
    inverse_norm, inverse_away = inverse * away, inverse * norm
    # Written out, as the loops in `triangularise` are.
    reflect_below(root, noise, n, j, end, 1, sign, inverse_norm, inverse_away)
    reflect_below(root, noise, n, j, end, 2, sign, inverse_norm, inverse_away)
    reflect_below(root, noise, n, j, end, 3, sign, inverse_norm, inverse_away)
    reflect_below(root, noise, n, j, end, 4, sign, inverse_norm, inverse_away)
    reflect_below(root, noise, n, j, end, 5, sign, inverse_norm, inverse_away)
    reflect_below(root, noise, n, j, end, 6, sign, inverse_norm, inverse_away)
    reflect_below(root, noise, n, j, end, 7, sign, inverse_norm, inverse_away)
    root[n * j + j] = norm


@inline
def reflect_below(
    root: Any, noise: Any, n: int, j: int, end: int, i: int, sign: Any, inverse_norm: Any, inverse_away: Any
) -> None:
    """The reflection of row j, of row i if that is one below it."""
    if j < i < n:
        dot = real(root, 0)
        for k in range(j, end):
            dot += root[n * j + k] * root[n * i + k]
        for k in range(j + 1):
            dot += noise[n * j + k] * noise[n * i + k]
        along = dot * inverse_norm
        d = (root[n * i + j] + sign * along) * inverse_away
        root[n * i + j] = along
        for k in range(j + 1, end):
            root[n * i + k] -= d * root[n * j + k]
        for k in range(j + 1):
            noise[n * i + k] -= d * noise[n * j + k]


@inline
def innovate(
    p: Any, w: Any, y: Any, c: int, m: Any, z: Any, drop: Any, g0: Any, g_plus: Any, g_minus: Any, r: Any
) -> None:
    """Predict the measurement `z` and compare: leaves the prediction, the innovation (z minus it) and its variance.

    `g0, g_plus, g_minus`: OCV at SoC x[0] and at x[0] +- gamma sqrt_P[0, 0]; `drop`: the ohmic drop by the cell file's
    r0, of the current as measured; `r`: variance of the measurement. The belief is not touched, so a gate can stand
    before `update`.
    """
    W = m.lanes
    e = p[P_W] * (g_plus + g_minus - g0 - g0)
    z_pred = g0 + e - drop
    for j in range(m.n_v):
        z_pred -= w[W * (m.x + V_RC1 + j) + c]
    now = y[W * Y_SCALED + c]
    for j in range(m.n_rc):
        now += w[W * (H_POLARISED + j) + c]
    z_pred -= now * w[W * (m.x + m.r0) + c]
    alpha = r + e * e * p[P_E2]
    variance = alpha
    for k in range(m.n):
        b = real(w, 0)
        for j in range(max(V_RC1, k), V_RC1 + m.n_v):
            b -= w[W * (m.root + tri(j, k)) + c]
        if k <= m.r0:
            b -= y[W * Y_LEAD + c] * w[W * (m.root + tri(m.r0, k)) + c]
        if k == SOC:
            b += p[P_W] * p[P_GAMMA] * (g_plus - g_minus)
        y[W * (Y_B + k) + c] = b
        variance += b * b
    y[W * Y_PREDICTED + c] = z_pred
    y[W * Y_INNOVATION + c] = z - z_pred
    y[W * Y_VARIANCE + c] = variance
    y[W * Y_PER_VARIANCE + c] = real(w, 1) / variance
    y[W * Y_ALPHA + c] = alpha
    y[W * Y_NOISE + c] = r


@inline
def update(w: Any, y: Any, c: int, m: Any) -> None:
    """Measurement update with what `innovate` left, where Y_FUSE says so; elsewhere x and sqrt_P stay.

    Carlson's triangular update (AIAA Journal 11(9), 1973, pp. 1259-1265), from the last column to the first: sums of
    squares only. Variances shrink or stay. The bias takes the share Y_TRUST of its gain, and its variance keeps what
    belongs to the rest (see `bias`).
    """
    W = m.lanes
    gain = vector(w, N_MAX)
    n = m.n
    for j in range(n):
        gain[j] = real(w, 0)
    fuse = y[W * Y_FUSE + c] == real(w, BY_SIGMA_POINTS)
    alpha, per_variance = y[W * Y_ALPHA + c], real(w, 0)
    # Written out, as LLVM does not unroll a loop whose inner one has another length each time.
    alpha, per_variance = shrink_column(w, y, c, m, gain, fuse, alpha, per_variance, 7)
    alpha, per_variance = shrink_column(w, y, c, m, gain, fuse, alpha, per_variance, 6)
    alpha, per_variance = shrink_column(w, y, c, m, gain, fuse, alpha, per_variance, 5)
    alpha, per_variance = shrink_column(w, y, c, m, gain, fuse, alpha, per_variance, 4)
    alpha, per_variance = shrink_column(w, y, c, m, gain, fuse, alpha, per_variance, 3)
    alpha, per_variance = shrink_column(w, y, c, m, gain, fuse, alpha, per_variance, 2)
    alpha, per_variance = shrink_column(w, y, c, m, gain, fuse, alpha, per_variance, 1)
    alpha, per_variance = shrink_column(w, y, c, m, gain, fuse, alpha, per_variance, 0)
    weight = y[W * Y_INNOVATION + c] * per_variance
    if m.bias:
        here = W * (m.root + tri(n - 1, n - 1)) + c
        refused = (real(w, 1) - y[W * Y_TRUST + c]) * gain[n - 1]
        old = w[here]
        w[here] = math.sqrt(old * old + refused * refused * per_variance) if fuse else old
        gain[n - 1] *= y[W * Y_TRUST + c]
    for j in range(n):
        increment = gain[j] * weight
        add(w, c, m, j, increment if fuse else real(w, 0))


@inline
def shrink_column(
    w: Any, y: Any, c: int, m: Any, gain: Any, fuse: Any, alpha: Any, per_variance: Any, j: int
) -> tuple[Any, Any]:
    """Carlson's step for column j of sqrt_P, if there is one: add its share to `gain`.

    Returns alpha, the variance that the columns so far and the noise explain, and one over it.
    """
    W = m.lanes
    if j < m.n:
        b = y[W * (Y_B + j) + c]
        alpha_next = alpha + b * b
        inverse = real(w, 1) / math.sqrt(alpha_next * alpha)
        keep = alpha * inverse
        take = b * inverse
        for i in range(j, m.n):
            here = W * (m.root + tri(i, j)) + c
            old = w[here]
            new = keep * old - take * gain[i]
            gain[i] += b * old
            w[here] = new if fuse else old
        alpha, per_variance = alpha_next, keep * inverse
    return alpha, per_variance
