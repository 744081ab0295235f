"""SoC at rest from the voltage there, for tests that nobody counted from full.

A cell at rest stands at its OCV, within what is left of the polarisation and of the hysteresis: the SoC is where the
OCV has that voltage, as well as the slope there tells it. A row at rest after a gap starts a new count.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError
from bms_ukf.identify import ocv, samples
from bms_ukf.manifest import MeasuredTest
from bms_ukf.recordings import Recording

Array = NDArray[np.float64]

WORTH_A_WARNING = 0.03  # SoC


def counted_soc(
    recording: Recording, test: MeasuredTest, slow: ocv.Slow, coulombic_efficiency: float
) -> tuple[Array, list[str]]:
    """SoC at every row, counted from the rest each stretch starts with, and what is doubtful of these starts.

    Raises ConfigError if the first row is under load.
    """
    if not recording.at_rest[0]:
        current_A = f"{recording.current_A[0]:.3g} A"
        raise ConfigError(
            recording.name, key="current of the first row", value=current_A, expected="initial_soc, or a rest"
        )
    starts = np.flatnonzero(recording.after_gap & recording.at_rest)
    starts = np.concatenate([[0], starts])
    soc, sigma = at_rest(recording.voltage_V[starts], slow)
    moved = samples.counted_soc(recording, test, slow.capacity_Ah, coulombic_efficiency)
    stretch = np.searchsorted(starts, np.arange(moved.size), side="right") - 1
    counted = moved + (soc - moved[starts])[stretch]
    return counted, _about(recording, soc, sigma)


def at_rest(voltage_V: Array, slow: ocv.Slow) -> tuple[Array, Array]:
    """SoC of a cell that rests at these voltages near 25 degC, and its standard error; held at 0 and 1.

    The error in volts, of the curve, of half the hysteresis and of a rest, over the slope of the curve.
    """
    curve_V = slow.at(25.0)
    soc = np.interp(voltage_V, curve_V, ocv.SOC)
    nearest = min(slow.curves, key=lambda curve: abs(curve.temperature_degC - 25))
    error_V = np.hypot(nearest.sigma_V, ocv.REST_ERROR_V)
    if nearest.half_width_V is not None:
        error_V = np.hypot(error_V, nearest.half_width_V)
    slope_V = np.gradient(curve_V, ocv.SOC)
    return soc, np.interp(soc, ocv.SOC, error_V / slope_V)


def _about(recording: Recording, soc: Array, sigma: Array) -> list[str]:
    worst = int(np.argmax(sigma))
    if sigma[worst] < WORTH_A_WARNING:
        return []
    return [
        f"{recording.name}: SoC of {soc.size} rests from the OCV, known to ±{100 * sigma[worst]:.0f} % at"
        f" {100 * soc[worst]:.0f} % and to ±{100 * np.median(sigma):.1f} % in the middle of them"
    ]
