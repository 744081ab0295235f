"""Loads that need not know the plant: piecewise constant over time, put on a grid without losing charge."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_ukf.loads.segments import Quantity
from bms_ukf.loads.series import Array
from bms_ukf.loads.terminal import Terminal

_CHUNK = 4096  # steps computed at once


@dataclass(slots=True)
class Profile:
    """Cell current on a uniform grid, positive = discharge; each value is the mean over the step ending at its time."""

    t_ns: NDArray[np.int64]  # shape (n,); the first entry is one step after the start of the load
    current_A: Array  # shape (n,)

    @property
    def t_s(self) -> Array:
        return np.asarray(self.t_ns * 1e-9, dtype=np.float64)

    @property
    def charge_Ah(self) -> float:
        """Net charge drawn from one cell over the profile."""
        step_s = self.t_s[0] if self.t_ns.size else 0.0
        return float(self.current_A.sum() * step_s / 3600)


class Piecewise:
    """A quantity that is constant over each interval, all of it `repeat` times; nothing flows afterwards."""

    def __init__(self, quantity: Quantity, duration_s: Array, value: Array, repeat: int = 1) -> None:
        self.quantity, self.duration_s, self.value, self.repeat = quantity, duration_s, value, repeat
        self._time_s = np.concatenate([[0.0], np.cumsum(duration_s)])
        self._integral = np.concatenate([[0.0], np.cumsum(value * duration_s)])

    @property
    def quantities(self) -> set[Quantity]:
        return {self.quantity}

    @property
    def end_s(self) -> float:
        return float(self._time_s[-1] * self.repeat)

    def then(self, other: Piecewise) -> Piecewise:
        """This one followed by another of the same quantity."""
        duration_s, value = zip(self._unrolled(), other._unrolled(), strict=True)
        return Piecewise(self.quantity, np.concatenate(duration_s), np.concatenate(value))

    def repeated(self, times: int) -> Piecewise:
        return Piecewise(self.quantity, self.duration_s, self.value, self.repeat * times)

    def _unrolled(self) -> tuple[Array, Array]:
        return np.tile(self.duration_s, self.repeat), np.tile(self.value, self.repeat)

    def means(self, start: int, stop: int, step_s: float) -> Array:
        """The mean over each of the steps `start` to `stop` - 1; shape (stop - start,)."""
        t_s = np.minimum(np.arange(start, stop + 1) * step_s, self.end_s)
        # The end of a repetition belongs to it, and not to the start of the next, which may be the one after the last.
        rounds = np.minimum(np.floor(t_s / self._time_s[-1]), self.repeat - 1)
        within = np.interp(t_s - rounds * self._time_s[-1], self._time_s, self._integral)
        over_s = np.diff(t_s) if self.quantity == "voltage_V" else step_s  # a voltage lasts to the end of the step
        return np.asarray(np.diff(rounds * self._integral[-1] + within) / over_s)

    def whole_steps(self, step_s: float) -> int:
        """How many steps fit in."""
        # The margin keeps the last step when sums of decimal durations fall short of it by rounding.
        return math.floor(self.end_s / step_s + 1e-6)

    def steps_at_most(self, step_s: float) -> int:
        """How many steps there are, the last one filled up with rest."""
        return math.ceil(self.end_s / step_s - 1e-6)

    def steps(self, step_s: float, terminal: Terminal) -> Iterator[tuple[Quantity, float]]:
        """The mean of each step, with the quantity it is of; the terminal is not looked at."""
        n = self.steps_at_most(step_s)
        for start in range(0, n, _CHUNK):
            for value in self.means(start, min(start + _CHUNK, n), step_s).tolist():
                yield self.quantity, value
