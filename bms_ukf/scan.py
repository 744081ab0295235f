"""The voltages of a pack, put together from the frames that bring them, and when every cell has been read once more.

A page of three cells is no news of the others: 32 of them within some milliseconds, under one current, are one sample
for the filter, and not 32. So are the frames of parallel strings that bring the current of one string each: what comes
second would else be taken for the current of the time to come.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bms_ukf.records import NAN, PerCell, Sample

TOGETHER_NS = 20_000_000  # apart by less, two pages are of one instant: a tenth of the shortest time constant of a cell


class Scan:
    """Takes samples, has `step` take what they make, and calls `end` when a scan is over, with the time of the last.

    Pages of voltages, and of the currents of some strings, are held until every cell has been read, a string comes
    again, anything else comes, or TOGETHER_NS have passed; currents alone until those of all strings are there. A cell
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
        voltage, strings_A = sample.voltage_V, sample.string_current_A
        some = strings_A is not None and bool(np.isnan(strings_A).any())  # strings, and others of them are to come
        if isinstance(voltage, float):
            if some:
                if not np.isnan(self._hold(sample).currents_A).any():
                    self.flush()
                return
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
        if again or not fresh or not (some or _is_page(sample)):
            self.flush()
            self._step(sample)
        else:
            self._hold(sample)
            np.copyto(self._voltage_V, voltage, where=read)
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

    def _hold(self, page: Sample) -> Sample:
        """Hold all of it but the voltages; returns what is held now."""
        held = self._held
        if held is not None and (
            page.t_ns < held.t_ns or page.open_circuit is not held.open_circuit or _has_one_of(held, page)
        ):
            self.flush()
        self.due(page.t_ns)
        held = self._held
        if held is None:
            self._voltage_V = np.full(self._cells, NAN)
            held = self._held = Sample(page.t_ns, voltage_V=self._voltage_V, open_circuit=page.open_circuit)
            self.held_ns = page.t_ns
        held.t_ns, held.bleed_A = page.t_ns, page.bleed_A
        if page.string_current_A is not None:
            _join(held, page.string_current_A, page.temperature_degC)
        return held


def _join(held: Sample, strings_A: NDArray[np.float64], temperature_degC: PerCell) -> None:
    """Add what a frame of some strings says to `held`."""
    if held.string_current_A is None:
        held.string_current_A = np.full(len(strings_A), NAN)
    np.copyto(held.string_current_A, strings_A, where=~np.isnan(strings_A))
    if not np.isnan(temperature_degC).all():
        held.temperature_degC = temperature_degC if isinstance(temperature_degC, float) else temperature_degC.copy()


def _has_one_of(held: Sample, page: Sample) -> bool:
    """Whether both have the current of a string."""
    if held.string_current_A is None or page.string_current_A is None:
        return False
    return not np.isnan(held.string_current_A + page.string_current_A).all()


def _is_page(sample: Sample) -> bool:
    """Whether nothing but voltages was measured."""
    current_A, temperature_degC = sample.current_A, sample.temperature_degC
    if current_A == current_A or sample.string_current_A is not None:  # noqa: PLR0124
        return False
    return isinstance(temperature_degC, float) and temperature_degC != temperature_degC  # noqa: PLR0124
