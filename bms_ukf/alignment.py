"""Samples in the order in which they were measured, where signals of one role arrive later than those of another."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from itertools import count

import numpy as np

from bms_ukf.records import PerCell, Sample


class Alignment:
    """Holds back what arrives early until what arrives late is there, and stamps both with the time of measurement.

    Without a difference between the lags samples pass as they are.
    """

    def __init__(self, current_s: float = 0.0, voltage_s: float = 0.0, temperature_s: float = 0.0) -> None:
        """How long after its instant a signal of each role is received."""
        lags = [round(1e9 * lag) for lag in (current_s, voltage_s, temperature_s)]
        common = min(lags)  # what is late by the same time is in order
        self._current_ns, self._voltage_ns, self._temperature_ns = (lag - common for lag in lags)
        self.behind_ns = max(lags) - common  # by which the samples that come out are older than those that go in
        self._waiting: list[tuple[int, int, Sample]] = []
        self._number = count()

    def put(self, sample: Sample) -> Sequence[Sample]:
        """Take a sample received at its `t_ns`; returns those that are due, oldest first."""
        if self.behind_ns == 0:
            return (sample,)
        for lag_ns, part, values in (
            (self._current_ns, _current_of(sample), sample.currents_A),
            (
                self._temperature_ns,
                Sample(0, temperature_degC=copied(sample.temperature_degC), open_circuit=sample.open_circuit),
                sample.temperature_degC,
            ),
            (
                self._voltage_ns,
                Sample(0, voltage_V=copied(sample.voltage_V), open_circuit=sample.open_circuit),
                sample.voltage_V,
            ),
        ):
            if not np.all(np.isnan(values)):
                part.t_ns = sample.t_ns - lag_ns
                heapq.heappush(self._waiting, (part.t_ns, next(self._number), part))
        return self.due(sample.t_ns)

    def due(self, t_ns: int) -> list[Sample]:
        """What is to be handled at the present `t_ns`, oldest first."""
        ready = []
        while self._waiting and self._waiting[0][0] <= t_ns - self.behind_ns:
            ready.append(heapq.heappop(self._waiting)[2])
        return ready


def _current_of(sample: Sample) -> Sample:
    strings_A = sample.string_current_A
    own = None if strings_A is None else strings_A.copy()
    return Sample(0, sample.current_A, open_circuit=sample.open_circuit, string_current_A=own)


def copied(values: PerCell) -> PerCell:
    """Not the decoder's own array, which its next frame overwrites."""
    return values if isinstance(values, float) else values.copy()
