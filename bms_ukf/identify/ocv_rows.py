"""The slow tests' OCV at the temperature rows of the tables, with its slope, as the fit looks it up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bms_ukf import pchip
from bms_ukf.identify import ocv

Array = NDArray[np.float64]

BELOW_EMPTY, BELOW_EMPTY_V = -0.25, 0.25  # the OCV goes on below SoC 0, for a cell that holds less than it should


class OcvRows:
    """OCV and slope at every temperature row over SoC, before any correction: PCHIP, straight below empty."""

    def __init__(self, rows_V: Sequence[Array]) -> None:
        soc = np.concatenate([[BELOW_EMPTY], ocv.SOC])
        self.knots = soc
        self.cubics = np.stack(
            [pchip.coefficients(soc, np.concatenate([[row[0] - BELOW_EMPTY_V], row])) for row in rows_V]
        )

    def __call__(self, row: NDArray[np.int64], soc: Array) -> tuple[Array, Array]:
        """OCV, V, and its slope, V per unit of SoC, at rows of the table (same shape as `soc`)."""
        soc = np.clip(soc, BELOW_EMPTY, 1.0)
        k = np.clip(np.searchsorted(self.knots, soc, side="right") - 1, 0, self.knots.size - 2)
        c, d = self.cubics[row, k], soc - self.knots[k]
        value = c[..., 0] + d * (c[..., 1] + d * (c[..., 2] + d * c[..., 3]))
        return value, c[..., 1] + d * (2 * c[..., 2] + d * 3 * c[..., 3])
