"""The daemon's configuration: which cell, which bus, which signals. `models/configs/example.toml` shows every key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, ValidationError, ValidationInfo, field_validator, model_validator

from bms_ukf import resources, toml
from bms_ukf.alignment import Alignment
from bms_ukf.cell import CellParams
from bms_ukf.dbc import Matrix
from bms_ukf.decoder import Decoder
from bms_ukf.e2e_settings import E2e
from bms_ukf.errors import ConfigError
from bms_ukf.estimator import Estimator
from bms_ukf.intake import Intake
from bms_ukf.logsetup import Log
from bms_ukf.open_circuit import OpenCircuit
from bms_ukf.pace import Pace
from bms_ukf.pack import Health, Limits
from bms_ukf.pack_output import CELL_SOC_PERIOD_S, PackOutput
from bms_ukf.scaling import scaled
from bms_ukf.sensor_spec import SensorSpec
from bms_ukf.signal_scale import check_scale, resolutions
from bms_ukf.signals import Sign, SignalMap
from bms_ukf.tuning import Tuning
from bms_ukf.units import BASE
from bms_ukf.wiring import Wiring

Text = Annotated[str, Field(min_length=1)]
Scale = Annotated[float, Field(ge=1e-3, le=1e3)]
Index = Annotated[int, Field(ge=1, le=400)]
OneOrMore = BeforeValidator(lambda given: [given] if isinstance(given, str) else given)
Lag = Annotated[float, Field(ge=0, le=60)]


class Bus(toml.Section):
    """[bus]: the python-can interface and its channel."""

    interface: Text
    channel: Text
    bitrate: Annotated[int, Field(gt=0)] | None = None  # SocketCAN takes it from `ip link`, others need it here
    fd: bool = False  # CAN FD frames are read, too
    receive_buffer_bytes: Annotated[int, Field(ge=4096, le=1 << 28)] = 1 << 20  # of SocketCAN; some 900 a frame
    options: dict[str, Any] = Field(default_factory=dict)  # further arguments of that python-can interface


class Lags(toml.Section):
    """lag_s: how long after its instant a signal of a role arrives."""

    current: Lag = 0.0
    voltage: Lag = 0.0
    temperature: Lag = 0.0


class Signals(toml.Section):
    """[signals]: which "Message.Signal" of the user's DBC files plays which role; without it, our own `bms.dbc`."""

    dbc: Annotated[list[Text], Field(min_length=1)]  # relative to the configuration file
    current: Annotated[list[Text], Field(min_length=1), OneOrMore]  # one, or one for each string of pack.string_of
    current_positive: Annotated[list[Sign], Field(min_length=1), OneOrMore]  # one for all of these, or one for each
    cell_voltage: list[Text] = Field(default_factory=list)  # one a cell, in order
    pack_voltage: Text | None = None  # in place of cell_voltage: the string is estimated as its mean cell
    series_cells: Annotated[int, Field(ge=1)] = 1  # how many cells pack_voltage is the sum of
    parallel_cells: Annotated[int, Field(ge=1)] = 1  # how many cells share the current, or that of their string
    temperature: Annotated[list[Text], Field(min_length=1)]  # one for all cells, or one a cell
    contactor: Text | None = None
    contactor_open: list[int | Text] = Field(default_factory=list)  # raw values, or their names, with no current
    balancing: list[Text] = Field(default_factory=list)  # one a cell: its bleed current, or a flag that is 1 with it
    not_available: dict[str, list[int]] = Field(default_factory=dict)  # raw values that mean "no value"
    plausible: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = Field(default_factory=dict)
    unit: dict[str, Text] = Field(default_factory=dict)  # where the DBC gives none, or a wrong one
    lag_s: Lags = Field(default_factory=Lags)
    e2e: dict[str, E2e] = Field(default_factory=dict)  # by message

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if bool(self.cell_voltage) == bool(self.pack_voltage):
            raise ValueError("either cell_voltage or pack_voltage")
        if bool(self.contactor) != bool(self.contactor_open):
            raise ValueError("contactor and contactor_open together or not at all")
        return self


class State(toml.Section):
    """[state]: where what is known of the battery outlives the process."""

    file: Text  # in systemd's state folder of the service, else relative to the configuration file
    period_s: Annotated[float, Field(ge=0.1, le=3600)] = 10.0
    max_age_s: Annotated[float, Field(gt=0)] = 2_592_000.0  # an older one is not used


class Recorder(toml.Section):
    """[recorder]: the last minutes before a fault, in a file that can be replayed."""

    folder: Text  # as for the state
    span_s: Annotated[float, Field(ge=10, le=3600)] = 120.0
    keep: Annotated[int, Field(ge=1, le=1000)] = 10  # files


class Metrics(toml.Section):
    """[metrics]: for Prometheus, on this machine only."""

    port: Annotated[int, Field(ge=1, le=65535)]


class PackUse(Limits):
    """[pack]: how its cells are wired, within what they are used, and what is published of it."""

    sensor_of: list[Index] | None = None  # the temperature signal of each cell, counted from 1
    string_of: list[Index] | None = None  # the string of each cell, counted from 1, each with a current of its own
    bleed_A: Annotated[float, Field(gt=0, le=100)] | None = None  # taken from a cell while its flag of balancing is 1
    cell_soc_period_s: Annotated[float, Field(ge=0.1, le=3600)] = CELL_SOC_PERIOD_S  # in which every cell's is sent


class Config(toml.Document):
    """A whole CONFIG.toml."""

    cell: Text  # a cell file, or the name of a shipped one
    cells: Annotated[int, Field(ge=1, le=400)] = 1  # how many are measured one by one
    capacity_scale: Scale = 1.0  # a cell of the same family, so many times as large
    resistance_scale: Scale | None = None  # None: 1 / capacity_scale
    silence_s: Annotated[float, Field(gt=0)] = 2.0  # without input for so long, a prediction is published instead
    transmit: Literal["on_update", "periodic"] = "on_update"  # after each scan of the voltages, or every period_s
    period_s: Annotated[float, Field(ge=0.005, le=10)] = 0.1
    soc_slew_per_s: Annotated[float, Field(gt=0, le=1)] = 0.001  # how fast SocSlewed may be corrected
    health: bool = True  # tell capacity and resistance of each cell from its use, and count SoC by that capacity
    bus: Bus
    signals: Signals | None = None
    pack: PackUse | None = None  # what is known of a pack is published with it, and of several cells without it, too
    state: State | None = None
    recorder: Recorder | None = None
    metrics: Metrics | None = None
    log: Log = Field(default_factory=Log)
    sensor_spec: SensorSpec | None = None  # None: that of [estimator]
    estimator: Tuning = Field(default_factory=Tuning)

    @field_validator("estimator")
    @classmethod
    def _one_sensor_spec(cls, estimator: Tuning, info: ValidationInfo) -> Tuning:
        if info.data.get("sensor_spec") is not None and "sensor_spec" in estimator.model_fields_set:
            raise ValueError("no sensor_spec in it beside the table [sensor_spec]")
        return estimator

    def tuning(self, cell: CellParams | None, source: Path) -> Tuning:
        """Return [estimator] with [sensor_spec]. Raises ConfigError naming `source` if `cell` contradicts it."""
        if self.sensor_spec is None:
            tuning, key = self.estimator, "estimator.sensor_spec"
        else:
            tuning, key = self.estimator.model_copy(update={"sensor_spec": self.sensor_spec}), "sensor_spec"
        if cell is not None:
            tuning.check(cell, source, key)
        return tuning


class Setup:
    """A configuration with everything it names loaded and checked; ConfigError for the first thing that is wrong."""

    def __init__(self, config: Config, source: Path, cell: CellParams | None = None) -> None:
        """`cell`: in place of the one the configuration names, before it is scaled."""
        self.config, self.source = config, source
        self.cell = self._cell(cell)
        self.wiring = self._wiring()
        self.warnings: list[str] = []
        self.decoder = self._decoder()
        if config.signals is not None:
            for bound in self.decoder.bound:
                if bound.role in BASE:
                    check_scale(bound, self.cell, source)
                self.warnings += [bound.warning] if bound.warning else []
        tuning = config.tuning(self.cell, source)
        spec = tuning.sensor_spec.with_resolution(resolutions(self.decoder.bound))
        self.tuning = tuning.model_copy(update={"sensor_spec": spec})

    @property
    def pace(self) -> Pace:
        """When sets of frames are published."""
        config = self.config
        return Pace(config.silence_s, config.period_s if config.transmit == "periodic" else None, config.soc_slew_per_s)

    @classmethod
    def load(cls, path: str | Path, cell: CellParams | None = None) -> Self:
        """The configuration in a file; `cell` as of the class itself."""
        source = Path(path)
        return cls(toml.load(source, Config), source, cell)

    def intake(self) -> Intake:
        """The way in for frames of that bus."""
        signals = self.config.signals
        if signals is None:
            return Intake(self.decoder)
        sigma_A = self.tuning.sensor_spec.current_offset_sigma_A(self.cell.cell.capacity_Ah)
        circuit = OpenCircuit(3 * sigma_A) if signals.contactor is not None else None
        lag = signals.lag_s
        return Intake(self.decoder, circuit, Alignment(lag.current, lag.voltage, lag.temperature))

    def estimator(self) -> Estimator:
        """One that has seen nothing."""
        return Estimator(self.cell, self.config.cells, self.tuning, wiring=self.wiring)

    def pack_output(self, estimator: Estimator) -> PackOutput | None:
        """What is published beyond the SoC; None: nothing, as of a single cell unless it is configured."""
        if self.config.pack is None and self.config.cells == 1:
            return None
        use = self.config.pack or PackUse()
        return PackOutput(estimator, use, use.cell_soc_period_s)

    def health(self, estimator: Estimator) -> Health | None:
        """What is told of how its cells age; None if the configuration does not want it."""
        return Health(estimator) if self.config.health else None

    def _wiring(self) -> Wiring:
        pack, cells = self.config.pack or PackUse(), self.config.cells
        for key, what in (("sensor_of", "sensor"), ("string_of", "string")):
            numbers = getattr(pack, key)
            if numbers is not None and len(numbers) != cells > 1:
                expected = f"the number of a {what} for each of {cells} cells, not of {len(numbers)}"
                raise ConfigError(self.source, key=f"pack.{key}", expected=expected)
        sensors = None if pack.sensor_of is None or cells == 1 else [sensor - 1 for sensor in pack.sensor_of]
        strings = None if self._strings() == 1 else [string - 1 for string in pack.string_of or ()]
        return Wiring(sensors, strings)

    def _strings(self) -> int:
        """How many there are, each with a current of its own. ConfigError unless signals and cells agree on it."""
        string_of, signals = (self.config.pack or PackUse()).string_of, self.config.signals
        known = set(string_of or [1])
        strings = max(known) if signals is None else len(signals.current)
        if strings > 1 and string_of is None:
            expected = f"the string of each cell, for the {strings} currents of signals.current"
            raise ConfigError(self.source, key="pack.string_of", expected=expected)
        if strings > 1 and self.config.cells == 1:
            expected = f"more than one, measured one by one, for {strings} strings"
            raise ConfigError(self.source, key="cells", value=1, expected=expected)
        if known != set(range(1, strings + 1)):
            has = "" if signals is None else ", as many as signals.current has"
            expected = f"strings 1 to {strings}{has}, each with a cell"
            raise ConfigError(self.source, key="pack.string_of", value=sorted(known), expected=expected)
        return strings

    def _cell(self, cell: CellParams | None) -> CellParams:
        config = self.config
        if cell is None:
            cell = CellParams.load(resources.find(config.cell, "cells", ".toml", relative_to=self.source.parent))
        if config.capacity_scale == 1.0 and config.resistance_scale is None:
            return cell
        try:
            return scaled(cell, config.capacity_scale, config.resistance_scale)
        except ValidationError as error:
            expected = f"a cell that can be ({error.errors()[0]['msg']})"
            raise ConfigError(
                self.source, key="capacity_scale", value=config.capacity_scale, expected=expected
            ) from None

    def _decoder(self) -> Decoder:
        cells, signals, pack = self.config.cells, self.config.signals, self.config.pack or PackUse()
        if pack.bleed_A is not None and (signals is None or not signals.balancing):
            raise ConfigError(self.source, key="pack.bleed_A", value=pack.bleed_A, expected="it with signals.balancing")
        if signals is None:
            sensors = max(pack.sensor_of or [1])
            own = SignalMap.default(cells, sensors, self.wiring.strings)
            return Decoder(own, cells=cells, wired=sensors > 1, source=self.source)
        matrix = Matrix([self.source.parent / name for name in signals.dbc], strict=False)
        self.warnings += matrix.warnings
        protected = {name: e2e.made(name, matrix, self.source) for name, e2e in signals.e2e.items()}
        sensor_of = pack.sensor_of
        if sensor_of is not None and max(sensor_of) != len(signals.temperature):
            expected = f"sensors 1 to {len(signals.temperature)}, as many as signals.temperature has"
            raise ConfigError(self.source, key="pack.sensor_of", value=max(sensor_of), expected=expected)
        named = signals.model_dump(exclude={"dbc", "lag_s", "e2e"})
        roles = SignalMap(**named, e2e=protected, bleed_A=pack.bleed_A)
        return Decoder(roles, matrix, cells=cells, wired=sensor_of is not None, source=self.source)
