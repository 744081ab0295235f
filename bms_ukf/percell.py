"""What each cell of an estimator has of its own: capacity, resistance, balancing, status."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bms_ukf import beliefs
from bms_ukf.kernel import layout
from bms_ukf.kernel.layout import Form
from bms_ukf.kernel.params import Precision
from bms_ukf.kernel.step import FAULT_MASK, STATUS_SHIFT
from bms_ukf.records import Status
from bms_ukf.tuning import Tuning
from bms_ukf.wiring import Wiring

Array = NDArray[np.float64]

SHARE_NS = 60_000_000_000  # how often cells put together what they know of their sensor's offset, which is slow


class Kept(NamedTuple):
    """What an estimator knew; made by `PerCell.keep`."""

    state: NDArray[Any]
    io: NDArray[Any]
    parts: NDArray[Any]  # of the cells whose belief is that of components, by their order
    t_ns: int | None
    code: int
    heard_ns: int | None


class PerCell:
    """Arrays of shape (cells,), by the order of the cells; all that is read is a copy."""

    __slots__ = (
        "_addresses",
        "_exchange",
        "_form",
        "_heard_ns",
        "_io",
        "_parts",
        "_share_ns",
        "_state",
        "_strings",
        "adjusted",
        "cells",
        "precision",
        "tuning",
        "wiring",
    )

    cells: int
    t_ns: int | None  # of the last sample
    adjusted: int  # how often capacities or resistances were set
    precision: Precision
    tuning: Tuning
    wiring: Wiring
    _code: int  # what the kernel said last
    _form: Form
    _io: NDArray[Any]
    _parts: NDArray[Any]  # components of each cell's belief
    _state: NDArray[Any]
    _strings: NDArray[Any]  # string of each cell, as the kernel's numbers
    _addresses: tuple[int, int, int, int]  # of params, state and io; cells
    _heard_ns: int | None  # when the first cell was, while others are waited for
    _share_ns: int  # how often, in the time of the samples, cells agree on the offset of their sensor
    _exchange: Any  # what they do it by

    def keep(self) -> Kept:
        """What is known, as a copy for `go_back`: sooner made than a `snapshot`, and good for this estimator only."""
        parts = self._parts[beliefs.with_parts(self._state, self.cells)]
        return Kept(self._state.copy(), self._io.copy(), parts, self.t_ns, self._code, self._heard_ns)

    def go_back(self, kept: Kept) -> None:
        """Know what was known then; `accepted` goes on, as receivers take it for a sign of life."""
        self._state[:], self._io[:] = kept.state, kept.io
        self._parts[beliefs.with_parts(kept.state, self.cells)] = kept.parts
        self.t_ns, self._code, self._heard_ns = kept.t_ns, kept.code, kept.heard_ns  # type: ignore[misc]

    @property
    def capacity_scale(self) -> Array:
        """(cells,) capacity of each cell as a multiple of the cell file's, above 0; a copy. Part of a snapshot."""
        return 1 / np.nan_to_num(beliefs.per_cell(self._state, layout.H_PER_CAPACITY, self.cells), nan=1.0)

    @capacity_scale.setter
    def capacity_scale(self, scale: ArrayLike) -> None:
        beliefs.set_per_cell(self._state, layout.H_PER_CAPACITY, self.cells, 1 / _positive(scale))
        self.adjusted += 1

    @property
    def resistance_scale(self) -> Array:
        """(cells,) resistances of each cell as a multiple of the cell file's, above 0; a copy. Part of a snapshot.

        It holds for r0 and the RC pairs. What the filter tracks of r0 comes on top, and is in `Estimate.r0_ohm`.
        """
        return np.nan_to_num(beliefs.per_cell(self._state, layout.H_RESISTANCE, self.cells), nan=1.0)

    @resistance_scale.setter
    def resistance_scale(self, scale: ArrayLike) -> None:
        beliefs.set_per_cell(self._state, layout.H_RESISTANCE, self.cells, _positive(scale))
        self._state[:, self._form.cache] = np.nan  # the cached table row has the old one in it
        self.adjusted += 1

    @property
    def bleed_A(self) -> Array:
        """(cells,) what balancing takes from each cell beside its string's current, A, positive = discharge; a copy.

        It counts from the next sample on, until it is set again. NaN, as at the start: unknown, and taken as 0.
        """
        return np.array(self._io[layout.IN_BLEED], dtype=float)

    @bleed_A.setter
    def bleed_A(self, current: ArrayLike) -> None:
        self._io[layout.IN_BLEED] = current

    @property
    def cell_status(self) -> NDArray[np.intp]:
        """(cells,) `Status` of each cell after the last step, as numbers."""
        status: NDArray[np.intp] = self._cell_codes() >> STATUS_SHIFT
        return status

    @property
    def cell_faults(self) -> NDArray[np.intp]:
        """(cells,) `Fault` bits of each cell after the last step, as numbers."""
        faults: NDArray[np.intp] = self._cell_codes() & FAULT_MASK
        return faults

    def _cell_codes(self) -> NDArray[np.intp]:
        codes: Array = np.nan_to_num(self._io[layout.OUT_CODE], nan=0.0)
        return codes.astype(np.intp)

    def _tend(self, t_ns: int, code: int) -> None:
        """After a tick that gave `code`: what concerns cells together, now and then."""
        if code >> STATUS_SHIFT == Status.INITIALISING:
            self._start_silent(t_ns)
        last_ns = t_ns if self.t_ns is None else self.t_ns
        if self._form.bias and t_ns // self._share_ns != last_ns // self._share_ns:
            self._share_bias()

    def _start_silent(self, t_ns: int) -> None:
        """Where some cells have been heard and others, for a voltage's timeout since, were not: predict these, too."""
        if self._heard_ns is None and beliefs.alive(self._form, self._state, self.cells).any():
            self._heard_ns = t_ns
        waited_s = 0.0 if self._heard_ns is None else (t_ns - self._heard_ns) * 1e-9
        if waited_s >= self.tuning.voltage_timeout_s:
            beliefs.start_silent(self._form, self._state, self.cells, self.tuning.cell_spread_sigma, waited_s)

    def _share_bias(self) -> None:
        """Let the cells of each string agree on the offset of their one current sensor."""
        params, state, *_ = self._addresses
        for string in range(self.wiring.strings):
            self._exchange(params, state, self._strings.ctypes.data, string, self.cells)


def _positive(scale: ArrayLike) -> Array:
    scales = np.asarray(scale, dtype=float)
    if not (np.isfinite(scales).all() and (scales > 0).all()):
        raise ValueError("a scale that is not finite and above 0")
    return scales
