"""The bounds of SoC that components have, and when one Gaussian has the same."""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import gaussian_sum as gs
from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import clamp
from bms_ukf.kernel.gaussian_sum import MASS
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import PARTS
from bms_ukf.kernel.memory import real
from bms_ukf.kernel.pieces import SIGMA_MIN, UNIFORM

NORMAL = 1.959964  # 97.5 % quantile of a Gaussian
TAIL = 0.025
SAME_SOC = 0.001  # quantiles that a Gaussian may move when it takes over
RELEASE = 0.75  # of the sigma at which components take over
ANYWHERE = 0.49  # a sigma is kept below 0.5 (P_SOC_SIGMA_MAX), so one near it stands for any SoC
BISECTIONS = 9  # of the range that the components have


@inline
def describe(s: Any, at: int, y: Any, sums: Any, m: Any, mb: Any, c: int, centre: Any) -> None:
    """Give the cell the quantiles and the mean of SoC within 0..1."""
    W, B, weights = m.lanes, mb.lanes, gs.weights_of(at, mb)
    zero, one, half = real(s, 0), real(s, 1), real(s, 0.5)
    # `sums` gets the lower end, 1 / length and weight of each component, as uniform in SoC.
    first, last = one, zero
    for j in range(PARTS):
        o, lane = gs.place_of(at, j // B, mb), j % B
        sigma = max(s[o + B * mb.root + lane], real(s, SIGMA_MIN))
        reach = real(s, 1 + gs.EDGE) if sigma > real(s, ANYWHERE) else real(s, UNIFORM) * sigma
        sums[j] = s[o + B * mb.x + lane] - reach
        sums[PARTS + j] = half / reach
        sums[2 * PARTS + j] = s[weights + j]
        first, last = min(first, sums[j]), max(last, s[o + B * mb.x + lane] + reach)
    first, last = clamp(first, zero, one), clamp(last, zero, one)
    below, upto = mass_below(sums, zero), mass_below(sums, one)
    within, mean = zero, zero
    for j in range(PARTS):
        left, right = max(sums[j], zero), min(sums[j] + one / sums[PARTS + j], one)
        mass = sums[2 * PARTS + j] * max(right - left, zero) * sums[PARTS + j]
        within += mass
        mean += mass * (left + right) * half
    low = quantile(sums, first, last, below, upto, below + real(s, TAIL) * (upto - below))
    high = quantile(sums, first, last, below, upto, below + real(s, 1 - TAIL) * (upto - below))
    # Beyond an end no mass is left within 0..1. The bounds are then at that end, and no closer than an OCV can tell.
    some, edge = within > real(s, MASS), one if centre > half else zero
    low, high = low if some else edge, high if some else edge
    least, at_top = real(s, 4 * SIGMA_MIN), low > half
    low, high = min(low, high - least) if at_top else low, high if at_top else max(high, low + least)
    mean = mean / within if some else edge
    y[W * k.Y_PARTS_LOW + c], y[W * k.Y_PARTS_HIGH + c] = low, high
    y[W * k.Y_PARTS_MEAN + c] = clamp(mean, low, high)


@inline
def mass_below(sums: Any, soc: Any) -> Any:
    """Of the components as `describe` lists them."""
    total, second, third = real(sums, 0), real(sums, 0), real(sums, 0)  # one sum would wait for each addition
    for j in range(0, PARTS, 3):
        total += share_below(sums, j, soc)
        second += share_below(sums, j + 1, soc)
        third += share_below(sums, j + 2, soc)
    return total + second + third


@inline
def share_below(sums: Any, j: int, soc: Any) -> Any:
    """Mass of component `j` below `soc`."""
    return sums[2 * PARTS + j] * clamp((soc - sums[j]) * sums[PARTS + j], real(sums, 0), real(sums, 1))


@inline
def quantile(sums: Any, low: Any, high: Any, to_low: Any, to_high: Any, mass: Any) -> Any:
    """The SoC within `low`..`high`, which have `to_low` and `to_high` below them, that has `mass` below it.

    The last interval is interpolated: a middle alone would move by whole intervals, as rounding decides.
    """
    for _ in range(BISECTIONS):
        middle = (low + high) * real(sums, 0.5)
        to_middle = mass_below(sums, middle)
        above = to_middle >= mass
        low, high = low if above else middle, middle if above else high
        to_low, to_high = to_low if above else to_middle, to_middle if above else to_high
    within = to_high - to_low
    share = (mass - to_low) / within if within > real(sums, 0) else real(sums, 0.5)
    return low + clamp(share, real(sums, 0), real(sums, 1)) * (high - low)


@inline
def release(p: Any, w: Any, y: Any, m: Any, c: int) -> None:
    """Let the cell's Gaussian take over where it has the bounds of the components, away from the ends of SoC.

    It is then published at once: another part of this sample will show it, too.
    """
    W = m.lanes
    mean, reach = w[W * m.x + c], real(w, NORMAL) * w[W * m.root + c]
    away = max(abs(mean - reach - y[W * k.Y_PARTS_LOW + c]), abs(mean + reach - y[W * k.Y_PARTS_HIGH + c]))
    same = away < real(w, SAME_SOC)
    narrow = w[W * m.root + c] < real(w, RELEASE) * p[k.P_WIDE_SIGMA]
    released = same & narrow
    w[W * k.H_PARTS + c] = real(w, 0) if released else real(w, 1)
    low = y[W * k.Y_PARTS_LOW + c]
    y[W * k.Y_PARTS_LOW + c] = real(w, math.nan) if released else low
