"""Which signal plays which role, and how its raw value becomes a number in the project's units and sign."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from cantools.database.can import Message, Signal

from bms_ukf.dbc import Extract, Field, Matrix
from bms_ukf.e2e import Profile
from bms_ukf.errors import ConfigError
from bms_ukf.units import BASE, Conversion, Quantity, conversion, known

Sign = Literal["charge", "discharge"]
Role = Literal["current", "voltage", "temperature", "contactor", "balancing"]


@dataclass(frozen=True, slots=True)
class SignalMap:
    """Which signal, as "Message.Signal", plays which role."""

    current: str | Sequence[str]  # of several strings one each, in order
    current_positive: Sign | Sequence[Sign]  # of all of them, or of each
    cell_voltage: Sequence[str] = ()  # one a cell, in order
    pack_voltage: str | None = None  # in place of cell_voltage: the string is estimated as one mean cell
    series_cells: int = 1  # how many cells pack_voltage is the sum of
    parallel_cells: int = 1  # how many cells share the current, or that of their string
    temperature: Sequence[str] = ()  # one for all cells, or one a cell
    contactor: str | None = None
    contactor_open: Sequence[int | str] = ()  # its raw values, or their names, with which no current can flow
    balancing: Sequence[str] = ()  # one a cell: a current, or a flag that is 1 while the cell is bled and 0 while not
    bleed_A: float | None = None  # what is taken while such a flag is 1, above 0
    not_available: Mapping[str, Sequence[int]] = field(default_factory=dict)  # raw values the DBC does not name
    plausible: Mapping[str, Sequence[float]] = field(default_factory=dict)  # [lowest, highest] in the signal's unit
    unit: Mapping[str, str] = field(default_factory=dict)  # of signals to which the DBC gives none, or a wrong one
    e2e: Mapping[str, Profile] = field(default_factory=dict)  # by message: what the DBC does not declare itself

    @property
    def currents(self) -> list[str]:
        """One for each string."""
        return [self.current] if isinstance(self.current, str) else list(self.current)

    @classmethod
    def default(cls, cells: int = 1, sensors: int = 1, strings: int = 1) -> SignalMap:
        """The messages of the project's own DBC; a single temperature sensor is that of all cells."""
        own = [f"StringCurrents.String{k + 1}" for k in range(strings)]
        return cls(
            current="PackMeasurement.PackCurrent" if strings == 1 else own,
            current_positive="discharge",
            cell_voltage=[f"CellVoltages.Cell{k + 1}" for k in range(cells)],
            temperature=[f"CellTemperatures.Sensor{k + 1}" for k in range(sensors)],
        )


@dataclass(frozen=True, slots=True)
class Bound:
    """A signal bound to its role. Limits and bit are in the project's unit and sign; a float has infinite limits."""

    role: Role
    index: int  # of the cell or sensor, from 0
    name: str
    message: Message
    signal: Signal
    extract: Extract  # NaN: not available; infinite: measured, and not plausible
    lowest: float  # what its raw values can say
    highest: float
    bit: float  # the smallest change they can
    is_float: bool = False
    warning: str = ""


def bind(signals: SignalMap, matrix: Matrix, cells: int, source: str | Path, *, wired: bool = False) -> list[Bound]:
    """Every mapped signal, found in the DBC. ConfigError naming the key if the map fits neither DBC nor cells.

    `wired`: a `Wiring` says whose temperatures are measured, so there may be any number.
    """
    voltages, voltage_key = signals.cell_voltage, "cell_voltage"
    if signals.pack_voltage is not None:
        voltages, voltage_key = [signals.pack_voltage], "pack_voltage"
    if len(voltages) != cells:
        expected = f"one signal for each of {cells} cells"
        raise ConfigError(source, key=f"signals.{voltage_key}", value=list(voltages), expected=expected)
    if len(signals.temperature) not in {0, 1, cells} and not wired:
        expected = f"one signal, or one for each of {cells} cells (pack.sensor_of allows any number)"
        raise ConfigError(source, key="signals.temperature", value=list(signals.temperature), expected=expected)
    if len(signals.balancing) not in {0, cells}:
        expected = f"one signal for each of {cells} cells"
        raise ConfigError(source, key="signals.balancing", value=list(signals.balancing), expected=expected)
    currents = signals.currents
    if len(set(currents)) != len(currents):
        raise ConfigError(source, key="signals.current", value=currents, expected="another signal for each string")
    positive = [signals.current_positive] if isinstance(signals.current_positive, str) else signals.current_positive
    if len(positive) not in {1, len(currents)}:
        expected = f"one for all currents, or one for each of {len(currents)}"
        raise ConfigError(source, key="signals.current_positive", value=list(positive), expected=expected)
    signed = [(name, -1.0 if positive[k % len(positive)] == "charge" else 1.0) for k, name in enumerate(currents)]
    measured = {*currents, *voltages, *signals.temperature, *signals.balancing}
    for key, named, known_names in (
        ("not_available", signals.not_available, measured | {signals.contactor}),
        ("plausible", signals.plausible, measured),
        ("unit", signals.unit, measured),
    ):
        for name in named.keys() - known_names:
            expected = "a signal that has a role in [signals]"
            raise ConfigError(source, key=f"signals.{key}", value=name, expected=expected)
    share = 1.0 / signals.parallel_cells
    binding = _Binding(signals, matrix, source)
    bound = [
        *(binding.measured("current", "current", k, v, sign * share) for k, (v, sign) in enumerate(signed)),
        *(binding.measured("voltage", voltage_key, k, v, 1.0 / signals.series_cells) for k, v in enumerate(voltages)),
        *(binding.measured("temperature", "temperature", k, name, 1.0) for k, name in enumerate(signals.temperature)),
    ]
    bound += [binding.balancing(k, name) for k, name in enumerate(signals.balancing)]
    if signals.contactor is not None:
        bound.append(binding.contactor(signals.contactor))
    for name in signals.e2e.keys() - {b.message.name for b in bound}:
        expected = "a message with a signal that has a role in [signals]"
        raise ConfigError(source, key="signals.e2e", value=name, expected=expected)
    return bound


@dataclass(frozen=True, slots=True)
class _Binding:
    signals: SignalMap
    matrix: Matrix
    source: str | Path

    def measured(self, role: Quantity, key: str, index: int, name: str, factor: float) -> Bound:
        message, signal = self.matrix.find(name, source=self.source, key=f"signals.{key}")
        found = Field(message, signal, self.signals.not_available.get(name, ()))
        unit, warning = self._unit(role, name, signal.unit or "")
        to_ours = Conversion(unit.factor * factor, unit.shift)
        extract = found.extract(*to_ours)
        if name in self.signals.plausible:
            extract = self._bounded(name, extract, to_ours)
        lowest, highest = sorted(value * to_ours.factor + to_ours.shift for value in found.span())
        bit = abs(found.scale * to_ours.factor)
        return Bound(role, index, name, message, signal, extract, lowest, highest, bit, found.is_float, warning)

    def contactor(self, name: str) -> Bound:
        message, signal = self.matrix.find(name, source=self.source, key="signals.contactor")
        named = {str(word): int(raw) for raw, word in (signal.choices or {}).items()}
        found = Field(message, signal)
        is_open = set()
        for value in self.signals.contactor_open:
            raw = named.get(value) if isinstance(value, str) else value
            if raw is None or raw & found.mask != raw:
                words = f", or {', '.join(named)}" if named else ""
                expected = f"raw values of {name} from 0 to {found.mask}{words}"
                raise ConfigError(self.source, key="signals.contactor_open", value=value, expected=expected)
            is_open.add(raw)
        if not is_open:
            expected = f"the values of {name} that mean open"
            raise ConfigError(self.source, key="signals.contactor_open", expected=expected)
        missing = frozenset(code & found.mask for code in self.signals.not_available.get(name, ()))
        read = found.raw()

        def extract(data: bytes) -> float:
            raw = read(data)
            return math.nan if raw in missing else float(raw in is_open)

        return Bound("contactor", 0, name, message, signal, extract, 0.0, 1.0, 1.0)

    def balancing(self, index: int, name: str) -> Bound:
        message, signal = self.matrix.find(name, source=self.source, key="signals.balancing")
        share, unit = 1.0 / self.signals.parallel_cells, self.signals.unit.get(name, signal.unit or "")
        if unit.strip():
            return replace(self.measured("current", "balancing", index, name, share), role="balancing")
        if name in self.signals.plausible:
            expected = "a signal with a unit: a flag of balancing has no range"
            raise ConfigError(self.source, key="signals.plausible", value=name, expected=expected)
        if self.signals.bleed_A is None:
            expected = f"what is taken from a cell while {name}, a flag without a unit, is 1"
            raise ConfigError(self.source, key="pack.bleed_A", expected=expected)
        found, on_A = Field(message, signal), self.signals.bleed_A * share
        missing = frozenset(code & found.mask for code in self.signals.not_available.get(name, ()))
        currents = {raw: raw * on_A for raw in (0, 1) if raw not in missing}
        read = found.raw()

        def extract(data: bytes) -> float:
            return currents.get(read(data), math.nan)

        return Bound("balancing", index, name, message, signal, extract, 0.0, on_A, on_A)

    def _unit(self, role: Quantity, name: str, in_dbc: str) -> tuple[Conversion, str]:
        stated = self.signals.unit.get(name)
        found = conversion(role, stated if stated is not None else in_dbc)
        if found is not None:
            return found, ""
        if stated is not None:
            raise ConfigError(
                self.source, key="signals.unit", value=stated, expected=f"a unit of {role}: {known(role)}"
            )
        if in_dbc.strip():
            expected = f"a {role}, but its unit in the DBC is {in_dbc!r} (signals.unit overrules it; {known(role)})"
            raise ConfigError(self.source, key="signals", value=name, expected=expected)
        return Conversion(1.0), f"{name} has no unit in the DBC: taken as {BASE[role]} (signals.unit says otherwise)"

    def _bounded(self, name: str, extract: Extract, to_ours: Conversion) -> Extract:
        ends = self.signals.plausible[name]
        if len(ends) != 2 or not ends[0] < ends[1]:
            raise ConfigError(self.source, key="signals.plausible", value=list(ends), expected="[lowest, highest]")
        low, high = sorted(end * to_ours.factor + to_ours.shift for end in ends)

        def bounded(data: bytes) -> float:
            value = extract(data)
            return math.inf if value < low or value > high else value

        return bounded
