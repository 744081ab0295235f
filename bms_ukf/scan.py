"""The voltages of a pack, put together from the frames that bring them, and when every cell has been read once more.

A page of three cells is no news of the others: 32 of them within some milliseconds, under one current, are one sample
for the filter, and not 32. So are the frames of parallel strings that bring the current of one string each: what comes
second would else be taken for the current of the time to come.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

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
        self.held_ns: int | None = None  # when the first page of it was measured

    def take(self, sample: Sample) -> None:
        """Handle a sample, or hold it. It may be overwritten afterwards."""
        voltage = sample.voltage_V
        if self._cells == 1:
            self._step(sample)
            if voltage == voltage:  # noqa: PLR0124 - not NaN, in a tenth of the time
                self._end(sample.t_ns)
            return
        fresh = [] if isinstance(voltage, float) else (voltage == voltage).nonzero()[0].tolist()  # noqa: PLR0124
        again = not self._seen.isdisjoint(fresh)
        if again:
            self._seen.clear()
        if not again and (_is_of_some_strings(sample) or (fresh and _is_page(sample))):
            self._hold(sample)
        else:
            self.flush()
            self._step(sample)
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

    def _hold(self, part: Sample) -> None:
        """Put a part of an instant to what is held of it."""
        held = self._held
        if held is not None and (
            part.t_ns < held.t_ns or part.open_circuit is not held.open_circuit or _has_one_of(held, part)
        ):
            self.flush()
        self.due(part.t_ns)
        if self._held is None:
            self._held = Sample(part.t_ns, voltage_V=np.full(self._cells, NAN), open_circuit=part.open_circuit)
            self.held_ns = part.t_ns
        held = self._held
        held.t_ns, held.bleed_A = part.t_ns, part.bleed_A
        held.voltage_V = _joined(held.voltage_V, part.voltage_V)
        if part.string_current_A is None:
            return
        held.temperature_degC = _joined(held.temperature_degC, part.temperature_degC)
        if held.string_current_A is None:
            held.string_current_A = part.string_current_A.copy()
        else:
            _joined(held.string_current_A, part.string_current_A)
        if isinstance(part.voltage_V, float) and not np.isnan(held.string_current_A).any():
            self.flush()


def _joined(held: PerCell, part: PerCell) -> PerCell:
    """What is known of either, in the array of `held` if both are arrays; never that of `part`, which is not ours."""
    if isinstance(part, float):
        return held if np.isnan(part) else part
    if isinstance(held, float):
        return part.copy()
    np.copyto(held, part, where=part == part)  # noqa: PLR0124
    return held


def _has_one_of(held: Sample, part: Sample) -> bool:
    """Whether both have the current of a string."""
    if held.string_current_A is None or part.string_current_A is None:
        return False
    return not np.isnan(held.string_current_A + part.string_current_A).all()


def _is_of_some_strings(sample: Sample) -> bool:
    """Whether it has the current of a string, and those of others are still to come."""
    strings_A = sample.string_current_A
    return strings_A is not None and bool(np.isnan(strings_A).any())


def _is_page(sample: Sample) -> bool:
    """Whether nothing but voltages was measured."""
    current_A, temperature_degC = sample.current_A, sample.temperature_degC
    if current_A == current_A or sample.string_current_A is not None:  # noqa: PLR0124
        return False
    return isinstance(temperature_degC, float) and temperature_degC != temperature_degC  # noqa: PLR0124
