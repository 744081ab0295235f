"""What a set of published frames says that no single step does: of the whole scan, of the way the SoC came, slewed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bms_ukf.records import NAN, Detail, Estimate, Fault, PerCell, Sample, Source, Status, mean_known

Array = NDArray[np.float64]

REST_NS = 600_000_000_000  # so long without a load, and a voltage is that of a rested cell
REST_C = 0.02  # what is no load, as a share of the capacity per hour
HELD_S = 5.0  # the current is taken to have flowed for no longer than this

# Wrong with one sample, and no longer with the next: a scan is many samples, and what it publishes tells of them all.
PASSING = int(
    Fault.CURRENT_MISSING
    | Fault.CURRENT_IMPLAUSIBLE
    | Fault.VOLTAGE_IMPLAUSIBLE
    | Fault.TEMPERATURE_IMPLAUSIBLE
    | Fault.INNOVATION_REJECTED
    | Fault.TIME_REVERSED
    | Fault.NUMERIC
)
_CURRENT_MISSING = int(Fault.CURRENT_MISSING)
_AVAILABLE = (Status.OK, Status.DEGRADED)
_COMPARED = ("voltage_pred_V", "innovation_V", "nis")


class Publication:
    """Follows every step, and completes the estimate that is published with what the steps before it said."""

    def __init__(self, capacity_Ah: float, slew_per_s: float = 0.001) -> None:
        """`slew_per_s` is how fast `soc_slewed` may be corrected, beyond the charge that has flowed."""
        self.detail = Detail()
        self.slew_per_s = slew_per_s
        self._capacity_As, self._load_A = capacity_Ah * 3600.0, REST_C * capacity_Ah
        self._held: tuple[PerCell, ...] | None = None  # of _COMPARED
        self._passed = 0
        self._load_ns: int | None = None  # when there last was one, or might have been
        self._current_ns: int | None = None
        self._published_ns: int | None = None
        self._moved = 0.0  # SoC, by the charge since the last set
        self._currents, self._sum_A = 0, 0.0  # since then
        self._strings: _Strings | None = None  # in place of these, if there are several

    def follow(self, sample: Sample, estimate: Estimate, heard: NDArray[np.intp] | None = None) -> None:
        """Take note of a step. Of a pack, `heard` are the cells that the sample has voltages of."""
        faults = int(estimate.faults)  # the operators of an enumeration take as long as the filter's step
        self._passed |= faults & PASSING
        current_A, t_ns = abs(sample.current_A), sample.t_ns
        if current_A < math.inf:
            last_ns, self._current_ns = self._current_ns, t_ns
            self._currents += 1
            self._sum_A += sample.current_A
            if last_ns is not None:
                self._moved += current_A * min((t_ns - last_ns) * 1e-9, HELD_S) / self._capacity_As
            if current_A > self._load_A:
                self._load_ns = t_ns
        elif sample.string_current_A is not None:
            self._follow_strings(sample.string_current_A, t_ns)
        if faults & _CURRENT_MISSING or self._load_ns is None:
            self._load_ns = t_ns
        self._hold(estimate, heard)
        if _fused(estimate.age_s, heard) and estimate.status in _AVAILABLE:
            first = self.detail.source is Source.NONE
            rested = t_ns - self._load_ns >= REST_NS
            self.detail.source = Source.START if first else Source.REST if rested else Source.VOLTAGE

    def complete(self, estimate: Estimate, t_ns: int, shown: int = 0) -> Detail:
        """Write what the steps since the last set said into `estimate`, with the fault bits `shown`; gives the rest."""
        for name, values in zip(_COMPARED, self._held or (), strict=False):
            if isinstance(values, float):
                setattr(estimate, name, values)
            else:
                np.copyto(getattr(estimate, name), values, where=~np.isnan(values))
        self._held = None
        shown |= self._passed
        self._passed = 0
        if shown:
            estimate.faults |= Fault(shown)
            if estimate.status is Status.OK:
                estimate.status = Status.DEGRADED
        self._slew(estimate, t_ns)
        return self.detail

    def whole(self, estimate: Estimate, t_ns: int) -> Sample:
        """The set that was completed last as one sample: the mean current and, of each cell, the voltage compared.

        Of several strings it has their mean currents, and as `current_A` the sum.
        """
        voltage_V = estimate.voltage_pred_V + estimate.innovation_V
        if self._strings is not None:
            strings_A = self._strings.means()
            return Sample(t_ns, float(strings_A.sum()), voltage_V, string_current_A=strings_A)
        current_A = self._sum_A / self._currents if self._currents else NAN
        self._currents, self._sum_A = 0, 0.0
        return Sample(t_ns, current_A, voltage_V)

    def _follow_strings(self, current_A: Array, t_ns: int) -> None:
        if self._strings is None:
            self._strings = _Strings(len(current_A))
        known = np.isfinite(current_A)
        if known.any():
            self._moved += self._strings.add(current_A, known, t_ns) / self._capacity_As
            if float(np.abs(current_A[known]).max()) > self._load_A:
                self._load_ns = t_ns

    def _hold(self, estimate: Estimate, heard: NDArray[np.intp] | None) -> None:
        innovation_V = estimate.innovation_V
        if isinstance(innovation_V, float):
            if not math.isnan(innovation_V):
                self._held = estimate.voltage_pred_V, innovation_V, estimate.nis
        elif heard is not None and heard.size:
            compared = heard[~np.isnan(innovation_V[heard])]
            if self._held is None:
                self._held = tuple(np.full(len(innovation_V), NAN) for _ in _COMPARED)
            for kept, name in zip(self._held, _COMPARED, strict=True):
                kept[compared] = getattr(estimate, name)[compared]  # type: ignore[index]

    def _slew(self, estimate: Estimate, t_ns: int) -> None:
        available = estimate.status in _AVAILABLE
        soc = NAN
        if available:
            soc = mean_known(estimate.soc)
        shown = self.detail.soc_slewed
        if not math.isnan(shown) and self._published_ns is not None:
            step = self._moved + self.slew_per_s * max(t_ns - self._published_ns, 0) * 1e-9
            soc = min(max(soc, shown - step), shown + step) if available else NAN
        self.detail.soc_slewed = soc
        self._published_ns, self._moved = t_ns, 0.0


class _Strings:
    """The currents of several strings since a set; a sample may have those of some."""

    def __init__(self, strings: int) -> None:
        self._count, self._sum_A = np.zeros(strings), np.zeros(strings)
        self._last_ns = np.full(strings, -1, dtype=np.int64)

    def add(self, current_A: Array, known: NDArray[np.bool_], t_ns: int) -> float:
        """Take those that are known; returns by how much charge, As >= 0, the mean string may have moved."""
        self._count += known
        self._sum_A[known] += current_A[known]
        before = known & (self._last_ns >= 0)
        spans_s = np.minimum((t_ns - self._last_ns[before]) * 1e-9, HELD_S)
        self._last_ns[known] = t_ns
        return float(np.abs(current_A[before]) @ spans_s) / len(current_A)

    def means(self) -> Array:
        """(strings,) mean of each since the last call, NaN for one that was not heard."""
        mean_A = np.full(len(self._count), NAN)
        np.divide(self._sum_A, self._count, out=mean_A, where=self._count > 0)
        self._count[:] = self._sum_A[:] = 0.0
        return mean_A


def _fused(age_s: PerCell, heard: NDArray[np.intp] | None) -> bool:
    """Whether a voltage was used with this very step."""
    if isinstance(age_s, float):
        return age_s == 0.0
    return heard is not None and 0.0 in age_s[heard].tolist()
