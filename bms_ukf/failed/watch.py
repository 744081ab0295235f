"""Watches the current sensors: a failed one is missing, and what it said since it failed is taken back."""

from __future__ import annotations

import math

import numpy as np

from bms_ukf.estimator import Estimator
from bms_ukf.failed.contradiction import Contradiction
from bms_ukf.failed.rewind import Rewind
from bms_ukf.failed.sensor import CurrentSensor
from bms_ukf.records import Estimate, Fault, Sample
from bms_ukf.strings import Cells, seen_by, with_values

REFUSED_SHARE = 0.7  # of `reject_s`: voltages refused for so long, and a sensor in doubt, name it
_REJECTED = int(Fault.INNOVATION_REJECTED)


class Watch:
    """Looks at every sample before the estimator does. `fault`: what is wrong with any of the sensors.

    `shown` has beside it what is only suspected: its sensor is used, and the status is degraded. UNCERTAIN is shown
    where the intervals of SoC contradict each other (`contradiction`).
    """

    def __init__(self, estimator: Estimator) -> None:
        self.fault = self.shown = Fault.NONE
        self._estimator, self._rewind = estimator, Rewind()
        cell, tuning = estimator.cell, estimator.tuning
        low_V, high_V = cell.cell.voltage_limits_V
        current_max_A = tuning.current_margin * max(abs(limit) for limit in cell.cell.current_limits_A)
        plausible = current_max_A, (low_V - tuning.voltage_margin_V, high_V + tuning.voltage_margin_V)
        strings = estimator.wiring.members()
        self._one = None if strings else CurrentSensor(cell, estimator.cells, *plausible)
        self._strings: list[tuple[int, Cells, CurrentSensor]] = [
            (k, cells, CurrentSensor(cell, len(cells), *plausible, string=k + 1)) for k, cells in strings.items()
        ]
        self._contradictions = {k: Contradiction(estimator, cells) for k, cells in strings.items()}
        self._contradiction = None if strings else Contradiction(estimator)
        self._refused_ns: int | None = None  # since when voltages have been refused
        self._patience_ns = round(REFUSED_SHARE * 1e9 * tuning.reject_s)

    def take(self, sample: Sample, estimate: Estimate) -> None:
        """Turn into NaN what failed sensors say; `estimate` is the latest, and `sample` what comes after it."""
        self._rewind.keep(self._estimator, sample.t_ns)
        soc = estimate.soc
        if self._one is not None and self._contradiction is not None:
            if self._one.see(sample, soc) or self._accuses(self._one, sample.t_ns, estimate):
                self._judge(self._one, sample.t_ns)
                self.fault = self._one.fault
            self.shown = self.fault if self.fault is not _NONE else self._one.suspected
            if self.fault is not _NONE:
                sample.current_A = math.nan
            self._contradiction.take(sample.t_ns, sample.current_A, estimate)
            if self._contradiction.stands(sample.t_ns):
                self.shown |= Fault.UNCERTAIN
            self._accuse_of_a_load(self._one, self._contradiction, sample.t_ns)
            return
        changed = [sensor for k, cells, sensor in self._strings if sensor.see(seen_by(k, cells, sample), soc)]
        for sensor in changed:
            self._judge(sensor, sample.t_ns)
        self.fault = self.shown = _NONE
        for *_, sensor in self._strings:
            self.fault |= sensor.fault
            self.shown |= sensor.fault | sensor.suspected
        if self.fault is not _NONE and sample.string_current_A is not None:
            failed = [k for k, _, sensor in self._strings if sensor.fault is not _NONE]
            sample.string_current_A = with_values(sample.string_current_A, failed, math.nan)
        strings_A = sample.string_current_A
        for k, contradiction in self._contradictions.items():
            contradiction.take(sample.t_ns, math.nan if strings_A is None else float(strings_A[k]), estimate)
            if contradiction.stands(sample.t_ns):
                self.shown |= Fault.UNCERTAIN
        for k, _, sensor in self._strings:
            self._accuse_of_a_load(sensor, self._contradictions[k], sample.t_ns)

    def distrust(self, t_ns: int) -> None:
        """Go back as far as can be: the current was never right."""
        self._rewind.back(self._estimator, 0, t_ns)

    def _accuses(self, sensor: CurrentSensor, t_ns: int, estimate: Estimate) -> bool:
        """Name a sensor that is in doubt while voltages are refused, before the filter doubts SoC in its place."""
        if not int(estimate.faults) & _REJECTED:
            innovation_V = estimate.innovation_V
            if not isinstance(innovation_V, float) or innovation_V == innovation_V:  # noqa: PLR0124 - not NaN
                self._refused_ns = None
            return False
        if self._refused_ns is None:
            self._refused_ns = t_ns
        if t_ns - self._refused_ns < self._patience_ns or not sensor.doubted or self._is_of_few_cells():
            return False
        sensor.accuse(self._refused_ns, t_ns)
        self._refused_ns = None
        return True

    def _accuse_of_a_load(self, sensor: CurrentSensor, contradiction: Contradiction, t_ns: int) -> None:
        """Name a sensor that shows a rest while the voltage goes where no rest takes it; from the next sample on."""
        if not contradiction.leans or sensor.fault is not _NONE:
            return
        since_ns = sensor.shows_rest_ns(t_ns)
        if since_ns is not None:
            sensor.accuse(since_ns, t_ns)
            self._judge(sensor, t_ns)
            self.fault |= sensor.fault
            self.shown |= sensor.fault

    def _is_of_few_cells(self) -> bool:
        return bool(np.mean(self._estimator.cell_faults & _REJECTED > 0) <= 0.5)

    def _judge(self, sensor: CurrentSensor, t_ns: int) -> None:
        if sensor.fault is not _NONE:
            self._rewind.back(self._estimator, sensor.since_ns, t_ns)
            contradictions = [self._contradiction] if self._contradiction else self._contradictions.values()
            for contradiction in contradictions:
                contradiction.reset()


_NONE = Fault.NONE  # what an enumeration does, beyond being compared, takes longer
