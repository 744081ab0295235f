"""A belief of any shape over SoC: components take over where one Gaussian would be wrong.

A first voltage, a gap, a voltage refused for long and a plateau of the OCV leave SoC with several explanations. Then
PARTS components carry the posterior: each is a Gaussian of all states with a narrow SoC of its own, and a weight
(`gaussian_sum`). Each component takes the same step as a cell's Gaussian, with its own tables, so these loops run the
functions of the filter over components as lanes. The likelihood of every voltage multiplies the weights. With
every voltage the cell's x and sqrt_P become the mean and the covariance of the sum; between voltages they are predicted
as one Gaussian. Once the bounds of the sum are those of a Gaussian, that takes over again.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import adapt, bounds, histories, ohmic, process, voltage
from bms_ukf.kernel import gaussian_sum as gs
from bms_ukf.kernel import layout as k
from bms_ukf.kernel.belief import is_finite
from bms_ukf.kernel.ecm import is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import PARTS, Form, form, tri
from bms_ukf.kernel.memory import real
from bms_ukf.kernel.srukf import update

GAP_S = 60.0  # of unknown current, after which the polarisation is that of an unknown history


def room(m: Form) -> tuple[int, int, int]:
    """Numbers in the scratch `b`, `v` and `sums` of `follow`."""
    mb = form(*m.variant[:4], m.part_lanes, m.compensated)
    copied = mb.cache if m.part_lanes > 1 else mb.size
    return m.part_lanes * copied, m.part_lanes * k.VALUES, PARTS * (1 + m.n + m.n * (m.n + 1) // 2)


@inline
def follow(
    p: Any, s: Any, at: int, w: Any, y: Any, b: Any, v: Any, sums: Any, m: Any, lanes: int, dt: Any, gaps: int
) -> None:
    """Take the step of every lane whose belief the components hold or take over.

    Components have no working copy: a lane that is to be refused is left out, so they stay as its record does.
    `s[at + lane * m.parts ..]` are a lane's components. Scratch: `b` and `v` are the working copy and the values of a
    loop over components, `sums` are those of the intervals; `room` has their sizes. `b` and `v` may be the second half
    of `sums`.
    """
    W = m.lanes
    for c in range(lanes):
        how = y[W * k.Y_FUSE + c]
        held = w[W * k.H_PARTS + c] > real(w, 0)
        sound = is_finite(w, m, c) & is_number(y[W * k.Y_CODE + c])
        if sound & (held | (how == real(w, k.BY_PARTS)) | (how == real(w, k.DOUBT))):
            step_one(p, s, at + c * m.parts, w, y, b, v, sums, m, c, dt, gaps)


@inline
def step_one(
    p: Any, s: Any, at: int, w: Any, y: Any, b: Any, v: Any, sums: Any, m: Any, c: int, dt: Any, gaps: int
) -> None:
    """Begin, take over, or predict and update the components of lane `c`; then give the cell what they say together."""
    W, mb = m.lanes, gs.of_parts(m)
    zero = real(w, 0)
    how = y[W * k.Y_FUSE + c]
    doubted = how == real(w, k.DOUBT)
    fuses = doubted | (how == real(w, k.BY_PARTS))
    held = (w[W * k.H_PARTS + c] > zero) & gs.are_finite(s, at, mb)
    begins = fuses & ((w[W * k.H_FRESH + c] > zero) | doubted | (w[W * k.H_UNSEEN_S + c] > real(w, GAP_S)))
    if begins | (not held):
        gs.forget_tables(s, at, mb)
        w[W * k.H_PART_WALK + c] = w[W * k.H_PART_S + c] = zero
    moves = held & (dt > zero) & (not begins)
    if begins:
        w[W * k.H_LEAN + c] = zero
        if doubted:
            adapt.start(w, m, c)
        y[W * k.Y_KNOWN + c] = zero  # they begin at this instant: no charge is to flow before their voltage
        histories.begin(p, s, at, w, y, b, v, sums, m, c, doubted)
    else:
        if not held:
            gs.become_one(s, at, w, m, mb, c)
            gs.cut(s, at, w, sums, m, mb, c, 1, fuses)
        step_components(p, s, at, w, y, b, v, sums, m, c, dt, gaps, moves, fuses)
    w[W * k.H_PART_S + c] += dt if moves else zero
    if fuses:
        w[W * k.H_VOLTAGE_AGE + c] = w[W * k.H_UNSEEN_S + c] = w[W * k.H_FRESH + c] = zero
        w[W * k.H_REJECTED_S + c] = real(w, math.nan)
        # With a voltage only: the cell's Gaussian then meets it predicted, whether its sample comes whole or in parts.
        gs.cut(s, at, w, sums, m, mb, c, 0, fuses)
    bounds.describe(s, at, y, sums, m, mb, c, w[W * m.x + c])
    if fuses:
        bounds.release(p, w, y, m, c)


@inline
def step_components(
    p: Any,
    s: Any,
    at: int,
    w: Any,
    y: Any,
    b: Any,
    v: Any,
    sums: Any,
    m: Any,
    c: int,
    dt: Any,
    gaps: int,
    moves: Any,
    fuses: Any,
) -> None:
    """Predict every component if time `moves`, and let the voltage update and weigh it if the cell `fuses` it."""
    mb = gs.of_parts(m)
    B = mb.lanes
    if moves:
        let_walk(s, at, w, y, m, mb, c)
    for block in range(PARTS // B):
        o = gs.place_of(at, block, mb)
        gs.share_inputs(w, y, b, v, m, c, mb)
        for slot in range(B * mb.x, B * mb.cache):
            b[slot] = s[o + slot]
        gs.read_tables(p, s, o, b, v, mb)
        ohmic.drop(p, b, v, mb, B, real(w, 0))  # the cell's own call has moved the low-pass
        if moves:
            process.relax(p, b, v, mb, B, dt, gaps)
            process.advance(p, b, v, mb, B, dt)
        share_current(p, w, y, b, v, m, mb, c)
        if mb.bias and is_number(y[m.lanes * k.Y_SHOWN + c]):
            fuse_offset(b, v, y[m.lanes * k.Y_SHOWN + c], y[m.lanes * k.Y_SHOWN_VAR + c], mb)
        if fuses:
            voltage.look_up(p, b, v, mb, B)
            voltage.innovations(p, b, v, mb, B)
            for lane in range(B):
                v[B * k.Y_FUSE + lane] = real(w, k.BY_SIGMA_POINTS)
            for lane in range(B):
                update(b, v, lane, mb)
            for lane in range(B):
                innovation, by_soc = v[B * k.Y_INNOVATION + lane], v[B * (k.Y_B + k.SOC) + lane]
                j = block * B + lane
                sums[j], sums[j + PARTS] = innovation * innovation, by_soc * by_soc
                sums[j + 2 * PARTS] = v[B * k.Y_VARIANCE + lane] - by_soc * by_soc
        for slot in range(B * mb.x, B * mb.cache):
            s[o + slot] = b[slot]
    if fuses:
        gs.weigh(s, at, sums, mb)


@inline
def fuse_offset(b: Any, v: Any, shown: Any, variance: Any, mb: Any) -> None:
    """Update every component by what a rest shows of the current sensor's offset, A (`bias.fuse_rest`)."""
    B, last = mb.lanes, mb.n - 1
    for lane in range(B):
        for j in range(mb.n):
            v[B * (k.Y_B + j) + lane] = b[B * (mb.root + tri(last, j)) + lane]
        v[B * k.Y_ALPHA + lane], v[B * k.Y_TRUST + lane] = variance, real(b, 1)
        v[B * k.Y_INNOVATION + lane] = shown - b[B * (mb.x + last) + lane]
        v[B * k.Y_FUSE + lane] = real(b, k.BY_SIGMA_POINTS)
    for lane in range(B):
        update(b, v, lane, mb)


@inline
def share_current(p: Any, w: Any, y: Any, b: Any, v: Any, m: Any, mb: Any, c: int) -> None:
    """Give components what the current alone makes: the lead, the polarisation, and the drop but for r0 over SoC.

    The r0 of a component's own SoC counts for the drop that has stood for some seconds, beyond that of a small load.
    By the noise of a current sensor, the components of one r0 would have smaller innovations than others at every
    sample, even where the voltage holds no information on SoC.
    """
    W, B = m.lanes, mb.lanes
    r0 = k.D_R0 if w[W * k.H_THROUGH + c] >= real(w, 0) else k.D_R0_CHARGE
    of_cell = y[W * (k.Y_DYN + r0) + c]
    used = w[W * k.H_USED + c] if y[W * k.Y_DROP + c] != real(w, 0) else real(w, 0)
    small = ohmic.small_load(p, w, m, c) * of_cell
    stood = ohmic.beyond(used, small)
    for lane in range(B):
        v[B * k.Y_DROP + lane] = y[W * k.Y_DROP + c] + stood * (v[B * (k.Y_DYN + r0) + lane] / of_cell - real(w, 1))
        v[B * k.Y_SCALED + lane] = ohmic.beyond(v[B * k.Y_DROP + lane], small)
        v[B * k.Y_DROP_SIGMA + lane] = y[W * k.Y_DROP_SIGMA + c]
        v[B * k.Y_LEAD + lane] = y[W * k.Y_LEAD + c]
        for j in range(m.n_rc):
            b[B * (k.H_POLARISED + j) + lane] = w[W * (k.H_POLARISED + j) + c]


@inline
def let_walk(s: Any, at: int, w: Any, y: Any, m: Any, mb: Any, c: int) -> None:
    """Leave in Y_WALK what the components' roots can show of it, as `process.resolve` does for a Gaussian."""
    W = m.lanes
    if m.compensated:
        widest = real(w, 0)
        for j in range(PARTS):
            o = gs.place_of(at, j // mb.lanes, mb)
            widest = max(widest, s[o + mb.lanes * mb.root + j % mb.lanes])
        grown = w[W * k.H_PART_WALK + c] + y[W * k.Y_WALK + c]
        enough = grown > real(w, process.RESOLVED) * widest * widest
        w[W * k.H_PART_WALK + c] = real(w, 0) if enough else grown
        y[W * k.Y_WALK + c] = grown if enough else real(w, 0)
