"""The cells' records, seen from outside the kernel: what is read and set of them between two ticks.

`state` is the kernel's buffer as an array (blocks, slots of a record, lanes); see `kernel.layout`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bms_ukf.kernel import layout
from bms_ukf.kernel.layout import Form
from bms_ukf.kernel.process import TINY_ROOT

Array = NDArray[Any]


def per_cell(state: Array, slot: int, cells: int) -> NDArray[np.float64]:
    """A slot of every cell's record, a copy of shape (cells,)."""
    return np.asarray(state[:, slot].reshape(-1)[:cells], dtype=float)


def set_per_cell(state: Array, slot: int, cells: int, values: ArrayLike) -> None:
    """Write a slot of every cell's record: one number, or one for each cell."""
    lanes = np.array(state[:, slot])
    lanes.reshape(-1)[:cells] = values
    state[:, slot] = lanes


def alive(form: Form, state: Array, cells: int) -> NDArray[np.bool_]:
    """Which cells have a belief, shape (cells,)."""
    return np.isfinite(per_cell(state, layout.H_VOLTAGE_AGE, cells) + per_cell(state, form.root, cells))


def r0_scale(form: Form, state: Array, cells: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """r0 of every cell as a multiple of the cell file's, and its variance; (cells,) each."""
    first = form.root + form.r0 * (form.r0 + 1) // 2
    rows = [per_cell(state, slot, cells) for slot in range(first, first + form.r0 + 1)]
    return 1.0 + per_cell(state, form.x + form.r0, cells), np.sum(np.square(rows), axis=0)


def with_parts(state: Array, cells: int) -> NDArray[np.bool_]:
    """Which cells have a belief that their components hold, shape (cells,)."""
    return per_cell(state, layout.H_PARTS, cells) > 0


def set_bias_aside(form: Form, state: Array) -> Array:
    """Make every bias 0 and known; returns its mean and variance, shape (2, blocks, lanes), empty without a bias."""
    if not form.bias:
        return np.empty(0)
    last, row = form.root - 1, slice(form.carry - form.n, form.carry)
    aside = np.stack([state[:, last], np.sum(state[:, row] ** 2, axis=1)])
    state[:, last] = state[:, row] = 0.0
    state[:, form.carry - 1] = TINY_ROOT
    return aside


def take_bias_back(form: Form, state: Array, aside: Array, kept: float, unknown_A: float) -> None:
    """The share `kept` of the bias is what it was; the rest is as unknown as at the start, and independent.

    Of one string's cells, what each knows is then taken for what all of them know.
    """
    if not form.bias:
        return
    state[:, form.carry - form.n : form.carry] = 0.0
    mean, variance = kept * aside[0], kept**2 * aside[1] + (1 - kept**2) * unknown_A**2
    state[:, form.root - 1] = state[:, layout.H_SHARED] = mean
    state[:, layout.H_SHARED_VAR] = variance
    state[:, form.carry - 1] = np.sqrt(variance)


def start_silent(form: Form, state: Array, cells: int, spread: float, waited_s: float) -> NDArray[np.intp]:
    """Give each cell without a belief that of its median neighbour, SoC in doubt by `spread` more; returns which.

    The same current has flowed through both, so the voltages that it left are alike; what sets cells of a string apart
    is SoC. The neighbour's own errors are these cells' too, but not known to be: their states are taken as independent.
    `spread` is one sigma of SoC between cells, `waited_s` how long they have been waited for. While no cell has a
    belief, none is started.
    """
    known = np.flatnonzero(alive(form, state, cells))
    silent = np.setdiff1d(np.arange(cells), known)
    if not (len(known) and len(silent)):
        return silent[:0]
    soc = per_cell(state, form.x, cells)
    like = known[np.argsort(soc[known])[len(known) // 2]]
    record = np.array(state[like // form.lanes, :, like % form.lanes])
    spread = float(np.hypot(spread, np.std(soc[known])))
    for row in range(form.n):
        first = form.root + row * (row + 1) // 2
        last = first + row
        sigma = np.sqrt(np.sum(record[first : last + 1] ** 2))
        record[first:last] = 0.0
        record[last] = np.hypot(sigma, spread) if row == layout.SOC else sigma
    record[layout.H_VOLTAGE_AGE] = waited_s
    record[layout.H_HEARD_AGE] = record[layout.H_REJECTED_S] = np.nan
    record[layout.H_FRESH] = 1
    record[layout.H_PARTS] = 0
    record[form.cache :] = np.nan
    for cell in silent:
        block, lane = divmod(int(cell), form.lanes)
        kept = [float(state[block, slot, lane]) for slot in (layout.H_PER_CAPACITY, layout.H_RESISTANCE)]
        state[block, :, lane] = record
        state[block, layout.H_PER_CAPACITY, lane], state[block, layout.H_RESISTANCE, lane] = kept
    return silent
