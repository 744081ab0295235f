"""What stands between the plant and the bus: sensors with noise, offset, gain, resolution and a limited range.

In TOML, all of it optional and ideal where left out:

    [sensors]
    seed = 1

    [sensors.current]
    noise_A = 0.05              # one standard deviation, white
    offset_A = 0.1              # positive makes a discharge look larger
    gain = 1.002
    resolution_A = 0.01
    range_A = [-300, 300]

and the same under `[sensors.voltage]` (`_V`) and `[sensors.temperature]` (`_degC`).
"""

from __future__ import annotations

import math
from typing import Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from bms_ukf.records import Sample


def _settings(unit: str) -> ConfigDict:
    """Keys carry the unit of the channel: `noise` is written `noise_A` in a current sensor's table."""
    return ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        alias_generator=lambda name: name if name == "gain" else f"{name}_{unit}",
    )


class SensorSettings(BaseModel):
    """measured = limit(round(gain true + offset + noise)), in this order; the unit is that of the channel."""

    noise: float = Field(default=0.0, ge=0)  # standard deviation
    offset: float = 0.0
    gain: float = Field(default=1.0, gt=0)
    resolution: float = Field(default=0.0, ge=0)  # 0: continuous
    range: tuple[float, float] | None = None  # lowest and highest value the sensor can give

    @model_validator(mode="after")
    def _range_is_ordered(self) -> Self:
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError(f"range must be [lowest, highest], not {list(self.range)}")
        return self


class CurrentSensor(SensorSettings):
    model_config = _settings("A")


class VoltageSensor(SensorSettings):
    model_config = _settings("V")


class TemperatureSensor(SensorSettings):
    model_config = _settings("degC")


class Sensors(BaseModel):
    """The `[sensors]` table of a scenario. The same seed gives the same noise, sample by sample."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: int = Field(default=0, ge=0)
    current: CurrentSensor = CurrentSensor()
    voltage: VoltageSensor = VoltageSensor()
    temperature: TemperatureSensor = TemperatureSensor()


class Sensor:
    """One channel. Its noise is seeded by `seed` and its own `name`, so another channel cannot change it."""

    def __init__(self, settings: SensorSettings, seed: int, name: str) -> None:
        self._noise, self._offset, self._gain = settings.noise, settings.offset, settings.gain
        self._resolution = settings.resolution
        self._low, self._high = settings.range or (-math.inf, math.inf)
        self._normal = np.random.default_rng([seed, *name.encode()]).standard_normal

    def measure(self, true_value: float) -> float:
        """What the sensor gives for `true_value`. A missing value (NaN) stays missing, and uses up its noise."""
        value = self._gain * true_value + self._offset + self._noise * self._normal()
        if math.isnan(value):
            return value
        if self._resolution:
            value = round(value / self._resolution) * self._resolution
        return min(max(value, self._low), self._high)


class SensorSet:
    """The current, voltage and temperature sensor of one cell."""

    def __init__(self, settings: Sensors) -> None:
        self._current = Sensor(settings.current, settings.seed, "current")
        self._voltage = Sensor(settings.voltage, settings.seed, "voltage")
        self._temperature = Sensor(settings.temperature, settings.seed, "temperature")

    def measure(self, t_ns: int, current_A: float, voltage_V: float, temperature_degC: float) -> Sample:
        """The sample that true values at `t_ns` become. Sensors have no delay yet: the stamp is passed on."""
        return Sample(
            t_ns=t_ns,
            current_A=self._current.measure(current_A),
            voltage_V=self._voltage.measure(voltage_V),
            temperature_degC=self._temperature.measure(temperature_degC),
        )
