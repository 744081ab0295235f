"""The estimator for a caller without Python: four C functions over one buffer that the caller owns.

They are what `estimator.Estimator` is to Python, with the same policy for time and for what is shown, and the same
`step.step` below. The buffer holds `words` of the latest sample, the cells' records one after the other (lanes = 1),
the rows of `io` and the components of each cell's belief; it is plain data, which may be copied, stored and put back.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from numba import types

from bms_ukf.kernel import layout as k
from bms_ukf.kernel import parts
from bms_ukf.kernel import step as policy
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.layout import Form, form_at_compile_time
from bms_ukf.kernel.memory import beyond, real, vector, whole, words
from bms_ukf.kernel.step import DEGRADED, FAULT_MASK, INITIALISING, INVALID, OK, STATUS_SHIFT
from bms_ukf.records import Fault

NUMERIC, TIME_REVERSED = int(Fault.NUMERIC), int(Fault.TIME_REVERSED)

# Words of 32 bits at the start of the buffer.
B_TIME = 0  # of the latest sample, ms
B_SEEN = 1  # 0: there was none
B_CODE = 2  # what `step.together` said of it
HEADER = 4  # numbers, of 32 or 64 bits

PERIOD_MS = 1 << 32  # where a count of ms begins anew
MS_PER_S = 1000


def size(form: Form, cells: int) -> int:
    """Numbers in the caller's buffer."""
    return HEADER + cells * (form.size + k.IO_ROWS + form.parts)


@inline
def forget(s: Any, m: Any, cells: int) -> None:
    """Make the buffer that of an estimator which has seen nothing."""
    for place in range(HEADER, HEADER + cells * (m.size + k.IO_ROWS + m.parts)):
        s[place] = real(s, math.nan)
    held = words(s)
    held[B_TIME] = 0
    held[B_SEEN] = 0
    held[B_CODE] = INITIALISING << STATUS_SHIFT


@inline
def sample(
    p: Any,
    s: Any,
    work: Any,
    time: int,
    current: Any,
    voltage: Any,
    temperature: Any,
    contactor_open: int,
    m: Any,
    cells: int,
) -> int:
    """`Estimator.step`, with the time in ms, of a count that may begin anew after 2^32; returns its code."""
    held = words(s)
    half = PERIOD_MS // 2
    elapsed = ((time - held[B_TIME] + half) & (PERIOD_MS - 1)) - half if held[B_SEEN] else 0
    io = HEADER + cells * m.size
    if elapsed < 0:
        for row in (k.OUT_VOLTAGE_PRED, k.OUT_INNOVATION, k.OUT_INNOVATION_VAR, k.OUT_NIS):
            for cell in range(cells):
                s[io + cells * row + cell] = real(s, math.nan)
        code: int = held[B_CODE]
        status = code >> STATUS_SHIFT
        return code & FAULT_MASK | TIME_REVERSED | (DEGRADED if status == OK else status) << STATUS_SHIFT
    shown = current if contactor_open else real(s, math.nan)
    flows = current
    if contactor_open and not m.bias:
        flows = real(s, 0)
    elif contactor_open and math.isnan(current):
        flows = real(s, 0)
        for cell in range(cells):  # a reading that is missing: what the sensor would show
            flows += s[io + cells * k.OUT_BIAS + cell] / real(s, cells)
    codes = 0
    for cell in range(cells):
        s[io + cells * k.IN_VOLTAGE + cell] = voltage[cell]
        s[io + cells * k.IN_TEMPERATURE + cell] = temperature[cell]
        s[io + cells * k.IN_OFFSET + cell] = shown
        dt = real(s, elapsed) / real(s, MS_PER_S)
        at = io + cells * k.IO_ROWS + cell * m.parts
        codes |= policy.step(p, s, HEADER + cell * m.size, at, work, s, io + cell, cells, m, 1, dt, flows)
    code = policy.together(codes)
    if not code & NUMERIC or cells > 1:  # a refused step has not passed: the next one covers its time
        held[B_TIME] = time
        held[B_SEEN] = 1
    held[B_CODE] = code
    return code


@inline
def result(s: Any, cell: int, row: int, m: Any, cells: int) -> Any:
    """A cell's number in an `OUT_*` row, NaN if there is none; SoC, sigma and bounds only if the cell shows a SoC."""
    if row < k.OUT_SOC or row >= k.IO_ROWS or cell < 0 or cell >= cells:
        return real(s, math.nan)
    io = HEADER + cells * m.size + cell
    of_all, own = words(s)[B_CODE] >> STATUS_SHIFT, s[io + cells * k.OUT_CODE]
    own = INITIALISING if math.isnan(own) else whole(own) >> STATUS_SHIFT
    hidden = (of_all == INITIALISING) | (of_all == INVALID) | (own == INITIALISING) | (own == INVALID)
    of_soc = (row == k.OUT_SOC) | (row == k.OUT_SOC_SIGMA) | (row == k.OUT_SOC_LOW) | (row == k.OUT_SOC_HIGH)
    return real(s, math.nan) if hidden & of_soc else s[io + cells * row]


class CFunction(NamedTuple):
    """What C code is to call, before it is compiled: a kernel function and its types, as numba names them."""

    function: Callable[..., Any]
    returns: Any
    arguments: tuple[Any, ...]


def c_functions(form: Form, bits: int) -> dict[str, CFunction]:
    """`init(buffer, cells)`, `step(params, buffer, time, .., cells)` and `get(buffer, row, cell, cells)`."""
    n_rc, hysteresis, bias, core, lanes, compensated, part_lanes = form.variant
    copied, values = form.cache, k.VALUES
    part_copied, part_values, part_sums = parts.room(form)
    second = part_sums // 2
    part_sums = max(part_sums, second + part_copied + part_values)
    number = types.float64 if bits == 64 else types.float32
    pointer: Any = types.CPointer
    numbers = pointer(number)
    word = types.int32

    def init(s: Any, cells: int) -> None:
        forget(s, form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes), cells)

    def step(
        p: Any, s: Any, time: int, current: Any, voltage: Any, temperature: Any, contactor_open: int, cells: int
    ) -> int:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        w, y = vector(s, copied), vector(s, values)
        sums = vector(s, part_sums)
        work = policy.Work(w, y, beyond(sums, second), beyond(sums, second + part_copied), sums)
        return sample(p, s, work, time, current, voltage, temperature, contactor_open, m, cells)

    def get(s: Any, row: int, cell: int, cells: int) -> Any:
        return result(
            s, cell, row, form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes), cells
        )

    return {
        "init": CFunction(init, types.void, (numbers, word)),
        "step": CFunction(step, word, (numbers, numbers, word, number, numbers, numbers, word, word)),
        "get": CFunction(get, number, (numbers, word, word, word)),
    }
