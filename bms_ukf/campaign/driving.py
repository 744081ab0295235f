"""Runs a load on a plant and keeps what was true, row by row."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf.campaign.traces import CURRENT_A  # the plant is given no current that a trace could not hold
from bms_ukf.loads import Load
from bms_ukf.plant import PlantState, open_plant

Array = NDArray[np.float64]


class Leg(NamedTuple):
    """A `[load]` table at an ambient temperature, in steps of so many seconds."""

    load: Mapping[str, Any]
    ambient_degC: float
    step_s: float = 1.0


class Run(NamedTuple):
    """What was true in the last leg; row k at the end of its step k."""

    current_A: Array  # (rows,), positive = discharge
    voltage_V: Array  # (rows, cells)
    temperature_degC: Array  # (rows, cells)
    soc: Array  # (rows, cells)
    soc_start: Array  # (cells,), before the first row


def drive(fmu: Path | str, parameters: Mapping[str, float], *legs: Leg) -> Run:
    """Runs the legs one after the other, from rest. A leg starts when the limits of the one before it end it."""
    with open_plant(fmu, parameters=dict(parameters), ambient_degC=legs[0].ambient_degC) as plant:
        for leg in legs:
            plant.set_ambient(leg.ambient_degC)
            soc_start = np.atleast_1d(plant.state.soc)
            demand = Load.model_validate(leg.load).demand(leg.step_s)
            step_ns = round(leg.step_s * 1e9)
            current_A: list[float] = []
            states: list[PlantState] = []
            while (asked := demand.next(plant.state.voltage_V, plant.state.soc)) is not None:
                current_A.append(round(asked / CURRENT_A) * CURRENT_A)
                states.append(plant.step(current_A[-1], step_ns))
    voltage_V, temperature_degC, soc = (_rows(states, name) for name in ("voltage_V", "temperature_degC", "soc"))
    return Run(np.array(current_A), voltage_V, temperature_degC, soc, soc_start)


def _rows(states: list[PlantState], name: str) -> Array:
    return np.array([np.atleast_1d(getattr(state, name)) for state in states])
