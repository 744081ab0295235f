"""Compute the published SoC: mean, sigma and 95 % bounds of the posterior, truncated to 0..1.

The posterior before truncation is the Gaussian N(mean, sigma^2); its sigma is the unit of `a`, `b` and `z`. The
formulas are those of the doubly truncated normal distribution (Johnson, Kotz, Balakrishnan: Continuous Univariate
Distributions 1, 1994, section 13.10.1). The coefficients are minimax fits to scipy.stats; `tests/test_interval.py`
compares the results.
"""

from __future__ import annotations

from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import clamp, decay, is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real

HALF_WIDTHS = 1.96  # sigmas between the mean of a Gaussian and a bound
TAIL = 0.025  # probability beyond each bound
FAR = 4.5  # sigmas to an edge of 0..1 beyond which that edge moves no bound by 1e-5 SoC
SQRT_TWO_PI = 2.5066282746310002

# A standard Gaussian cut off below a >= -FAR: how far its 2.5 % quantile, 97.5 % quantile and mean lie above a.
# Rational functions of a: numerator, then denominator, constant terms first. Error below 3e-5 SoC.
LOW = (
    (0.031438359, 0.009366482, 0.0036897079, -0.00032162424, 0.00017171756),
    (1.0, 1.0806959, 0.50063355, 0.11854387, 0.014371402, 0.00070510016),
)
HIGH = (
    (2.2414082, 0.34008315, 0.11855695, 0.0079895618, 0.00045027034),
    (1.0, 0.46034473, 0.14747582, 0.026103877, 0.0026020225, 0.00011137844),
)
MEAN = (
    (0.79787842, 0.18322655, 0.060058563, 0.0039564954, 0.00028481605),
    (1.0, 0.6851499, 0.25069526, 0.049397272, 0.0052337691, 0.00023198374),
)
# z over r of the probability 1/2 + r that a Gaussian lies below z, |r| <= 0.4915: a function of r^2. Error 3e-5.
QUANTILE = (
    (2.5071141, -20.072383, 47.280438, -27.827786),
    (1.0, -9.045246, 25.883302, -22.716138),
)


@inline
def describe(w: Any, y: Any, m: Any, lanes: int) -> None:
    """Fill each lane's Y_SOC (the mean), Y_SOC_SIGMA, Y_SOC_LOW and Y_SOC_HIGH; NaN without a belief.

    A Gaussian that no edge touches keeps its own mean and sigma, to the last bit.
    """
    W = m.lanes
    zero, one = real(w, 0), real(w, 1)
    near, wide = 0, 0
    for c in range(lanes):
        mean, sigma = w[W * (m.x + k.SOC) + c], w[W * m.root + c]
        half, far = real(w, HALF_WIDTHS) * sigma, real(w, FAR) * sigma
        y[W * k.Y_SOC + c], y[W * k.Y_SOC_SIGMA + c] = mean, sigma
        y[W * k.Y_SOC_LOW + c], y[W * k.Y_SOC_HIGH + c] = mean - half, mean + half
        below, above = mean - far < zero, mean + far > one
        near |= 1 if below | above else 0
        wide |= 1 if below & above else 0
    if near:
        for c in range(lanes):
            truncate(w, y, m, c)
    if wide:
        for c in range(lanes):
            truncate_twice(w, y, m, c)
    for c in range(lanes):
        low, mean, high = y[W * k.Y_PARTS_LOW + c], y[W * k.Y_PARTS_MEAN + c], y[W * k.Y_PARTS_HIGH + c]
        apart = is_number(low)
        sigma = (high - low) * real(w, 1 / (2 * HALF_WIDTHS))
        y[W * k.Y_SOC + c] = mean if apart else y[W * k.Y_SOC + c]
        y[W * k.Y_SOC_SIGMA + c] = sigma if apart else y[W * k.Y_SOC_SIGMA + c]
        y[W * k.Y_SOC_LOW + c] = low if apart else y[W * k.Y_SOC_LOW + c]
        y[W * k.Y_SOC_HIGH + c] = high if apart else y[W * k.Y_SOC_HIGH + c]


@inline
def truncate(w: Any, y: Any, m: Any, c: int) -> None:
    """Cut the posterior off at the nearer edge of 0..1."""
    W = m.lanes
    mean, sigma = w[W * (m.x + k.SOC) + c], w[W * m.root + c]
    away = clearance(w, mean)
    a = -away / sigma
    from_edge = sigma * ratio(w, MEAN, a), sigma * ratio(w, LOW, a), sigma * ratio(w, HIGH, a)
    publish_lane(w, y, m, c, mean, from_edge, away < real(w, FAR) * sigma)


@inline
def truncate_twice(w: Any, y: Any, m: Any, c: int) -> None:
    """Cut the posterior off at both edges, where both matter."""
    W = m.lanes
    mean, sigma = w[W * (m.x + k.SOC) + c], w[W * m.root + c]
    away = clearance(w, mean)
    a, b = -away / sigma, (real(w, 1) - away) / sigma
    at_a, below_a = gaussian(w, a)
    at_b, below_b = gaussian(w, b)
    within = below_b - below_a
    within = within if within > real(w, 0) else real(w, 1)  # of a lane that this is not for: plain Python would raise
    middle = sigma * (at_a - at_b) / within
    low = sigma * quantile(w, below_a + real(w, TAIL) * within)
    high = sigma * quantile(w, below_b - real(w, TAIL) * within)
    from_edge = away + middle, away + low, away + high
    publish_lane(w, y, m, c, mean, from_edge, b < real(w, FAR))


@inline
def clearance(w: Any, mean: Any) -> Any:
    """Distance of `mean` to the nearer edge of 0..1; below 0 outside."""
    other = real(w, 1) - mean
    return other if other < mean else mean


@inline
def publish_lane(w: Any, y: Any, m: Any, c: int, mean: Any, from_edge: tuple[Any, Any, Any], applies: Any) -> None:
    """Write mean and bounds, given as distances from the edge nearer to `mean`, if the truncation `applies`."""
    W = m.lanes
    one, most = real(w, 1), mean > real(w, 0.5)
    low, high = clamp(from_edge[1], real(w, 0), one), clamp(from_edge[2], real(w, 0), one)
    soc = clamp(from_edge[0], low, high)
    soc = one - soc if most else soc
    sigma = (high - low) / real(w, 2 * HALF_WIDTHS)
    first, last = (one - high if most else low), (one - low if most else high)
    y[W * k.Y_SOC + c] = soc if applies else y[W * k.Y_SOC + c]
    y[W * k.Y_SOC_SIGMA + c] = sigma if applies else y[W * k.Y_SOC_SIGMA + c]
    y[W * k.Y_SOC_LOW + c] = first if applies else y[W * k.Y_SOC_LOW + c]
    y[W * k.Y_SOC_HIGH + c] = last if applies else y[W * k.Y_SOC_HIGH + c]


@inline
def ratio(s: Any, of: Any, x: Any) -> Any:
    """A rational function: numerator and denominator in `of`, constant terms first."""
    return horner(s, of[0], x) / horner(s, of[1], x)


@inline
def horner(s: Any, coefficients: Any, x: Any) -> Any:
    value = real(s, coefficients[-1])
    for place in range(len(coefficients) - 2, -1, -1):
        value = value * x + real(s, coefficients[place])
    return value


@inline
def gaussian(s: Any, z: Any) -> tuple[Any, Any]:
    """Density and distribution of a standard Gaussian at z. Its tail is the density over the hazard, |z| + MEAN."""
    size = abs(z)
    density = decay(s, size * size * real(s, 0.5)) * real(s, 1 / SQRT_TWO_PI)
    tail = density / (size + ratio(s, MEAN, size))
    return density, tail if z < real(s, 0) else real(s, 1) - tail


@inline
def quantile(s: Any, probability: Any) -> Any:
    r = probability - real(s, 0.5)
    return r * ratio(s, QUANTILE, r * r)
