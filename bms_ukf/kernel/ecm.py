"""The cell: a two-RC equivalent circuit whose open-circuit voltage and resistances depend on SoC and temperature.

    v = ocv(soc, T) - v_rc1 - v_rc2 - r0 knee asinh(i / knee)
    d soc / dt    = -ce i / charge            ce = 1 on discharge, the coulombic efficiency on charge
    d v_rcj / dt  = (r_j i - v_rcj) / tau_j

Below its knee current r0 is a resistance; above it the drop grows with the logarithm of the current, as that of a
charge transfer does (Butler-Volmer with equal coefficients). It matters in the cold, where the knee is low.

Current i is positive on discharge and constant over a step, so the step is exact for any dt: a_j = exp(-dt / tau_j)
(zero-order hold; Plett, Battery Management Systems I, 2015, section 2.1). r0, r_j and tau_j are taken at the mean SoC,
so the process is affine in the state and only the OCV says where SoC is. Letting r0(soc) say so
too, as sigma points would, was measured to do harm: r0 is known to some ten percent, and its slope times the current
then counts as evidence (SoC RMSE 1.5 % instead of 0.5 %, mean over the drives of tests/test_accuracy.py).
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel.layout import (
    DYN_CHANNELS,
    OCV_COEFFICIENTS,
    P_DYN,
    P_OCV,
    T_INV_DSOC,
    T_INV_DTEMP,
    T_KNOTS,
    T_OFFSET,
    T_ROW_SIZE,
    T_ROWS,
    T_TEMP0,
)
from bms_ukf.kernel.memory import inline, real

R0, KNEE = 0, 5  # channels of `dynamics`


@inline
def clamp(value: Any, low: Any, high: Any) -> Any:
    return min(max(value, low), high)


@inline
def _row(p: Any, table: int, T: Any) -> tuple[int, Any]:
    """The table row at or below T, as an index into `p`, and T's fraction of the way to the next; held at the edges."""
    rows = int(p[table + T_ROWS])
    u = clamp((T - p[table + T_TEMP0]) * p[table + T_INV_DTEMP], real(p, 0), real(p, rows - 1))
    row = min(int(u), rows - 2)
    return int(p[table + T_OFFSET]) + row * int(p[table + T_ROW_SIZE]), u - real(p, row)


@inline
def _cubic(p: Any, at: int, d: Any, beyond: Any) -> Any:
    """A cubic at fraction d of its interval, continued by its slope there for `beyond` more of it."""
    value = p[at] + d * (p[at + 1] + d * (p[at + 2] + d * p[at + 3]))
    slope = p[at + 1] + d * (real(p, 2) * p[at + 2] + d * real(p, 3) * p[at + 3])
    return value + beyond * slope


@inline
def ocv(p: Any, soc: Any, T: Any) -> Any:
    """Open-circuit voltage, V: PCHIP in SoC, extrapolated by its edge slope; linear between temperature rows."""
    at, f = _row(p, P_OCV, T)
    intervals = int(p[P_OCV + T_KNOTS])
    u = soc * p[P_OCV + T_INV_DSOC]
    inside = clamp(u, real(p, 0), real(p, intervals))
    k = min(int(inside), intervals - 1)
    at += OCV_COEFFICIENTS * k
    d = inside - real(p, k)
    cold = _cubic(p, at, d, u - inside)
    warm = _cubic(p, at + int(p[P_OCV + T_ROW_SIZE]), d, u - inside)
    return cold + f * (warm - cold)


@inline
def dynamics(p: Any, soc: Any, T: Any, channel: int) -> Any:
    """One of r0, r1, tau1, r2, tau2, knee (channel 0..5; ohm, s, A): bilinear in SoC and T, held at the edges."""
    at, f = _row(p, P_DYN, T)
    knots = int(p[P_DYN + T_KNOTS])
    u = clamp(soc * p[P_DYN + T_INV_DSOC], real(p, 0), real(p, knots))
    k = min(int(u), knots - 1)
    at += DYN_CHANNELS * k + channel
    d = u - real(p, k)
    warm = at + int(p[P_DYN + T_ROW_SIZE])
    lower = p[at] + d * (p[at + DYN_CHANNELS] - p[at])
    upper = p[warm] + d * (p[warm + DYN_CHANNELS] - p[warm])
    return lower + f * (upper - lower)


@inline
def ohmic_drop(p: Any, soc: Any, T: Any, i: Any) -> Any:
    """The part of the terminal voltage that follows the current at once, V, positive on discharge."""
    knee = dynamics(p, soc, T, KNEE)
    return dynamics(p, soc, T, R0) * knee * math.asinh(i / knee)
