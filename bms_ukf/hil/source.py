"""The plant and its sensors, as the vehicle that sends what they measure: also when the plant fails."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from bms_ukf.errors import PlantError
from bms_ukf.faults.base import Injection
from bms_ukf.faults.plant import Crash, Hang, Nan, PlantFault
from bms_ukf.faults.sensor import SensorFaults
from bms_ukf.plant import PlantState, open_plant
from bms_ukf.records import NAN, PerCell, Sample
from bms_ukf.scenario import Scenario
from bms_ukf.sensors import SensorSet


class Source:
    """A context manager; `failure` says how the plant failed, if it has."""

    def __init__(self, scenario: Scenario, path: Path) -> None:
        self.failure: str | None = None
        self._scenario, self._path = scenario, path
        self._step_ns = round(scenario.step_s * 1e9)
        self._sensors = SensorSet(scenario.sensors)
        self._faults = SensorFaults(scenario.fault, scenario.sensors.seed, scenario.cells)
        self._planned: Sequence[Injection] = [fault for fault in scenario.fault if isinstance(fault, PlantFault)]

    def __enter__(self) -> Self:
        self._plant = open_plant(self._scenario.plant, self._path.parent)
        return self

    def __exit__(self, *error: object) -> None:
        self._plant.close()

    def step(self, load: float, t_ns: int) -> tuple[PlantState, Sample]:
        """The plant at `t_ns`, and what its sensors say then. Raises PlantError if it fails and the run is to end.

        Else nothing is measured and nothing is true from then on.
        """
        if self.failure is None:
            try:
                self._break(t_ns)
                true = self._plant.step(load, self._step_ns)
                return true, self._faults.spoil(self._measured(true))
            except PlantError as error:
                self.failure = error.kind
                if self._scenario.plant.on_failure == "end":
                    raise
        return PlantState(t_ns, current_A=NAN), self._faults.spoil(self._spread(Sample(t_ns)))

    def _break(self, t_ns: int) -> None:
        for fault in self._planned:
            if fault.active(t_ns):
                match fault:
                    case Hang():
                        self._plant.pause()
                    case Crash():
                        self._plant.kill()
                    case Nan():  # no shipped plant gives one: what the plant says is replaced
                        raise PlantError("a value that is not finite, as the scenario has it", "nan")

    def _measured(self, true: PlantState) -> Sample:
        sample = self._sensors.measure(
            true.t_ns, float(true.current_A), float(true.voltage_V), float(true.temperature_degC)
        )
        return self._spread(sample)

    def _spread(self, sample: Sample) -> Sample:
        """A plant of one cell stands for each of several in series."""
        cells = self._scenario.cells
        if cells > 1:
            sample.voltage_V = _each(sample.voltage_V, cells)
            sample.temperature_degC = _each(sample.temperature_degC, cells)
        return sample


def _each(value: PerCell, cells: int) -> PerCell:
    return np.full(cells, value) if isinstance(value, float) else value
