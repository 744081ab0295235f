"""The belief before a first voltage, which its components then take over (`parts`)."""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import adapt
from bms_ukf.kernel import layout as k
from bms_ukf.kernel.adapt import FAST_S
from bms_ukf.kernel.ecm import dynamics
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import tri
from bms_ukf.kernel.memory import real


@inline
def start(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """Give a lane without a belief its first one, as soon as a current, a temperature and a voltage are known."""
    W = m.lanes
    for c in range(lanes):
        known = y[W * k.Y_VOLTAGE + c] + w[W * k.H_THROUGH + c] + w[W * k.H_TEMPERATURE + c]
        if y[W * k.Y_ALIVE + c] == real(w, 0) and math.isfinite(known):
            # The load may have begun just now or long ago: the RC voltages are between nothing and r i.
            half = w[W * k.H_THROUGH + c] / real(w, 2)
            for j in range(m.n_rc):
                w[W * (m.x + k.V_RC1 + j) + c] = resistance(p, w, y, m, c, j) * half
            if m.hysteresis:
                w[W * (m.x + k.V_RC1 + m.n_rc) + c] = real(w, 0)
            w[W * (m.x + m.n_v) + c] = w[W * (m.x + m.r0) + c] = real(w, 0)
            if m.bias:
                w[W * (m.x + m.n - 1) + c] = w[W * k.H_SHARED + c] = real(w, 0)
                w[W * k.H_SHARED_VAR + c] = p[k.P_BIAS_SIGMA] * p[k.P_BIAS_SIGMA]
            before = math.sqrt(p[k.P_INITIAL_CURRENT] * p[k.P_INITIAL_CURRENT] + half * half)
            believe(p, w, y, m, c, p[k.P_INITIAL_SOC], p[k.P_INITIAL_SIGMA], before)
            w[W * k.H_GAP_S + c] = real(w, 0)
            w[W * k.H_CORE_RISE + c] = w[W * k.H_CORE_USED + c] = real(w, 0)
            w[W * k.H_SOC_WALK + c] = w[W * k.H_PARTS + c] = real(w, 0)
            w[W * k.H_UNSEEN_S + c] = real(w, 0)
            for j in range(k.N_RC_MAX):
                w[W * (k.H_POLARISED + j) + c] = real(w, 0)
            adapt.start(w, m, c)
            w[W * k.H_REST_A + c] = real(w, math.nan)
            w[W * k.H_LOADED + c] = real(w, 0)
            w[W * k.H_VOLTAGE_AGE + c] = real(w, FAST_S)  # no voltage was fused lately
            y[W * k.Y_ALIVE + c] = real(w, 1)


@inline
def is_finite(w: Any, m: Any, c: int) -> Any:
    """Whether a lane has a belief, and one of numbers only."""
    W = m.lanes
    total = w[W * k.H_VOLTAGE_AGE + c]
    for slot in range(m.x, m.carry):
        total += abs(w[W * slot + c])
    return total - total == real(w, 0)


@inline
def believe(p: Any, w: Any, y: Any, m: Any, c: int, soc: Any, sigma: Any, before: Any) -> None:
    """Set SoC and its sigma; the other states stay, as wide as an unknown current of sigma `before` has left them."""
    W = m.lanes
    for row in range(m.n):
        for column in range(row + 1):
            w[W * (m.root + tri(row, column)) + c] = real(w, 0)
    if m.compensated:
        for slot in range(m.carry, m.cache):
            w[W * slot + c] = real(w, 0)
    w[W * (m.x + k.SOC) + c] = soc
    w[W * m.root + c] = sigma
    w[W * k.H_FRESH + c] = real(w, 1)
    error = y[W * (k.Y_DYN + k.D_ERROR) + c]
    error *= error
    for j in range(m.n_rc):
        row = k.V_RC1 + j
        drop = resistance(p, w, y, m, c, j) * before
        w[W * (m.root + tri(row, row)) + c] = math.sqrt(error * p[k.P_VAR_V + j] + drop * drop)
    if m.hysteresis:
        row = k.V_RC1 + m.n_rc
        largest = dynamics(p, soc, y[W * k.Y_T + c], k.D_RC1 + 2 * m.n_rc, m.channels)
        # Anywhere between the branches: a uniform distribution.
        anywhere = largest * largest / real(w, 3)
        w[W * (m.root + tri(row, row)) + c] = math.sqrt(error * p[k.P_VAR_V + m.n_rc] + anywhere)
    w[W * (m.root + tri(m.n_v, m.n_v)) + c] = math.sqrt(error * p[k.P_SLOW_VAR])
    w[W * (m.root + tri(m.r0, m.r0)) + c] = math.sqrt(p[k.P_R0_VAR])
    if m.bias:
        w[W * (m.root + tri(m.n - 1, m.n - 1)) + c] = p[k.P_BIAS_SIGMA]


@inline
def resistance(p: Any, w: Any, y: Any, m: Any, c: int, j: int) -> Any:
    """r of an RC pair at half charge, ohm: SoC is not known yet, and at the ends of a table r is beyond all measure."""
    W = m.lanes
    return w[W * k.H_RESISTANCE + c] * dynamics(p, real(p, 0.5), y[W * k.Y_T + c], k.D_RC1 + 2 * j, m.channels)
