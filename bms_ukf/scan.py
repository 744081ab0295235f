"""When every cell has been read once more: the end of a scan, which a set of frames answers."""

from __future__ import annotations

import numpy as np

from bms_ukf.records import Sample


class Scan:
    """Follows the voltages of `cells` cells.

    A cell that is silent, or without a valid value, does not hold the others up: where a cell comes again before that
    one did, the scan is over, too.
    """

    def __init__(self, cells: int) -> None:
        self._seen = np.zeros(cells, bool)

    def ends_with(self, sample: Sample) -> bool:
        """Whether this sample completes the scan, or shows that the one before it was over."""
        voltage = sample.voltage_V
        if isinstance(voltage, float):
            return voltage == voltage  # noqa: PLR0124 - not NaN, in a tenth of the time
        fresh = ~np.isnan(voltage)
        if bool((fresh & self._seen).any()):
            self._seen[:] = fresh
            return True
        self._seen |= fresh
        if self._seen.all():
            self._seen[:] = False
            return True
        return False
