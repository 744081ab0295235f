"""The plant and its sensors, as the vehicle that sends what they measure: also when the plant fails."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import numpy as np

from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.faults.base import Injection
from bms_ukf.faults.plant import Crash, Hang, Nan, PlantFault
from bms_ukf.faults.sensor import SensorFaults
from bms_ukf.plant import PlantState, open_plant
from bms_ukf.records import NAN, PerCell, Sample
from bms_ukf.scenario import Scenario
from bms_ukf.sensors import SensorSet


class Source:
    """A context manager; entered, the plant is at t = 0. `failure` says how it failed, if it has."""

    def __init__(self, scenario: Scenario, path: Path) -> None:
        self.failure: str | None = None
        self._scenario, self._path = scenario, path
        self._step_ns = round(scenario.step_s * 1e9)
        self._sensors = SensorSet(scenario.sensors)
        self._faults = SensorFaults(scenario.fault, scenario.sensors.seed, scenario.cells)
        sensor_of = np.array(scenario.daemon.sensor_of(scenario.cells))
        sensors = range(scenario.daemon.temperature_sensors)
        self._felt = [int(np.median(np.flatnonzero(sensor_of == sensor))) for sensor in sensors]  # cells with a sensor
        self._planned: Sequence[Injection] = [fault for fault in scenario.fault if isinstance(fault, PlantFault)]

    def __enter__(self) -> Self:
        scenario, folder = self._scenario, self._path.parent
        with ExitStack() as undo:
            self._plant = undo.enter_context(open_plant(scenario.plant, folder))
            driven_by = self._plant.input or "current_A"  # a part of the plant drives it: the load says how long
            self._demand = scenario.load.demand(scenario.step_s, plant_input=driven_by, relative_to=folder)
            self._undo = undo.pop_all()
        return self

    @property
    def steps_at_most(self) -> int:
        return self._demand.steps_at_most

    def __exit__(self, *error: object) -> None:
        self._undo.close()

    def step(self, t_ns: int) -> tuple[PlantState, Sample] | None:
        """The plant at `t_ns`, and what its sensors say then; None if the load was over before.

        Raises PlantError if the plant fails and the run is to end, else nothing is measured and true from then on.
        """
        state = self._plant.state
        asked = self._demand.next(state.voltage_V, state.soc, float(state.current_A))
        if asked is None:
            return None
        if self.failure is None:
            try:
                self._break(t_ns)
                true = self._plant.step(asked, self._step_ns)
                return true, self._sent(self._measured(true))
            except PlantError as error:
                self.failure = error.kind
                if self._scenario.plant.on_failure == "end":
                    raise
        nothing = Sample(t_ns, voltage_V=self._each(NAN), temperature_degC=self._each(NAN))
        return PlantState(t_ns, current_A=NAN), self._sent(nothing)

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
        """A plant of one cell stands for each of several in series."""
        voltage_V, temperature_degC = self._each(true.voltage_V), self._each(true.temperature_degC)
        return self._sensors.measure(true.t_ns, float(true.current_A), voltage_V, temperature_degC)

    def _sent(self, sample: Sample) -> Sample:
        """What the faults of sensors leave of a sample, with the temperatures of the cells that have a sensor."""
        sample = self._faults.spoil(sample)
        if not isinstance(sample.temperature_degC, float):
            sample.temperature_degC = sample.temperature_degC[self._felt]
        return sample

    def _each(self, value: PerCell) -> PerCell:
        cells = self._scenario.cells
        if isinstance(value, float):
            return np.full(cells, value) if cells > 1 else value
        if len(value) != cells:
            expected = f"{len(value)}, as many as the plant has"
            raise ConfigError(self._path, key="cells", value=cells, expected=expected)
        return value if cells > 1 else float(value[0])
