"""Within what a pack is used."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bms_ukf.toml import Section

Positive = Annotated[float, Field(gt=0)]


class Limits(Section):
    """Of each cell; None: as its cell file says. Rates are multiples of the cell file's capacity per hour."""

    voltage_V: tuple[float, float] | None = None  # lowest and highest
    current_A: tuple[float, float] | None = None  # largest charge, negative, and discharge

    # A cell is empty where it meets the lower voltage at this rate, and full where it meets the upper one: what a cold
    # cell holds beyond cannot be had at this rate.
    discharge_rate: Positive = 0.5
    charge_rate: Positive = 0.2

    pulse_s: Positive = 10.0  # for so long a pulse must be kept up
    power_tau_s: Positive = 60.0  # over which the recent power is averaged
