"""The belief before a first voltage, as components: every SoC, and two histories of the load.

Nobody knows what has polarised the cell. Two hypotheses stand for it: parked (no load but a small one), or under some
load that the cell allows. The first current is evidence between them. Each hypothesis has components on fine intervals
of SoC; the first voltage weighs them all, and those of one history are then merged into PARTS / HISTORIES components.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import gaussian_sum as gs
from bms_ukf.kernel import layout as k
from bms_ukf.kernel import ohmic, voltage
from bms_ukf.kernel.ecm import clamp, decay
from bms_ukf.kernel.gaussian_sum import HISTORIES
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import PARTS, tri
from bms_ukf.kernel.memory import real, vector
from bms_ukf.kernel.pieces import UNIFORM, clear, put
from bms_ukf.kernel.process import offset_drop
from bms_ukf.kernel.srukf import update

FINE = 2  # times PARTS: intervals of SoC
PASSES = HISTORIES * FINE  # to find where mass is; as many to collect it

PARKED = 0.9  # probability of no load before a first current that is none
PARKED_IN_GAP = 0.7  # the same for no load in a gap of the current, or before a doubt
LOADED_YET_PARKED = 0.05  # and before one that is a load
STRAY = 0.05  # probability that a SoC believed before a first voltage is anything else
DOUBTED = 0.5  # and where voltages have contradicted it
DOUBT_TIMES, DOUBT_MORE = 3.0, 0.02  # its sigma then
LOADED_SLOW = 2.0  # times the sigma of the slow voltage error after a load
NIS_REACH = 40.0  # beyond the best normalised innovation squared, a component has no mass: exp(-20)
DENSITY = 0.39894228  # 1 / sqrt(2 pi)


@inline
def begin(p: Any, s: Any, at: int, w: Any, y: Any, b: Any, v: Any, sums: Any, m: Any, c: int, doubted: Any) -> None:
    """Make the components at `at` the belief of lane `c` after its first voltage."""
    W, mb = m.lanes, gs.of_parts(m)
    B, each = mb.lanes, PARTS // HISTORIES
    mean, sigma = w[W * m.x + c], w[W * m.root + c]
    stray = real(w, DOUBTED) if doubted else real(w, STRAY)
    sigma = real(w, DOUBT_TIMES) * sigma + real(w, DOUBT_MORE) if doubted else sigma
    best, low, width = vector(w, HISTORIES), vector(w, HISTORIES), vector(w, HISTORIES)
    for history in range(HISTORIES):
        best[history], low[history], width[history] = real(w, math.inf), real(w, 0), real(w, 1)
    for turn in range(2 * PASSES):
        history, fine = turn // FINE % HISTORIES, turn % FINE * PARTS
        if turn == PASSES:
            for of_history in range(HISTORIES):
                low[of_history], width[of_history] = reached(sums, of_history * FINE * PARTS, best[of_history])
        if (turn >= PASSES) & (turn % FINE == 0):
            clear(sums, each, m)
        for block in range(PARTS // B):
            first_voltage(p, s, gs.place_of(at, block, mb), w, y, b, v, m, mb, c, fine + block * B, history, doubted)
            for lane in range(B):
                innovation, per_variance = v[B * k.Y_INNOVATION + lane], v[B * k.Y_PER_VARIANCE + lane]
                nis, j = innovation * innovation * per_variance, fine + block * B + lane
                if turn < PASSES:
                    sums[history * FINE * PARTS + j] = nis
                    best[history] = min(best[history], nis)
                else:
                    soc = (real(w, j) + real(w, 0.5)) / real(w, FINE * PARTS)
                    mass = prior(w, soc, mean, sigma, stray) * hypothesis(p, w, m, c, history)
                    mass *= gs.likelihood(w, nis - min(best[0], best[1]), per_variance)
                    put(sums, each, b, 0, B, lane, mb, mass, low[history], width[history], 0)
        if (turn >= PASSES) & (turn % FINE == FINE - 1):
            gs.place(s, at, sums, m, mb, history * each, each, low[history], width[history])
            w[W * (k.H_PART_WIDTH + history) + c] = width[history]
    gs.normalise(s, at, mb)
    w[W * k.H_PART_GROUPS + c] = real(w, HISTORIES)


@inline
def first_voltage(
    p: Any,
    s: Any,
    o: int,
    w: Any,
    y: Any,
    b: Any,
    v: Any,
    m: Any,
    mb: Any,
    c: int,
    first: int,
    history: int,
    doubted: Any,
) -> None:
    """Let the first voltage update components of one history on the fine intervals from `first` on.

    `o` is a block of records whose table caches may be used.
    """
    B = mb.lanes
    gs.share_inputs(w, y, b, v, m, c, mb)
    spread(p, w, b, m, c, mb, first, doubted)
    gs.read_tables(p, s, o, b, v, mb)
    polarise(p, w, b, v, m, c, mb, history)
    ohmic.drop(p, b, v, mb, B, real(w, 0))
    voltage.look_up(p, b, v, mb, B)
    voltage.innovations(p, b, v, mb, B)
    for lane in range(B):
        v[B * k.Y_FUSE + lane] = real(w, k.BY_SIGMA_POINTS)
    for lane in range(B):
        update(b, v, lane, mb)


@inline
def spread(p: Any, w: Any, b: Any, m: Any, c: int, mb: Any, first: int, doubted: Any) -> None:
    """Components on the fine intervals from `first` on, before their first voltage; polarisation comes after.

    The slow voltage error, the r0 error and the bias are what the cell's Gaussian has, without their correlations.
    Where the belief was contradicted they are as wide as at the very start, and no further off than that width: a wrong
    SoC had bent them.
    """
    W, B = m.lanes, mb.lanes
    zero, fine = real(w, 0), real(w, 1) / real(w, FINE * PARTS)
    for slot in range(B * mb.x, B * mb.cache):
        b[slot] = zero
    for lane in range(B):
        b[B * (mb.x + k.SOC) + lane] = (real(w, first + lane) + real(w, 0.5)) * fine
        b[B * mb.root + lane] = fine / real(w, 2 * UNIFORM)
    for row in range(m.n_v, m.n):
        prior_var = p[k.P_BIAS_SIGMA] * p[k.P_BIAS_SIGMA]
        prior_var = p[k.P_R0_VAR] if row == m.r0 else prior_var
        prior_var = p[k.P_SLOW_VAR] if row == m.n_v else prior_var
        known = variance_of(w, W, c, m, row)
        known = prior_var if doubted else known
        most, mean = math.sqrt(prior_var), w[W * (m.x + row) + c]
        mean = clamp(mean, -most, most) if doubted else mean
        for lane in range(B):
            b[B * (mb.x + row) + lane] = mean
            b[B * (mb.root + tri(row, row)) + lane] = math.sqrt(known)


@inline
def variance_of(w: Any, W: int, c: int, m: Any, row: int) -> Any:
    """Of a state, by its row of sqrt_P."""
    total = real(w, 0)
    for column in range(row + 1):
        total += w[W * (m.root + tri(row, column)) + c] * w[W * (m.root + tri(row, column)) + c]
    return total


@inline
def polarise(p: Any, w: Any, b: Any, v: Any, m: Any, c: int, mb: Any, loaded: int) -> None:
    """The polarisation before a first voltage: none but that of a small load, or that of any load the cell allows."""
    W, B = m.lanes, mb.lanes
    zero = real(w, 0)
    i = w[W * k.H_THROUGH + c] / real(w, 2) if loaded else zero
    # Loads are those of the cell as large as it is here: a parallel group takes more.
    history = p[k.P_HISTORY] / w[W * k.H_PER_CAPACITY + c] if loaded else p[k.P_INITIAL_CURRENT]
    times = real(w, LOADED_SLOW) if loaded else real(w, 1)
    for lane in range(B):
        error = v[B * (k.Y_DYN + k.D_ERROR) + lane]
        for j in range(m.n_rc):
            row = k.V_RC1 + j
            r = v[B * (k.Y_DYN + k.D_RC1 + 2 * j) + lane]
            b[B * (mb.x + row) + lane] = r * i
            sigma = r * history
            b[B * (mb.root + tri(row, row)) + lane] = math.sqrt(error * error * p[k.P_VAR_V + j] + sigma * sigma)
        if m.hysteresis:
            row = k.V_RC1 + m.n_rc
            largest = v[B * (k.Y_DYN + k.D_RC1 + 2 * m.n_rc) + lane]
            # Anywhere between the branches: a uniform distribution.
            anywhere = error * error * p[k.P_VAR_V + m.n_rc] + largest * largest / real(w, 3)
            b[B * (mb.root + tri(row, row)) + lane] = math.sqrt(anywhere)
        # The slow error of the resistances at this temperature: the cell's Gaussian was begun at half charge.
        slow = b[B * (mb.root + tri(m.n_v, m.n_v)) + lane]
        offset_V = offset_drop(p, v, mb, lane)
        slow = max(error, real(w, 1)) * slow
        b[B * (mb.root + tri(m.n_v, m.n_v)) + lane] = times * math.sqrt(slow * slow + offset_V * offset_V)


@inline
def hypothesis(p: Any, w: Any, m: Any, c: int, loaded: int) -> Any:
    """Probability of the history, by the first current."""
    i = w[m.lanes * k.H_THROUGH + c] * w[m.lanes * k.H_PER_CAPACITY + c]
    idle = abs(i) <= p[k.P_EXCITED] / real(w, 2)
    rested = real(w, PARKED) if w[m.lanes * k.H_FRESH + c] > real(w, 0) else real(w, PARKED_IN_GAP)
    parked = rested if idle else real(w, LOADED_YET_PARKED)
    return real(w, 1) - parked if loaded else parked


@inline
def prior(w: Any, soc: Any, mean: Any, sigma: Any, stray: Any) -> Any:
    """Density of SoC before the first voltage, up to a factor."""
    fine = real(w, 1 / (FINE * PARTS * 2 * UNIFORM))
    spread = math.sqrt(sigma * sigma + fine * fine)
    away = (soc - mean) / spread
    return stray + (real(w, 1) - stray) * real(w, DENSITY) / spread * decay(w, away * away / real(w, 2))


@inline
def reached(sums: Any, found: int, best: Any) -> tuple[Any, Any]:
    """Return where a first voltage leaves mass: the lower end, and the width of one history's intervals over it."""
    one = real(sums, 1)
    fine = one / real(sums, FINE * PARTS)
    low, high = one, real(sums, 0)
    for j in range(FINE * PARTS):
        if sums[found + j] < best + real(sums, NIS_REACH):
            low, high = min(low, real(sums, j) * fine), max(high, real(sums, j + 1) * fine)
    return low, (high - low) / real(sums, PARTS // HISTORIES)
