"""From the last sample to this one: read the tables at the SoC to come, let voltages relax, predict the belief."""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import FALL_SMALL, cache_dynamics, clamp, fall, fall_small, is_number
from bms_ukf.kernel.inputs import UNKNOWN_TEMPERATURE
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import N_MAX
from bms_ukf.kernel.memory import real, vector
from bms_ukf.kernel.srukf import predict

# Below this a noise factor is not distinguishable from zero, and zero ends in 0/0 (`srukf.triangularise`). V, SoC or A.
TINY_ROOT = 1e-12
RESOLVED = 1e-4  # of a variance: a float32 root moves by 1 part in 20 000, of which rounding is a part in 1000


@inline
def soc_per_ampere(p: Any, w: Any, y: Any, m: Any, c: int) -> Any:
    """SoC per ampere of the known current in this step, 1/A."""
    W = m.lanes
    ce, per_coulomb = p[k.P_CE_CHARGE], real(p, 1) / p[k.P_CHARGE_COULOMB]
    ce = ce if w[W * k.H_THROUGH + c] < real(p, 0) else real(p, 1)
    return ce * y[W * k.Y_KNOWN + c] * per_coulomb * w[W * k.H_PER_CAPACITY + c]


@inline
def charge(p: Any, w: Any, y: Any, m: Any, c: int) -> Any:
    """SoC that the known current takes off the cell in this step."""
    return w[m.lanes * k.H_THROUGH + c] * soc_per_ampere(p, w, y, m, c)


@inline
def schedule(p: Any, s: Any, o: int, w: Any, y: Any, m: Any, lanes: int) -> None:
    """Read every parameter at the mean SoC to come: from the record's cache while SoC and temperature stay near it."""
    W = m.lanes
    zero, one = real(p, 0), real(p, 1)
    # Here as in other loops over lanes: a parameter read under a condition would be gathered for each lane.
    intervals, initial = p[k.P_DYN + k.T_INTERVALS], p[k.P_INITIAL_SOC]
    stale = 0
    for c in range(lanes):
        alive = y[W * k.Y_ALIVE + c] > zero
        soc = w[W * (m.x + k.SOC) + c] - charge(p, w, y, m, c)
        if m.bias:
            soc += soc_per_ampere(p, w, y, m, c) * w[W * (m.x + m.n - 1) + c]
        T = w[W * k.H_TEMPERATURE + c]
        if m.core:
            moves = y[W * k.Y_KNOWN + c] + y[W * k.Y_GAP + c] > zero
            rise, used = w[W * k.H_CORE_RISE + c], w[W * k.H_CORE_USED + c]
            rise = rise if moves else used
            w[W * k.H_CORE_USED + c] = rise
            T += rise if alive else zero
        sound = (soc - soc == zero) | (not alive)  # else the step will be refused: no index must come of it
        soc = soc if alive & sound else initial
        T = T if is_number(T) else real(p, UNKNOWN_TEMPERATURE)
        y[W * k.Y_SOC + c] = soc
        y[W * k.Y_T + c] = T
        d = clamp(soc * intervals, zero, intervals) - s[o + W * (m.cache + k.C_KNOT) + c]
        away = abs(T - s[o + W * (m.cache + k.C_TEMPERATURE) + c])
        serves = (d >= zero) & (d <= one) & (away <= p[k.P_CACHE_TEMPERATURE])
        y[W * k.Y_STALE + c] = zero if serves | (not sound) else one
        stale |= 0 if serves | (not sound) else 1
    if stale:
        for c in range(lanes):
            if y[W * k.Y_STALE + c] > zero:
                cache_dynamics(p, s, o + c, m, y[W * k.Y_SOC + c], y[W * k.Y_T + c], w[W * k.H_RESISTANCE + c])
    for c in range(lanes):
        d = clamp(y[W * k.Y_SOC + c] * intervals, zero, intervals) - s[o + W * (m.cache + k.C_KNOT) + c]
        for channel in range(m.channels):
            value = s[o + W * (m.cache + k.C_VALUES + 2 * channel) + c]
            rise = s[o + W * (m.cache + k.C_VALUES + 2 * channel + 1) + c]
            y[W * (k.Y_DYN + channel) + c] = value + d * rise


@inline
def relax(p: Any, w: Any, y: Any, m: Any, lanes: int, dt: Any, gaps: int) -> None:
    """What each voltage, and the core's temperature, lose of their distance to where they go: 1 - exp(-time / tau)."""
    W = m.lanes
    for c in range(lanes):
        in_taus(p, w, y, m, c, k.Y_FALL, y[W * k.Y_KNOWN + c], abs(w[W * k.H_THROUGH + c]))
        if m.core:
            y[W * (k.Y_FALL + m.r0) + c] = dt / p[k.P_CORE_TAU]
    one_minus_exp(w, y, m, k.Y_FALL, m.r0 + m.core, lanes)
    if gaps:
        for c in range(lanes):
            in_taus(p, w, y, m, c, k.Y_FADE, y[W * k.Y_GAP + c], p[k.P_CURRENT_RANGE])
        one_minus_exp(w, y, m, k.Y_FADE, m.r0, lanes)
    else:
        for place in range(W * m.r0):
            y[W * k.Y_FADE + place] = real(p, 0)


@inline
def in_taus(p: Any, w: Any, y: Any, m: Any, c: int, slot: int, time: Any, current: Any) -> None:
    """A time in the time constants of each voltage, from `slot` on; that of hysteresis is one of charge, either way.

    Those of the slow error and of r0's are both."""
    W = m.lanes
    for j in range(m.n_rc):
        y[W * (slot + j) + c] = time / y[W * (k.Y_DYN + k.D_RC1 + 2 * j + 1) + c]
    if m.hysteresis:
        rate = p[k.P_HYSTERESIS_RATE] * w[W * k.H_PER_CAPACITY + c]
        y[W * (slot + m.n_rc) + c] = rate * current * time
    moved = current * w[W * k.H_PER_CAPACITY + c]
    y[W * (slot + m.n_pol) + c] = time * (p[k.P_SLOW_RATE] * moved + real(p, 1) / p[k.P_SLOW_TAU])
    y[W * (slot + m.n_v) + c] = time * (p[k.P_R0_RATE] * moved + real(p, 1) / p[k.P_R0_TAU])


@inline
def one_minus_exp(w: Any, y: Any, m: Any, slot: int, count: int, lanes: int) -> None:
    """x <- 1 - exp(-x) in `count` slots; the short form where every x is small."""
    W = m.lanes
    large = 0
    for c in range(lanes):
        for j in range(count):
            large |= 1 if y[W * (slot + j) + c] > real(w, FALL_SMALL) else 0
    if large:
        for c in range(lanes):
            for j in range(count):
                y[W * (slot + j) + c] = fall(w, y[W * (slot + j) + c])
    else:
        for c in range(lanes):
            for j in range(count):
                y[W * (slot + j) + c] = fall_small(w, y[W * (slot + j) + c])


@inline
def advance(p: Any, w: Any, y: Any, m: Any, lanes: int, dt: Any) -> None:
    """Predict every lane's belief over dt > 0 under the current it holds; in a gap SoC is doubted instead."""
    W = m.lanes
    bias_lost, most = fall(p, dt / p[k.P_BIAS_TAU]), p[k.P_SOC_SIGMA_MAX]
    for c in range(lanes):
        lost = vector(w, N_MAX)
        g = vector(w, N_MAX)
        gain = vector(w, N_MAX)
        q = vector(w, N_MAX)
        lost[k.SOC] = real(p, 0)
        g[k.SOC] = soc_per_ampere(p, w, y, m, c)
        gain[k.SOC] = -charge(p, w, y, m, c)
        q[k.SOC] = math.sqrt(y[W * k.Y_RESOLVED + c]) + real(p, TINY_ROOT)
        for j in range(m.n_rc):
            relax_rc(p, w, y, m, c, j, lost, g, gain, q)
        if m.hysteresis:
            relax_hysteresis(p, w, y, m, c, lost, g, gain, q)
        for j in range(m.n_pol, m.r0):
            rise, faded = y[W * (k.Y_FALL + j) + c], y[W * (k.Y_FADE + j) + c]
            lost[1 + j] = rise + faded - rise * faded
        g[m.n_v] = g[m.r0] = gain[m.n_v] = gain[m.r0] = real(p, 0)
        q[m.n_v] = noise_root(p, lost[m.n_v], slow_variance(p, w, y, m, c))
        q[m.r0] = noise_root(p, lost[m.r0], p[k.P_R0_VAR])
        if m.bias:
            lost[m.n - 1] = bias_lost
            g[m.n - 1] = gain[m.n - 1] = real(p, 0)
            q[m.n - 1] = noise_root(p, bias_lost, p[k.P_BIAS_SIGMA] * p[k.P_BIAS_SIGMA])
            share(p, w, m, c, bias_lost)
        if m.core:
            warm_core(p, w, y, m, c, dt)
        predict(w, c, m, lost, g, gain, q)
        sigma = w[W * m.root + c]
        w[W * m.root + c] = most if sigma > most else sigma


@inline
def share(p: Any, w: Any, m: Any, c: int, lost: Any) -> None:
    """What the cells know of the offset in common grows old as the bias does."""
    W = m.lanes
    kept = real(p, 1) - lost
    stationary = p[k.P_BIAS_SIGMA] * p[k.P_BIAS_SIGMA]
    w[W * k.H_SHARED + c] *= kept
    w[W * k.H_SHARED_VAR + c] = stationary + kept * kept * (w[W * k.H_SHARED_VAR + c] - stationary)


@inline
def walk(p: Any, w: Any, y: Any, m: Any, lanes: int, dt: Any) -> None:
    """Growth of SoC's variance in this step, from what is not known of the charge that flowed; accounts for the gap.

    An unknown gain or capacity is one number: over a charge moved one way its sigma grows with the charge. As a walk
    its variance grows with the charge moved, either way: equal where MOVED of the capacity has gone.
    """
    W = m.lanes
    for c in range(lanes):
        i = w[W * k.H_THROUGH + c]
        gap = y[W * k.Y_GAP + c]
        before = w[W * k.H_GAP_S + c]
        after = before + gap
        w[W * k.H_GAP_S + c] = real(p, 0) if w[W * k.H_CURRENT_AGE + c] <= real(p, 0) else after
        w[W * k.H_UNSEEN_S + c] += gap
        # The current of a gap is one unknown number, not noise: its sigma grows with time, its variance squared.
        doubted = p[k.P_CURRENT_RANGE] / p[k.P_CHARGE_COULOMB]
        unknown = doubted * doubted * gap * (after + before)
        times = w[W * k.H_PER_CAPACITY + c]
        moved = p[k.P_SOC_WALK_GAIN] * abs(i) * y[W * k.Y_KNOWN + c]
        # `moved` is in shares of the capacity squared over that charge: a larger cell has both larger.
        y[W * k.Y_WALK + c] = times * (times * (dt * p[k.P_SOC_WALK_OFFSET] + unknown) + moved)


@inline
def resolve(w: Any, y: Any, m: Any, lanes: int) -> None:
    """Leave in Y_RESOLVED what of Y_WALK a root can show; in float32 the rest waits until it has become enough.

    sqrt(sigma^2 + q^2) is sigma itself where q^2 is below 6e-8 of sigma^2, as it is at every step of 100 Hz.
    """
    W = m.lanes
    for c in range(lanes):
        grown = y[W * k.Y_WALK + c]
        if m.compensated:
            sigma = w[W * m.root + c]
            grown += w[W * k.H_SOC_WALK + c]
            enough = grown > real(w, RESOLVED) * sigma * sigma
            w[W * k.H_SOC_WALK + c] = real(w, 0) if enough else grown
            grown = grown if enough else real(w, 0)
        y[W * k.Y_RESOLVED + c] = grown


@inline
def relax_hysteresis(p: Any, w: Any, y: Any, m: Any, c: int, lost: Any, g: Any, gain: Any, q: Any) -> None:
    """What the step does to the hysteresis voltage; an unknown current may have moved it anywhere."""
    W = m.lanes
    h = k.V_RC1 + m.n_rc
    largest = y[W * (k.Y_DYN + k.D_RC1 + 2 * m.n_rc) + c]
    rise = y[W * (k.Y_FALL + m.n_rc) + c]
    faded = y[W * (k.Y_FADE + m.n_rc) + c]
    to_target = rise if w[W * k.H_CURRENT_AGE + c] <= real(p, 0) else rise - rise * faded
    lost[h] = rise + faded - rise * faded
    g[h] = real(p, 0)
    gain[h] = to_target * (-largest if w[W * k.H_THROUGH + c] < real(p, 0) else largest)
    anywhere = largest * largest / real(p, 3)
    error = y[W * (k.Y_DYN + k.D_ERROR) + c]
    stationary = error * error * p[k.P_VAR_V + m.n_rc] + (anywhere if y[W * k.Y_GAP + c] > real(p, 0) else real(p, 0))
    q[h] = noise_root(p, lost[h], stationary)


@inline
def relax_rc(p: Any, w: Any, y: Any, m: Any, c: int, j: int, lost: Any, g: Any, gain: Any, q: Any) -> None:
    """What the step does to the voltage of an RC pair."""
    W = m.lanes
    i = w[W * k.H_THROUGH + c]
    r = y[W * (k.Y_DYN + k.D_RC1 + 2 * j) + c]
    rise = y[W * (k.Y_FALL + j) + c]
    faded = y[W * (k.Y_FADE + j) + c]
    # What is known of the current is the end of the step if it was just measured, else its beginning.
    to_target = rise if w[W * k.H_CURRENT_AGE + c] <= real(p, 0) else rise - rise * faded
    lost[k.V_RC1 + j] = rise + faded - rise * faded
    g[k.V_RC1 + j] = real(p, 0)
    gain[k.V_RC1 + j] = r * i * to_target
    w[W * (k.H_POLARISED + j) + c] += r * i * to_target - lost[k.V_RC1 + j] * w[W * (k.H_POLARISED + j) + c]
    # Model error as an Ornstein-Uhlenbeck process: the same stationary variance at every sample rate.
    times = y[W * (k.Y_DYN + k.D_ERROR) + c]
    relative = p[k.P_RC_REL] * r * i
    unknown = r * p[k.P_CURRENT_RANGE]
    stationary = times * times * (p[k.P_VAR_V + j] + relative * relative)
    stationary += unknown * unknown if y[W * k.Y_GAP + c] > real(p, 0) else real(p, 0)
    q[k.V_RC1 + j] = noise_root(p, lost[k.V_RC1 + j], stationary)


@inline
def slow_variance(p: Any, w: Any, y: Any, m: Any, c: int) -> Any:
    """Of the slow voltage error where it has forgotten its past, V^2.

    The current sensor's offset drops a voltage on every resistance that stays: to the filter a slow error like any
    other. Diffusion that an equivalent circuit does not follow is in proportion to the polarisation.
    """
    W = m.lanes
    error, offset, polarised = y[W * (k.Y_DYN + k.D_ERROR) + c], offset_drop(p, y, m, c), real(p, 0)
    for j in range(m.n_rc):
        polarised += w[W * (k.H_POLARISED + j) + c]
    follows = p[k.P_SLOW_REL] * polarised
    return error * error * p[k.P_SLOW_VAR] + offset * offset + follows * follows


@inline
def offset_drop(p: Any, y: Any, m: Any, c: int) -> Any:
    """One sigma of what the current sensor's offset drops on all resistances, V."""
    W = m.lanes
    r = y[W * (k.Y_DYN + k.D_R0) + c]
    for j in range(m.n_rc):
        r += y[W * (k.Y_DYN + k.D_RC1 + 2 * j) + c]
    return p[k.P_BIAS_SIGMA] * r


@inline
def noise_root(p: Any, lost: Any, stationary: Any) -> Any:
    """Root of the noise that keeps a state of which the share `lost` decays at the variance `stationary`."""
    return math.sqrt(lost * (real(p, 2) - lost) * stationary) + real(p, TINY_ROOT)


@inline
def warm_core(p: Any, w: Any, y: Any, m: Any, c: int, dt: Any) -> None:
    """The core's temperature goes to the surface's and what the losses i (ocv - v) put on top while i is known."""
    W = m.lanes
    loss = y[W * k.Y_DROP + c]
    for j in range(m.n_pol):
        loss += w[W * (m.x + k.V_RC1 + j) + c]
    target = p[k.P_CORE_K_PER_W] * w[W * k.H_THROUGH + c] * loss * (y[W * k.Y_KNOWN + c] / dt)
    rise = w[W * k.H_CORE_RISE + c]
    w[W * k.H_CORE_RISE + c] = rise + y[W * (k.Y_FALL + m.r0) + c] * (target - rise)
