"""What a current drops at once, on r0: by how much, how sure of that, and how fast it grows with the current.

    drop = r0 knee asinh(i / knee)

The relative error of r0 is a state. Everything here is by the cell file's r0: `srukf.by_belief` applies the state after
the time update, so all parts of one sample use the same r0. The measurement depends on the state by the drop that has
stood for RECENT_S, not by that of this sample: the noise of a current sensor moves the prediction and not the cell, and
would drive r0 to nothing. For the same reason a drop scales with that error only beyond the drop of a small load.

The logarithm is taken of a small argument: halvings of it bring the block's largest i / knee into the reach of a
polynomial, so a block whose currents are far below the knee takes no square root at all.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.adapt import VOLTAGE_ERROR_S
from bms_ukf.kernel.ecm import ASINH_HALVINGS, ASINH_REACH, asinh_small, clamp, halve_asinh
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real

RECENT_S = 3.0  # how long a change of the current leaves a fast voltage error
LEADS_S = 0.5  # a voltage whose current is older says nothing of r0: a frame of the current may be lost
SMALL_LOAD = 4.0  # times P_STILL: of less, noise of the sensor may be as much
STALE = 3.0  # times P_EXCITED: one sigma of how far a current has moved since it became so old
LASTS_S = 300.0  # how long an unknown current stays about the same


@inline
def drop(p: Any, w: Any, y: Any, m: Any, lanes: int, dt: Any) -> None:
    """Compute each lane's ohmic drop, its slope over the error of r0 and its sigma; move H_RECENT on by `dt` s.

    With no current known the drop is 0, and its sigma that of P_CURRENT_RANGE.
    """
    W = m.lanes
    zero, one = real(p, 0), real(p, 1)
    largest = p[k.P_CURRENT_RANGE]
    lasting = math.sqrt(real(p, LASTS_S / VOLTAGE_ERROR_S))
    passed, again = dt / (dt + real(p, RECENT_S)), dt <= zero
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
        ohmic = r0 * y[W * (k.Y_DYN + k.D_KNEE) + c] * (times * asinh_small(p, u / y[W * k.Y_SCALE + c]))
        small = small_load(p, w, m, c) * r0
        recent = w[W * k.H_RECENT + c]
        alive = y[W * k.Y_ALIVE + c] > zero  # before a belief the temperature may not be known yet
        recent = recent if (recent - recent == zero) & alive else ohmic
        lead = beyond(recent, small)
        for j in range(m.n_rc):
            polarised = w[W * (k.H_POLARISED + j) + c]
            lead += polarised if polarised - polarised == zero else zero
        used, led = w[W * k.H_USED + c], w[W * k.H_LEAD + c]
        used = used if again & alive & (used - used == zero) else recent
        led = led if again & alive & (led - led == zero) else lead
        w[W * k.H_USED + c], w[W * k.H_LEAD + c] = used, led
        stale = w[W * k.H_CURRENT_AGE + c] > real(p, LEADS_S)
        y[W * k.Y_LEAD + c] = zero if unknown | stale else led
        y[W * k.Y_DROP + c] = zero if unknown else ohmic
        y[W * k.Y_SCALED + c] = zero if unknown else beyond(ohmic, small)
        # An unknown current is not a new one at every sample: its drop counts as one error that lasts LASTS_S.
        fast = p[k.P_FAST_REL] * (ohmic - used)
        moved = r0 / math.sqrt(one + u * u) * real(p, STALE) * p[k.P_EXCITED]
        fast = math.sqrt(fast * fast + moved * moved) if stale else fast
        y[W * k.Y_DROP_SIGMA + c] = lasting * ohmic if unknown else fast
        w[W * k.H_RECENT + c] = recent if unknown else recent + (ohmic - recent) * passed


@inline
def small_load(p: Any, w: Any, m: Any, c: int) -> Any:
    """Of the cell as large as it is here, A: a parallel group takes more."""
    return real(p, SMALL_LOAD) * p[k.P_STILL] / w[m.lanes * k.H_PER_CAPACITY + c]


@inline
def beyond(drop: Any, small: Any) -> Any:
    """The part of a drop beyond that of a small load: nothing of it is noise of the current sensor at rest."""
    return drop - clamp(drop, -small, small)


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
