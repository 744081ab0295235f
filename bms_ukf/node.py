"""The other end of the bus, as a vehicle, a co-simulated plant or a monitor has it: samples out, estimates in."""

from __future__ import annotations

import numpy as np

from bms_ukf.dbc import Field, own_matrix
from bms_ukf.fault_bits import FaultBits
from bms_ukf.frames import Frame, Inbox, Outbox, Pages
from bms_ukf.records import Estimate, Sample, Status


class SampleEncoder:
    """Turns samples into the frames of a vehicle, by the project's own DBC.

    NaN is sent as not available, and a value beyond the DBC's limits as the limit.
    """

    def __init__(self, cells: int = 1, sensors: int = 1, strings: int = 1) -> None:
        """Several `strings` have a current sensor each."""
        matrix = own_matrix()
        self._pack_box = Outbox(matrix.message("PackMeasurement"))
        self._current = Field(*matrix.find("PackMeasurement.PackCurrent")).insert()
        self._pack_voltage = Field(*matrix.find("PackMeasurement.PackVoltage")).insert()
        self._temperatures = Pages(matrix, "CellTemperatures", "Sensor", sensors)
        self._voltages = Pages(matrix, "CellVoltages", "Cell", cells)
        self._strings = Pages(matrix, "StringCurrents", "String", strings) if strings > 1 else None
        self._parallel = strings
        self._sent = 0

    def encode(self, sample: Sample) -> list[Frame]:
        """All frames of a sample, current first: whichever comes first moves the estimator's time on to `t_ns`."""
        return [*self.strings(sample), self.pack(sample), *self.temperatures(sample), *self.voltages(sample)]

    def pack(self, sample: Sample) -> Frame:
        """PackMeasurement: the current and the sum of the cell voltages; of strings their sum, and their mean."""
        cells, current = sample.voltage_V, sample.currents_A
        pack_voltage = cells if isinstance(cells, float) else float(np.sum(cells)) / self._parallel
        current_A = current if isinstance(current, float) else float(np.sum(current))
        return self._pack_box.frame(self._current(current_A) | self._pack_voltage(pack_voltage), self._tick())

    def strings(self, sample: Sample) -> list[Frame]:
        """StringCurrents, every page; none of a single string."""
        pages = self._strings
        if pages is None:
            return []
        return [pages.frame(page, sample.currents_A, self._tick()) for page in range(pages.count)]

    def temperatures(self, sample: Sample) -> list[Frame]:
        """CellTemperatures, every page."""
        pages = self._temperatures
        return [pages.frame(page, sample.temperature_degC, self._tick()) for page in range(pages.count)]

    def voltages(self, sample: Sample) -> list[Frame]:
        """CellVoltages, every page."""
        pages = self._voltages
        return [pages.frame(page, sample.voltage_V, self._tick()) for page in range(pages.count)]

    def _tick(self) -> int:
        self._sent += 1
        return self._sent


class EstimateDecoder(Inbox[Estimate]):
    """Turns the frames of an `Encoder` back into estimates; see `Inbox.decode`.

    SocEstimate closes a set: it gives an `Estimate` that holds its own signals and those of the SocInterval, SocQuality
    and BmsState received since the one before, the rest NaN. A pack's values are those the messages give: mean, largest
    or worst.
    """

    def __init__(self) -> None:
        matrix = own_matrix()

        def field_of(name: str) -> Field:
            return Field(*matrix.find(name))

        self._status = field_of("SocEstimate.Status").raw()
        self._soc = field_of("SocEstimate.Soc").extract(0.01)
        self._sigma = field_of("SocEstimate.SocSigma").extract(0.01)
        self._age = field_of("SocEstimate.InformationAge").extract()
        self._voltage_pred = field_of("SocQuality.PredictedVoltage").extract()
        self._innovation = field_of("SocQuality.Innovation").extract()
        self._nis = field_of("SocQuality.Nis").extract()
        self._faults = FaultBits()
        self._low = field_of("SocInterval.SocLow").extract(0.01)
        self._high = field_of("SocInterval.SocHigh").extract(0.01)
        self._open = Estimate()
        super().__init__(
            {
                matrix.message("SocEstimate"): self._read_estimate,
                matrix.message("SocQuality"): self._read_quality,
                matrix.message("BmsState"): self._read_state,
                matrix.message("SocInterval"): self._read_interval,
            }
        )

    def _read_estimate(self, data: bytes, t_ns: int) -> Estimate:
        estimate, self._open = self._open, Estimate()
        status = self._status(data)
        estimate.t_ns = t_ns
        estimate.soc, estimate.soc_sigma = self._soc(data), self._sigma(data)
        estimate.age_s = self._age(data)
        estimate.status = Status(status) if status in _STATUSES else Status.INVALID
        return estimate

    def _read_quality(self, data: bytes, _: int) -> None:
        self._open.voltage_pred_V = self._voltage_pred(data)
        self._open.innovation_V, self._open.nis = self._innovation(data), self._nis(data)

    def _read_interval(self, data: bytes, _: int) -> None:
        self._open.soc_low, self._open.soc_high = self._low(data), self._high(data)

    def _read_state(self, data: bytes, _: int) -> None:
        self._open.faults = self._faults.extract(data)


_STATUSES = frozenset(Status)
