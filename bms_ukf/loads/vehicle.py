"""From the speed of a car to what one cell of its pack delivers."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from bms_ukf.loads.series import Array

GRAVITY = 9.80665  # m/s^2
AIR_DENSITY = 1.2  # kg/m^3, dry air at 20 degC and 1013 hPa


class Vehicle(BaseModel):
    """Longitudinal road-load model on a level road, and the pack that feeds it. Defaults: a small electric car.

    Wheel force = mass_factor m dv/dt + c_rr m g + rho/2 CdA v^2. Braking power up to `regen_power_max_W` at the wheels
    is recovered, the friction brakes take the rest. The pack is taken at its nominal voltage, so that the current does
    not depend on any model of the cell.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    mass_kg: float = Field(default=1400.0, gt=0)  # with driver
    mass_factor: float = Field(default=1.05, ge=1)  # rotating parts, as a share of the mass
    drag_area_m2: float = Field(default=0.69, ge=0)  # Cd times frontal area
    rolling_resistance: float = Field(default=0.010, ge=0)  # of the weight
    drive_efficiency: float = Field(default=0.88, gt=0, le=1)  # pack to wheels
    regen_efficiency: float = Field(default=0.75, ge=0, le=1)  # wheels to pack
    regen_power_max_W: float = Field(default=40e3, ge=0)  # at the wheels
    auxiliary_power_W: float = Field(default=500.0, ge=0)  # heating, electronics; always on while driving
    cells_series: int = Field(default=96, gt=0)
    cells_parallel: int = Field(default=14, gt=0)
    cell_voltage_nominal_V: float = Field(default=3.63, gt=0)

    def cell_current_A(self, time_s: Array, speed_mps: Array) -> Array:
        """Mean current of one cell over each interval of a speed trace; shape (n - 1,), positive = discharge."""
        return np.asarray(self.cell_power_W(time_s, speed_mps) / self.cell_voltage_nominal_V)

    def cell_power_W(self, time_s: Array, speed_mps: Array) -> Array:
        """Mean power of one cell over each interval of a speed trace; shape (n - 1,), positive = discharge.

        Speed is taken as linear between the stamps: the means of v and v^3 and the kinetic energy are then exact.
        """
        v0, v1 = speed_mps[:-1], speed_mps[1:]
        inertia_W = self.mass_factor * self.mass_kg * (v1**2 - v0**2) / (2 * np.diff(time_s))
        rolling_W = self.rolling_resistance * self.mass_kg * GRAVITY * (v0 + v1) / 2
        drag_W = 0.5 * AIR_DENSITY * self.drag_area_m2 * (v0 + v1) * (v0**2 + v1**2) / 4
        wheel_W = inertia_W + rolling_W + drag_W
        drive_W = np.maximum(wheel_W, 0.0) / self.drive_efficiency
        regen_W = np.clip(-wheel_W, 0.0, self.regen_power_max_W) * self.regen_efficiency
        pack_W = drive_W - regen_W + self.auxiliary_power_W
        return np.asarray(pack_W / (self.cells_series * self.cells_parallel))
