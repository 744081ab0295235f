"""The cell: an equivalent circuit whose open-circuit voltage and resistances depend on SoC and temperature.

    v = ocv(soc, T) - v_rc1 - v_rc2 .. - v_hyst - r0 knee asinh(i / knee)
    d soc / dt    = -ce i / charge                       ce = 1 on discharge, the coulombic efficiency on charge
    d v_rcj / dt  = (r_j i - v_rcj) / tau_j
    d v_hyst / dt = rate |i| (m sgn(i) - v_hyst)         m: largest hysteresis voltage; rate per charge moved

Below its knee current r0 is a resistance; above it the drop grows with the logarithm of the current, as that of a
charge transfer does (Butler-Volmer with equal coefficients). It matters in the cold, where the knee is low.
The hysteresis is Plett's one-state model, as a drop (Plett, Battery Management Systems I, 2015, section 2.6).

Current i is positive on discharge and constant over a step, so the step is exact for any dt: a_j = exp(-dt / tau_j)
(zero-order hold; Plett, section 2.1). All parameters are taken at the mean SoC that the step predicts,
so the process is affine in the state and only the OCV says where SoC is. Letting r0(soc) say so
too, as sigma points would, was measured to do harm: r0 is known to some ten percent, and its slope times the current
then counts as evidence (SoC RMSE 1.5 % instead of 0.5 %, mean over the drives of tests/test_accuracy.py).
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import (
    C_KNOT,
    C_TEMPERATURE,
    C_VALUES,
    D_KNEE,
    D_R0,
    D_R0_CHARGE,
    D_RC1,
    OCV_COEFFICIENTS,
    P_DYN,
    P_OCV,
    T_INTERVALS,
    T_INV_DTEMP,
    T_OFFSET,
    T_ROW_SIZE,
    T_ROWS,
    T_TEMP0,
)
from bms_ukf.kernel.memory import floor, real, whole


@inline
def clamp(value: Any, low: Any, high: Any) -> Any:
    value = low if value < low else value
    return high if value > high else value


@inline
def is_number(value: Any) -> Any:
    """Not NaN; a comparison, where math.isnan would be a branch."""
    return value == value  # noqa: PLR0124


@inline
def between_rows(p: Any, table: int, T: Any) -> tuple[Any, Any]:
    """The place in `p` of the table row at or below T, and T's fraction of the way to the next; held at the edges."""
    rows = p[table + T_ROWS]
    u = clamp((T - p[table + T_TEMP0]) * p[table + T_INV_DTEMP], real(p, 0), rows - real(p, 1))
    u = u if is_number(u) else real(p, 0)  # an index is made of it
    row = clamp(floor(u), real(p, 0), rows - real(p, 2))
    return p[table + T_OFFSET] + row * p[table + T_ROW_SIZE], u - row


@inline
def ocv_interval(p: Any, row_at: Any, soc: Any) -> tuple[Any, Any]:
    """The place in `p` of the interval that holds `soc`, and soc's fraction of it.

    The first and the last interval of a row lie outside 0..1 and are straight: the curve goes on by its edge slope.
    """
    intervals = p[P_OCV + T_INTERVALS]
    u = soc * intervals
    k = floor(clamp(u if is_number(u) else real(p, 0), real(p, -1), intervals))
    return row_at + (k + real(p, 1)) * real(p, OCV_COEFFICIENTS), u - k


@inline
def ocv_cubic(p: Any, at: int, d: Any, f: Any) -> Any:
    """OCV, V, from the interval at `at` of a row and the same of the next."""
    warmer = at + whole(p[P_OCV + T_ROW_SIZE])
    cold = p[at] + d * (p[at + 1] + d * (p[at + 2] + d * p[at + 3]))
    warm = p[warmer] + d * (p[warmer + 1] + d * (p[warmer + 2] + d * p[warmer + 3]))
    return cold + f * (warm - cold)


@inline
def ocv(p: Any, soc: Any, T: Any) -> Any:
    """Open-circuit voltage, V: PCHIP in SoC, extrapolated by its edge slope; linear between temperature rows."""
    row_at, f = between_rows(p, P_OCV, T)
    at, d = ocv_interval(p, row_at, soc)
    return ocv_cubic(p, whole(at), d, f)


@inline
def dynamics_knot(p: Any, soc: Any) -> tuple[Any, Any]:
    """The knot at or below `soc`, the last but one at most, and soc's fraction of the way to the next; held beyond."""
    intervals = p[P_DYN + T_INTERVALS]
    u = clamp(soc * intervals, real(p, 0), intervals)
    u = u if is_number(u) else real(p, 0)
    k = clamp(floor(u), real(p, 0), intervals - real(p, 1))
    return k, u - k


@inline
def dynamics(p: Any, soc: Any, T: Any, channel: int, channels: int) -> Any:
    """One of the `D_*` channels (ohm, s, A, V): bilinear in SoC and T, held at the edges."""
    row_at, f = between_rows(p, P_DYN, T)
    k, d = dynamics_knot(p, soc)
    at = whole(row_at) + whole(k) * channels + channel
    value, rise = _blend(p, at, f, channels)
    return value + d * rise


@inline
def _blend(p: Any, at: int, f: Any, channels: int) -> tuple[Any, Any]:
    """A channel's value at a knot and its rise to the next, between two temperature rows."""
    warmer = at + whole(p[P_DYN + T_ROW_SIZE])
    here = p[at] + f * (p[warmer] - p[at])
    there = p[at + channels] + f * (p[warmer + channels] - p[at + channels])
    return here, there - here


@inline
def cache_dynamics(p: Any, s: Any, o: int, m: Any, soc: Any, T: Any, resistance: Any) -> None:
    """Fill the cache of the record at `o`: within its SoC interval, at its T, it gives what `dynamics` gives.

    Of a cell with `resistance` times the resistances of the cell file: it drops at a current what the file's cell drops
    at `resistance` times that current, so its knee comes as much earlier.
    """
    row_at, f = between_rows(p, P_DYN, T)
    k, _ = dynamics_knot(p, soc)
    at = whole(row_at) + whole(k) * m.channels
    c = o + m.lanes * m.cache
    s[c + m.lanes * C_KNOT] = k
    s[c + m.lanes * C_TEMPERATURE] = T
    for channel in range(m.channels):
        value, rise = _blend(p, at + channel, f, m.channels)
        r_j = (channel >= D_RC1) & (channel < D_RC1 + 2 * m.n_rc) & ((channel - D_RC1) % 2 == 0)
        times = resistance if r_j | (channel == D_R0) | (channel == D_R0_CHARGE) else real(p, 1)
        times = real(p, 1) / resistance if channel == D_KNEE else times
        value *= times
        rise *= times
        s[c + m.lanes * (C_VALUES + 2 * channel)] = value
        s[c + m.lanes * (C_VALUES + 2 * channel + 1)] = rise


# 1 - exp(-x) = x (1 - x/2 (1 - x/3 (..))). Up to FALL_SMALL ten terms are exact to rounding.
FALL_SMALL = 0.125
FALL_TERMS = 10
FALL_DOUBLINGS = 9
DECAY_AS_FALL = 3  # of these doublings
FALL_HALF = 0.5**FALL_DOUBLINGS
FALL_LARGEST = FALL_SMALL * 2**FALL_DOUBLINGS  # exp(-64) is nothing


@inline
def fall_small(s: Any, x: Any) -> Any:
    """1 - exp(-x) for 0 <= x <= FALL_SMALL, to rounding. libm's would be a call for each lane of a vector loop."""
    r = real(s, 1)
    for k in range(FALL_TERMS, 1, -1):
        r = real(s, 1) - x * (real(s, 1) / real(s, k)) * r
    return x * r


@inline
def fall(s: Any, x: Any) -> Any:
    """1 - exp(-x) for x >= 0, by doubling: 1 - e^2 = (1 - e) (2 - (1 - e)), which loses no digits of a small one."""
    r = fall_small(s, clamp(x, real(s, 0), real(s, FALL_LARGEST)) * real(s, FALL_HALF))
    for _ in range(FALL_DOUBLINGS):
        r *= real(s, 2) - r
    return r


@inline
def decay(s: Any, x: Any) -> Any:
    """exp(-x) for x >= 0, to 250 roundings (3e-14; 1.5e-5 in float32); beyond x = 64 it stays what it is there.

    No two libms agree on the last digit of an exponential, so with one no two machines would agree on an estimate.
    """
    r = fall_small(s, clamp(x, real(s, 0), real(s, FALL_LARGEST)) * real(s, FALL_HALF))
    for _ in range(DECAY_AS_FALL):
        r *= real(s, 2) - r
    r = real(s, 1) - r
    for _ in range(FALL_DOUBLINGS - DECAY_AS_FALL):
        r *= r  # the error doubles with each, hence not from the start
    return r


# asinh(v) / v over v^2 in 0..0.125, constant term first: Chebyshev fit, error 3.5e-16 (mpmath.chebyfit, 9 terms).
ASINH = (
    0.9999999999999997,
    -0.16666666666621394,
    0.07499999990309558,
    -0.04464284913277126,
    0.030381611450183237,
    -0.022364336883969414,
    0.017243750157529533,
    -0.013062012380898675,
    0.0073250596579582244,
)
ASINH_REACH = 0.35  # the fit's range of |v|
ASINH_HALVINGS = 4  # bring |u| <= 127 there


@inline
def asinh(s: Any, u: Any) -> Any:
    """asinh(u), to rounding up to |u| = 127 and to 1e-9 up to 1000, without a call."""
    cosh, scale = math.sqrt(real(s, 1) + u * u), real(s, 1)
    for _ in range(ASINH_HALVINGS):
        cosh, scale = halve_asinh(s, cosh, scale)
    return asinh_small(s, u / scale) * real(s, 2**ASINH_HALVINGS)


@inline
def halve_asinh(s: Any, cosh: Any, scale: Any) -> tuple[Any, Any]:
    """Halve y of u = sinh(y): cosh(y) becomes cosh(y/2), and sinh(y) = 2 sinh(y/2) cosh(y/2) tells u's scale."""
    cosh = math.sqrt(real(s, 0.5) * cosh + real(s, 0.5))
    return cosh, scale * (real(s, 2) * cosh)


@inline
def asinh_small(s: Any, v: Any) -> Any:
    """asinh(v) for |v| <= ASINH_REACH."""
    ratio = real(s, ASINH[-1])
    for k in range(len(ASINH) - 2, -1, -1):
        ratio = ratio * (v * v) + real(s, ASINH[k])
    return v * ratio
