"""What a cell can still give and take: where it is empty and full at a rate, what a pulse may be, how much energy.

Read from a cell's record and changing nothing in it. With the model of `ecm` and i positive on discharge,

    at rate    v(soc, i) = ocv(soc, T) - drop(soc, i) - sum r_j(soc) i                       all voltages settled
    a pulse    v(i) = ocv(soc - i h / charge, T) - drop(i) - sum (v_j + f_j (r_j i - v_j)) - v_hyst

h being the pulse's length and f_j = 1 - exp(-h / tau_j). Both fall with i, so a limit is the one current at which v
meets a voltage limit. A cold cell reaches its lower voltage at a higher SoC: that is where it is empty at this rate.
Its SoC does not change.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel import limit_rows as lr
from bms_ukf.kernel.ecm import asinh, clamp, dynamics, fall, is_number, ocv
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import N_MAX, tri
from bms_ukf.kernel.memory import real, vector

KNOTS = 40  # steps of SoC in which an end is looked for, from the end of the table inwards
REFINEMENTS = 3  # of the step that holds it, by the false position
ITERATIONS = 8  # for a pulse's current, at most
CLOSE_V = 1e-5  # a voltage that is so near its limit is there
GAUSS = (0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970262)  # Gauss-Legendre on 0..1
GAUSS_WEIGHTS = (0.17392742256872692, 0.32607257743127305, 0.32607257743127305, 0.17392742256872692)
OCV_STEP = 0.0025  # of SoC: half an interval of the OCV table, over which a slope is taken


@inline
def temperature(s: Any, o: int, m: Any) -> Any:
    """Where the tables are read, degC."""
    T = s[o + m.lanes * k.H_TEMPERATURE]
    rise = s[o + m.lanes * k.H_CORE_RISE]
    return T + rise if m.core and is_number(rise) else T


@inline
def tracked(s: Any, o: int, m: Any) -> Any:
    """What the filter has found to multiply all resistances by: r0's and those of the RC pairs."""
    return real(s, 1) + s[o + m.lanes * (m.x + m.r0)]


@inline
def ohmic(p: Any, s: Any, o: int, m: Any, soc: Any, T: Any, i: Any) -> Any:
    """Ohmic drop at `i`, V, by the r0 that is tracked."""
    resistance = s[o + m.lanes * k.H_RESISTANCE]
    r0 = dynamics(p, soc, T, k.D_R0 if i >= real(p, 0) else k.D_R0_CHARGE, m.channels)
    knee = dynamics(p, soc, T, k.D_KNEE, m.channels)
    return tracked(s, o, m) * r0 * knee * asinh(p, resistance * i / knee)


@inline
def settled(p: Any, s: Any, o: int, m: Any, soc: Any, T: Any, i: Any) -> Any:
    """Terminal voltage under a current that has flowed for long, V."""
    resistance = s[o + m.lanes * k.H_RESISTANCE] * tracked(s, o, m)
    v = ocv(p, soc, T) - ohmic(p, s, o, m, soc, T, i)
    for j in range(m.n_rc):
        v -= resistance * i * dynamics(p, soc, T, k.D_RC1 + 2 * j, m.channels)
    return v


@inline
def end(p: Any, s: Any, o: int, m: Any, T: Any, i: Any, limit: Any) -> Any:
    """The SoC, 0..1, at which `i` meets the voltage `limit`: looked for from empty on discharge, else from full."""
    zero, one = real(p, 0), real(p, 1)
    inwards = one if i >= zero else -one
    step = inwards / real(p, KNOTS)
    outer = zero if i >= zero else one
    soc = beyond = outer
    margin = short = zero
    for knot in range(KNOTS + 1):
        soc = outer + real(p, knot) * step
        margin = (settled(p, s, o, m, soc, T, i) - limit) * inwards
        if margin >= zero:
            break
        beyond, short = soc, margin
    if margin > zero and short < zero:
        for _ in range(REFINEMENTS):
            between = soc - margin * (soc - beyond) / (margin - short)
            found = (settled(p, s, o, m, between, T, i) - limit) * inwards
            if found >= zero:
                soc, margin = between, found
            else:
                beyond, short = between, found
    return clamp(soc, zero, one)


# What a pulse from now on is reckoned with.
Z_SOC = 0
Z_FALL = 1  # of SoC, per ampere
Z_V = 2  # of RC voltages, hysteresis and slow error that is left at its end, V
Z_OHM = 3  # that the RC pairs make of its current
Z_DROP = 4  # tracked r0 times knee, V, on discharge; then on charge
Z_KNEE = 6  # A
Z_LARGEST = 7  # hysteresis voltage, V
Z_TURN = 8  # and how fast it goes there, 1/A
PULSE = 9


@inline
def prepare(p: Any, s: Any, o: int, m: Any, T: Any, seconds: Any, z: Any) -> None:
    """Fill the `Z_*` values of a cell."""
    W = m.lanes
    zero = real(p, 0)
    soc, resistance, per_capacity = s[o + W * m.x], s[o + W * k.H_RESISTANCE], s[o + W * k.H_PER_CAPACITY]
    times = tracked(s, o, m)
    knee = dynamics(p, soc, T, k.D_KNEE, m.channels)
    z[Z_SOC], z[Z_FALL] = soc, seconds / p[k.P_CHARGE_COULOMB] * per_capacity
    z[Z_DROP] = times * knee * dynamics(p, soc, T, k.D_R0, m.channels)
    z[Z_DROP + 1] = times * knee * dynamics(p, soc, T, k.D_R0_CHARGE, m.channels)
    z[Z_KNEE] = knee / resistance
    z[Z_OHM] = z[Z_LARGEST] = z[Z_TURN] = zero
    z[Z_V] = s[o + W * (m.x + m.n_v)]
    for j in range(m.n_rc):
        risen = fall(p, seconds / dynamics(p, soc, T, k.D_RC1 + 2 * j + 1, m.channels))
        # The filter applies the error of resistances to what the current has polarised, and not to the state.
        polarised = (times - real(p, 1)) * s[o + W * (k.H_POLARISED + j)]
        polarised = polarised if is_number(polarised) else zero
        z[Z_V] += (real(p, 1) - risen) * (s[o + W * (m.x + k.V_RC1 + j)] + polarised)
        z[Z_OHM] += times * risen * resistance * dynamics(p, soc, T, k.D_RC1 + 2 * j, m.channels)
    if m.hysteresis:
        z[Z_V] += s[o + W * (m.x + k.V_RC1 + m.n_rc)]
        z[Z_LARGEST] = dynamics(p, soc, T, k.D_RC1 + 2 * m.n_rc, m.channels)
        z[Z_TURN] = p[k.P_HYSTERESIS_RATE] * per_capacity * seconds


@inline
def drop(p: Any, z: Any, i: Any) -> Any:
    """Ohmic, of a pulse, V."""
    return (z[Z_DROP + 1] if i < real(p, 0) else z[Z_DROP]) * asinh(p, i / z[Z_KNEE])


@inline
def after_pulse(p: Any, s: Any, o: int, m: Any, T: Any, z: Any, i: Any) -> Any:
    """Terminal voltage at the end of a pulse, V."""
    v = ocv(p, z[Z_SOC] - i * z[Z_FALL], T) - drop(p, z, i) - z[Z_V] - z[Z_OHM] * i
    if m.hysteresis:
        to = -z[Z_LARGEST] if i < real(p, 0) else z[Z_LARGEST]
        v -= fall(p, z[Z_TURN] * abs(i)) * (to - s[o + m.lanes * (m.x + k.V_RC1 + m.n_rc)])
    return v


@inline
def pulse(p: Any, s: Any, o: int, m: Any, T: Any, z: Any, most: Any, limit: Any) -> Any:
    """The current of largest size, between 0 and `most` (A, negative: charge), that keeps to the voltage `limit`."""
    zero, two = real(p, 0), real(p, 2)
    side = real(p, 1) if most >= zero else real(p, -1)
    low, high = zero, most
    above = (after_pulse(p, s, o, m, T, z, low) - limit) * side
    below = (after_pulse(p, s, o, m, T, z, high) - limit) * side
    current = most
    if not above > zero:
        current = zero
    elif below < zero:
        for _ in range(ITERATIONS):
            current = high - below * (high - low) / (below - above)
            margin = (after_pulse(p, s, o, m, T, z, current) - limit) * side
            if abs(margin) < real(p, CLOSE_V):
                break
            if margin >= zero:  # the Illinois rule: the end that stays counts for half
                low, above, below = current, margin, below / two
            else:
                high, below, above = current, margin, above / two
    return current


@inline
def doubt(p: Any, s: Any, o: int, m: Any, T: Any, seconds: Any, z: Any, i: Any) -> Any:
    """One sigma of the voltage at the end of a pulse, V: of the belief, the model and r0."""
    W = m.lanes
    soc = s[o + W * (m.x + k.SOC)]
    step = real(p, OCV_STEP)
    slope = (ocv(p, soc + step, T) - ocv(p, soc - step, T)) / (step + step)
    error = dynamics(p, soc, T, k.D_ERROR, m.channels)
    by_resistance_V = drop(p, z, i) + z[Z_OHM] * i
    variance = error * error * (p[k.P_VAR_VOLTAGE] + p[k.P_FAST_VAR])
    stays = vector(s, N_MAX)
    for j in range(m.n_v):
        stays[j] = real(p, 1)
    for j in range(m.n_rc):
        stays[j] -= fall(p, seconds / dynamics(p, soc, T, k.D_RC1 + 2 * j + 1, m.channels))
    for column in range(m.r0 + 1):
        b = slope * s[o + W * m.root] if column == 0 else real(p, 0)
        for j in range(max(k.V_RC1, column), k.V_RC1 + m.n_v):
            b -= stays[j - k.V_RC1] * s[o + W * (m.root + tri(j, column))]
        b -= by_resistance_V * s[o + W * (m.root + tri(m.r0, column))]
        variance += b * b
    return math.sqrt(variance)


@inline
def limits(p: Any, s: Any, out: Any, a: Any, cells: int, m: Any) -> None:
    """Fill the `L_*` rows of `out` but L_MEAN_V for every cell; `a` has the `A_*` conditions. NaN without a belief."""
    W = m.lanes
    z = vector(s, PULSE)
    for c in range(cells):
        o = c // W * W * m.size + c % W
        T = temperature(s, o, m)
        known = s[o + W * m.x] + T + s[o + W * k.H_VOLTAGE_AGE]
        if known - known == real(p, 0):
            seconds = a[lr.A_SECONDS]
            prepare(p, s, o, m, T, seconds, z)
            out[cells * lr.L_EMPTY + c] = end(p, s, o, m, T, a[lr.A_DISCHARGE_RATE], a[lr.A_VOLTAGE_MIN])
            out[cells * lr.L_FULL + c] = end(p, s, o, m, T, a[lr.A_CHARGE_RATE], a[lr.A_VOLTAGE_MAX])
            for row in (lr.L_DISCHARGE, lr.L_CHARGE):
                gives = row == lr.L_DISCHARGE
                most = a[lr.A_CURRENT_MAX] if gives else a[lr.A_CURRENT_MIN]
                i = pulse(p, s, o, m, T, z, most, a[lr.A_VOLTAGE_MIN] if gives else a[lr.A_VOLTAGE_MAX])
                away = most / real(p, 100)
                v = after_pulse(p, s, o, m, T, z, i)
                ohm = (after_pulse(p, s, o, m, T, z, i - away) - v) / away
                out[cells * row + c] = i
                out[cells * (row + lr.L_SIGMA) + c] = doubt(p, s, o, m, T, seconds, z, i) / ohm
                out[cells * (row + lr.L_VOLTAGE) + c] = v
                out[cells * (row + lr.L_OHM) + c] = ohm
        else:
            for row in range(lr.LIMIT_ROWS):
                out[cells * row + c] = real(p, math.nan)


@inline
def energy(p: Any, s: Any, out: Any, a: Any, cells: int, m: Any) -> None:
    """Mean terminal voltage of each cell while A_MOVED A s leave it at A_DRAIN (negative: charge), in row L_MEAN_V."""
    W = m.lanes
    for c in range(cells):
        o = c // W * W * m.size + c % W
        T, soc = temperature(s, o, m), s[o + W * m.x]
        span = a[lr.A_MOVED] / p[k.P_CHARGE_COULOMB] * s[o + W * k.H_PER_CAPACITY]
        mean = real(p, 0)
        known = soc + T
        if known - known == real(p, 0):
            for point in range(len(GAUSS)):
                at = soc - real(p, GAUSS[point]) * span
                mean += real(p, GAUSS_WEIGHTS[point]) * settled(p, s, o, m, at, T, a[lr.A_DRAIN])
        out[cells * lr.L_MEAN_V + c] = mean if known - known == real(p, 0) else real(p, math.nan)
