"""What a current drops at once, on r0: by how much, how sure of that, and how fast it grows with the current.

    drop = r0 knee asinh(i / knee)

The logarithm is taken of a small argument: halvings of it bring the block's largest i / knee into the reach of a
polynomial, so a block whose currents are far below the knee takes no square root at all.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import ASINH_HALVINGS, ASINH_REACH, asinh_small, clamp, halve_asinh, is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real

R0_SHAPE = 0.1  # share of r0 by which a good fit may have it wrong


@inline
def drop(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """The ohmic drop, its slope over the current and its uncertainty; with no current known, what one could make it."""
    W = m.lanes
    zero, one = real(p, 0), real(p, 1)
    largest = p[k.P_CURRENT_RANGE]
    relative = p[k.P_R0_REL]
    large = 0
    for c in range(lanes):
        unknown = w[W * k.H_CURRENT_AGE + c] > p[k.P_CURRENT_TIMEOUT]
        i = w[W * k.H_THROUGH + c]
        i = largest if unknown else i
        # A choice between two places in memory would be made by a gather: exact as a blend, and cheaper.
        charges = one if i < zero else zero
        r0 = y[W * (k.Y_DYN + k.D_R0) + c] * (one - charges) + y[W * (k.Y_DYN + k.D_R0_CHARGE) + c] * charges
        u = i / y[W * (k.Y_DYN + k.D_KNEE) + c]
        y[W * k.Y_R0 + c], y[W * k.Y_OHMIC + c] = r0, u
        y[W * k.Y_SCALE + c] = one
        large |= 1 if abs(u) > real(p, ASINH_REACH) else 0
    times = logarithm(w, y, m, lanes) if large else one
    for c in range(lanes):
        unknown = w[W * k.H_CURRENT_AGE + c] > p[k.P_CURRENT_TIMEOUT]
        r0, u = y[W * k.Y_R0 + c], y[W * k.Y_OHMIC + c]
        scale = w[W * k.H_R0_SCALE + c]
        scale = beyond_shape(p, scale if is_number(scale) else one)
        ohmic = r0 * y[W * (k.Y_DYN + k.D_KNEE) + c] * (times * asinh_small(p, u / y[W * k.Y_SCALE + c]))
        r0 *= scale
        tracked = ohmic * scale
        y[W * k.Y_R0 + c] = r0
        y[W * k.Y_OHMIC + c] = real(p, math.nan) if unknown else ohmic
        y[W * k.Y_DROP + c] = zero if unknown else tracked
        y[W * k.Y_DROP_SIGMA + c] = tracked if unknown else relative * y[W * (k.Y_DYN + k.D_ERROR) + c] * tracked
        if m.bias:
            y[W * k.Y_DROP_SLOPE + c] = r0 / math.sqrt(one + u * u)


@inline
def logarithm(w: Any, y: Any, m: Any, lanes: int) -> Any:
    """Grow Y_SCALE until every Y_OHMIC over it is in reach of `asinh_small`; returns by what to multiply that."""
    W = m.lanes
    times = real(w, 1)
    for c in range(lanes):
        u = y[W * k.Y_OHMIC + c]
        y[W * k.Y_COSH + c] = math.sqrt(real(w, 1) + u * u)
    large = 1
    for _ in range(ASINH_HALVINGS):
        if large:
            large = 0
            times += times
            for c in range(lanes):
                cosh, scale = halve_asinh(w, y[W * k.Y_COSH + c], y[W * k.Y_SCALE + c])
                y[W * k.Y_COSH + c], y[W * k.Y_SCALE + c] = cosh, scale
                large |= 1 if abs(y[W * k.Y_OHMIC + c]) > real(w, ASINH_REACH) * scale else 0
    return times


@inline
def beyond_shape(p: Any, scale: Any) -> Any:
    """The multiple of the cell file's r0 to use, with a dead band: nothing of the first R0_SHAPE that steps ask for.

    A cell file that has the fast resistance a little wrong has made up for it in the first RC pair; to correct the one
    alone would make the sum wrong. What is tracked goes on until what is used explains the steps, so an aged cell's r0
    is found as it is.
    """
    margin = real(p, R0_SHAPE)
    away = scale - real(p, 1)
    return scale - clamp(away, -margin, margin)
