"""The true course of one run: a piece of a trace, resampled or prolonged, before any sensor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf.campaign.traces import Trace

Array = NDArray[np.float64]

LOAD_C = 0.02  # a larger current counts as load


class Course(NamedTuple):
    """True signals. A row's current is the mean over the interval that ends at its time."""

    trace: Trace  # where it was cut
    t_s: Array  # (rows,)
    current_A: Array  # (rows,) positive = discharge
    voltage_V: Array  # (rows, cells)
    temperature_degC: Array  # (rows,)
    soc: Array  # (rows, cells)

    @property
    def rows(self) -> int:
        return self.t_s.size

    @property
    def capacity_Ah(self) -> float:
        return float(self.trace.capacity_Ah.mean())

    @property
    def loaded(self) -> NDArray[np.bool_]:
        """(rows,) True where a current flows."""
        return np.asarray(np.abs(self.current_A) > LOAD_C * self.capacity_Ah)


def cut(trace: Trace, first: int, rows: int) -> Course:
    """Return `rows` rows of a trace from row `first` on, or as many as there are. Time restarts at 0."""
    part = slice(first, min(first + rows, trace.rows))
    t_s = trace.step_s * np.arange(1.0, part.stop - part.start + 1)
    return Course(
        trace, t_s, trace.current_A[part], trace.voltage_V[part], trace.temperature_degC[part], trace.soc[part]
    )


def resample(course: Course, step_s: float) -> Course:
    """Return the course at another interval: slower by means of the current, faster by lines between the rows.

    Both keep the charge: a mean exactly, a line but for half of the first and the last step.
    """
    t_s = np.arange(1, round(course.t_s[-1] / step_s) + 1) * step_s
    own_s = course.t_s[0]
    t_s = t_s[(t_s >= own_s - 1e-9) & (t_s <= course.t_s[-1] + 1e-9)]
    if step_s > own_s:
        every = round(step_s / own_s)
        rows = course.rows // every
        last = every * np.arange(1, rows + 1) - 1
        current_A = course.current_A[: rows * every].reshape(rows, every).mean(axis=1)
        parts = course.voltage_V[last], course.temperature_degC[last], course.soc[last]
        return Course(course.trace, course.t_s[last], current_A, *parts)

    def line(values: Array) -> Array:
        return np.asarray(np.interp(t_s, course.t_s, values), dtype=np.float64)

    def lines(values: Array) -> Array:
        return np.stack([line(column) for column in values.T], axis=1)

    parts = lines(course.voltage_V), line(course.temperature_degC), lines(course.soc)
    return Course(course.trace, t_s - t_s[0] + step_s, line(course.current_A), *parts)


def prolong(course: Course, row: int, more_s: float) -> Course:
    """Return the course with a rest at `row`, at equilibrium, longer by `more_s`: the row repeats."""
    step_s = float(course.t_s[0])
    times = np.ones(course.rows, dtype=int)
    times[row] += round(more_s / step_s)
    index = np.repeat(np.arange(course.rows), times)
    parts = (part[index] for part in course[2:])
    return Course(course.trace, step_s * np.arange(1.0, index.size + 1), *parts)


def tile(course: Course, cells: int) -> Course:
    """Return the course as a string of equal cells."""
    return course._replace(
        voltage_V=np.repeat(course.voltage_V, cells, axis=1), soc=np.repeat(course.soc, cells, axis=1)
    )
