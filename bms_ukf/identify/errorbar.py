"""Whether the estimator's error bar is true with an identified cell, and what it takes to make it so.

The noise that explains the voltage errors of a model is not all that its SoC depends on: on a plateau of the OCV an
error of the curve stays the same for hours, and a filter that takes it for one that changes is too sure of itself.
Only the estimator itself can tell. So it is run over tests that were not fitted, with the cell file as it will be
used, and all sigmas grow until its error bar holds the SoC of the tests as often as it says.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bms_ukf import honesty
from bms_ukf.cell import CellParams
from bms_ukf.estimator import Estimator
from bms_ukf.identify.samples import LONGEST_STEP_S, Samples
from bms_ukf.tuning import Tuning

TRUE = 0.9  # share of the time that the interval shall hold SoC on average; a Gaussian error would be held 95 %
FACTORS = (1.0, 1.4, 2.0, 2.8, 4.0)


def factor(cell: CellParams, tests: Sequence[Samples]) -> float:
    """The least factor on the [noise] sigmas by which the error bar is true over the tests together, at most 4."""
    for candidate in FACTORS:
        noise = cell.noise.model_copy(update=grown(cell, candidate))
        if held(cell.model_copy(update={"noise": noise}), tests) >= TRUE:
            return candidate
    return FACTORS[-1]


def held(cell: CellParams, tests: Sequence[Samples]) -> float:
    """Share of its counted time at which the interval holds the SoC of a test: the mean of all tests, 1 without any."""
    shares = []
    tuning = Tuning(current_timeout_s=2 * LONGEST_STEP_S, voltage_timeout_s=2 * LONGEST_STEP_S)
    for test in tests:
        t_ns = np.round(test.time_s * 1e9).astype(np.int64)
        run = Estimator(cell, tuning=tuning).replay(t_ns, test.current_A, test.voltage_V, test.temperature_degC)
        counted = test.counted & np.isfinite(run["soc"])
        inside = counted & honesty.inside(run["soc_low"], run["soc_high"], test.soc, test.test.soc_ref_sigma)
        shares.append(float(test.step_s[inside].sum() / max(test.step_s[counted].sum(), 1e-9)))
    return float(np.mean(shares)) if shares else 1.0


def grown(cell: CellParams, times: float) -> dict[str, float]:
    """The sigmas of the cell's [noise], so many times as large."""
    sigmas = {key: value for key, value in cell.noise.model_dump().items() if "_sigma" in key and value is not None}
    return {key: round(min(times * value, 1.9), 5) for key, value in sigmas.items()}
