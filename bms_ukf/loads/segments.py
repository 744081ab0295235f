"""The segments of a `[load]` table, each told by its own key; `models/loads/README.md` shows them all."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from bms_ukf import resources
from bms_ukf.errors import ConfigError
from bms_ukf.loads.series import Array, read_series
from bms_ukf.loads.vehicle import Vehicle

Quantity = Literal["current_A", "power_W", "voltage_V"]


class Limits(BaseModel):
    """Where a segment ends before its time, whichever comes first: the lowest or the highest cell passes a limit."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    until_below_V: float | None = None
    until_above_V: float | None = None
    until_below_soc: float | None = None
    until_above_soc: float | None = None

    @property
    def limited(self) -> bool:
        return any(getattr(self, name) is not None for name in Limits.model_fields)


class Drive(Limits):
    """A speed trace driven `repeat` times: a shipped name, or a CSV with the columns time_s,speed_mps.

    As the current that the pack at its nominal voltage would give, or as power.
    """

    cycle: str
    quantity: Literal["current_A", "power_W"] = "current_A"
    repeat: int = Field(default=1, ge=1)

    def intervals(self, vehicle: Vehicle, relative_to: Path | None) -> tuple[Array, Array]:
        path = resources.find(self.cycle, "loads", ".csv", relative_to=relative_to)
        time_s, speed_mps = read_series(path, "speed_mps")
        if speed_mps.min() < 0:
            row = int(speed_mps.argmin())
            raise ConfigError(path, key=f"speed_mps, row {row + 1}", value=float(speed_mps[row]), expected="at least 0")
        convert = vehicle.cell_current_A if self.quantity == "current_A" else vehicle.cell_power_W
        return np.diff(time_s), convert(time_s, speed_mps)


class Recording(Limits):
    """What a CSV holds, `repeat` times: the columns time_s and `quantity` (current_A, power_W or voltage_V).

    `current_positive` is the sign of currents and powers. `current_hold` tells which interval a row belongs to: the one
    that ends at its time, the one that begins there, or both, on a straight line between the rows.
    """

    csv: str
    quantity: Quantity = "current_A"
    current_positive: Literal["charge", "discharge"] = "discharge"
    current_hold: Literal["preceding", "following", "trapezoid"] = "preceding"
    repeat: int = Field(default=1, ge=1)

    def intervals(self, vehicle: Vehicle, relative_to: Path | None) -> tuple[Array, Array]:
        path = resources.find(self.csv, "loads", ".csv", relative_to=relative_to)
        time_s, value = read_series(path, self.quantity)
        ends = {"preceding": value[1:], "following": value[:-1], "trapezoid": (value[1:] + value[:-1]) / 2}
        is_charge = self.current_positive == "charge" and self.quantity != "voltage_V"
        return np.diff(time_s), ends[self.current_hold] * (-1.0 if is_charge else 1.0)


class _Held(Limits):
    """One value for a duration, under the key that is its quantity."""

    quantity: ClassVar[Quantity]
    repeat: ClassVar[int] = 1
    duration_s: float = Field(gt=0)

    def intervals(self, vehicle: Vehicle, relative_to: Path | None) -> tuple[Array, Array]:
        return np.array([self.duration_s]), np.array([getattr(self, self.quantity)])


class Current(_Held):
    """A constant cell current, positive = discharge."""

    quantity: ClassVar[Quantity] = "current_A"
    current_A: float


class Power(_Held):
    """A constant power at the plant's terminals, of all its cells in series; positive = discharge."""

    quantity: ClassVar[Quantity] = "power_W"
    power_W: float


class Voltage(_Held):
    """A constant voltage at the terminals of a plant that takes a voltage."""

    quantity: ClassVar[Quantity] = "voltage_V"
    voltage_V: float = Field(gt=0)


class Rest(Limits):
    """No current at all."""

    quantity: ClassVar[Quantity] = "current_A"
    repeat: ClassVar[int] = 1
    rest_s: float = Field(gt=0)

    def intervals(self, vehicle: Vehicle, relative_to: Path | None) -> tuple[Array, Array]:
        return np.array([self.rest_s]), np.array([0.0])


class Cccv(Limits):
    """Constant current until `voltage_V`, then that voltage held until the current is down to `cutoff_A`.

    Negative `cccv_A` charges, until the highest cell is there; positive discharges, until the lowest is. Ends after
    `max_duration_s` in any case.
    """

    cccv_A: float
    voltage_V: float = Field(gt=0)
    cutoff_A: float = Field(gt=0)
    max_duration_s: float = Field(default=86400.0, gt=0)

    @model_validator(mode="after")
    def _cutoff_is_below_the_current(self) -> Self:
        if self.cutoff_A >= abs(self.cccv_A):
            raise ValueError(f"cutoff_A below the current, which is {abs(self.cccv_A):g} A")
        return self


class Schedule(Limits):
    """Segments one after the other, all of them `repeat` times."""

    schedule: list[Segment] = Field(min_length=1)
    repeat: int = Field(default=1, ge=1)


_TELLING = ("cycle", "csv", "current_A", "power_W", "rest_s", "cccv_A", "schedule")
# `voltage_V` belongs to `cccv_A` too: it tells a segment that has none of the others.
KEYS = (*_TELLING, "voltage_V")


def _kind(segment: Any) -> str | None:
    """The one of `KEYS` that a segment has; None, which pydantic refuses, for none or several."""

    def has(key: str) -> bool:
        return key in segment if isinstance(segment, dict) else hasattr(segment, key)

    present = [key for key in _TELLING if has(key)]
    if not present:
        return "voltage_V" if has("voltage_V") else None
    return present[0] if len(present) == 1 else None


Segment = Annotated[
    Annotated[Drive, Tag("cycle")]
    | Annotated[Recording, Tag("csv")]
    | Annotated[Current, Tag("current_A")]
    | Annotated[Power, Tag("power_W")]
    | Annotated[Voltage, Tag("voltage_V")]
    | Annotated[Rest, Tag("rest_s")]
    | Annotated[Cccv, Tag("cccv_A")]
    | Annotated[Schedule, Tag("schedule")],
    Discriminator(_kind, custom_error_type="segment", custom_error_message=f"a table with one of {', '.join(KEYS)}"),
]
Schedule.model_rebuild()
