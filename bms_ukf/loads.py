"""What a cell is asked to deliver: drive cycles, recorded or constant current and rests, as current over time.

A load is written in TOML as a list of segments, each told by its own key:

    [load]
    repeat = 1                                          # the whole list, over and over
    segments = [
        { rest_s = 600 },
        { cycle = "wltc_3b", repeat = 4 },              # shipped speed trace, or a CSV with time_s,speed_mps
        { current_A = -2.5, duration_s = 1800 },        # constant cell current, positive = discharge
        { csv = "measured.csv", current_positive = "charge" },   # time_s,current_A
    ]

    [load.vehicle]                                      # optional: any field of Vehicle
    mass_kg = 1400
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from bms_ukf import resources
from bms_ukf.errors import ConfigError

Array = NDArray[np.float64]

GRAVITY = 9.80665  # m/s^2
AIR_DENSITY = 1.2  # kg/m^3, dry air at 20 degC and 1013 hPa


@dataclass(slots=True)
class Profile:
    """Cell current on a uniform grid, positive = discharge; each value is the mean over the step ending at its time."""

    t_ns: NDArray[np.int64]  # shape (n,); the first entry is one step after the start of the load
    current_A: Array  # shape (n,)

    @property
    def t_s(self) -> Array:
        return np.asarray(self.t_ns * 1e-9, dtype=np.float64)

    @property
    def charge_Ah(self) -> float:
        """Net charge drawn from one cell over the profile."""
        step_s = self.t_s[0] if self.t_ns.size else 0.0
        return float(self.current_A.sum() * step_s / 3600)


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Vehicle(_Settings):
    """Longitudinal road-load model on a level road, and the pack that feeds it. Defaults: a small electric car.

    Wheel force = mass_factor m dv/dt + c_rr m g + rho/2 CdA v^2. Braking power up to `regen_power_max_W` at the wheels
    is recovered, the friction brakes take the rest. The pack is taken at its nominal voltage, so that the current does
    not depend on any model of the cell.
    """

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
        """Mean current of one cell over each interval of a speed trace; shape (n - 1,), positive = discharge.

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
        return np.asarray(pack_W / (self.cells_series * self.cells_parallel * self.cell_voltage_nominal_V))


class Drive(_Settings):
    """A speed trace driven `repeat` times: a shipped name, or a CSV with the columns time_s,speed_mps."""

    cycle: str
    repeat: int = Field(default=1, ge=1)

    def intervals(self, vehicle: Vehicle, relative_to: Path | None) -> tuple[Array, Array]:
        path = resources.find(self.cycle, "loads", ".csv", relative_to=relative_to)
        time_s, speed_mps = read_series(path, "speed_mps")
        if speed_mps.min() < 0:
            row = int(speed_mps.argmin())
            raise ConfigError(path, key=f"speed_mps, row {row + 1}", value=float(speed_mps[row]), expected="at least 0")
        current_A = vehicle.cell_current_A(time_s, speed_mps)
        return np.tile(np.diff(time_s), self.repeat), np.tile(current_A, self.repeat)


class Recording(_Settings):
    """A cell current from a CSV with the columns time_s,current_A, `repeat` times.

    `current_hold` tells which interval a row's current belongs to: the one that ends at its time, the one that begins
    there, or both, on a straight line between the rows.
    """

    csv: str
    current_positive: Literal["charge", "discharge"] = "discharge"
    current_hold: Literal["preceding", "following", "trapezoid"] = "preceding"
    repeat: int = Field(default=1, ge=1)

    def intervals(self, vehicle: Vehicle, relative_to: Path | None) -> tuple[Array, Array]:
        path = resources.find(self.csv, "loads", ".csv", relative_to=relative_to)
        time_s, value_A = read_series(path, "current_A")
        ends = {"preceding": value_A[1:], "following": value_A[:-1], "trapezoid": (value_A[1:] + value_A[:-1]) / 2}
        sign = 1.0 if self.current_positive == "discharge" else -1.0
        return np.tile(np.diff(time_s), self.repeat), np.tile(sign * ends[self.current_hold], self.repeat)


class Constant(_Settings):
    """A constant cell current, positive = discharge."""

    current_A: float
    duration_s: float = Field(gt=0)

    def intervals(self, vehicle: Vehicle, relative_to: Path | None) -> tuple[Array, Array]:
        return np.array([self.duration_s]), np.array([self.current_A])


class Rest(_Settings):
    """No current at all."""

    rest_s: float = Field(gt=0)

    def intervals(self, vehicle: Vehicle, relative_to: Path | None) -> tuple[Array, Array]:
        return np.array([self.rest_s]), np.array([0.0])


_SEGMENT_KEYS = ("cycle", "csv", "current_A", "rest_s")


def _kind(segment: Any) -> str | None:
    """The one key of `_SEGMENT_KEYS` that a segment has; None, which pydantic refuses, for none or several."""
    present = [key for key in _SEGMENT_KEYS if (key in segment if isinstance(segment, dict) else hasattr(segment, key))]
    return present[0] if len(present) == 1 else None


Segment = Annotated[
    Annotated[Drive, Tag("cycle")]
    | Annotated[Recording, Tag("csv")]
    | Annotated[Constant, Tag("current_A")]
    | Annotated[Rest, Tag("rest_s")],
    Discriminator(
        _kind, custom_error_type="segment", custom_error_message=f"a table with one of {', '.join(_SEGMENT_KEYS)}"
    ),
]


class Load(_Settings):
    """The `[load]` table of a scenario: segments one after the other, the whole list `repeat` times."""

    segments: list[Segment] = Field(min_length=1)
    repeat: int = Field(default=1, ge=1)
    vehicle: Vehicle = Vehicle()

    def profile(self, step_s: float, *, relative_to: Path | None = None) -> Profile:
        """The load on a uniform grid of `step_s`; every step carries the exact charge of its interval.

        A last stretch shorter than a step is left out. File names are looked up in `relative_to` first. Raises
        ConfigError for a file that is missing or malformed, and for a load shorter than one step.
        """
        parts = [segment.intervals(self.vehicle, relative_to) for segment in self.segments] * self.repeat
        duration_s = np.concatenate([part[0] for part in parts])
        current_A = np.concatenate([part[1] for part in parts])
        time_s = np.concatenate([[0.0], np.cumsum(duration_s)])
        charge_As = np.concatenate([[0.0], np.cumsum(current_A * duration_s)])
        step_ns = round(step_s * 1e9)
        # The margin keeps the last step when sums of decimal durations fall short of it by rounding.
        steps = math.floor(time_s[-1] * 1e9 / step_ns + 1e-6) if step_ns > 0 else 0
        if steps < 1:
            expected = f"a step_s above 0 and within the load's {time_s[-1]:g} s"
            raise ConfigError("load", key="step_s", value=step_s, expected=expected)
        t_ns = np.arange(steps + 1, dtype=np.int64) * step_ns
        charge_on_grid_As = np.interp(t_ns * 1e-9, time_s, charge_As)
        return Profile(t_ns[1:], np.diff(charge_on_grid_As) / (step_ns * 1e-9))


def read_series(path: Path, column: str) -> tuple[Array, Array]:
    """The columns `time_s` and `column` of a CSV: at least two rows, finite, time increasing. Others are ignored.

    Raises ConfigError naming the file, the column and the row (the header is row 0).
    """
    with path.open(newline="", encoding="utf-8-sig") as file:
        try:
            reader = csv.DictReader(file)
            missing = [name for name in ("time_s", column) if name not in (reader.fieldnames or ())]
            if missing:
                header = f"a header row with the columns time_s,{column}"
                raise ConfigError(path, key=missing[0], value=",".join(reader.fieldnames or ()), expected=header)
            rows = [(row["time_s"], row[column]) for row in reader]
        except UnicodeDecodeError:
            raise ConfigError(path, expected=f"a text file with the columns time_s,{column}") from None
    time_s = _numbers(path, "time_s", (row[0] for row in rows))
    value = _numbers(path, column, (row[1] for row in rows))
    if time_s.size < 2:
        raise ConfigError(path, value=f"{time_s.size} rows", expected="at least two rows below the header")
    if not np.all(np.diff(time_s) > 0):
        row_index = int(np.argmin(np.diff(time_s) > 0)) + 1
        expected = f"a time after that of the row before, {time_s[row_index - 1]:g}"
        raise ConfigError(path, key=f"time_s, row {row_index + 1}", value=float(time_s[row_index]), expected=expected)
    return time_s, value


def _numbers(path: Path, column: str, texts: Iterable[str | None]) -> Array:
    numbers = []
    for row, text in enumerate(texts, start=1):
        try:
            number = float(text or "")
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ConfigError(path, key=f"{column}, row {row}", value=text, expected="a finite number")
        numbers.append(number)
    return np.array(numbers)
