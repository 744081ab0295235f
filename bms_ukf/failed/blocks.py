"""Samples of any rate in, blocks of a second or more out: mean current, voltage, temperature.

Means over a second take out noise and the skew between frames at 100 Hz; slower samples are blocks of their own. A
block ends with an instant; the order of that instant's frames does not matter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf.records import PerCell, Sample

BLOCK_NS = 950_000_000  # a second, less what a sender's clock may be off
TOGETHER_NS = 20_000_000  # apart by less, two frames are of one instant
GAP_NS = 25_000_000_000  # the course within a longer block is unknown; one lost sample at 10 s sampling stays below
PATIENCE = 2.5  # times the last block, for a voltage to come


class Block(NamedTuple):
    t_ns: int  # its end
    dt_s: float  # since the block before it; NaN: this is the first, or follows a gap
    current_A: float
    voltage_V: float  # of several cells the median: a sensor that fails alone does not move it; NaN: none came
    temperature_degC: float


class Blocks:
    """Takes what was measured of one string."""

    def __init__(self, cells: int, current_max_A: float, voltages_V: tuple[float, float]) -> None:
        """What is beyond `current_max_A` or outside `voltages_V` is no reading."""
        self._max_A, (self._low_V, self._high_V) = current_max_A, voltages_V
        self._held_V = np.full(cells, math.nan) if cells > 1 else None
        self._temperature_degC = 25.0
        self._begin_ns: int | None = None
        self._last_ns = 0
        self._usual_ns = BLOCK_NS  # length of the last block
        self._sum_A = self._sum_V = 0.0
        self._currents = self._voltages = 0

    def take(self, sample: Sample) -> Block | None:
        """The block that is over with this sample, if one is."""
        block = None
        if self._begin_ns is None or sample.t_ns < self._last_ns:
            self._begin(sample.t_ns)
        elif self._last_ns - self._begin_ns >= BLOCK_NS:
            block = self._end(sample.t_ns)
        self._last_ns = sample.t_ns
        temperature = sample.temperature_degC
        temperature_degC = temperature if isinstance(temperature, float) else float(temperature[0])
        if temperature_degC == temperature_degC:  # noqa: PLR0124 - not NaN
            self._temperature_degC = temperature_degC
        if abs(sample.current_A) <= self._max_A:  # not NaN either
            self._sum_A += sample.current_A
            self._currents += 1
        if self._hear(sample.voltage_V):
            self._voltages += 1
        return block

    def _begin(self, t_ns: int) -> None:
        self._begin_ns = t_ns
        self._sum_A = self._sum_V = 0.0
        self._currents = self._voltages = 0

    def _end(self, t_ns: int) -> Block | None:
        """The block up to the last sample, if nothing of it is still to come when the next is of `t_ns`."""
        end_ns, long_ns = self._last_ns, self._last_ns - (self._begin_ns or 0)
        another = t_ns - end_ns > TOGETHER_NS or long_ns > BLOCK_NS + 5 * TOGETHER_NS
        late = long_ns > PATIENCE * self._usual_ns
        if not (another and self._currents and (self._voltages or late)):
            return None
        current_A, voltage_V = self._sum_A / self._currents, math.nan
        if self._voltages and not late:
            voltage_V = self._sum_V / self._voltages if self._held_V is None else _median(self._held_V)
        self._usual_ns = min(max(long_ns, BLOCK_NS), GAP_NS)
        self._begin(end_ns)
        return Block(
            end_ns, long_ns * 1e-9 if long_ns <= GAP_NS else math.nan, current_A, voltage_V, self._temperature_degC
        )

    def _hear(self, voltage: PerCell) -> bool:
        if isinstance(voltage, float):
            if self._held_V is not None or not self._low_V <= voltage <= self._high_V:
                return False
            self._sum_V += voltage
            return True
        if self._held_V is None:
            return self._hear(float(voltage[0]))
        np.copyto(self._held_V, voltage, where=(voltage >= self._low_V) & (voltage <= self._high_V))
        return True


def _median(values: NDArray[np.float64]) -> float:
    """Of those that are not NaN, of which there are some: in a fifth of numpy's time."""
    ordered = np.sort(values)  # NaN last
    known = len(ordered) - int(np.count_nonzero(ordered != ordered))  # noqa: PLR0124
    return 0.5 * float(ordered[(known - 1) // 2] + ordered[known // 2])
