"""The first measurement update of a belief so wide that the OCV curve is not nearly straight across it.

Sigma points describe a curve by three values. Over +-35 % SoC (a start that is told 20 % sigma) that is not enough: the
update would land beside the truth and be sure of it. Given SoC, though, everything else is linear and Gaussian, so the
posterior's mean and covariance follow from a quadrature over SoC alone (Rao-Blackwellised moment matching).

With x = mean + sqrt_P xi and xi standard normal, SoC is mean + sqrt_P[0, 0] xi_0. For every xi_0:
    residual    e(xi_0) = z - (predicted voltage at that SoC, the other states at their mean given SoC)
    weight      N(xi_0; 0, 1) N(e; 0, V),  V = r + sum of b_k^2, k >= 1
    the rest    xi_k | xi_0 ~ N(b_k e / V, I - b b^T / V),  k >= 1
with b and r as `srukf.innovate` left them. The moments of xi under these weights give the new mean and, as the product
of two lower triangles, the new sqrt_P.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel.ecm import decay, ocv
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import (
    DENSE_MAX,
    H_POLARISED,
    N_MAX,
    SOC,
    V_RC1,
    Y_B,
    Y_DROP,
    Y_LEAD,
    Y_NOISE,
    Y_SCALED,
    Y_T,
    Y_VOLTAGE,
    tri,
)
from bms_ukf.kernel.memory import real, vector

MOMENTS = 5  # see `moments`
POINTS = 64  # a pass; the second pass spreads them over what the first has left
REACH = 5.0  # sigmas of the belief, or of what the first pass has left of it
SOC_MIN, SOC_MAX = -0.02, 1.02  # no SoC lies outside: the tables' slack


@inline
def update_wide(p: Any, w: Any, y: Any, m: Any, c: int) -> None:
    """As `srukf.update`, for lane `c`."""
    W = m.lanes
    sigma = w[W * m.root + c]
    soc = w[W * (m.x + SOC) + c]
    variance = y[W * Y_NOISE + c]
    for j in range(V_RC1, m.n):
        variance += y[W * (Y_B + j) + c] * y[W * (Y_B + j) + c]
    first = (real(w, SOC_MIN) - soc) / sigma
    last = (real(w, SOC_MAX) - soc) / sigma
    reach = real(w, REACH)
    # Of the tables, what the belief reaches; if it reaches nothing of them, the end that is nearest to it.
    low = max(first, min(-reach, last - reach))
    high = min(last, max(reach, first + reach))
    moments = vector(w, MOMENTS)
    for _ in range(2):
        quadrature(p, w, y, m, c, variance, low, high, moments)
        reach = real(w, REACH) * math.sqrt(moments[2]) + (high - low) / real(w, POINTS)
        low = max(low, moments[0] - reach)
        high = min(high, moments[0] + reach)
    conclude(w, y, m, c, variance, moments)


@inline
def quadrature(p: Any, w: Any, y: Any, m: Any, c: int, variance: Any, low: Any, high: Any, moments: Any) -> None:
    """Means and covariances of xi_0 and the residual e, by quadrature from `low` to `high`.

    Writes moments = [E xi_0, E e, var xi_0, cov(xi_0, e), var e].
    """
    W = m.lanes
    weights = vector(w, POINTS)
    exponent = vector(w, POINTS)
    residual = vector(w, POINTS)
    step = (high - low) / real(w, POINTS)
    half = real(w, 0.5)
    # All but the OCV is linear in xi_0.
    T = y[W * Y_T + c]
    rest = y[W * Y_VOLTAGE + c] + y[W * Y_DROP + c]
    slope = y[W * Y_B + c] * real(w, 0)
    for j in range(V_RC1, V_RC1 + m.n_v):
        rest += w[W * (m.x + j) + c]
        slope += w[W * (m.root + tri(j, SOC)) + c]
    now = y[W * Y_SCALED + c]
    for j in range(m.n_rc):
        now += w[W * (H_POLARISED + j) + c]
    rest += now * w[W * (m.x + m.r0) + c]
    slope += y[W * Y_LEAD + c] * w[W * (m.root + tri(m.r0, SOC)) + c]
    soc = w[W * (m.x + SOC) + c]
    sigma = w[W * m.root + c]
    least = real(w, math.inf)
    before = rest + slope * low - ocv(p, soc + sigma * low, T)
    for point in range(POINTS):
        xi = low + (real(w, point) + half) * step
        end = xi + half * step
        after = rest + slope * end - ocv(p, soc + sigma * end, T)
        e = rest + slope * xi - ocv(p, soc + sigma * xi, T)
        # Where the grid is coarser than the likelihood is wide, the likelihood is widened to the grid.
        blur = after - before
        spread = variance + blur * blur / real(w, 12)
        weights[point] = real(w, 1) / math.sqrt(spread)
        exponent[point] = half * (xi * xi + e * e / spread)
        residual[point] = e
        least = min(least, exponent[point])
        before = after
    total = real(w, 0)
    for j in range(MOMENTS):
        moments[j] = real(w, 0)
    for point in range(POINTS):
        weight = weights[point] * decay(w, exponent[point] - least)
        weights[point] = weight
        total += weight
        moments[0] += weight * (low + (real(w, point) + half) * step)
        moments[1] += weight * residual[point]
    moments[0] /= total
    moments[1] /= total
    for point in range(POINTS):
        weight = weights[point] / total
        d_xi = low + (real(w, point) + half) * step - moments[0]
        d_e = residual[point] - moments[1]
        moments[2] += weight * d_xi * d_xi
        moments[3] += weight * d_xi * d_e
        moments[4] += weight * d_e * d_e
    moments[2] += step * step / real(w, 12)  # each point stands for an interval


@inline
def conclude(w: Any, y: Any, m: Any, c: int, variance: Any, moments: Any) -> None:
    """Turn the moments of xi_0 and e into those of all xi, and these into x and sqrt_P."""
    W = m.lanes
    n = m.n
    xi = vector(w, N_MAX)
    cov = vector(w, DENSE_MAX)  # covariance of xi, then its Cholesky factor
    root = vector(w, DENSE_MAX)
    xi[SOC] = moments[0]
    cov[0] = moments[2]
    shrink = (moments[4] / variance - real(w, 1)) / variance
    for j in range(V_RC1, n):
        b = y[W * (Y_B + j) + c]
        xi[j] = b * moments[1] / variance
        cov[n * j] = b * moments[3] / variance
        for i in range(V_RC1, j + 1):
            cov[n * j + i] = b * y[W * (Y_B + i) + c] * shrink + (real(w, 1) if j == i else real(w, 0))
    for j in range(n):
        for i in range(j + 1):
            rest = cov[n * j + i]
            for between in range(i):
                rest -= cov[n * j + between] * cov[n * i + between]
            cov[n * j + i] = math.sqrt(rest) if j == i else rest / cov[n * i + i]
    for j in range(n):
        for i in range(j + 1):
            root[n * j + i] = real(w, 0)
            for between in range(i, j + 1):
                root[n * j + i] += w[W * (m.root + tri(j, between)) + c] * cov[n * between + i]
    for j in range(n):
        for i in range(j + 1):
            w[W * (m.x + j) + c] += w[W * (m.root + tri(j, i)) + c] * xi[i]
    for j in range(n):
        for i in range(j + 1):
            w[W * (m.root + tri(j, i)) + c] = root[n * j + i]
