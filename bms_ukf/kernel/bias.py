"""What tells of the current sensor's offset, and how much of it is believed.

Rest tells it outright: what a sensor shows while no current flows is its offset. That no current flows is known where
the contactor is open. Elsewhere a small reading that stands still may be a small load: of a slow discharge, there is
nothing to tell it from an offset. So only a reading that comes back is believed, at one rest as at the rest before,
with a load between them; once a rest, with the sigma of what may draw a little all the time, and not at all if it is
more than an offset could be.

A voltage tells it by way of SoC: as far as SoC shows in the voltage against what the model itself may be wrong by.
Slow errors of the model look like an offset to a filter that takes every second's voltage for news. So of its Kalman
gain the bias takes a share only, and its variance falls no further than that share allows: the partial-update
Schmidt-Kalman filter (Brink, J. Guid. Control Dyn. 40(9), 2017). With the bias last in a triangular root this is one
sum of squares.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import tri
from bms_ukf.kernel.memory import real
from bms_ukf.kernel.srukf import update

REST_S = 120.0  # a reading that has not moved for so long is one of rest
PLAUSIBLE = 2.5  # sigmas of the offset: a larger reading is a load
KNOWN = 0.1  # of the offset's sigma: error of a reading while no current can flow


@inline
def stand_still(p: Any, w: Any, y: Any, m: Any, lanes: int, dt: Any) -> None:
    """Keep the account of how long the current has not moved, and of loads between rests.

    Leaves in Y_RESTED whether this is the moment at which a rest shows what the one before it showed.
    """
    W = m.lanes
    zero, one = real(p, 0), real(p, 1)
    for c in range(lanes):
        i, anchor, since = w[W * k.H_CURRENT + c], w[W * k.H_STILL_A + c], w[W * k.H_STILL_S + c]
        still = (abs(i - anchor) <= p[k.P_STILL]) & (w[W * k.H_CURRENT_AGE + c] <= p[k.P_CURRENT_TIMEOUT])
        anchor = anchor if still else i
        after = since + dt if still else zero
        w[W * k.H_STILL_A + c] = anchor
        w[W * k.H_STILL_S + c] = after
        earlier, loaded = w[W * k.H_REST_A + c], w[W * k.H_LOADED + c]
        loaded = one if abs(i - earlier) > p[k.P_EXCITED] else loaded
        rests = (after >= real(p, REST_S)) & (after - dt < real(p, REST_S)) & still
        rests = rests & (abs(anchor) <= real(p, PLAUSIBLE) * p[k.P_BIAS_SIGMA])
        again = rests & (loaded > zero) & (abs(anchor - earlier) <= real(p, 2) * p[k.P_STILL])
        y[W * k.Y_RESTED + c] = one if again else zero
        w[W * k.H_REST_A + c] = anchor if rests else earlier
        w[W * k.H_LOADED + c] = zero if rests else loaded


@inline
def fuse_rest(p: Any, w: Any, y: Any, io: Any, first: int, rows: int, m: Any, lanes: int, dt: Any) -> None:
    """Update the belief of every lane for which this sample says what no current looks like."""
    W = m.lanes
    last = m.n - 1
    told = 0
    for c in range(lanes):
        shown, reading = io[rows * k.IN_OFFSET + first + c], w[W * k.H_STILL_A + c]
        known = (p[k.P_CURRENT_MIN] <= shown) & (shown <= p[k.P_CURRENT_MAX])
        rested = y[W * k.Y_RESTED + c] > real(p, 0)
        shown = shown if known else reading
        sigma = real(p, KNOWN) * p[k.P_BIAS_SIGMA] if known else p[k.P_PARASITIC]
        alpha = sigma * sigma
        variance = alpha
        for j in range(m.n):
            b = w[W * (m.root + tri(last, j)) + c]
            y[W * (k.Y_B + j) + c] = b
            variance += b * b
        innovation = shown - w[W * (m.x + last) + c]
        y[W * k.Y_ALPHA + c], y[W * k.Y_INNOVATION + c], y[W * k.Y_TRUST + c] = alpha, innovation, real(p, 1)
        fuse = (known | rested) & (y[W * k.Y_ALIVE + c] > real(p, 0)) & is_number(innovation + variance)
        common, common_var = w[W * k.H_SHARED + c], w[W * k.H_SHARED_VAR + c]
        gain = common_var / (common_var + alpha)  # every cell of the string is told the same
        w[W * k.H_SHARED + c] = common + gain * (shown - common) if fuse else common
        w[W * k.H_SHARED_VAR + c] = common_var - gain * common_var if fuse else common_var
        y[W * k.Y_FUSE + c] = real(p, k.BY_SIGMA_POINTS) if fuse else real(p, k.IGNORE)
        y[W * k.Y_SHOWN + c], y[W * k.Y_SHOWN_VAR + c] = shown if fuse else real(p, math.nan), alpha
        told |= 1 if fuse else 0
    if told:
        for c in range(lanes):
            update(w, y, c, m)


@inline
def weigh(p: Any, y: Any, m: Any, c: int, by_soc: Any) -> None:
    """The share of its gain that the bias takes: of what the voltage may be off by, `by_soc`, V^2, is SoC's doing."""
    W = m.lanes
    error = y[W * (k.Y_DYN + k.D_ERROR) + c]
    model = y[W * k.Y_NOISE + c]
    for j in range(m.n_pol):
        model += error * error * p[k.P_VAR_V + j]
    y[W * k.Y_TRUST + c] = by_soc / (by_soc + model)
