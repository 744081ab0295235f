"""A load that is asked step by step what it wants of a plant, because that may depend on what the plant has done."""

from __future__ import annotations

import math

from bms_ukf.errors import ConfigError
from bms_ukf.loads.plan import Plan
from bms_ukf.loads.segments import Quantity
from bms_ukf.loads.series import Array
from bms_ukf.loads.terminal import Terminal


class Demand:
    """What a load wants of a plant, one step after the other.

    `next` is given the plant's state before a step, and tells the plant's input over that step. `steps_at_most` is
    where the load ends if no limit ends it before. Raises ConfigError for a load in volts, if the plant takes none.
    """

    def __init__(self, plan: Plan, step_s: float, plant_input: Quantity) -> None:
        if plant_input != "voltage_V" and "voltage_V" in plan.quantities:
            raise ConfigError("load", key="voltage_V", expected=f"no voltage, as the plant takes {plant_input}")
        self.steps_at_most = plan.steps_at_most(step_s)
        self._terminal = Terminal(plant_input)
        self._steps = plan.steps(step_s, self._terminal)

    def next(
        self, voltage_V: float | Array, soc: float | Array = math.nan, current_A: float = math.nan
    ) -> float | None:
        """The plant's input over the step ahead, in the unit of `plant_input`; None once the load is over.

        `voltage_V` and `soc` are those of each cell now, a scalar or of shape (cells,); `current_A` is the mean of the
        step behind, which only a plant that takes a voltage has to give. Currents and powers are positive on discharge.
        Raises ConfigError for a limit on what the plant does not give.
        """
        self._terminal.observe(voltage_V, soc, current_A)
        asked = next(self._steps, None)
        return None if asked is None else self._terminal.ask(*asked)
