"""The components of a belief: where they lie, and how they are cut, merged and weighed.

A Gaussian sum (Alspach & Sorenson, IEEE Trans. Automatic Control 17(4), 1972) over SoC. SoC is divided into equal
intervals; every Gaussian is cut at their ends, and all pieces in an interval become one Gaussian with the mean and the
covariance of these pieces. A Gaussian that is about as wide as an interval is cut as a uniform distribution of its mean
and variance, so a sum keeps both exactly.

The components of a cell are PARTS records without the policy's slots, in blocks of Form.part_lanes, followed by PARTS
weights.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import cache_dynamics, decay, is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import PARTS, form_at_compile_time, tri
from bms_ukf.kernel.memory import real, whole
from bms_ukf.kernel.pieces import REACH, SIGMA_MIN, clear, gather, per_interval, put
from bms_ukf.kernel.process import schedule

HISTORIES = 2  # that are kept apart: see `histories`

MASS = 1e-5  # weight of a component that counts for the range
COUNTS = 1e-3  # and for the width
WEIGHT_MIN = 1e-9  # a component this unlikely can still come back
WIDTH_MIN = 3e-4  # SoC between components
EDGE = 0.05  # how far SoC may wander beyond 0..1
APART, JOIN_S = 1e-4, 900.0  # weight and age below which histories are kept apart
TOO_WIDE, TOO_SPARSE = 1.5, 0.5  # in widths and in the range: when components are placed again


@inline
def of_parts(m: Any) -> Any:
    """The form of a loop over components."""
    return form_at_compile_time(m.n_rc, m.hysteresis, m.bias, m.core, m.part_lanes, m.compensated, 0)


@inline
def place_of(at: int, block: int, mb: Any) -> Any:
    """Where the record of a block of components would begin: they have no part of it before x."""
    return at + mb.lanes * (block * (end_of(mb) - k.HELD) - k.HELD)


@inline
def end_of(mb: Any) -> Any:
    """Slots of a component's record: a loop over one component keeps of a table row only where it was read."""
    return mb.size if mb.lanes > 1 else mb.cache + k.C_VALUES


@inline
def weights_of(at: int, mb: Any) -> Any:
    return at + PARTS * (end_of(mb) - k.HELD)


@inline
def forget_tables(s: Any, at: int, mb: Any) -> None:
    """The components' cached table rows are none, whatever the memory holds."""
    for block in range(PARTS // mb.lanes):
        o = place_of(at, block, mb)
        for slot in range(mb.lanes * mb.x, mb.lanes * end_of(mb)):
            s[o + slot] = real(s, 0)
        for lane in range(mb.lanes):
            s[o + mb.lanes * (mb.cache + k.C_KNOT) + lane] = real(s, math.nan)


@inline
def are_finite(s: Any, at: int, mb: Any) -> Any:
    """Whether the components are numbers only, and have weight."""
    weights, mass, unsound = weights_of(at, mb), real(s, 0), 0
    for j in range(PARTS):
        mass += s[weights + j]
    for block in range(PARTS // mb.lanes):
        o = place_of(at, block, mb)
        for slot in range(mb.lanes * mb.x, mb.lanes * mb.carry):
            value = s[o + slot]  # a sum of them would wait for each addition
            unsound |= 0 if value - value == real(s, 0) else 1
    return (unsound == 0) & (mass > real(s, 0)) & (mass - mass == real(s, 0))


@inline
def read_tables(p: Any, s: Any, o: int, b: Any, v: Any, mb: Any) -> None:
    """`process.schedule` of the block at `o`; one component's row is made again from where it was read, in `b`."""
    if mb.lanes > 1:
        schedule(p, s, o, b, v, mb, mb.lanes)
    else:
        knot, temperature = mb.cache + k.C_KNOT, mb.cache + k.C_TEMPERATURE
        b[knot], b[temperature] = s[o + knot], s[o + temperature]
        if is_number(b[knot]):
            soc = (b[knot] + real(p, 0.5)) / p[k.P_DYN + k.T_INTERVALS]
            cache_dynamics(p, b, 0, mb, soc, b[temperature], b[k.H_RESISTANCE])
        schedule(p, b, 0, b, v, mb, 1)
        s[o + knot], s[o + temperature] = b[knot], b[temperature]


@inline
def share_inputs(w: Any, y: Any, b: Any, v: Any, m: Any, c: int, mb: Any) -> None:
    """Give every component what was measured of its cell, and what is held."""
    W, B = m.lanes, mb.lanes
    for slot in range(k.HELD):
        held = w[W * slot + c]
        for lane in range(B):
            b[B * slot + lane] = held
    if m.core:  # the cell's own step has warmed it already
        for lane in range(B):
            b[B * k.H_CORE_RISE + lane] = b[B * k.H_CORE_USED + lane]
    known, gap, volts = y[W * k.Y_KNOWN + c], y[W * k.Y_GAP + c], y[W * k.Y_VOLTAGE + c]
    walked, since = y[W * k.Y_WALK + c], y[W * k.Y_SINCE_HEARD + c]
    for lane in range(B):
        v[B * k.Y_KNOWN + lane], v[B * k.Y_GAP + lane], v[B * k.Y_VOLTAGE + lane] = known, gap, volts
        v[B * k.Y_RESOLVED + lane], v[B * k.Y_SINCE_HEARD + lane] = walked, since
        v[B * k.Y_ALIVE + lane], v[B * k.Y_CODE + lane] = real(w, 1), real(w, 0)


@inline
def become_one(s: Any, at: int, w: Any, m: Any, mb: Any, c: int) -> None:
    """Make the cell's Gaussian the first component, with all the weight."""
    W, B, weights = m.lanes, mb.lanes, weights_of(at, mb)
    for j in range(PARTS):
        s[weights + j] = real(s, 0)
    s[weights] = real(s, 1)
    o = place_of(at, 0, mb)
    for slot in range(mb.x, mb.cache):
        s[o + B * slot] = w[W * slot + c]
    w[W * k.H_PART_WIDTH + c] = real(w, 0)


@inline
def place(s: Any, at: int, sums: Any, m: Any, mb: Any, first: int, count: int, low: Any, width: Any) -> None:
    """Make the first `count` sums components `first` to `first + count - 1`; one without mass gets no weight."""
    B, weights = mb.lanes, weights_of(at, mb)
    total = real(s, 0)
    for j in range(first, first + count):
        total += sums[(j - first) * per_interval(m)]
    for j in range(first, first + count):
        here = (j - first) * per_interval(m)
        o, lane, mass = place_of(at, j // B, mb), j % B, sums[here]
        centre = low + (real(s, j - first) + real(s, 0.5)) * width
        some = mass > total * real(s, WEIGHT_MIN)
        s[weights + j] = mass if some else real(s, 0)
        if some:
            gather(s, o, B, lane, sums, here, mb, centre)
        else:
            for slot in range(mb.x, mb.cache):
                s[o + B * slot + lane] = real(s, 0)
            s[o + B * mb.x + lane] = centre
            for row in range(mb.n):
                s[o + B * (mb.root + tri(row, row)) + lane] = real(s, SIGMA_MIN)
        s[o + B * (mb.cache + k.C_KNOT) + lane] = real(s, math.nan)


@inline
def pool(s: Any, at: int, w: Any, sums: Any, m: Any, mb: Any, c: int, centre: Any) -> None:
    """Give lane `c` of `w` the mean and the covariance of the components; `centre` is near their SoC.

    Every lane has sums of its own, which are added at the end: so the loop over lanes becomes vector instructions.
    """
    B, weights = mb.lanes, weights_of(at, mb)
    for here in range(B * per_interval(m)):
        sums[here] = real(s, 0)
    for block in range(PARTS // B):
        o = place_of(at, block, mb)
        for lane in range(B):
            weight = s[weights + block * B + lane]
            sums[lane] += weight
            for row in range(m.n):
                x_row = s[o + B * (mb.x + row) + lane]
                x_row -= centre if row == 0 else real(s, 0)
                sums[B * (1 + row) + lane] += weight * x_row
                for column in range(row + 1):
                    x_column = s[o + B * (mb.x + column) + lane]
                    x_column -= centre if column == 0 else real(s, 0)
                    second = x_row * x_column
                    for between in range(column + 1):
                        product = s[o + B * (mb.root + tri(row, between)) + lane]
                        second += product * s[o + B * (mb.root + tri(column, between)) + lane]
                    sums[B * (1 + m.n + tri(row, column)) + lane] += weight * second
    for here in range(per_interval(m)):
        total = real(s, 0)
        for lane in range(B):
            total += sums[B * here + lane]
        sums[here] = total
    gather(w, 0, m.lanes, c, sums, 0, m, centre)


@inline
def normalise(s: Any, at: int, mb: Any) -> None:
    weights, total = weights_of(at, mb), real(s, 0)
    for j in range(PARTS):
        total += s[weights + j]
    for j in range(PARTS):
        s[weights + j] /= total


@inline
def likelihood(w: Any, nis: Any, per_variance: Any) -> Any:
    """Of an innovation, up to a factor, from its normalised square beyond that of another."""
    return math.sqrt(per_variance) * decay(w, nis / real(w, 2))


@inline
def weigh(s: Any, at: int, sums: Any, mb: Any) -> None:
    """Multiply the weights by the likelihood of the voltage.

    `sums` has of each component: innovation squared; the variance that its own SoC gives the innovation; the
    rest of its variance. All components share the mean of that rest. Tables over SoC give each component noise of its
    own, and noise is rather overestimated: with a variance of its own, the component of the lowest noise would win by
    the normaliser, or that of the highest noise by its small innovations, whatever the voltage.
    """
    weights, zero = weights_of(at, mb), real(s, 0)
    shared, mass, best, total = zero, zero, real(s, math.inf), zero
    for j in range(PARTS):
        weight = s[weights + j]
        shared += weight * sums[2 * PARTS + j] if weight > zero else zero
        mass += weight
    shared /= mass
    for j in range(PARTS):
        per_variance = real(s, 1) / (shared + sums[PARTS + j])
        sums[PARTS + j] = shared * per_variance
        sums[j] *= per_variance
        best = min(best, sums[j]) if s[weights + j] > zero else best
    for j in range(PARTS):
        weight = s[weights + j] * likelihood(s, sums[j] - best, sums[PARTS + j])
        sums[j] = weight
        total += weight
    for j in range(PARTS):
        weight = sums[j] / total
        s[weights + j] = max(weight, real(s, WEIGHT_MIN)) if s[weights + j] > zero else zero


@inline
def cut(s: Any, at: int, w: Any, sums: Any, m: Any, mb: Any, c: int, gaussian: int, due_now: Any) -> None:
    """Place components again where they are too wide for their number, or have too narrow a range, if `due_now`.

    Histories are placed apart; they join when one is without mass, or when either has faded. At last the cell gets the
    mean and the covariance of the sum.
    """
    W, B, weights = m.lanes, mb.lanes, weights_of(at, mb)
    zero, one, half = real(s, 0), real(s, 1), real(s, 0.5)
    before = w[W * m.x + c]
    before = before if before - before == zero else half
    groups, mass = whole(w[W * k.H_PART_GROUPS + c]), zero
    for j in range(PARTS // HISTORIES):
        mass += s[weights + j]
    apart = min(mass, one - mass) > real(s, APART)
    joins = due_now & (groups == HISTORIES) & ((not apart) | (w[W * k.H_PART_S + c] > real(s, JOIN_S)))
    groups = 1 if joins else groups
    w[W * k.H_PART_GROUPS + c] = real(w, groups)
    for group in range(HISTORIES):
        count = PARTS // HISTORIES if groups == HISTORIES else PARTS
        first = group * count
        last = first + count if group < groups else 0
        last = PARTS if joins else last
        low, high, widest = real(s, math.inf), -real(s, math.inf), zero
        for j in range(first, last):
            o, lane, weight = place_of(at, j // B, mb), j % B, s[weights + j]
            soc, sigma = s[o + B * mb.x + lane], s[o + B * mb.root + lane]
            reach = sigma * (real(s, REACH) if gaussian else real(s, 2))
            low, high = (min(low, soc - reach), max(high, soc + reach)) if weight > real(s, MASS) else (low, high)
            widest = max(widest, sigma) if weight > real(s, COUNTS) else widest
        low, high = max(low, real(s, -EDGE)), min(high, real(s, 1 + EDGE))
        width = w[W * (k.H_PART_WIDTH + group) + c]
        sparse = (high - low < real(s, TOO_SPARSE) * real(s, count) * width) & (width > real(s, WIDTH_MIN))
        due = (high > low) & (sparse | joins | (widest > real(s, TOO_WIDE) * width))
        due = due & due_now & (group < groups) & (not (joins & (group > 0)))
        width = (high - low) / real(s, count)
        if due:
            clear(sums, count, m)
            for j in range(first, last):
                if s[weights + j] > zero:
                    o = place_of(at, j // B, mb)
                    put(sums, count, s, o, B, j % B, mb, s[weights + j], low, width, gaussian)
            place(s, at, sums, m, mb, first, count, low, width)
            w[W * (k.H_PART_WIDTH + group) + c] = width
    if gaussian:
        normalise(s, at, mb)
    pool(s, at, w, sums, m, mb, c, before)
