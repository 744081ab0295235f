"""The filter's assumptions about sensors, starts and timeouts. The cell file has the rest.

Every default suits an automotive current and voltage measurement; none is fitted to a data set.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field

from bms_ukf.cell import CellParams
from bms_ukf.sensor_spec import SensorSpec, require_possible, rounding
from bms_ukf.toml import Section

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]


class Tuning(Section):
    """Sensor errors, timeouts, gate and start-up of an `Estimator`; None: from the cell's capacity.

    The bounds of `sensor_spec` are of 95 %; every other error here is one sigma.
    """

    replaced: ClassVar[dict[str, str]] = {
        "current_offset_sigma_A": "sensor_spec.current_offset_A, a 95 % bound (1.96 sigma)",
        "current_gain_sigma": "sensor_spec.current_gain, a 95 % bound (1.96 sigma)",
        "voltage_sensor_sigma_V": "voltage_noise_V, one sigma of white noise, and sensor_spec.voltage_offset_V, "
        "a 95 % bound of a lasting error",
        "soc_sigma_invalid": "invalid_half_width, a half-width (1.96 sigma)",
    }

    # What is believed before the first voltage. The default is no opinion: that voltage, at rest or not, decides.
    initial_soc: Annotated[float, Field(ge=0, le=1)] = 0.5
    initial_soc_sigma: Annotated[float, Field(gt=0, le=0.5)] = 0.3
    initial_current_sigma_A: NonNegative | None = None  # unseen load before the first sample; None: C/20

    sensor_spec: SensorSpec = Field(default_factory=SensorSpec)
    voltage_noise_V: NonNegative = 0.002  # white noise of the voltage sensor, without its rounding
    capacity_doubt: Annotated[float, Field(ge=0, le=0.5)] = 0.05  # relative error of the cell file's capacity; 0: exact
    current_bias: bool = True  # estimate the offset as a state of the filter
    # One sensor, many cells: how alike the errors are by which two cells of a string tell its offset. 1: no two cells
    # know more than one.
    bias_error_correlation: Annotated[float, Field(ge=0, le=1)] = 0.5
    current_error_horizon_s: Positive = 7200.0  # how long an offset stays the same before it is another one

    # What a cell gives while nothing is measured: self-discharge and what stays awake.
    standby_current_A: NonNegative = 0.0
    standby_sigma_A: NonNegative | None = None  # None: C/2000

    # One sigma of SoC between the cells of a pack: what is believed of a cell that has never been measured.
    cell_spread_sigma: Annotated[float, Field(gt=0, le=0.5)] = 0.03

    # A current counts for no longer than this, so it must exceed the interval between samples.
    current_timeout_s: Positive = 5.0
    voltage_timeout_s: Positive = 5.0
    temperature_timeout_s: Positive = 60.0
    voltage_margin_V: NonNegative = 0.7  # plausible: the cell's voltage limits and so much beyond
    current_margin: Annotated[float, Field(ge=1)] = 10.0  # plausible: so many times the cell's current limits

    adaptive: bool = True  # scale the fast error's variance by the innovations; restart a belief if they keep one sign
    gate_sigmas: Positive = 5.0
    reject_s: Positive = 30.0  # after so long the belief is doubted, not the voltage
    wide_soc_sigma: Annotated[float, Field(gt=0, le=0.5)] = 0.05  # above it a belief has components (`kernel.parts`)
    # Half of the 95 % interval of SoC: up to the first a cell is ok, above the second it has no SoC.
    ok_half_width: Annotated[float, Field(gt=0, le=0.5)] = 0.10
    invalid_half_width: Annotated[float, Field(gt=0, le=0.5)] = 0.40

    # Sigma points; `kernel.params` refuses a set that is unsound. alpha = 1 makes every weight non-negative.
    alpha: Annotated[float, Field(gt=0, le=1)] = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    @property
    def voltage_white_var_V2(self) -> float:
        """Variance of the voltage sensor's white error: noise and rounding, V^2."""
        return self.voltage_noise_V**2 + rounding(self.sensor_spec.voltage_resolution_V) ** 2

    @property
    def charge_gain_sigma(self) -> float:
        """One sigma of the relative error of charge over capacity that the filter lets SoC walk by, 1."""
        return math.hypot(self.sensor_spec.current_gain_sigma, self.capacity_doubt)

    def check(self, cell: CellParams, source: str | Path, key: str) -> None:
        """Raise ConfigError if `sensor_spec`, the table `key` of the file `source`, is impossible for `cell`."""
        timeout_s = min(self.current_timeout_s, self.voltage_timeout_s)
        require_possible(self.sensor_spec, cell, timeout_s, source, key)
