"""What the filter assumes of its sensors, and the limits it works within. The cell file says the rest.

Every default suits an automotive current and voltage measurement; none is fitted to a data set.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bms_ukf.toml import Section

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]


class Tuning(Section):
    """Sensor errors (one sigma), timeouts, gate and start-up of an `Estimator`; None: from the cell's capacity."""

    # What is believed before the first voltage. The default is no opinion: that voltage, at rest or not, decides.
    initial_soc: Annotated[float, Field(ge=0, le=1)] = 0.5
    initial_soc_sigma: Annotated[float, Field(gt=0, le=0.5)] = 0.3
    initial_current_sigma_A: NonNegative | None = None  # unseen load before the first sample; None: C/20

    current_offset_sigma_A: Positive | None = None  # None: C/50
    current_bias: bool = True  # estimate the offset as a state of the filter
    # One sensor, many cells: how alike the errors are by which two cells of a string tell its offset. 1: no two cells
    # know more than one.
    bias_error_correlation: Annotated[float, Field(ge=0, le=1)] = 0.5
    current_gain_sigma: NonNegative = 0.01
    current_error_horizon_s: Positive = 7200.0  # how long an offset stays the same before it is another one
    voltage_sensor_sigma_V: NonNegative = 0.002

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

    adaptive: bool = True  # let the innovations tell r0, and how large the fast voltage error is
    gate_sigmas: Positive = 5.0
    reject_s: Positive = 30.0  # after so long the belief is doubted, not the voltage
    wide_soc_sigma: Annotated[float, Field(gt=0, le=0.5)] = 0.02  # a wider start is met by quadrature, not sigma points
    # Half of the 95 % interval of SoC: up to the first a cell is ok, above the second it has no SoC.
    ok_half_width: Annotated[float, Field(gt=0, le=0.5)] = 0.10
    invalid_half_width: Annotated[float, Field(gt=0, le=0.5)] = 0.40

    # Sigma points; `kernel.params` refuses a set that is unsound. alpha = 1 makes every weight non-negative.
    alpha: Annotated[float, Field(gt=0, le=1)] = 1.0
    beta: float = 2.0
    kappa: float = 0.0
