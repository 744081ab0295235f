"""The voltages of a pack, put together from the frames that bring them, and when every cell has been read once more.

A page of three cells is no news of the others: 32 of them within some milliseconds, under one current, are one sample
for the filter, and not 32.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bms_ukf.records import NAN, Sample

TOGETHER_NS = 20_000_000  # apart by less, two pages are of one instant: a tenth of the shortest time constant of a cell


class Scan:
    """Takes samples, has `step` take what they make, and calls `end` when a scan is over, with the time of the last.

    Pages of voltages are held until every cell has been read, anything else comes, or TOGETHER_NS have passed. A cell
    that is silent, or without a valid value, does not hold the others up: where a cell comes again before that one
    did, the scan is over, too.
    """

    def __init__(self, cells: int, step: Callable[[Sample], None], end: Callable[[int], None]) -> None:
        self._cells, self._step, self._end = cells, step, end
        self._seen = set[int]()
        self._held: Sample | None = None
        self._voltage_V: NDArray[np.float64] = np.empty(0)  # of the held one
        self.held_ns: int | None = None  # when the first page of it was measured

    def take(self, sample: Sample) -> None:
        """Handle a sample, or hold it. It may be overwritten afterwards."""
        voltage = sample.voltage_V
        if isinstance(voltage, float):
            self.flush()
            self._step(sample)
            if self._cells == 1 and voltage == voltage:  # noqa: PLR0124 - not NaN, in a tenth of the time
                self._end(sample.t_ns)
            return
        read = voltage == voltage  # noqa: PLR0124
        fresh = read.nonzero()[0].tolist()
        again = not self._seen.isdisjoint(fresh)
        if again:
            self._seen.clear()
        if again or not fresh or not _is_page(sample):
            self.flush()
            self._step(sample)
        else:
            self._hold(sample, voltage, read)
        self._seen.update(fresh)
        whole = len(self._seen) == self._cells
        if whole:
            self._seen.clear()
        if again or whole:
            self.flush()
            self._end(sample.t_ns)

    def due(self, t_ns: int) -> None:
        """Handle what has been held for long enough at `t_ns`."""
        if self.held_ns is not None and t_ns - self.held_ns >= TOGETHER_NS:
            self.flush()

    def flush(self) -> None:
        """Handle what is held, if anything is."""
        held, self._held, self.held_ns = self._held, None, None
        if held is not None:
            self._step(held)

    def _hold(self, page: Sample, voltage_V: NDArray[np.float64], read: NDArray[np.bool_]) -> None:
        held = self._held
        if held is not None and (page.t_ns < held.t_ns or page.open_circuit is not held.open_circuit):
            self.flush()
        self.due(page.t_ns)
        held = self._held
        if held is None:
            self._voltage_V = np.full(self._cells, NAN)
            held = self._held = Sample(page.t_ns, voltage_V=self._voltage_V, open_circuit=page.open_circuit)
            self.held_ns = page.t_ns
        held.t_ns, held.bleed_A = page.t_ns, page.bleed_A
        np.copyto(self._voltage_V, voltage_V, where=read)


def _is_page(sample: Sample) -> bool:
    """Whether nothing but voltages was measured."""
    current_A, temperature_degC = sample.current_A, sample.temperature_degC
    if current_A == current_A or sample.string_current_A is not None:  # noqa: PLR0124
        return False
    return isinstance(temperature_degC, float) and temperature_degC != temperature_degC  # noqa: PLR0124
