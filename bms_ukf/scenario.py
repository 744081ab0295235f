"""A scenario: plant, load, sensors, bus and estimator; what goes wrong, and what is expected of the daemon then.

`models/scenarios/demo.toml` shows every table of a drive, `models/scenarios/faults.toml` those of a test.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bms_ukf import resources, toml
from bms_ukf.expectations import Expectation
from bms_ukf.faults import Fault
from bms_ukf.faults.sensor import SensorFault
from bms_ukf.loads import Load
from bms_ukf.plant import PlantTable
from bms_ukf.sensors import Sensors
from bms_ukf.tuning import Tuning

Text = Annotated[str, Field(min_length=1)]


class BusTable(toml.Section):
    """[bus]: what lies between plant and estimator."""

    interface: Text = "direct"  # "direct": no bus; "virtual": in this process; else a python-can interface
    channel: Text = "bms-ukf"


class EstimatorTable(toml.Section):
    """[estimator]: the cell file, and the tuning in [estimator.tuning]."""

    cell: Text
    tuning: Tuning = Field(default_factory=Tuning)


class DaemonTable(toml.Section):
    """[daemon]: what `bms-ukf hil` puts into the daemon's configuration beside cell, bus and tuning; see `config`."""

    silence_s: Annotated[float, Field(gt=0)] = 2.0
    transmit: Literal["on_update", "periodic"] = "on_update"
    period_s: Annotated[float, Field(ge=0.005, le=10)] = 0.1
    state_period_s: Annotated[float, Field(ge=0.1, le=3600)] = 60.0
    temperature_sensors: Annotated[int, Field(ge=1, le=400)] = 1  # each for as many cells in a row, on the middle one

    def sensor_of(self, cells: int) -> list[int]:
        """The number of the sensor of each cell, from 0."""
        return [cell * self.temperature_sensors // cells for cell in range(cells)]


class PaceTable(toml.Section):
    """[pace]: how fast `bms-ukf hil` goes where the daemon is in its process; another process sets its own pace."""

    mode: Literal["lockstep", "realtime"] = "lockstep"


class Scenario(toml.Document):
    """A whole SCENARIO.toml."""

    name: Text
    step_s: Annotated[float, Field(gt=0, le=3600)] = 1.0  # of the plant, the sensors and the frames
    cells: Annotated[int, Field(ge=1, le=400)] = 1  # how many are measured one by one
    plant: PlantTable
    load: Load
    sensors: Sensors = Field(default_factory=Sensors)
    bus: BusTable = Field(default_factory=BusTable)
    estimator: EstimatorTable
    daemon: DaemonTable = Field(default_factory=DaemonTable)
    pace: PaceTable = Field(default_factory=PaceTable)
    fault: list[Fault] = Field(default_factory=list)
    expect: list[Expectation] = Field(default_factory=list)

    @model_validator(mode="after")
    def _current_is_held_over_a_step(self) -> Self:
        timeout_s = self.estimator.tuning.current_timeout_s
        if self.step_s > timeout_s:
            raise ValueError(f"step_s of at most estimator.tuning.current_timeout_s, which is {timeout_s:g} s")
        return self

    @model_validator(mode="after")
    def _names_mean_something(self) -> Self:
        labels = [fault.label for fault in self.fault]
        if twice := {label for label in labels if labels.count(label) > 1}:
            raise ValueError(f"fault: a name of its own for each (several are called {', '.join(sorted(twice))})")
        for expectation in self.expect:
            name = expectation.refers_to()
            if name is not None and name not in labels:
                raise ValueError(f"expect: a fault of this file, not {name!r} (it has {', '.join(labels) or 'none'})")
        for fault in self.fault:
            if isinstance(fault, SensorFault) and fault.cell is not None and fault.cell > self.cells:
                raise ValueError(f"fault: cell of at most {self.cells}, as many as there are, not {fault.cell}")
        if self.daemon.temperature_sensors > self.cells:
            raise ValueError(f"daemon.temperature_sensors of at most {self.cells}, as many as there are cells")
        return self


def load(given: str | Path) -> tuple[Scenario, Path]:
    """A scenario file, or a shipped scenario by name, with the path it was found at."""
    path = resources.find(given, "scenarios", ".toml")
    return toml.load(path, Scenario), path
