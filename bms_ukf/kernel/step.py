"""What one sample does to the cells of a block: hold the inputs, predict, innovate, gate, update, commit.

This is policy, and it is in the kernel so that the daemon, a replay, a microcontroller and an FMU share it bit for bit.
Every phase is a loop over the lanes that writes only to the working copy `w`: so the loops become vector instructions,
and nothing is half done when a result turns out not to be finite. What happens rarely (a first voltage, a belief to
be doubted) has loops of its own, with branches.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from bms_ukf.kernel import adapt, belief, bias, idle, inputs, interval, ohmic, parts, process, voltage
from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import clamp, is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real, whole
from bms_ukf.kernel.srukf import by_belief
from bms_ukf.kernel.wide import update_wide
from bms_ukf.records import Fault, Status

NUMERIC = float(Fault.NUMERIC)
OUT_OF_TABLE = float(Fault.OUT_OF_TABLE)
UNCERTAIN = float(Fault.UNCERTAIN)
INITIALISING, OK, DEGRADED, INVALID = (int(status) for status in Status)
STATUS_SHIFT = 20  # codes pass through numbers: a float32 holds 24 bits
FAULT_MASK = (1 << STATUS_SHIFT) - 1

SOC_SLACK = 0.02  # how far SoC may wander beyond 0..1 before it is called out of the table
SOC_BEYOND = 0.1  # and where it is stopped


class Work(NamedTuple):
    """Scratch of a step: working copy and values of the lanes, the same of components, and sums of their intervals."""

    w: Any
    y: Any
    b: Any
    v: Any
    sums: Any


@inline
def step(
    p: Any,
    s: Any,
    o: int,
    at: int,
    work: Any,
    io: Any,
    first: int,
    rows: int,
    m: Any,
    lanes: int,
    dt: Any,
    current: Any,
) -> int:
    """Advance the block at `o` by `dt` >= 0 s to a sample of one current (A) and each lane's voltage and temperature.

    `io[row * rows + first + lane]` holds what was measured (NaN: not) and receives the results. Returns the fault bits
    of all lanes (`records.Fault`) and, from bit STATUS_SHIFT up, a bit for each status (`records.Status`) among them.
    The components of the lanes' beliefs (`parts`) are at `at`.
    """
    w, y = work.w, work.y
    stands = m.lanes > 1 and dt <= real(p, 0) and not is_number(current)
    if stands and not idle.has_news(io, first, rows, lanes, real(p, OK << STATUS_SHIFT)):
        idle.compare_nothing(io, first, rows, lanes)
        return 1 << OK << STATUS_SHIFT
    load(s, o, w, y, m, lanes)
    inputs.take(p, w, y, io, first, rows, m, lanes, dt, current)
    gaps = inputs.share(p, w, y, m, lanes, dt)
    process.schedule(p, s, o, w, y, m, lanes)
    ohmic.drop(p, w, y, m, lanes, dt)
    if dt > real(p, 0):  # another measurement of the same instant moves nothing
        process.relax(p, w, y, m, lanes, dt, gaps)
        process.walk(p, w, y, m, lanes, dt)
        process.resolve(w, y, m, lanes)
        process.advance(p, w, y, m, lanes, dt)
    belief.start(p, w, y, m, lanes)
    if m.bias:
        bias.stand_still(p, w, y, m, lanes, dt)
        bias.fuse_rest(p, w, y, io, first, rows, m, lanes, dt)
    voltage.look_up(p, w, y, m, lanes)
    special = voltage.compare(p, w, y, m, lanes)
    adapt.learn(p, w, y, m, lanes)
    voltage.fuse(p, w, y, m, lanes)
    if special:
        parts.follow(p, s, at, w, y, work.b, work.v, work.sums, m, lanes, dt, gaps)
    inputs.missing(p, w, y, m, lanes)
    refuse(s, o, w, y, m, lanes)
    bound(p, w, y, m, lanes)
    interval.describe(w, y, m, lanes)
    judge(p, y, m, lanes)
    publish(w, y, io, first, rows, m, lanes)
    return commit(s, o, w, y, m, lanes)


@inline
def predict(p: Any, s: Any, w: Any, y: Any, m: Any, dt: Any, current: Any, temperature: Any) -> int:
    """The time update alone, of one record: dt > 0 s under `current`, A, at `temperature`, degC. Returns fault bits."""
    load(s, 0, w, y, m, 1)
    w[k.H_CURRENT], w[k.H_TEMPERATURE], w[k.H_THROUGH] = current, temperature, current
    w[k.H_CURRENT_AGE] = w[k.H_TEMPERATURE_AGE] = w[k.H_GAP_S] = y[k.Y_GAP] = y[k.Y_CODE] = real(p, 0)
    w[k.H_VOLTAGE_AGE] += dt
    y[k.Y_KNOWN] = dt
    process.schedule(p, s, 0, w, y, m, 1)
    ohmic.drop(p, w, y, m, 1, dt)
    process.relax(p, w, y, m, 1, dt, 0)
    process.walk(p, w, y, m, 1, dt)
    process.resolve(w, y, m, 1)
    process.advance(p, w, y, m, 1, dt)
    y[k.Y_INNOVATION] = real(p, math.nan)  # that of another belief
    return settle(p, s, w, y, m)


@inline
def innovate(p: Any, s: Any, w: Any, y: Any, m: Any, z: Any) -> int:
    """Compare the voltage `z`, V, with what the belief that `predict` left makes expect. Returns fault bits."""
    load(s, 0, w, y, m, 1)
    y[k.Y_VOLTAGE] = z
    y[k.Y_CODE] = real(p, 0)
    voltage.look_up(p, w, y, m, 1)
    voltage.compare(p, w, y, m, 1)
    rejected = y[k.Y_CODE] == real(p, voltage.INNOVATION_REJECTED)
    compared = is_number(y[k.Y_CODE]) & is_number(y[k.Y_INNOVATION])
    return (int(voltage.INNOVATION_REJECTED) if rejected else 0) if compared else int(NUMERIC)


@inline
def update(p: Any, s: Any, w: Any, y: Any, m: Any) -> int:
    """Fuse the voltage that `innovate` compared, whatever the gate said of it. Returns fault bits."""
    load(s, 0, w, y, m, 1)
    wide = w[m.root] > p[k.P_WIDE_SIGMA]
    y[k.Y_FUSE] = real(p, k.BY_QUADRATURE) if wide else real(p, k.BY_SIGMA_POINTS)
    y[k.Y_CODE] = real(p, 0) if is_number(y[k.Y_INNOVATION]) else real(p, math.nan)
    voltage.fuse(p, w, y, m, 1)
    if y[k.Y_FUSE] == real(p, k.BY_QUADRATURE):
        update_wide(p, w, y, m, 0)
    y[k.Y_INNOVATION] = real(p, math.nan)  # fused once
    return settle(p, s, w, y, m)


@inline
def settle(p: Any, s: Any, w: Any, y: Any, m: Any) -> int:
    """Commit one record, or leave it as it was; returns its fault bits."""
    refuse(s, 0, w, y, m, 1)
    bound(p, w, y, m, 1)
    return commit(s, 0, w, y, m, 1) & FAULT_MASK


@inline
def load(s: Any, o: int, w: Any, y: Any, m: Any, lanes: int) -> None:
    """Copy the block's records, and see which lanes have a belief: one that is not finite is none."""
    W = m.lanes
    for place in range(W * m.cache):
        w[place] = s[o + place]
    for c in range(lanes):
        y[W * k.Y_PARTS_LOW + c] = real(w, math.nan)
        y[W * k.Y_ALIVE + c] = real(w, 1) if belief.is_finite(w, m, c) else real(w, 0)
        per_capacity, resistance = w[W * k.H_PER_CAPACITY + c], w[W * k.H_RESISTANCE + c]
        w[W * k.H_PER_CAPACITY + c] = per_capacity if is_number(per_capacity) else real(w, 1)
        w[W * k.H_RESISTANCE + c] = resistance if is_number(resistance) else real(w, 1)


@inline
def refuse(s: Any, o: int, w: Any, y: Any, m: Any, lanes: int) -> None:
    """Take back the whole step of a lane whose result is not finite: its record stays as it was."""
    W = m.lanes
    refused = 0
    for c in range(lanes):
        code = y[W * k.Y_CODE + c]
        good = (belief.is_finite(w, m, c) | (y[W * k.Y_ALIVE + c] == real(w, 0))) & is_number(code)
        y[W * k.Y_CODE + c] = code if good else real(w, NUMERIC)
        refused |= 0 if good else 1
    if refused:
        for c in range(lanes):
            if y[W * k.Y_CODE + c] == real(w, NUMERIC):
                for slot in range(m.cache):
                    w[W * slot + c] = s[o + W * slot + c]
                y[W * k.Y_INNOVATION + c] = real(w, math.nan)
                y[W * k.Y_ALIVE + c] = real(w, 1) if belief.is_finite(w, m, c) else real(w, 0)


@inline
def bound(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """Keep beliefs within their bounds, and note which of them read tables beyond their edges."""
    W = m.lanes
    zero, one = real(p, 0), real(p, 1)
    slack, beyond = real(p, SOC_SLACK), real(p, SOC_BEYOND)
    least, most = p[k.P_SOC_SIGMA_MIN], p[k.P_SOC_SIGMA_MAX]  # the sum of components may be wider
    for c in range(lanes):
        alive = y[W * k.Y_ALIVE + c] > zero
        soc = w[W * (m.x + k.SOC) + c]
        w[W * (m.x + k.SOC) + c] = clamp(soc, -beyond, one + beyond)
        sigma = w[W * m.root + c]
        w[W * m.root + c] = clamp(sigma, least, most)
        T = w[W * k.H_TEMPERATURE + c]
        within = (p[k.P_TABLE_TEMPERATURE_MIN] <= T) & (p[k.P_TABLE_TEMPERATURE_MAX] >= T)
        within = within & (-slack <= soc) & (soc <= one + slack)
        code = y[W * k.Y_CODE + c]
        y[W * k.Y_CODE + c] += real(p, OUT_OF_TABLE) if alive & (not within) & (code != real(p, NUMERIC)) else zero


@inline
def judge(p: Any, y: Any, m: Any, lanes: int) -> None:
    """Give each lane its status, from its faults and the width of the interval to be published."""
    W = m.lanes
    zero, most, worst = real(p, 0), p[k.P_OK_HALF_WIDTH], p[k.P_INVALID_HALF_WIDTH]
    for c in range(lanes):
        alive = y[W * k.Y_ALIVE + c] > zero
        half = (y[W * k.Y_SOC_HIGH + c] - y[W * k.Y_SOC_LOW + c]) * real(p, 0.5)
        code = y[W * k.Y_CODE + c]
        code += real(p, UNCERTAIN) if alive & (half > most) else zero
        status = real(p, OK << STATUS_SHIFT) if code == zero else real(p, DEGRADED << STATUS_SHIFT)
        status = real(p, INVALID << STATUS_SHIFT) if half > worst else status
        status = status if alive else real(p, INITIALISING << STATUS_SHIFT)
        y[W * k.Y_CODE + c] = code + status


@inline
def publish(w: Any, y: Any, io: Any, first: int, rows: int, m: Any, lanes: int) -> None:
    """Write the lanes' results."""
    W = m.lanes
    zero, nan = real(w, 0), real(w, math.nan)
    for c in range(lanes):
        innovation = y[W * k.Y_INNOVATION + c]
        variance = y[W * k.Y_VARIANCE + c] - y[W * k.Y_CROWDED + c]
        predicted = y[W * k.Y_PREDICTED + c]
        compared = is_number(innovation) & (y[W * k.Y_ALIVE + c] > zero)
        y[W * k.Y_PREDICTED + c] = predicted if compared else nan
        y[W * k.Y_INNOVATION + c] = innovation if compared else nan
        y[W * k.Y_VARIANCE + c] = variance if compared else nan
        nis = innovation * innovation / variance
        y[W * k.Y_NIS + c] = nis if compared else nan
        y[W * k.Y_BIAS + c] = w[W * (m.x + m.n - 1) + c] if m.bias else nan
        r0 = by_belief(w, c, m, y[W * k.Y_R0 + c])
        y[W * k.Y_R0 + c] = r0 if y[W * k.Y_ALIVE + c] > zero else nan
    # A row at a time: rows that might overlap would take more checks than LLVM is ready to make.
    show(io, rows * k.OUT_SOC + first, y, W * k.Y_SOC, lanes)
    show(io, rows * k.OUT_SOC_SIGMA + first, y, W * k.Y_SOC_SIGMA, lanes)
    show(io, rows * k.OUT_SOC_LOW + first, y, W * k.Y_SOC_LOW, lanes)
    show(io, rows * k.OUT_SOC_HIGH + first, y, W * k.Y_SOC_HIGH, lanes)
    show(io, rows * k.OUT_VOLTAGE_PRED + first, y, W * k.Y_PREDICTED, lanes)
    show(io, rows * k.OUT_INNOVATION + first, y, W * k.Y_INNOVATION, lanes)
    show(io, rows * k.OUT_INNOVATION_VAR + first, y, W * k.Y_VARIANCE, lanes)
    show(io, rows * k.OUT_NIS + first, y, W * k.Y_NIS, lanes)
    show(io, rows * k.OUT_AGE + first, w, W * k.H_VOLTAGE_AGE, lanes)
    show(io, rows * k.OUT_BIAS + first, y, W * k.Y_BIAS, lanes)
    show(io, rows * k.OUT_R0 + first, y, W * k.Y_R0, lanes)
    show(io, rows * k.OUT_CODE + first, y, W * k.Y_CODE, lanes)


@inline
def show(io: Any, out: int, source: Any, at: int, lanes: int) -> None:
    for c in range(lanes):
        io[out + c] = source[at + c]


@inline
def commit(s: Any, o: int, w: Any, y: Any, m: Any, lanes: int) -> int:
    """Make the working copy the block's records; returns the lanes' faults and status together."""
    W = m.lanes
    for place in range(W * m.cache):
        s[o + place] = w[place]
    faults, seen = 0, 0
    for c in range(lanes):
        code = whole(y[W * k.Y_CODE + c])
        faults |= code & FAULT_MASK
        seen |= 1 << (code >> STATUS_SHIFT & 3)  # of 4: a shift by any number of 64 bits is a call on 32-bit machines
    return faults | seen << STATUS_SHIFT


@inline
def together(codes: int) -> int:
    """Faults and one status of all cells, from faults and the set of their statuses.

    Cells that are not OK leave the pack degraded: what is known of the others is worth showing.
    """
    seen = codes >> STATUS_SHIFT
    status = DEGRADED
    if seen & 1 << INITIALISING:
        status = INITIALISING
    elif seen == 1 << INVALID:
        status = INVALID
    elif seen == 1 << OK:
        status = OK
    return codes & FAULT_MASK | status << STATUS_SHIFT
