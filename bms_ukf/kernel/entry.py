"""The compiled functions: what Python calls. Nothing else in the kernel is compiled on its own.

Buffers are passed as integer addresses (see `memory`) of aligned numbers of `bits` bits; their layout is a `Form`. Each
variant is compiled when it is first asked for, which takes some seconds on a new machine, and cached (NUMBA_CACHE_DIR).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

from bms_ukf.kernel import ecm, layout, parts, shared
from bms_ukf.kernel import limits as reach
from bms_ukf.kernel import step as policy
from bms_ukf.kernel.jit import entry
from bms_ukf.kernel.layout import Form, form_at_compile_time
from bms_ukf.kernel.memory import pointer, real, vector


@functools.cache
def tick(form: Form, bits: int) -> Callable[[int, int, int, int, float, float], int]:
    """tick(params, state, io, cells, dt, current) -> code: `step.step` of every cell under one current, A; dt >= 0 s.

    `io` has `layout.IO_ROWS` rows of `cells` numbers. Returns the faults of all cells together (`records.Fault`) and,
    from bit STATUS_SHIFT up, a `records.Status`: INITIALISING if any cell's is, OK or INVALID if every cell's is.
    """
    n_rc, hysteresis, bias, core, lanes, compensated, part_lanes = form.variant
    copied, values = lanes * form.cache, lanes * layout.VALUES
    part_copied, part_values, part_sums = parts.room(form)

    def tick(params: int, state: int, io: int, cells: int, dt: float, current: float) -> int:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        p = pointer(params, bits)
        s = pointer(state, bits)
        rows = pointer(io, bits)
        w, y = vector(s, copied), vector(s, values)
        b, v, sums = vector(s, part_copied), vector(s, part_values), vector(s, part_sums)
        work = policy.Work(w, y, b, v, sums)
        span, i = real(s, dt), real(s, current)
        codes = 0
        blocks = (cells + lanes - 1) // lanes
        for block in range(blocks):
            first = block * lanes
            count = 1 if lanes == 1 else min(lanes, cells - first)
            at = blocks * lanes * m.size + first * m.parts
            codes |= policy.step(p, s, first * m.size, at, work, rows, first, cells, m, count, span, i)
        return policy.together(codes)

    return entry(tick, "int64(int64, int64, int64, int64, float64, float64)")


@functools.cache
def replay(form: Form, bits: int) -> Callable[[int, int, int, int, int, int], int]:
    """replay(params, state, io, steps, dt, current) -> code: `steps` ticks of one cell in one call.

    `io` has `steps` rows of `layout.IO_ROWS` numbers, `dt` and `current` are arrays of `steps`; the code has the faults
    of all ticks together and, from STATUS_SHIFT up, a status as that of `tick`.
    """
    n_rc, hysteresis, bias, core, lanes, compensated, part_lanes = form.variant
    copied, values, row = form.cache, layout.VALUES, layout.IO_ROWS
    part_copied, part_values, part_sums = parts.room(form)

    def replay(params: int, state: int, io: int, steps: int, dt: int, current: int) -> int:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        p = pointer(params, bits)
        s = pointer(state, bits)
        rows = pointer(io, bits)
        w, y = vector(s, copied), vector(s, values)
        b, v, sums = vector(s, part_copied), vector(s, part_values), vector(s, part_sums)
        work = policy.Work(w, y, b, v, sums)
        spans = pointer(dt, bits)
        currents = pointer(current, bits)
        codes = 0
        for k in range(steps):
            codes |= policy.step(p, s, 0, m.size, work, rows, k * row, 1, m, 1, spans[k], currents[k])
        return policy.together(codes)

    return entry(replay, "int64(int64, int64, int64, int64, int64, int64)")


@functools.cache
def exchange(form: Form, bits: int) -> Callable[[int, int, int, int, int], None]:
    """exchange(params, state, string_of, string, cells): `shared.exchange`; `string_of` has `cells` numbers."""
    n_rc, hysteresis, bias, core, lanes, compensated, part_lanes = form.variant
    copied, values = form.cache, layout.VALUES

    def exchange(params: int, state: int, string_of: int, string: int, cells: int) -> None:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        alone = form_at_compile_time(n_rc, hysteresis, bias, core, 1, compensated, part_lanes)
        p, s, strings = pointer(params, bits), pointer(state, bits), pointer(string_of, bits)
        w, y = vector(s, copied), vector(s, values)
        shared.exchange(p, s, w, y, strings, string, cells, m, alone)

    return entry(exchange, "void(int64, int64, int64, int64, int64)")


@functools.cache
def limits(form: Form, bits: int) -> Callable[[int, int, int, int, int], None]:
    """limits(params, state, out, conditions, cells): `limits.limits`; LIMIT_ROWS rows of `cells` numbers in `out`."""
    n_rc, hysteresis, bias, core, lanes, compensated, part_lanes = form.variant

    def limits(params: int, state: int, out: int, conditions: int, cells: int) -> None:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        p, s, a = pointer(params, bits), pointer(state, bits), pointer(conditions, bits)
        reach.limits(p, s, pointer(out, bits), a, cells, m)

    return entry(limits, "void(int64, int64, int64, int64, int64)")


@functools.cache
def energy(form: Form, bits: int) -> Callable[[int, int, int, int, int], None]:
    """energy(params, state, out, conditions, cells): `limits.energy`, into the row L_MEAN_V of `out`."""
    n_rc, hysteresis, bias, core, lanes, compensated, part_lanes = form.variant

    def energy(params: int, state: int, out: int, conditions: int, cells: int) -> None:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        p, s, a = pointer(params, bits), pointer(state, bits), pointer(conditions, bits)
        reach.energy(p, s, pointer(out, bits), a, cells, m)

    return entry(energy, "void(int64, int64, int64, int64, int64)")


class ThreeSteps(NamedTuple):
    """`predict(params, state, work, dt, current, temperature)`, `innovate(params, state, work, voltage)` and
    `update(params, state, work)` of one cell; all return fault bits. `work` has `layout.VALUES` numbers.
    """

    predict: Callable[[int, int, int, float, float, float], int]
    innovate: Callable[[int, int, int, float], int]
    update: Callable[[int, int, int], int]


@functools.cache
def three_steps(form: Form, bits: int) -> ThreeSteps:
    n_rc, hysteresis, bias, core, lanes, compensated, part_lanes = form.variant
    copied = form.cache

    def predict(params: int, state: int, work: int, dt: float, current: float, temperature: float) -> int:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        p, s, y = pointer(params, bits), pointer(state, bits), pointer(work, bits)
        return policy.predict(p, s, vector(s, copied), y, m, real(s, dt), real(s, current), real(s, temperature))

    def innovate(params: int, state: int, work: int, voltage: float) -> int:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        p, s, y = pointer(params, bits), pointer(state, bits), pointer(work, bits)
        return policy.innovate(p, s, vector(s, copied), y, m, real(s, voltage))

    def update(params: int, state: int, work: int) -> int:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        p, s, y = pointer(params, bits), pointer(state, bits), pointer(work, bits)
        return policy.update(p, s, vector(s, copied), y, m)

    return ThreeSteps(
        entry(predict, "int64(int64, int64, int64, float64, float64, float64)"),
        entry(innovate, "int64(int64, int64, int64, float64)"),
        entry(update, "int64(int64, int64, int64)"),
    )


@functools.cache
def ocv() -> Callable[[int, float, float], float]:
    """ocv(params, soc, temperature) -> open-circuit voltage, V; float64."""

    def ocv(params: int, soc: float, temperature: float) -> Any:
        return ecm.ocv(pointer(params, 64), soc, temperature)

    return entry(ocv, "float64(int64, float64, float64)")


@functools.cache
def dynamics() -> Callable[[int, float, float, int, int], float]:
    """dynamics(params, soc, temperature, channel, channels) -> a `layout.D_*` channel, ohm, s, A or V; float64."""

    def dynamics(params: int, soc: float, temperature: float, channel: int, channels: int) -> Any:
        return ecm.dynamics(pointer(params, 64), soc, temperature, channel, channels)

    return entry(dynamics, "float64(int64, float64, float64, int64, int64)")
