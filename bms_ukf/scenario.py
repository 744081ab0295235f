"""A co-simulation scenario: plant, load, sensors, bus and estimator. `models/scenarios/demo.toml` shows every table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from bms_ukf import resources, toml
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


class Scenario(toml.Document):
    """A whole SCENARIO.toml."""

    name: Text
    step_s: Annotated[float, Field(gt=0, le=3600)] = 1.0  # of the plant, the sensors and the frames
    plant: PlantTable
    load: Load
    sensors: Sensors = Field(default_factory=Sensors)
    bus: BusTable = Field(default_factory=BusTable)
    estimator: EstimatorTable

    @model_validator(mode="after")
    def _current_is_held_over_a_step(self) -> Self:
        timeout_s = self.estimator.tuning.current_timeout_s
        if self.step_s > timeout_s:
            raise ValueError(f"step_s of at most estimator.tuning.current_timeout_s, which is {timeout_s:g} s")
        return self


def load(given: str | Path) -> tuple[Scenario, Path]:
    """A scenario file, or a shipped scenario by name, with the path it was found at."""
    path = resources.find(given, "scenarios", ".toml")
    return toml.load(path, Scenario), path
