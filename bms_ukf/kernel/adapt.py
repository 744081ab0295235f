"""What the innovations say of the model: how large its fast voltage error is here and now, and how large r0 is.

Neither is a state of the filter. Both are told from what a state could not explain, and slowly: over minutes.

The variance of the fast voltage error is a multiple of the cell file's, never below 1. It follows the normalised
innovation squared, whose mean is 1 where the error is as large as the filter takes it to be. On a plateau of the OCV
the innovations are small whatever SoC is: so it only ever grows from there, and never says that SoC is well known.

r0 is told from changes. From one voltage to the next the error of the prediction moves by what the ohmic drop moved,
times what r0 is off; the slow errors of OCV, SoC and polarisation stay as they were, and so does an offset of the
current sensor, which cancels in a difference. Only a step of the current tells: where it stands still, a difference is
the sensor's noise, by which the prediction moves and the cell does not, and r0 would be told to be nothing. And only a
voltage whose current was measured with it. An r0 and an offset that were both told from the level of the voltage could
not be told apart (DERIVATION.md).

A cell file's r0 is that of a second: it holds the charge transfer, which takes some tenths of one. What a voltage shows
a tenth of a second after a step may be half of it. So differences are between means over R0_BLOCK_S where voltages come
faster than once a second. Neither may the error be found smaller because they crowd: their variance is that of one a
second here.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import clamp
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real

VOLTAGE_ERROR_S = 1.0  # how long a fast voltage error lasts: the interval that [noise] of a cell file is derived at
SCALE_S = 300.0  # over which the size of the fast error is told
SCALE_MAX = 64.0
STEP_MAX_S = 10.0  # a longer silence counts as so much: one innovation says no more

R0_SIGMA = 0.2  # of a cell that has aged, by nobody knows how much, as a share of the cell file's r0
R0_TAU_S = 3600.0  # how long an r0 holds: SoC and temperature move on to where the tables err otherwise
R0_BLOCK_S = 1.45
R0_ALONE_S = 0.75  # a voltage that comes so long after the one before is a block by itself
R0_STEP_S = 2.0  # voltages that lie further apart differ by polarisation
R0_CURRENT_S = 0.1  # a voltage whose current is older than this was made by another current
R0_ELSE = 0.3  # share of a change of the drop that fast polarisation may add to it or take from it
R0_LEAST, R0_MOST = 0.5, 4.0


@inline
def start(w: Any, m: Any, c: int) -> None:
    """As the cell file has it."""
    W = m.lanes
    w[W * k.H_VOLTAGE_SCALE + c] = w[W * k.H_R0_SCALE + c] = real(w, 1)
    w[W * k.H_R0_VAR + c] = real(w, R0_SIGMA * R0_SIGMA)
    w[W * k.H_RESIDUAL + c] = real(w, math.nan)


@inline
def learn(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """From the innovation of every lane that has one, between its comparison and its fusion."""
    W = m.lanes
    zero, one = real(p, 0), real(p, 1)
    gate2, adapts = p[k.P_GATE2], p[k.P_ADAPT] > real(p, 0)
    for c in range(lanes):
        innovation, variance = y[W * k.Y_INNOVATION + c], y[W * k.Y_VARIANCE + c]
        since = clamp(y[W * k.Y_SINCE_HEARD + c], zero, real(p, STEP_MAX_S))
        age = clamp(w[W * k.H_VOLTAGE_AGE + c], zero, real(p, VOLTAGE_ERROR_S))
        crowded = y[W * k.Y_NOISE + c] * (one - age / real(p, VOLTAGE_ERROR_S))
        nis = innovation * innovation / (variance - crowded)
        compared = (nis - nis == zero) & (w[W * k.H_FRESH + c] == zero) & adapts
        excess = clamp(nis, zero, gate2) - one
        scale = w[W * k.H_VOLTAGE_SCALE + c]
        followed = scale + scale * excess * since * real(p, 1 / SCALE_S)
        w[W * k.H_VOLTAGE_SCALE + c] = clamp(followed, one, real(p, SCALE_MAX)) if compared else scale
    for c in range(lanes):
        follow_r0(p, w, y, m, c)


@inline
def follow_r0(p: Any, w: Any, y: Any, m: Any, c: int) -> None:
    """Add a voltage that will be fused to its block, and let a block that is whole tell r0 beside the one before it."""
    W = m.lanes
    zero, one, nan = real(p, 0), real(p, 1), real(p, math.nan)
    innovation, since = y[W * k.Y_INNOVATION + c], y[W * k.Y_SINCE_HEARD + c]
    fused = (y[W * k.Y_FUSE + c] > real(p, k.IGNORE)) & (innovation - innovation == zero)
    # By how much the error moved since the voltage before, whatever that one corrected.
    moved = innovation - w[W * k.H_RESIDUAL + c]
    goes_on = (moved - moved == zero) & (since <= real(p, R0_STEP_S))
    drift = w[W * k.H_DRIFT + c] + moved
    drift = drift if goes_on else zero
    ohmic = y[W * k.Y_OHMIC + c]
    counts = (w[W * k.H_CURRENT_AGE + c] <= real(p, R0_CURRENT_S)) & (ohmic - ohmic == zero)
    total_V = w[W * k.H_BLOCK_DRIFT + c]
    total_V = (total_V if goes_on else zero) + (drift if counts else zero)
    total_ohmic = w[W * k.H_BLOCK_OHMIC + c]
    total_ohmic = (total_ohmic if goes_on else zero) + (ohmic if counts else zero)
    count = w[W * k.H_BLOCK_COUNT + c]
    count = (count if goes_on else zero) + (one if counts else zero)
    lasted = w[W * k.H_BLOCK_S + c] + since
    lasted = lasted if goes_on else zero
    before = w[W * k.H_OHMIC + c]
    before = before if goes_on else nan
    whole = (lasted >= real(p, R0_BLOCK_S)) | (goes_on & (since >= real(p, R0_ALONE_S)))

    each = one / (count if count > zero else nan)  # none: no current was of its voltage's moment
    mean_V, mean_ohmic = total_V * each, total_ohmic * each
    tell_r0(p, w, y, m, c, fused & whole & (w[W * k.H_FRESH + c] == zero), mean_V, mean_ohmic - before, lasted)

    # The next block's drift is counted from this one's mean. What a measurement leaves of its innovation is the share
    # of its noise in the variance.
    drift = drift - mean_V if whole & (mean_V - mean_V == zero) else drift
    before = mean_ohmic if whole else before
    left = innovation * y[W * k.Y_NOISE + c] * y[W * k.Y_PER_VARIANCE + c]
    keep(w, W * k.H_RESIDUAL + c, fused, left)
    keep(w, W * k.H_DRIFT + c, fused, drift)
    keep(w, W * k.H_OHMIC + c, fused, before)
    keep(w, W * k.H_BLOCK_DRIFT + c, fused, zero if whole else total_V)
    keep(w, W * k.H_BLOCK_OHMIC + c, fused, zero if whole else total_ohmic)
    keep(w, W * k.H_BLOCK_COUNT + c, fused, zero if whole else count)
    keep(w, W * k.H_BLOCK_S + c, fused, zero if whole else lasted)


@inline
def tell_r0(p: Any, w: Any, y: Any, m: Any, c: int, whole: Any, change: Any, moved: Any, lasted: Any) -> None:
    """r0 and its variance from a change of the error, V, and of the ohmic drop by the cell file's r0, V."""
    W = m.lanes
    error = y[W * (k.Y_DYN + k.D_ERROR) + c]
    r0, r0_var = w[W * k.H_R0_SCALE + c], w[W * k.H_R0_VAR + c]
    r0_var += (real(p, R0_SIGMA * R0_SIGMA) - r0_var) * lasted * real(p, 1 / R0_TAU_S)
    white = real(p, 2) * w[W * k.H_VOLTAGE_SCALE + c] * error * error * p[k.P_VAR_VOLTAGE]
    otherwise = real(p, R0_ELSE) * moved
    gain = r0_var * moved / (r0_var * moved * moved + white + otherwise * otherwise)
    excited = abs(moved) > y[W * k.Y_R0 + c] * p[k.P_EXCITED]
    told = whole & excited & (p[k.P_ADAPT] > real(p, 0)) & (gain * change - gain * change == real(p, 0))
    keep(w, W * k.H_R0_VAR + c, whole, r0_var - gain * moved * r0_var if told else r0_var)
    keep(w, W * k.H_R0_SCALE + c, told, clamp(r0 - gain * change, real(p, R0_LEAST), real(p, R0_MOST)))


@inline
def keep(w: Any, at: int, replaced: Any, value: Any) -> None:
    before = w[at]
    w[at] = value if replaced else before
