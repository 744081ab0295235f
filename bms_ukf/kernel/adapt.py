"""Adapts the variance of the fast voltage error from the innovations, slowly: over minutes.

The variance is a multiple of the cell file's, never below 1. It follows the normalised innovation squared, whose mean
is 1 where the error is as large as the filter assumes. On a plateau of the OCV the innovations are small whatever SoC
is: so the multiple only grows from 1, and small innovations never make SoC look well known.

Innovations of a right belief lean to neither side. Where they do for minutes, it is the belief that is wrong, not the
voltage noisy: their mean, in their own sigmas, doubts it (`voltage.compare`), however large the multiple has grown.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import clamp
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real

VOLTAGE_ERROR_S = 1.0  # how long noise of a voltage lasts: the interval that [noise] of a cell file is derived at
FAST_S = 40.0  # how long a fast error of the model lasts: readings that crowd in so long are together worth one
SCALE_S = 300.0  # over which the size of the fast error is told
SCALE_MAX = 64.0
LEAN_MOST = 0.95  # of a right belief: 0.69 at most, in a charge with 5 mV steps
STEP_MAX_S = 10.0  # a longer silence counts as so much: one innovation says no more


@inline
def start(w: Any, m: Any, c: int) -> None:
    """As the cell file has it, and no innovation seen."""
    W = m.lanes
    w[W * k.H_VOLTAGE_SCALE + c] = real(w, 1)
    w[W * k.H_LEAN + c] = real(w, 0)


@inline
def learn(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """From the innovation of every lane that has one, between its comparison and its fusion."""
    W = m.lanes
    zero, one = real(p, 0), real(p, 1)
    gate2, adapts = p[k.P_GATE2], p[k.P_ADAPT] > real(p, 0)
    for c in range(lanes):
        innovation, variance = y[W * k.Y_INNOVATION + c], y[W * k.Y_VARIANCE + c]
        crowded = y[W * k.Y_CROWDED + c]
        since = clamp(y[W * k.Y_SINCE_HEARD + c], zero, real(p, STEP_MAX_S))
        per_variance = one / (variance - crowded)
        nis = innovation * innovation * per_variance
        # A refused voltage would make the filter accept the next one like it.
        fused = y[W * k.Y_FUSE + c] > real(p, k.IGNORE)
        compared = (nis - nis == zero) & (w[W * k.H_FRESH + c] == zero) & fused
        lean = w[W * k.H_LEAN + c]
        leant = lean + (innovation * math.sqrt(per_variance) - lean) * since * real(p, 1 / SCALE_S)
        w[W * k.H_LEAN + c] = leant if compared else lean
        excess = clamp(nis, zero, gate2) - one
        scale = w[W * k.H_VOLTAGE_SCALE + c]
        followed = scale + scale * excess * since * real(p, 1 / SCALE_S)
        w[W * k.H_VOLTAGE_SCALE + c] = clamp(followed, one, real(p, SCALE_MAX)) if compared & adapts else scale
