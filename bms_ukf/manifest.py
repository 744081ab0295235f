"""MANIFEST.toml: which measured tests there are of a cell, and which of them a model may be fitted to."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bms_ukf import toml
from bms_ukf.cell import Temperature
from bms_ukf.errors import ConfigError

DATA_FOLDER = "BMS_UKF_DATA"  # environment variable: where a manifest's files are looked for after its own folder

Part = Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=2, max_length=2)]


Cell = float | str


class Columns(toml.Section):
    """The headers of quantities that the file calls otherwise. A unit in the header counts before the key's."""

    time_s: str | None = None
    current_A: str | None = None
    voltage_V: str | None = None
    temperature_degC: str | None = None
    ah: str | None = None
    soc_ref: str | None = None
    hysteresis_V: str | None = None  # of an ocv_table: half of charge branch minus discharge branch

    def named(self) -> dict[str, str]:
        """Header by quantity, for those that are given."""
        return {key: title for key, title in self if title is not None}


class MeasuredTest(toml.Section):
    """[[test]]: one file, or some rows of one."""

    role: Literal["ocv", "ocv_table", "pulse", "drive", "charge"]
    file: str
    columns: Columns = Field(default_factory=Columns)
    where: dict[str, Cell | list[Cell]] = Field(default_factory=dict)  # header: what the test's rows have there
    temperature_degC: Temperature
    use: Literal["fit", "validate"] = "fit"
    part: Part = Field(default_factory=lambda: [0.0, 1.0])  # of its rows; the others are simulated, and do not count
    direction: Literal["charge", "discharge"] | None = None  # of an ocv file that holds one only
    initial_soc: Annotated[float, Field(ge=-0.05, le=1.05)] | Literal["rest"] | None = None  # None: soc_ref, else full
    voltage_lag_s: Annotated[float, Field(ge=-10, le=10)] | Literal["estimate"] = 0.0
    current_positive: Literal["charge", "discharge"] | None = None  # default: the manifest's
    current_hold: Literal["preceding", "following", "trapezoid"] = "preceding"
    group: Literal["standard", "mixed"] = "standard"
    soc_ref_sigma: Annotated[float, Field(ge=0, lt=0.5)] = 0.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.part[0] >= self.part[1]:
            raise ValueError("part as [from, to] with from < to")
        if self.initial_soc == "rest" and self.role in ("ocv", "ocv_table"):
            raise ValueError("initial_soc as a number: 'rest' looks it up on the OCV that this test gives")
        return self


class Manifest(toml.Document):
    """The tests of one cell. Made by `load`."""

    cell: Annotated[str, Field(min_length=1)]
    chemistry: str
    capacity_Ah: Annotated[float, Field(gt=0, le=2000)] | None = None  # at 25 degC; None: from the OCV test
    current_positive: Literal["charge", "discharge"]
    voltage_limits_V: Annotated[list[Annotated[float, Field(gt=0.5, lt=6)]], Field(min_length=2, max_length=2)]
    test: Annotated[list[MeasuredTest], Field(min_length=1)]

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if self.voltage_limits_V[0] >= self.voltage_limits_V[1]:
            raise ValueError("voltage_limits_V as [lower, upper]")
        return self

    @classmethod
    def load(cls, path: Path) -> Self:
        """The manifest at `path`. Raises ConfigError naming file, key and value."""
        return toml.load(path, cls)


def find(manifest: Path, file: str) -> Path:
    """The path of a test's file: beside the manifest, else in the folder `BMS_UKF_DATA` names.

    Raises ConfigError when it is in neither.
    """
    folders = [manifest.parent]
    if os.environ.get(DATA_FOLDER):
        folders.append(Path(os.environ[DATA_FOLDER]).expanduser())
    for folder in folders:
        if (folder / file).is_file():
            return folder / file
    places = " or in ".join(str(folder) for folder in folders)
    hint = "" if len(folders) > 1 else f"; set {DATA_FOLDER} to look elsewhere too"
    raise ConfigError(manifest, key="test.file", value=file, expected=f"a file in {places}{hint}")
