"""What stands between the plant and the bus: sensors that are noisy, off, drifting, slow, coarse and limited.

In TOML, all of it optional and ideal where left out:

    [sensors]
    seed = 1

    [sensors.current]
    noise_A = 0.05                    # one standard deviation, white
    offset_A = 0.1                    # positive makes a discharge look larger
    offset_sigma_A = 0.0              # drawn from the seed, and added to offset_A
    offset_A_per_degC = 0.002         # from 25 degC on
    offset_A_per_h = 0.01
    offset_walk_A_per_sqrt_h = 0.02   # random walk: its standard deviation after an hour
    gain = 1.002
    gain_sigma = 0.0                  # drawn, and added to gain
    gain_per_degC = 50e-6
    lag_s = 0.1                       # time constant of a first-order lag
    delay_s = 0.0
    resolution_A = 0.01
    range_A = [-300, 300]

and the same under `[sensors.voltage]` (`_V`) and `[sensors.temperature]` (`_degC`). Of several cells each has a sensor
of its own: noise, walks and what is drawn differ from cell to cell, and offset and gain may be lists, one value a cell.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from bms_ukf.errors import ConfigError
from bms_ukf.records import Sample

Array = NDArray[np.float64]
Value = float | Array  # a scalar, or of shape (cells,)

REFERENCE_degC = 25.0
_HOUR_NS = 3600e9
_WITHOUT_UNIT = {"gain", "gain_sigma", "gain_per_degC", "lag_s", "delay_s"}


def _settings(unit: str) -> ConfigDict:
    """Keys carry the unit of the channel: `noise` is written `noise_A` in a current sensor's table."""

    def key(name: str) -> str:
        if name in _WITHOUT_UNIT:
            return name
        quantity, per, what = name.partition("_per_")
        return f"{quantity}_{unit}{per}{what}"

    return ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, alias_generator=key)


NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]


class SensorSettings(BaseModel):
    """measured = limit(round(gain delayed(lagged(true)) + offset + noise)), in this order; in the channel's unit.

    gain = gain + drawn + gain_per_degC (T - 25 degC); offset = offset + drawn + offset_per_degC (T - 25 degC)
    + offset_per_h t + walk, with the time t since the first value and the plant's (mean) temperature T.
    """

    noise: NotNegative = 0.0  # standard deviation
    offset: float | list[float] = 0.0
    offset_sigma: NotNegative = 0.0
    offset_per_degC: float = 0.0
    offset_per_h: float = 0.0
    offset_walk_per_sqrt_h: NotNegative = 0.0
    gain: Positive | list[Positive] = 1.0
    gain_sigma: NotNegative = 0.0
    gain_per_degC: float = 0.0
    lag_s: NotNegative = 0.0
    delay_s: NotNegative = 0.0
    resolution: NotNegative = 0.0  # 0: continuous
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
    """The `[sensors]` table of a scenario. The same seed gives the same errors, sample by sample."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: int = Field(default=0, ge=0)
    current: CurrentSensor = CurrentSensor()
    voltage: VoltageSensor = VoltageSensor()
    temperature: TemperatureSensor = TemperatureSensor()


class Sensor:
    """One channel, of one value or of one for each cell.

    What is random of it depends on `seed` and its own `name` alone, so that another channel cannot change it; noise,
    walk and what is drawn at the start are apart, so that one cannot change another.
    """

    def __init__(self, settings: SensorSettings, seed: int, name: str) -> None:
        self._settings, self._name = settings, name
        self._normal = np.random.default_rng([seed, *name.encode()]).standard_normal
        self._walk_normal = np.random.default_rng([seed, *f"{name} walk".encode()]).standard_normal
        self._drawn = np.random.default_rng([seed, *f"{name} drawn".encode()])
        self._low, self._high = settings.range or (-math.inf, math.inf)
        self._begun = False
        self._start_ns = self._last_ns = 0
        self._walk: Value = 0.0
        self._lagged: Value = math.nan
        self._past: deque[tuple[int, Value]] = deque()

    def measure(self, t_ns: int, true_value: Value, plant_degC: float = REFERENCE_degC) -> Value:
        """What the sensor gives for `true_value` at `t_ns`, later than the time before; of the same shape.

        A missing value (NaN) stays missing, and uses up its noise. Raises ConfigError if the settings are for another
        number of cells.
        """
        settings = self._settings
        shape = true_value.shape if isinstance(true_value, np.ndarray) else None
        if not self._begun:
            self._begin(t_ns, shape)
        warmth_K = 0.0 if math.isnan(plant_degC) else plant_degC - REFERENCE_degC
        if settings.offset_walk_per_sqrt_h:
            spread = settings.offset_walk_per_sqrt_h * math.sqrt((t_ns - self._last_ns) / _HOUR_NS)
            self._walk = self._walk + spread * self._walk_normal(shape)
        offset = (
            self._offset
            + settings.offset_per_degC * warmth_K
            + settings.offset_per_h * (t_ns - self._start_ns) / _HOUR_NS
            + self._walk
        )
        value = self._delay(t_ns, self._lag(t_ns, true_value))
        value = (self._gain + settings.gain_per_degC * warmth_K) * value + offset + settings.noise * self._normal(shape)
        self._last_ns = t_ns
        if settings.resolution:
            value = np.rint(value / settings.resolution) * settings.resolution
        value = np.minimum(np.maximum(value, self._low), self._high)
        return float(value) if shape is None else value

    def _begin(self, t_ns: int, shape: tuple[int, ...] | None) -> None:
        self._begun = True
        self._start_ns = self._last_ns = t_ns
        settings = self._settings
        drawn: list[Any] = [self._drawn.standard_normal(shape) for _ in range(2)]
        self._offset = self._for_each_cell("offset", shape) + settings.offset_sigma * drawn[0]
        self._gain = self._for_each_cell("gain", shape) + settings.gain_sigma * drawn[1]

    def _for_each_cell(self, name: str, shape: tuple[int, ...] | None) -> Value:
        given = getattr(self._settings, name)
        if not isinstance(given, list):
            return float(given)
        if shape != (len(given),):
            key = f"{self._name}.{type(self._settings).model_fields[name].alias}"
            expected = "one value" if shape is None else f"one value, or a list of {shape[0]}, one for each cell"
            raise ConfigError("sensors", key=key, value=f"a list of {len(given)}", expected=expected)
        return np.array(given)

    def _lag(self, t_ns: int, value: Value) -> Value:
        """y' = (value - y) / lag, exact for a value that has been there since the last time; settled at first."""
        if not self._settings.lag_s:
            return value
        share = -math.expm1(-(t_ns - self._last_ns) * 1e-9 / self._settings.lag_s)
        followed = self._lagged + share * (value - self._lagged)
        followed = np.where(np.isnan(self._lagged), value, followed)
        self._lagged = np.where(np.isnan(value), self._lagged, followed)  # over a gap it stays where it was
        return np.where(np.isnan(value), math.nan, followed)[()]

    def _delay(self, t_ns: int, value: Value) -> Value:
        """The value of `delay_s` ago, on the line between the stamps around it; the first one until then.

        On equal steps this is also right for a mean over the step, of which the shares of two steps are then taken.
        """
        if not self._settings.delay_s:
            return value
        wanted_ns = t_ns - round(self._settings.delay_s * 1e9)
        past = self._past
        past.append((t_ns, value))
        while len(past) > 1 and past[1][0] <= wanted_ns:
            past.popleft()
        t0_ns, before = past[0]
        if wanted_ns <= t0_ns:
            return before
        t1_ns, after = past[1]
        return before + (wanted_ns - t0_ns) / (t1_ns - t0_ns) * (after - before)


class SensorSet:
    """The current, voltage and temperature sensors of a cell, or of all cells of a pack."""

    def __init__(self, settings: Sensors) -> None:
        self._current = Sensor(settings.current, settings.seed, "current")
        self._voltage = Sensor(settings.voltage, settings.seed, "voltage")
        self._temperature = Sensor(settings.temperature, settings.seed, "temperature")

    def measure(self, t_ns: int, current_A: float, voltage_V: Value, temperature_degC: Value) -> Sample:
        """The sample that true values at `t_ns` become; voltage and temperature are scalars or of shape (n,).

        It is stamped `t_ns`: lag and delay are in the values. Raises ConfigError if the settings are for another number
        of cells.
        """
        plant_degC = float(np.mean(temperature_degC)) if isinstance(temperature_degC, np.ndarray) else temperature_degC
        return Sample(
            t_ns=t_ns,
            current_A=float(self._current.measure(t_ns, current_A, plant_degC)),
            voltage_V=self._voltage.measure(t_ns, voltage_V, plant_degC),
            temperature_degC=self._temperature.measure(t_ns, temperature_degC, plant_degC),
        )
