"""What a reader of the result should be told before trusting it, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError
from bms_ukf.identify import beyond, ocv, uncertainty
from bms_ukf.identify.dynamics import Model
from bms_ukf.identify.openloop import Prediction
from bms_ukf.identify.samples import Samples
from bms_ukf.identify.tables import SOC
from bms_ukf.manifest import MeasuredTest
from bms_ukf.recordings import Recording

Array = NDArray[np.float64]

OFF_COUNT = 0.02  # SoC
LEAST_COVERED = (0.15, 0.85)  # SoC
MOVED_CAPACITY = 0.03  # share


def about_count(recording: Recording, test: MeasuredTest, soc: Array, source: str) -> list[str]:
    """Whether the counted SoC is possible, and agrees with the file's own. Raises ConfigError if it is far from it."""
    if soc.min() < -0.3 or soc.max() > 1.3:
        expected = "a capacity_Ah, current unit and initial_soc by which the SoC stays within 0..1"
        found = f"a SoC from {soc.min():.2f} to {soc.max():.2f} in {recording.name}"
        raise ConfigError(source, key=f"test.file {test.file}", value=found, expected=expected)
    warnings = []
    if soc.min() < -0.05 or soc.max() > 1.05:
        warnings.append(f"{recording.name}: SoC counted from {soc.min():.2f} to {soc.max():.2f}")
    if recording.soc_ref is not None:
        apart = float(np.nanmax(np.abs(soc - recording.soc_ref)))
        if apart > OFF_COUNT:
            warnings.append(f"{recording.name}: counted SoC and soc_ref differ by up to {100 * apart:.1f} %")
    return warnings


def about(
    model: Model, slow: ocv.Slow, chosen: dict[str, list[Samples]], judged: dict[str, list[Prediction]]
) -> list[str]:
    """Extrapolation, poor observability and moved capacity."""
    if not chosen["fit"]:
        return [
            "no test of role 'pulse', 'drive' or 'charge': resistances are what cells of this capacity have,"
            " and may be wrong by a factor"
        ]
    return [
        *_about_capacity(model),
        *_about_reach(model, chosen["fit"], judged["validate"]),
        *_about_observability(model),
    ]


def _about_capacity(model: Model) -> list[str]:
    scales = np.exp(model.x[model.unknowns.scale])
    return [
        f"at {T:g} degC the OCV falls as if the cell held {100 / scale:.0f} % of its capacity: ageing between tests,"
        " or charge that the cold cell does not give"
        for T, scale in zip(model.unknowns.temperature_degC, scales, strict=True)
        if scale > 1 + MOVED_CAPACITY
    ]


def _about_reach(model: Model, fitted: Sequence[Samples], validated: Sequence[Prediction]) -> list[str]:
    """SoC and temperatures of the tables and of validated tests beyond what was fitted."""
    warmest = max(float(test.temperature_degC.max()) for test in fitted)
    coldest = min(float(test.temperature_degC.min()) for test in fitted)
    warnings = []
    if coldest > beyond.COLD_DEGC + beyond.LEAST_K or warmest < beyond.HOT_DEGC - beyond.LEAST_K:
        warnings.append(
            f"fitted tests were at {coldest:.0f} to {warmest:.0f} degC: beyond, the tables go on by Arrhenius,"
            " less sure the farther"
        )
    least = min(float(test.soc[test.counted].min()) for test in fitted)
    most = max(float(test.soc[test.counted].max()) for test in fitted)
    if least > LEAST_COVERED[0] or most < LEAST_COVERED[1]:
        warnings.append(f"fitted tests cover SoC {least:.2f} to {most:.2f}: beyond, the tables are carried on")
    for prediction in validated:
        low, high = float(prediction.temperature_degC.min()), float(prediction.temperature_degC.max())
        if low < coldest - 3 or high > warmest + 3:
            warnings.append(f"{prediction.name}: at {low:.0f} to {high:.0f} degC, beyond the fitted tests")
    return warnings


def _about_observability(model: Model) -> list[str]:
    """SoC ranges of r0 that the tests hardly saw."""
    warnings = []
    for T, row in zip(model.unknowns.temperature_degC, uncertainty.tables(model).get("r0_ohm", []), strict=False):
        poor = SOC[row > 0.3]
        if poor.size == SOC.size:
            warnings.append(f"r0 at {T:g} degC is hardly observed")
        elif poor.size:
            warnings.append(f"r0 at {T:g} degC is hardly observed at SoC {', '.join(f'{soc:g}' for soc in poor)}")
    return warnings
