"""Gaussians cut into intervals of SoC, and the pieces in an interval made one Gaussian again.

What is summed for an interval: the mass of its pieces, mass times state, and mass times the products of two states.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel.ecm import clamp, decay, is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import tri
from bms_ukf.kernel.memory import floor, real, whole
from bms_ukf.kernel.process import TINY_ROOT

UNIFORM = 1.7320508  # half-width of a uniform distribution, in its sigmas
REACH = 4.0  # sigmas of a Gaussian that is cut by its density
SIGMA_MIN = 1e-4
FLAT = 1e-6  # share of a variance below which rounding has eaten it


@inline
def per_interval(m: Any) -> Any:
    """Numbers that are summed for an interval: mass, mass times state, mass times squares."""
    return 1 + m.n + m.n * (m.n + 1) // 2


@inline
def clear(sums: Any, count: int, m: Any) -> None:
    for place in range(count * per_interval(m)):
        sums[place] = real(sums, 0)


@inline
def put(
    sums: Any,
    count: int,
    a: Any,
    o: int,
    W: int,
    c: int,
    m: Any,
    mass: Any,
    low: Any,
    width: Any,
    gaussian: int,
) -> None:
    """Cut the Gaussian in lane `c` of the record at `o` of `a` into `count` intervals of SoC; add the pieces to `sums`.

    The intervals begin at `low`. What lies beyond the first or the last interval goes into that one. A piece of a
    Gaussian that is much wider than an interval has its density; any other Gaussian is cut as a uniform distribution
    of its mean and variance.
    """
    zero, half = real(a, 0), real(a, 0.5)
    soc, sigma = a[o + W * m.x + c], max(a[o + W * m.root + c], real(a, SIGMA_MIN))
    reach = sigma * (real(a, REACH) if gaussian else real(a, UNIFORM))
    begin, end = soc - reach, soc + reach
    most = real(a, count - 1)
    first_at, last_at = floor((begin - low) / width), floor((end - low) / width)
    # What is not a number must not give an index.
    first = whole(clamp(first_at if is_number(first_at) else zero, zero, most))
    last = whole(clamp(last_at if is_number(last_at) else zero, zero, most))
    for j in range(first, last + 1):
        centre = low + (real(a, j) + half) * width
        left = begin if j == first else centre - half * width
        right = end if j == last else centre + half * width
        middle, length = (left + right) * half, right - left
        away = (middle - soc) / sigma
        share = mass * length / (end - begin)
        share *= decay(a, away * away * half) if gaussian else real(a, 1)
        within = length * length / (sigma * sigma * real(a, 12))
        at = j * per_interval(m)
        sums[at] += share
        for row in range(m.n):
            x_row = middle - centre if row == 0 else mean_at(a, o, W, c, m, row, away)
            sums[at + 1 + row] += share * x_row
            for column in range(row + 1):
                x_column = middle - centre if column == 0 else mean_at(a, o, W, c, m, column, away)
                lead = lead_of(a, o, W, c, m, row) * lead_of(a, o, W, c, m, column) * within
                for between in range(1, column + 1):
                    product = a[o + W * (m.root + tri(row, between)) + c]
                    lead += product * a[o + W * (m.root + tri(column, between)) + c]
                sums[at + 1 + m.n + tri(row, column)] += share * (x_row * x_column + lead)


@inline
def lead_of(a: Any, o: int, W: int, c: int, m: Any, row: int) -> Any:
    """What a sigma of SoC moves a state by."""
    lead = a[o + W * (m.root + tri(row, 0)) + c]
    return max(lead, real(a, SIGMA_MIN)) if row == 0 else lead


@inline
def mean_at(a: Any, o: int, W: int, c: int, m: Any, row: int, away: Any) -> Any:
    """Mean of a state where SoC is `away` of its sigmas from its mean."""
    return a[o + W * (m.x + row) + c] + away * a[o + W * (m.root + tri(row, 0)) + c]


@inline
def gather(a: Any, o: int, W: int, c: int, sums: Any, at: int, m: Any, centre: Any) -> None:
    """Make the sums at `at` the Gaussian in lane `c` of the record at `o` of `a`: its mean, and Cholesky's root."""
    mass = sums[at]
    for row in range(m.n):
        mean = sums[at + 1 + row] / mass
        a[o + W * (m.x + row) + c] = mean
        for column in range(row + 1):
            here = o + W * (m.root + tri(row, column)) + c
            second = sums[at + 1 + m.n + tri(row, column)] / mass
            covariance = second - mean * a[o + W * (m.x + column) + c]
            rest = covariance
            for between in range(column):
                product = a[o + W * (m.root + tri(row, between)) + c]
                rest -= product * a[o + W * (m.root + tri(column, between)) + c]
            if row == column:
                least = real(a, FLAT) * abs(covariance) + real(a, TINY_ROOT) * real(a, TINY_ROOT)
                a[here] = math.sqrt(max(rest, least))
            else:
                a[here] = rest / a[o + W * (m.root + tri(column, column)) + c]
    a[o + W * m.x + c] += centre
    for slot in range(m.carry, m.cache):
        a[o + W * slot + c] = real(a, 0)
