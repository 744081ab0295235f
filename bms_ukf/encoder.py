"""The way out: estimates to frames of the project's own DBC.

Signs, units and scales are converted here and nowhere else: inside, current is positive on discharge, SoC from 0 to 1,
and what is not available is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bms_ukf.dbc import Field, own_matrix
from bms_ukf.fault_bits import FaultBits
from bms_ukf.frames import Frame, Outbox
from bms_ukf.records import NAN, Detail, Estimate, PerCell, Status, largest_known, mean_known, smallest_known

HEALTH = ("FramesDropped", "FramesRefused", "FramesNotSent", "ClockSteps", "Reopened", "Contradictions")


class Encoder:
    """Turns estimates into frames.

    `accepted` is how many samples the estimator has accepted so far: the alive counter of a message stands still while
    that number does, so an estimator that has stopped cannot look alive. Values beyond the DBC's limits are sent as the
    limit; SoC and sigma are sent as not available unless the status is `OK` or `DEGRADED`. Of a pack, cells that
    are not known (NaN) are left out. Nothing here raises.
    """

    def __init__(self) -> None:
        matrix = own_matrix()

        def field_of(name: str) -> Field:
            return Field(*matrix.find(name))

        self._soc_box = Outbox(matrix.message("SocEstimate"))
        self._status_shift = field_of("SocEstimate.Status").shift
        self._soc = field_of("SocEstimate.Soc").insert(0.01)
        self._sigma = field_of("SocEstimate.SocSigma").insert(0.01)
        self._age = field_of("SocEstimate.InformationAge").insert()

        self._quality_box = Outbox(matrix.message("SocQuality"))
        self._worst_cell_shift = field_of("SocQuality.WorstCell").shift
        self._voltage_pred = field_of("SocQuality.PredictedVoltage").insert()
        self._innovation = field_of("SocQuality.Innovation").insert()
        self._nis = field_of("SocQuality.Nis").insert()

        self._state_box = Outbox(matrix.message("BmsState"))
        self._faults = FaultBits()
        self._stored_shift = field_of("BmsState.StoredState").shift
        self._soc_min = field_of("BmsState.SocMin").insert(0.01)
        self._soc_max = field_of("BmsState.SocMax").insert(0.01)

        self._interval_box = Outbox(matrix.message("SocInterval"))
        self._low = field_of("SocInterval.SocLow").insert(0.01)
        self._high = field_of("SocInterval.SocHigh").insert(0.01)

        self._detail_box = Outbox(matrix.message("SocDetail"))
        self._source_shift = field_of("SocDetail.Source").shift
        self._slewed = field_of("SocDetail.SocSlewed").insert(0.01)
        self._min_cell = field_of("SocDetail.MinCell").insert()
        self._max_cell = field_of("SocDetail.MaxCell").insert()
        self._bias = field_of("SocDetail.CurrentBias").insert()

        self._health_box = Outbox(matrix.message("BusHealth"))
        self._counts = [field_of(f"BusHealth.{name}") for name in HEALTH]

    def encode(self, estimate: Estimate, detail: Detail, accepted: int) -> list[Frame]:
        """A set: SocDetail, SocInterval, BmsState, SocQuality and SocEstimate."""
        return [
            self.detail(estimate, detail, accepted),
            self.interval(estimate, accepted),
            self.state(estimate, detail, accepted),
            self.quality(estimate, accepted),
            self.soc(estimate, accepted),
        ]

    def soc(self, estimate: Estimate, accepted: int) -> Frame:
        """SocEstimate: the mean SoC, the largest sigma and the largest age of the cells, and the status."""
        soc, sigma, age = estimate.soc, estimate.soc_sigma, estimate.age_s
        if not (isinstance(soc, float) and isinstance(sigma, float) and isinstance(age, float)):
            soc, sigma, age = mean_known(soc), largest_known(sigma), largest_known(age)
        if estimate.status not in _AVAILABLE:
            soc = sigma = NAN
        word = estimate.status << self._status_shift | self._soc(soc) | self._sigma(sigma) | self._age(age)
        return self._soc_box.frame(word, accepted)

    def interval(self, estimate: Estimate, accepted: int) -> Frame:
        """SocInterval: the smallest lower and the largest upper bound of the cells' SoC."""
        low, high = (estimate.soc_low, estimate.soc_high) if estimate.status in _AVAILABLE else (NAN, NAN)
        word = self._low(smallest_known(low)) | self._high(largest_known(high))
        return self._interval_box.frame(word, accepted)

    def quality(self, estimate: Estimate, accepted: int) -> Frame:
        """SocQuality: innovation, NIS and predicted voltage of the cell with the largest NIS."""
        nis = estimate.nis
        worst = 0 if isinstance(nis, float) else int(np.argmax(np.nan_to_num(nis, nan=-1.0)))
        word = (worst + 1) << self._worst_cell_shift
        word |= self._voltage_pred(_of_cell(worst, estimate.voltage_pred_V))
        word |= self._innovation(_of_cell(worst, estimate.innovation_V)) | self._nis(_of_cell(worst, nis))
        return self._quality_box.frame(word, accepted)

    def state(self, estimate: Estimate, detail: Detail, accepted: int) -> Frame:
        """BmsState: fault bits, what became of a stored belief, lowest and highest SoC of the cells."""
        soc = estimate.soc if estimate.status in _AVAILABLE else NAN
        lowest, highest = smallest_known(soc), largest_known(soc)
        word = self._faults.insert(estimate.faults) | detail.stored << self._stored_shift
        word |= self._soc_min(lowest) | self._soc_max(highest)
        return self._state_box.frame(word, accepted)

    def detail(self, estimate: Estimate, detail: Detail, accepted: int) -> Frame:
        """SocDetail: what is told beside the SoC, and the cells that are lowest and highest."""
        soc = estimate.soc if estimate.status in _AVAILABLE else NAN
        if isinstance(soc, float) or np.isnan(soc).all():
            lowest = highest = 1.0 if isinstance(soc, float) and not math.isnan(soc) else NAN
        else:
            lowest, highest = 1.0 + int(np.nanargmin(soc)), 1.0 + int(np.nanargmax(soc))
        word = detail.source << self._source_shift | self._slewed(detail.soc_slewed)
        word |= self._min_cell(lowest) | self._max_cell(highest) | self._bias(detail.current_bias_A)
        return self._detail_box.frame(word, accepted)

    def health(self, counts: Sequence[int], accepted: int) -> Frame:
        """BusHealth: counts in the order of `HEALTH`."""
        word = 0
        for field, count in zip(self._counts, counts, strict=True):
            word |= min(count, field.mask) << field.shift
        return self._health_box.frame(word, accepted)


_AVAILABLE = (Status.OK, Status.DEGRADED)


def _of_cell(k: int, values: PerCell) -> float:
    return values if isinstance(values, float) else float(values[k])
