"""The daemon's configuration: which cell, which bus, which signals. `models/configs/example.toml` shows every key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from bms_ukf import resources, toml
from bms_ukf.cell import CellParams
from bms_ukf.codec import Decoder, SignalMap
from bms_ukf.dbc import Matrix
from bms_ukf.tuning import Tuning

Text = Annotated[str, Field(min_length=1)]


class Bus(toml.Section):
    """[bus]: the python-can interface and its channel."""

    interface: Text
    channel: Text
    bitrate: Annotated[int, Field(gt=0)] | None = None  # SocketCAN takes it from `ip link`, others need it here
    options: dict[str, Any] = Field(default_factory=dict)  # further arguments of that python-can interface


class Signals(toml.Section):
    """[signals]: which "Message.Signal" of the user's DBC files plays which role; without it, our own `bms.dbc`."""

    dbc: Annotated[list[Text], Field(min_length=1)]  # relative to the configuration file
    current: Text
    current_positive: Literal["charge", "discharge"]
    cell_voltage: list[Text] = Field(default_factory=list)  # one a cell, in order
    pack_voltage: Text | None = None  # in place of cell_voltage: the string is estimated as its mean cell
    series_cells: Annotated[int, Field(ge=1)] = 1  # how many cells pack_voltage is the sum of
    temperature: Annotated[list[Text], Field(min_length=1)]  # one for all cells, or one a cell
    not_available: dict[str, list[int]] = Field(default_factory=dict)  # raw values that mean "no value"

    @model_validator(mode="after")
    def _one_voltage(self) -> Self:
        if bool(self.cell_voltage) == bool(self.pack_voltage):
            raise ValueError("either cell_voltage or pack_voltage")
        return self


class Config(toml.Document):
    """A whole CONFIG.toml."""

    cell: Text  # a cell file, or the name of a shipped one
    cells: Annotated[int, Field(ge=1, le=400)] = 1  # how many are measured one by one
    silence_s: Annotated[float, Field(gt=0)] = 2.0  # without input for so long, a prediction is published instead
    bus: Bus
    signals: Signals | None = None
    estimator: Tuning = Field(default_factory=Tuning)


class Setup:
    """A configuration with everything it names loaded and checked; ConfigError for the first thing that is wrong."""

    def __init__(self, config: Config, source: Path) -> None:
        self.config, self.source = config, source
        cell_path = resources.find(config.cell, "cells", ".toml", relative_to=source.parent)
        self.cell = CellParams.load(cell_path)
        self.warnings: list[str] = []
        self.decoder = self._decoder()

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The configuration in a file."""
        source = Path(path)
        return cls(toml.load(source, Config), source)

    def _decoder(self) -> Decoder:
        cells, signals = self.config.cells, self.config.signals
        if signals is None:
            return Decoder(cells=cells, source=self.source)
        files = [self.source.parent / name for name in signals.dbc]
        matrix = Matrix(files, strict=False)
        self.warnings += matrix.warnings
        roles = SignalMap(**signals.model_dump(exclude={"dbc"}))
        return Decoder(roles, matrix, cells=cells, source=self.source)
