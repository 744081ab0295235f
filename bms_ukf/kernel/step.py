"""What one sample does to one cell: hold the inputs, predict, innovate, gate, update. Returns `records.Fault` bits.

This is policy, and it is in the kernel so that the daemon, a replay, a microcontroller and an FMU share it bit for bit.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel.ecm import R0, clamp, dynamics, ocv, ohmic_drop
from bms_ukf.kernel.layout import (
    H_CURRENT,
    H_CURRENT_AGE,
    H_GAP_S,
    H_HEARD_AGE,
    H_INNOVATION,
    H_INNOVATION_VAR,
    H_REJECTED_S,
    H_TEMPERATURE,
    H_TEMPERATURE_AGE,
    H_VOLTAGE_AGE,
    H_VOLTAGE_PRED,
    N_MAX,
    N_RC,
    P_CE_CHARGE,
    P_CHARGE_COULOMB,
    P_CURRENT_MAX,
    P_CURRENT_MIN,
    P_CURRENT_OFFSET,
    P_CURRENT_RANGE,
    P_CURRENT_TIMEOUT,
    P_GAMMA,
    P_GATE2,
    P_INITIAL_CURRENT,
    P_INITIAL_SIGMA,
    P_INITIAL_SOC,
    P_R0_REL,
    P_RC_REL,
    P_REJECT_S,
    P_SOC_SIGMA_INVALID,
    P_SOC_SIGMA_MAX,
    P_SOC_WALK_GAIN,
    P_SOC_WALK_OFFSET,
    P_TABLE_TEMPERATURE_MAX,
    P_TABLE_TEMPERATURE_MIN,
    P_TEMPERATURE_MAX,
    P_TEMPERATURE_MIN,
    P_TEMPERATURE_TIMEOUT,
    P_VAR_RC,
    P_VAR_VOLTAGE,
    P_VOLTAGE_MAX,
    P_VOLTAGE_MIN,
    P_VOLTAGE_TIMEOUT,
    P_WIDE_SIGMA,
    SOC,
    V_RC1,
    held_at,
    root_at,
    tri,
)
from bms_ukf.kernel.memory import inline, real, vector
from bms_ukf.kernel.srukf import innovate, predict, update
from bms_ukf.kernel.wide import update_wide
from bms_ukf.records import Fault, Status

CURRENT_MISSING = int(Fault.CURRENT_MISSING)
VOLTAGE_MISSING = int(Fault.VOLTAGE_MISSING)
TEMPERATURE_MISSING = int(Fault.TEMPERATURE_MISSING)
CURRENT_IMPLAUSIBLE = int(Fault.CURRENT_IMPLAUSIBLE)
VOLTAGE_IMPLAUSIBLE = int(Fault.VOLTAGE_IMPLAUSIBLE)
TEMPERATURE_IMPLAUSIBLE = int(Fault.TEMPERATURE_IMPLAUSIBLE)
INNOVATION_REJECTED = int(Fault.INNOVATION_REJECTED)
NUMERIC = int(Fault.NUMERIC)
OUT_OF_TABLE = int(Fault.OUT_OF_TABLE)
INITIALISING, OK, DEGRADED, INVALID = (int(status) for status in Status)
STATUS_SHIFT = 16
FAULT_MASK = (1 << STATUS_SHIFT) - 1

# Below this a noise factor is not distinguishable from zero, and zero ends in 0/0 (`srukf.triangularise`). V, or SoC.
TINY_ROOT = 1e-12
VOLTAGE_ERROR_S = 1.0  # how long a fast voltage error lasts: the interval that [noise] of a cell file is derived at
SOC_SLACK = 0.02  # how far SoC may wander beyond 0..1 before it is called out of the table


@inline
def step_cell(p: Any, s: Any, o: int, n: int, dt: Any, i: Any, v: Any, T: Any) -> int:
    """Advance the record at `o` by `dt` >= 0 s to a sample of current, voltage and temperature (NaN: not measured).

    Returns the fault bits, with the status (`records.Status`) in the bits from STATUS_SHIFT up.
    """
    h = o + held_at(n)
    faults = hold_inputs(p, s, h, dt, i, v, T)
    s[h + H_VOLTAGE_PRED] = s[h + H_INNOVATION] = s[h + H_INNOVATION_VAR] = real(s, math.nan)
    if faults & VOLTAGE_IMPLAUSIBLE:
        v = real(s, math.nan)
    if math.isfinite(s[h + H_VOLTAGE_AGE]):
        faults |= advance(p, s, o, n, dt)
    else:
        start(p, s, o, n, v)
    if math.isfinite(s[h + H_VOLTAGE_AGE]) and math.isfinite(v) and not faults & NUMERIC:
        faults |= fuse(p, s, o, n, v)
    faults |= missing(p, s, o, n)
    return faults | (status(p, s, o, n, faults) << STATUS_SHIFT)


@inline
def hold_inputs(p: Any, s: Any, h: int, dt: Any, i: Any, v: Any, T: Any) -> int:
    """Age what is held, then take what was measured and is plausible."""
    faults = 0
    s[h + H_CURRENT_AGE] += dt
    s[h + H_TEMPERATURE_AGE] += dt
    s[h + H_VOLTAGE_AGE] += dt
    s[h + H_REJECTED_S] += dt
    s[h + H_HEARD_AGE] += dt
    if p[P_CURRENT_MIN] <= i <= p[P_CURRENT_MAX]:
        s[h + H_CURRENT] = i
        s[h + H_CURRENT_AGE] = real(s, 0)
    elif not math.isnan(i):
        faults |= CURRENT_IMPLAUSIBLE
    if p[P_TEMPERATURE_MIN] <= T <= p[P_TEMPERATURE_MAX]:
        s[h + H_TEMPERATURE] = T
        s[h + H_TEMPERATURE_AGE] = real(s, 0)
    elif not math.isnan(T):
        faults |= TEMPERATURE_IMPLAUSIBLE
    if p[P_VOLTAGE_MIN] <= v <= p[P_VOLTAGE_MAX]:
        if s[h + H_HEARD_AGE] > p[P_VOLTAGE_TIMEOUT]:
            s[h + H_REJECTED_S] = real(s, math.nan)
        s[h + H_HEARD_AGE] = real(s, 0)
    elif not math.isnan(v):
        faults |= VOLTAGE_IMPLAUSIBLE
    return faults


@inline
def start(p: Any, s: Any, o: int, n: int, v: Any) -> None:
    """Set the belief before the first voltage is fused, once current, temperature and voltage are known."""
    h = o + held_at(n)
    i = s[h + H_CURRENT]
    T = s[h + H_TEMPERATURE]
    if math.isfinite(v) and math.isfinite(i) and math.isfinite(T):
        # The load may have begun just now or long ago: the RC voltages are between nothing and r i.
        half = i / real(s, 2)
        for j in range(N_RC):
            s[o + V_RC1 + j] = dynamics(p, p[P_INITIAL_SOC], T, 1 + 2 * j) * half
        before = math.sqrt(p[P_INITIAL_CURRENT] * p[P_INITIAL_CURRENT] + half * half)
        believe(p, s, o, n, p[P_INITIAL_SOC], p[P_INITIAL_SIGMA], before)
        s[h + H_VOLTAGE_AGE] = real(s, VOLTAGE_ERROR_S)  # no voltage was fused lately


@inline
def believe(p: Any, s: Any, o: int, n: int, soc: Any, sigma: Any, before: Any) -> None:
    """Set SoC and its sigma; the RC voltages stay, as wide as an unknown current of sigma `before` has left them."""
    h = o + held_at(n)
    for k in range(n):
        for j in range(k + 1):
            s[o + root_at(n) + tri(k, j)] = real(s, 0)
    s[o + SOC] = soc
    s[o + root_at(n) + tri(SOC, SOC)] = sigma
    for j in range(N_RC):
        drop = dynamics(p, soc, s[h + H_TEMPERATURE], 1 + 2 * j) * before
        s[o + root_at(n) + tri(V_RC1 + j, V_RC1 + j)] = math.sqrt(p[P_VAR_RC + j] + drop * drop)


@inline
def advance(p: Any, s: Any, o: int, n: int, dt: Any) -> int:
    """Predict over dt under the held current; past its timeout no charge is invented, and SoC is doubted instead."""
    h = o + held_at(n)
    fresh = s[h + H_CURRENT_AGE] <= real(s, 0)
    if dt <= real(s, 0):  # another measurement of the same instant: it may end a gap, but moves nothing
        if fresh:
            s[h + H_GAP_S] = real(s, 0)
        return 0
    span = dt if fresh else s[h + H_CURRENT_AGE]
    gap = clamp(span - p[P_CURRENT_TIMEOUT], real(s, 0), dt)
    known = dt - gap
    gap_before = s[h + H_GAP_S]
    gap_after = gap_before + gap
    s[h + H_GAP_S] = real(s, 0) if fresh else gap_after

    i = s[h + H_CURRENT]
    T = s[h + H_TEMPERATURE]
    soc = s[o + SOC]
    a = vector(s, N_MAX)
    c = vector(s, N_MAX)
    q = vector(s, N_MAX)
    tiny = real(s, TINY_ROOT)

    ce = p[P_CE_CHARGE] if i < real(s, 0) else real(s, 1)
    doubted = p[P_CURRENT_RANGE] / p[P_CHARGE_COULOMB]
    # The current of a gap is one unknown number, not noise: its sigma grows with time, its variance with time squared.
    var_soc = dt * (p[P_SOC_WALK_OFFSET] + p[P_SOC_WALK_GAIN] * i * i)
    var_soc += doubted * doubted * (gap_after * gap_after - gap_before * gap_before)
    a[SOC] = real(s, 1)
    c[SOC] = -ce * i * known / p[P_CHARGE_COULOMB]
    q[SOC] = math.sqrt(var_soc) + tiny
    r0 = dynamics(p, soc, T, R0)
    for j in range(N_RC):
        r = dynamics(p, soc, T, 1 + 2 * j)
        tau = dynamics(p, soc, T, 2 + 2 * j)
        # expm1, as 1 - exp would leave a float32 nothing of a short step.
        rise = -math.expm1(-known / tau)
        fade = math.exp(-gap / tau) if gap > real(s, 0) else real(s, 1)
        decay = (real(s, 1) - rise) * fade
        a[V_RC1 + j] = decay
        # What is known of the current is the end of the step if it was just measured, else its beginning.
        c[V_RC1 + j] = r * i * (rise if fresh else rise * fade)
        # Model error as an Ornstein-Uhlenbeck process: the same stationary variance whatever the sample rate. An offset
        # of the current shifts every drop for good; the slowest process carries that of r0 too.
        error = p[P_RC_REL] * r * i
        shift = p[P_CURRENT_OFFSET] * (r + r0 if j == N_RC - 1 else r)
        variance = p[P_VAR_RC + j] + error * error + shift * shift
        if gap > real(s, 0):
            variance += r * r * p[P_CURRENT_RANGE] * p[P_CURRENT_RANGE]
        q[V_RC1 + j] = math.sqrt((real(s, 1) - decay * decay) * variance) + tiny
    if not predict(s, o, n, a, c, q):
        return NUMERIC
    sigma = o + root_at(n) + tri(SOC, SOC)
    s[sigma] = min(s[sigma], p[P_SOC_SIGMA_MAX])
    return CURRENT_MISSING if gap > real(s, 0) else 0


@inline
def fuse(p: Any, s: Any, o: int, n: int, v: Any) -> int:
    """Compare the voltage with its prediction and, unless the gate refuses it, update the belief."""
    h = o + held_at(n)
    i = s[h + H_CURRENT]
    T = s[h + H_TEMPERATURE]
    soc = s[o + SOC]
    spread = p[P_GAMMA] * s[o + root_at(n) + tri(SOC, SOC)]
    drop = ohmic_drop(p, soc, T, i)
    drop_error = p[P_R0_REL] * drop
    if s[h + H_CURRENT_AGE] > p[P_CURRENT_TIMEOUT]:
        drop, drop_error = real(s, 0), ohmic_drop(p, soc, T, p[P_CURRENT_RANGE])
    # Neither sensor nor model errors are new every millisecond: readings that crowd are each worth less.
    crowd = real(s, VOLTAGE_ERROR_S) / clamp(s[h + H_VOLTAGE_AGE], real(s, TINY_ROOT), real(s, VOLTAGE_ERROR_S))
    r = crowd * (p[P_VAR_VOLTAGE] + drop_error * drop_error)
    if not innovate(p, s, o, n, v, drop, ocv(p, soc, T), ocv(p, soc + spread, T), ocv(p, soc - spread, T), r):
        return NUMERIC
    excess = s[h + H_INNOVATION] * s[h + H_INNOVATION] / p[P_GATE2] - s[h + H_INNOVATION_VAR]
    if excess > real(s, 0):
        return reject(p, s, o, n)
    wide = s[o + root_at(n)] > p[P_WIDE_SIGMA]
    if not (update_wide(p, s, o, n, v + drop, T, r) if wide else update(s, o, n)):
        return NUMERIC
    s[h + H_VOLTAGE_AGE] = real(s, 0)
    s[h + H_REJECTED_S] = real(s, math.nan)
    return 0


@inline
def reject(p: Any, s: Any, o: int, n: int) -> int:
    """Refuse a voltage; after P_REJECT_S of nothing else it is the SoC believed that is wrong, and is forgotten.

    The RC voltages are not: they follow from the current, and under load a SoC found without them would be far off.
    """
    h = o + held_at(n)
    if not math.isfinite(s[h + H_REJECTED_S]):
        s[h + H_REJECTED_S] = real(s, 0)
    if s[h + H_REJECTED_S] >= p[P_REJECT_S]:
        believe(p, s, o, n, real(s, 0.5), p[P_SOC_SIGMA_MAX], p[P_INITIAL_CURRENT])
        s[h + H_REJECTED_S] = real(s, math.nan)
    return INNOVATION_REJECTED


@inline
def missing(p: Any, s: Any, o: int, n: int) -> int:
    """Which inputs are older than their timeout, or were never seen, and whether the belief has left the tables."""
    faults = 0
    h = o + held_at(n)
    if not s[h + H_CURRENT_AGE] <= p[P_CURRENT_TIMEOUT]:
        faults |= CURRENT_MISSING
    if not s[h + H_VOLTAGE_AGE] <= p[P_VOLTAGE_TIMEOUT]:
        faults |= VOLTAGE_MISSING
    if not s[h + H_TEMPERATURE_AGE] <= p[P_TEMPERATURE_TIMEOUT]:
        faults |= TEMPERATURE_MISSING
    if math.isfinite(s[h + H_VOLTAGE_AGE]) and not within_tables(p, s, o, n):
        faults |= OUT_OF_TABLE
    return faults


@inline
def within_tables(p: Any, s: Any, o: int, n: int) -> Any:
    T = s[o + held_at(n) + H_TEMPERATURE]
    slack = real(s, SOC_SLACK)
    return p[P_TABLE_TEMPERATURE_MIN] <= T <= p[P_TABLE_TEMPERATURE_MAX] and -slack <= s[o + SOC] <= real(s, 1) + slack


@inline
def status(p: Any, s: Any, o: int, n: int, faults: int) -> int:
    if not math.isfinite(s[o + held_at(n) + H_VOLTAGE_AGE]):
        return INITIALISING
    if s[o + root_at(n)] > p[P_SOC_SIGMA_INVALID]:
        return INVALID
    return DEGRADED if faults else OK
