"""The specification of the sensors: the bounds that their errors keep, and the checks that it is possible."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.toml import Section

BOUND_SIGMAS = 1.96  # a bound holds 95 % of a normal distribution

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, lt=1)]
Kelvin = Annotated[float, Field(ge=0, le=100)]


class SensorSpec(Section):
    """[sensor_spec]: 95 % bounds of errors that stay the same for long, and the step of what a sensor can show.

    A bound b means that the error lies within -b .. +b in 95 % of sensors: its sigma is b / BOUND_SIGMAS. White noise
    of the voltage is not here: that is `Tuning.voltage_noise_V`, one sigma.
    """

    voltage_offset_V: NonNegative = 0.005
    voltage_gain: Share = 0.001  # share of the voltage
    current_offset_A: Positive | None = None  # None: capacity / 50 h
    current_gain: Share = 0.005  # share of the current
    temperature_K: Kelvin = 2.0
    # None: the daemon takes the scale of the signal in the DBC; elsewhere 0.
    current_resolution_A: NonNegative | None = None
    voltage_resolution_V: NonNegative | None = None
    temperature_resolution_K: Kelvin | None = None
    skew_s: NonNegative = 0.2  # how far apart in time the current and the voltage of one sample may be measured

    def current_offset_sigma_A(self, capacity_Ah: float) -> float:
        """Return one sigma of the current sensor's offset, A, on a cell of that capacity."""
        bound_A = capacity_Ah / 50 if self.current_offset_A is None else self.current_offset_A
        return bound_A / BOUND_SIGMAS

    @property
    def current_gain_sigma(self) -> float:
        """One sigma of the relative error of the current, 1."""
        return self.current_gain / BOUND_SIGMAS

    def voltage_offset_sigma_V(self, voltage_V: float) -> float:
        """Return one sigma of the error that stays the same at voltages near `voltage_V`: offset and gain, V."""
        return math.hypot(self.voltage_offset_V, self.voltage_gain * voltage_V) / BOUND_SIGMAS

    @property
    def temperature_sigma_K(self) -> float:
        """One sigma of the temperature, rounding included, K."""
        return math.hypot(self.temperature_K / BOUND_SIGMAS, rounding(self.temperature_resolution_K))

    @property
    def skew_sigma_s(self) -> float:
        """One sigma of the time between current and voltage, s."""
        return self.skew_s / BOUND_SIGMAS

    def with_resolution(self, default: Mapping[str, float]) -> SensorSpec:
        """Return this specification with the resolutions in `default`, by field name, where it states none."""
        return self.model_copy(update={name: step for name, step in default.items() if getattr(self, name) is None})


def rounding(step: float | None) -> float:
    """Return one sigma of the rounding to multiples of `step`, whose error is uniform; 0 for None."""
    return (step or 0.0) / math.sqrt(12)


def require_possible(spec: SensorSpec, cell: CellParams, timeout_s: float, source: str | Path, key: str) -> None:
    """Raise ConfigError for a bound larger than the signal, or a skew longer than `timeout_s`.

    `source` is the file that states the specification, `key` its table there, `timeout_s` the shorter of the timeouts
    of current and voltage.
    """
    low, high = cell.cell.voltage_limits_V
    largest_A = max(abs(limit) for limit in cell.cell.current_limits_A)
    span, limit = f"{high - low:g} V, the cell's voltage span", f"{largest_A:g} A, the cell's current limit"
    timeout = f"{timeout_s:g} s, the shorter of current_timeout_s and voltage_timeout_s"
    for name, most, what in (
        ("voltage_offset_V", high - low, span),
        ("voltage_resolution_V", high - low, span),
        ("current_offset_A", largest_A, limit),
        ("current_resolution_A", largest_A, limit),
        ("skew_s", timeout_s, timeout),
    ):
        value = getattr(spec, name)
        if value is not None and value > most:
            raise ConfigError(source, key=f"{key}.{name}", value=value, expected=f"at most {what}")
