"""The measurement update for a belief so wide that the OCV curve is not nearly straight across it.

Sigma points describe a curve by three values. Over +-35 % SoC (a start that is told 20 % sigma) that is not enough: the
update would land beside the truth and be sure of it. Given SoC, though, everything else is linear and Gaussian, so the
posterior's mean and covariance follow from a quadrature over SoC alone (Rao-Blackwellised moment matching).

With x = mean + sqrt_P xi and xi standard normal, SoC is mean + sqrt_P[0, 0] xi_0. For every xi_0:
    residual    e(xi_0) = z - ocv(soc) + v_rc1 + v_rc2, these at their mean given SoC
    weight      N(xi_0; 0, 1) N(e; 0, V),  V = r + sum of b_k^2, k >= 1
    the rest    xi_k | xi_0 ~ N(b_k e / V, I - b b^T / V),  k >= 1
with b and r as `srukf.innovate` left them. The moments of xi under these weights give the new mean and, as the product
of two lower triangles, the new sqrt_P.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel.ecm import ocv
from bms_ukf.kernel.layout import H_B, N_MAX, PACKED_MAX, SOC, V_RC1, held_at, root_at, tri
from bms_ukf.kernel.memory import inline, real, vector
from bms_ukf.kernel.srukf import commit

MOMENTS = 5  # see `moments`
POINTS = 64  # a pass; the second pass spreads them over what the first has left
REACH = 5.0  # sigmas of the belief, or of what the first pass has left of it
SOC_MIN, SOC_MAX = -0.02, 1.02  # no SoC lies outside: the tables' slack


@inline
def update_wide(p: Any, s: Any, o: int, n: int, z: Any, T: Any, r: Any) -> bool:
    """As `srukf.update`, for the measurement `z` (V, without the ohmic drop) of variance `r` at temperature `T`."""
    h = o + held_at(n)
    sigma = s[o + root_at(n)]
    variance = r
    for k in range(V_RC1, n):
        variance += s[h + H_B + k] * s[h + H_B + k]
    first = (real(s, SOC_MIN) - s[o + SOC]) / sigma
    last = (real(s, SOC_MAX) - s[o + SOC]) / sigma
    reach = real(s, REACH)
    # Of the tables, what the belief reaches; if it reaches nothing of them, the end that is nearest to it.
    low = max(first, min(-reach, last - reach))
    high = min(last, max(reach, first + reach))
    m = vector(s, MOMENTS)
    for _ in range(2):
        moments(p, s, o, n, z, T, variance, low, high, m)
        reach = real(s, REACH) * math.sqrt(m[2]) + (high - low) / real(s, POINTS)
        low = max(low, m[0] - reach)
        high = min(high, m[0] + reach)
    return _commit_moments(s, o, n, variance, m)


@inline
def moments(p: Any, s: Any, o: int, n: int, z: Any, T: Any, variance: Any, low: Any, high: Any, m: Any) -> None:
    """Means and covariances of xi_0 and the residual e, by quadrature from `low` to `high`.

    Writes m = [E xi_0, E e, var xi_0, cov(xi_0, e), var e].
    """
    log_weight = vector(s, POINTS)
    residual = vector(s, POINTS)
    step = (high - low) / real(s, POINTS)
    largest = real(s, -math.inf)
    before = _residual(p, s, o, n, z, T, low)
    for k in range(POINTS):
        xi = low + (real(s, k) + real(s, 0.5)) * step
        after = _residual(p, s, o, n, z, T, xi + real(s, 0.5) * step)
        e = _residual(p, s, o, n, z, T, xi)
        # Where the grid is coarser than the likelihood is wide, the likelihood is widened to the grid.
        blur = after - before
        spread = variance + blur * blur / real(s, 12)
        log_weight[k] = real(s, -0.5) * (xi * xi + e * e / spread + math.log(spread))
        residual[k] = e
        largest = max(largest, log_weight[k])
        before = after
    total = real(s, 0)
    for j in range(MOMENTS):
        m[j] = real(s, 0)
    for k in range(POINTS):
        weight = math.exp(log_weight[k] - largest)
        log_weight[k] = weight
        total += weight
        m[0] += weight * (low + (real(s, k) + real(s, 0.5)) * step)
        m[1] += weight * residual[k]
    m[0] /= total
    m[1] /= total
    for k in range(POINTS):
        weight = log_weight[k] / total
        d_xi = low + (real(s, k) + real(s, 0.5)) * step - m[0]
        d_e = residual[k] - m[1]
        m[2] += weight * d_xi * d_xi
        m[3] += weight * d_xi * d_e
        m[4] += weight * d_e * d_e
    m[2] += step * step / real(s, 12)  # each point stands for an interval


@inline
def _residual(p: Any, s: Any, o: int, n: int, z: Any, T: Any, xi: Any) -> Any:
    e = z - ocv(p, s[o + SOC] + s[o + root_at(n)] * xi, T)
    for j in range(V_RC1, n):
        e += s[o + j] + s[o + root_at(n) + tri(j, SOC)] * xi
    return e


@inline
def _commit_moments(s: Any, o: int, n: int, variance: Any, m: Any) -> bool:
    x = vector(s, N_MAX)
    xi = vector(s, N_MAX)
    c = vector(s, PACKED_MAX)  # covariance of xi, then its Cholesky factor
    root = vector(s, PACKED_MAX)
    b_at = o + held_at(n) + H_B
    xi[SOC] = m[0]
    c[0] = m[2]
    for j in range(V_RC1, n):
        xi[j] = s[b_at + j] * m[1] / variance
        c[tri(j, SOC)] = s[b_at + j] * m[3] / variance
        for k in range(V_RC1, j + 1):
            shrink = (m[4] / variance - real(s, 1)) / variance
            c[tri(j, k)] = s[b_at + j] * s[b_at + k] * shrink + (real(s, 1) if j == k else real(s, 0))
    for j in range(n):
        for k in range(j + 1):
            rest = c[tri(j, k)]
            for between in range(k):
                rest -= c[tri(j, between)] * c[tri(k, between)]
            c[tri(j, k)] = math.sqrt(rest) if j == k else rest / c[tri(k, k)]
    for j in range(n):
        x[j] = s[o + j]
        for k in range(j + 1):
            x[j] += s[o + root_at(n) + tri(j, k)] * xi[k]
            root[tri(j, k)] = real(s, 0)
            for between in range(k, j + 1):
                root[tri(j, k)] += s[o + root_at(n) + tri(j, between)] * c[tri(between, k)]
    return commit(s, o, n, x, root)
