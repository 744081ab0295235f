"""Sensor errors of one run: drawn once, then applied to all rows at a time.

The specification is that of a daemon without `[sensor_spec]`: bounds that hold 95 % of sensors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_ukf.sensor_spec import BOUND_SIGMAS, SensorSpec

Array = NDArray[np.float64]

_SPEC = SensorSpec()
SIGMAS = {
    "voltage_offset_V": _SPEC.voltage_offset_V / BOUND_SIGMAS,
    "voltage_gain": _SPEC.voltage_gain / BOUND_SIGMAS,
    "current_offset_C": _SPEC.current_offset_sigma_A(1.0),
    "current_gain": _SPEC.current_gain_sigma,
    "temperature_offset_K": _SPEC.temperature_K / BOUND_SIGMAS,
    "skew_s": _SPEC.skew_sigma_s,
}
RESOLUTIONS = {"voltage_bit_V": (0.001, 0.005), "current_bit_C": (0.002, 0.02), "temperature_bit_K": (0.5, 1.0)}


@dataclass(slots=True, frozen=True)
class Errors:
    """Errors of the three channels. Currents are in C, multiples of the capacity per hour; noise is one sigma."""

    voltage_offset_V: float = 0.0
    voltage_gain: float = 0.0  # beside 1
    voltage_noise_V: float = 0.001
    voltage_bit_V: float = 0.001
    current_offset_C: float = 0.0
    current_gain: float = 0.0
    current_noise_C: float = 0.002
    current_bit_C: float = 0.002
    temperature_offset_K: float = 0.0
    temperature_noise_K: float = 0.1
    temperature_bit_K: float = 0.5
    skew_s: float = 0.0  # positive: the current lags the voltage

    def words(self) -> str:
        """Say which errors are specified, and how large they are."""
        shown = {
            "voltage_offset_V": f"{1e3 * self.voltage_offset_V:+.1f} mV",
            "voltage_gain": f"{100 * self.voltage_gain:+.2f} % of voltage",
            "current_offset_C": f"{100 * self.current_offset_C:+.1f} % of C",
            "current_gain": f"{100 * self.current_gain:+.2f} % of current",
            "temperature_offset_K": f"{self.temperature_offset_K:+.1f} K",
            "skew_s": f"skew {self.skew_s:+.2f} s",
        }
        return ", ".join(text for name, text in shown.items() if getattr(self, name)) or "no sensor error"


def draw(rng: np.random.Generator, names: tuple[str, ...] = tuple(SIGMAS)) -> Errors:
    """Draw errors within the specification for the channels in `names`; the others have noise and resolution alone."""
    return replace(Errors(), **{name: float(rng.normal(0.0, SIGMAS[name])) for name in names})


def usual(rng: np.random.Generator) -> Errors:
    """Draw the sensors of a run that is not about sensors: half of them exact, half of them within specification."""
    return draw(rng) if rng.random() < 0.5 else Errors()


def current(errors: Errors, rng: np.random.Generator, t_s: Array, true_A: Array, capacity_Ah: float) -> Array:
    """Return the measured current, (rows,) A. A skew moves charge between rows and loses none."""
    shown = true_A
    if errors.skew_s:
        step_s = np.diff(t_s, prepend=t_s[0] - (t_s[1] - t_s[0]))
        charge = np.cumsum(true_A * step_s)
        moved = np.interp(t_s - errors.skew_s, t_s, charge)
        shown = np.diff(moved, prepend=moved[0] - true_A[0] * step_s[0]) / step_s
    noise_A = errors.current_noise_C * capacity_Ah * rng.standard_normal(true_A.shape)
    shown = (1 + errors.current_gain) * shown + errors.current_offset_C * capacity_Ah + noise_A
    return _rounded(shown, errors.current_bit_C * capacity_Ah)


def voltage(errors: Errors, rng: np.random.Generator, true_V: Array) -> Array:
    """Return the measured voltages, (rows, cells) V. Every further cell has an offset and a gain of its own."""
    cells = true_V.shape[1]
    offset, gain = np.full(cells, errors.voltage_offset_V), np.full(cells, errors.voltage_gain)
    if errors.voltage_offset_V:
        offset[1:] = rng.normal(0.0, SIGMAS["voltage_offset_V"], cells - 1)
    if errors.voltage_gain:
        gain[1:] = rng.normal(0.0, SIGMAS["voltage_gain"], cells - 1)
    noise_V = errors.voltage_noise_V * rng.standard_normal(true_V.shape)
    return _rounded((1 + gain) * true_V + offset + noise_V, errors.voltage_bit_V)


def temperature(errors: Errors, rng: np.random.Generator, true_degC: Array) -> Array:
    """Return the measured temperature, (rows,) degC."""
    noise_K = errors.temperature_noise_K * rng.standard_normal(true_degC.shape)
    return _rounded(true_degC + errors.temperature_offset_K + noise_K, errors.temperature_bit_K)


def _rounded(values: Array, bit: float) -> Array:
    return np.asarray(np.rint(values / bit) * bit if bit else values)
