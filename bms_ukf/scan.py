"""When every cell has been read once more: the end of a scan, which a set of frames answers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Scan:
    """Follows the voltages of `cells` cells.

    A cell that is silent, or without a valid value, does not hold the others up: where a cell comes again before that
    one did, the scan is over, too.
    """

    def __init__(self, cells: int) -> None:
        self._cells, self._seen = cells, set[int]()

    def ends_with(self, heard: float | NDArray[np.intp]) -> bool:
        """Whether this sample completes the scan, or shows that the one before it was over.

        `heard` is the voltage of a single cell, NaN if there is none; of several cells it is which have one.
        """
        if isinstance(heard, float):
            return heard == heard  # noqa: PLR0124 - not NaN, in a tenth of the time
        fresh = heard.tolist()
        if not self._seen.isdisjoint(fresh):
            self._seen = set(fresh)
            return True
        self._seen.update(fresh)
        if len(self._seen) == self._cells:
            self._seen.clear()
            return True
        return False
