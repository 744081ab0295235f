"""What tells of the current sensor's offset, and how much of it is believed.

Rest tells it outright: what a sensor shows while no current flows is its offset. That no current flows is known where
the contactor is open. Where a small reading merely stands still, something may yet draw a little: believed once a rest,
with the sigma of such a load, and not at all if it is more than an offset could be.

A voltage tells it by way of SoC: as far as SoC shows in the voltage against what the model itself may be wrong by.
Slow errors of the model look like an offset to a filter that takes every second's voltage for news. So of its Kalman
gain the bias takes a share only, and its variance falls no further than that share allows: the partial-update
Schmidt-Kalman filter (Brink, J. Guid. Control Dyn. 40(9), 2017). With the bias last in a triangular root this is one
sum of squares.
"""

from __future__ import annotations

from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import tri
from bms_ukf.kernel.memory import real
from bms_ukf.kernel.srukf import update

REST_S = 60.0  # a reading that has not moved for so long is one of rest
PLAUSIBLE = 3.0  # sigmas of the offset: a larger reading is a load
KNOWN = 0.1  # of the offset's sigma: error of a reading while no current can flow


@inline
def stand_still(p: Any, w: Any, y: Any, m: Any, lanes: int, dt: Any) -> None:
    """Keep the account of how long the current has not moved."""
    W = m.lanes
    zero = real(p, 0)
    for c in range(lanes):
        i, anchor, since = w[W * k.H_CURRENT + c], w[W * k.H_STILL_A + c], w[W * k.H_STILL_S + c]
        still = (abs(i - anchor) <= p[k.P_STILL]) & (w[W * k.H_CURRENT_AGE + c] <= p[k.P_CURRENT_TIMEOUT])
        w[W * k.H_STILL_A + c] = anchor if still else i
        w[W * k.H_STILL_S + c] = since + dt if still else zero


@inline
def fuse_rest(p: Any, w: Any, y: Any, io: Any, first: int, rows: int, m: Any, lanes: int, dt: Any) -> None:
    """Update the belief of every lane for which this sample says what no current looks like."""
    W = m.lanes
    last = m.n - 1
    told = 0
    for c in range(lanes):
        shown, reading, since = io[rows * k.IN_OFFSET + first + c], w[W * k.H_STILL_A + c], w[W * k.H_STILL_S + c]
        known = (p[k.P_CURRENT_MIN] <= shown) & (shown <= p[k.P_CURRENT_MAX])
        rested = (since >= real(p, REST_S)) & (since - dt < real(p, REST_S))
        rested = rested & (abs(reading) <= real(p, PLAUSIBLE) * p[k.P_BIAS_SIGMA])
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
        y[W * k.Y_FUSE + c] = real(p, k.BY_SIGMA_POINTS) if fuse else real(p, k.IGNORE)
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
    for j in range(m.n_v):
        model += error * error * p[k.P_VAR_V + j]
    y[W * k.Y_TRUST + c] = by_soc / (by_soc + model)
