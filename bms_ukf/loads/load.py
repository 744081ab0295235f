"""The `[load]` table as a whole: as a profile over time, or asked step by step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from bms_ukf.errors import ConfigError
from bms_ukf.loads.demand import Demand
from bms_ukf.loads.plan import plan
from bms_ukf.loads.profile import Piecewise, Profile
from bms_ukf.loads.segments import Quantity, Segment
from bms_ukf.loads.vehicle import Vehicle


class Load(BaseModel):
    """Segments one after the other, the whole list `repeat` times. File names are looked up in `relative_to` first."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    segments: list[Segment] = Field(min_length=1)
    repeat: int = Field(default=1, ge=1)
    vehicle: Vehicle = Vehicle()

    def demand(self, step_s: float, *, plant_input: Quantity = "current_A", relative_to: Path | None = None) -> Demand:
        """The load as what a plant is asked for, step by step, in the unit of `plant_input`.

        Where segments need not know the plant, every step carries the exact charge (or energy) of its interval. Those
        that do start and end with a step: what stands before them and ends within a step fills it up with rest.
        Raises ConfigError for a file that is missing or malformed, and for a load that the plant cannot take.
        """
        return Demand(plan(self.segments, self.repeat, self.vehicle, relative_to), step_s, plant_input)

    def profile(self, step_s: float, *, relative_to: Path | None = None) -> Profile:
        """The load on a uniform grid of `step_s`; every step carries the exact charge of its interval.

        A last stretch shorter than a step is left out. Raises ConfigError for a file that is missing or malformed, for
        a load shorter than one step, and for one that is not a current over time whatever the plant does.
        """
        whole = plan(self.segments, self.repeat, self.vehicle, relative_to)
        if not isinstance(whole, Piecewise) or whole.quantity != "current_A":
            raise ConfigError("load", key="segments", expected="currents over time, without limits, CC-CV, W or V")
        step_ns = round(step_s * 1e9)
        steps = whole.whole_steps(step_ns * 1e-9) if step_ns > 0 else 0
        if steps < 1:
            expected = f"a step_s above 0 and within the load's {whole.end_s:g} s"
            raise ConfigError("load", key="step_s", value=step_s, expected=expected)
        t_ns = np.arange(1, steps + 1, dtype=np.int64) * step_ns
        return Profile(t_ns, whole.means(0, steps, step_ns * 1e-9))
