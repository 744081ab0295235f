"""What the innovations say of the model: how large its fast voltage error is here and now, and how large r0 is.

Neither is a state of the filter. Both are told from what a state could not explain, and slowly: over minutes.

The variance of the fast voltage error is a multiple of the cell file's, never below 1. It follows the normalised
innovation squared, whose mean is 1 where the error is as large as the filter takes it to be. On a plateau of the OCV
the innovations are small whatever SoC is: so it only ever grows from there, and never says that SoC is well known.

r0 is told from changes. From one voltage to the next the innovation moves by what the ohmic drop moved, times what r0
is off; the slow errors of OCV, SoC and polarisation stay as they were, and so does an offset of the current sensor,
which cancels in a difference. Only a step of the current tells: where it stands still, a difference is the sensor's
noise, by which the prediction moves and the cell does not, and r0 would be told to be nothing. And only a voltage whose
current was measured with it. An r0 and an offset that were both told from the level of the voltage could not be told
apart (DERIVATION.md).
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import clamp
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real

SCALE_S = 300.0  # over which the size of the fast error is told
SCALE_MAX = 64.0
STEP_MAX_S = 10.0  # a longer silence counts as so much: one innovation says no more

R0_SIGMA = 0.2  # of a cell that has aged, by nobody knows how much, as a share of the cell file's r0
R0_TAU_S = 3600.0  # how long an r0 holds: SoC and temperature move on to where the tables err otherwise
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
    w[W * k.H_RESIDUAL + c] = w[W * k.H_OHMIC + c] = real(w, math.nan)


@inline
def learn(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """From the innovation of every lane that has one, between its comparison and its fusion."""
    W = m.lanes
    zero, one = real(p, 0), real(p, 1)
    for c in range(lanes):
        innovation, variance = y[W * k.Y_INNOVATION + c], y[W * k.Y_VARIANCE + c]
        since = clamp(y[W * k.Y_SINCE_HEARD + c], zero, real(p, STEP_MAX_S))
        nis = innovation * innovation / variance
        heard = nis - nis == zero
        compared = heard & (w[W * k.H_FRESH + c] == zero) & (p[k.P_ADAPT] > zero)
        excess = clamp(nis, zero, p[k.P_GATE2]) - one
        scale = w[W * k.H_VOLTAGE_SCALE + c]
        followed = scale + scale * excess * since / real(p, SCALE_S)
        w[W * k.H_VOLTAGE_SCALE + c] = clamp(followed, one, real(p, SCALE_MAX)) if compared else scale

        error = y[W * (k.Y_DYN + k.D_ERROR) + c]
        own = w[W * k.H_CURRENT_AGE + c] <= real(p, R0_CURRENT_S)
        ohmic = y[W * k.Y_OHMIC + c]
        ohmic = ohmic if own else real(p, math.nan)
        moved = ohmic - w[W * k.H_OHMIC + c]
        change = innovation - w[W * k.H_RESIDUAL + c]
        r0, r0_var = w[W * k.H_R0_SCALE + c], w[W * k.H_R0_VAR + c]
        forgotten = since / real(p, R0_TAU_S)
        forgotten = forgotten if heard else zero
        r0_var += (real(p, R0_SIGMA * R0_SIGMA) - r0_var) * forgotten
        white = real(p, 2) * scale * error * error * p[k.P_VAR_VOLTAGE]
        otherwise = real(p, R0_ELSE) * moved
        gain = r0_var * moved / (r0_var * moved * moved + white + otherwise * otherwise)
        fused = y[W * k.Y_FUSE + c] > real(p, k.IGNORE)
        excited = abs(moved) > y[W * k.Y_R0 + c] * p[k.P_EXCITED]
        told = compared & fused & excited & (since <= real(p, R0_STEP_S)) & (gain * change - gain * change == zero)
        w[W * k.H_R0_VAR + c] = r0_var - gain * moved * r0_var if told else r0_var
        w[W * k.H_R0_SCALE + c] = clamp(r0 - gain * change, real(p, R0_LEAST), real(p, R0_MOST)) if told else r0
        # What a measurement leaves of its innovation is the share of its noise in the variance.
        left = innovation * y[W * k.Y_NOISE + c] / variance
        left = left if fused else real(p, math.nan)
        before, before_V = w[W * k.H_RESIDUAL + c], w[W * k.H_OHMIC + c]
        w[W * k.H_RESIDUAL + c] = left if heard else before
        w[W * k.H_OHMIC + c] = ohmic if heard else before_V
