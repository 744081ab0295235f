"""What the variables of a plant's FMUs are for, and in which units: [plant.variables] and [[plant.connect]]."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bms_ukf.errors import ConfigError
from bms_ukf.plant import quantities
from bms_ukf.plant.description import NUMBERS, variable_named
from bms_ukf.plant.part import Part
from bms_ukf.plant.quantities import Quantity
from bms_ukf.plant.table import PlantTable, VariableTable
from bms_ukf.records import PerCell


class Role(NamedTuple):
    quantity: Quantity
    signed: bool  # turned round by current_positive = "charge"
    expected: bool  # must be named, or be named "", where no variable has the role's own name


ROLES = {
    "current_A": Role(quantities.CURRENT, signed=True, expected=False),  # an input, or the current that flows
    "power_W": Role(quantities.POWER, signed=True, expected=False),  # input
    "supply_V": Role(quantities.VOLTAGE, signed=False, expected=False),  # input: voltage that is applied
    "ambient_degC": Role(quantities.TEMPERATURE, signed=False, expected=True),  # input
    "voltage_V": Role(quantities.VOLTAGE, signed=False, expected=True),  # an output, or the voltage that is applied
    "temperature_degC": Role(quantities.TEMPERATURE, signed=False, expected=True),
    "soc": Role(quantities.RATIO, signed=False, expected=True),  # the truth an estimate is scored against, 0..1
}
LOADS = ("current_A", "power_W", "supply_V", "voltage_V")  # what may drive a plant, in order of preference
_NEVER_READ = ("power_W", "supply_V", "ambient_degC")


class Channel:
    """The variables of a role: value in the role's unit = value in the FMU's * gain + offset, for each."""

    def __init__(self, picked: Sequence[tuple[Part, Any]], conversions: Sequence[tuple[float, float]]) -> None:
        self._picked, self._conversions = picked, conversions
        self._elements: list[tuple[Part, int, float, float]] = []
        self.is_scalar = False

    def settle(self, *, is_input: bool) -> None:
        """Finds the elements, once the parts are prepared."""
        for (part, variable), (gain, offset) in zip(self._picked, self._conversions, strict=True):
            places = part.input_places(variable.name) if is_input else part.output_places(variable.name)
            self._elements += [(part, place, gain, offset) for place in places]
        self.is_scalar = len(self._picked) == 1 and not self._picked[0][1].dimensions

    def write(self, value: PerCell) -> None:
        """Sets all elements to a number, or each to its own."""
        values = [value] * len(self._elements) if isinstance(value, float | int) else value
        for (part, place, gain, offset), item in zip(self._elements, values, strict=True):
            part.inputs[place] = (item - offset) / gain

    def read(self) -> PerCell:
        """A float, or an array if the role has several variables, or one that is an array. Of the outputs."""
        if self.is_scalar:
            part, place, gain, offset = self._elements[0]
            return part.outputs[place] * gain + offset
        return np.array([part.outputs[place] * gain + offset for part, place, gain, offset in self._elements])

    def held(self) -> PerCell:
        """The first of the values that were written."""
        part, place, gain, offset = self._elements[0]
        return part.inputs[place] * gain + offset


class Connection(NamedTuple):
    source: Channel
    target: Channel


class Wiring(NamedTuple):
    """Who sets and reads what. `load` is the role that drives the plant; None if a part of it does."""

    load: str | None
    drive: Channel | None
    ambient: Channel | None
    outputs: dict[str, Channel]
    connections: list[Connection]


def wire_up(table: PlantTable, parts: Sequence[Part]) -> Wiring:
    """Finds the variables for roles and connections, and has the parts use them. ConfigError for what does not fit."""
    return _Wiring(table, parts).result()


class _Wiring:
    def __init__(self, table: PlantTable, parts: Sequence[Part]) -> None:
        self._table, self._parts = table, parts
        self._connected: set[tuple[str, str]] = set()

    def result(self) -> Wiring:
        for role in self._table.variables.keys() - ROLES:
            raise ConfigError(self._parts[0].path, key=f"variables.{role}", expected=f"a role among {', '.join(ROLES)}")
        connections = [self._connection(k) for k in range(len(self._table.connect))]
        picked = {role: self._picked(role) for role in ROLES}
        load = self._load(picked)
        channels = {role: self._channel(role, variables) for role, variables in picked.items() if variables}
        for role in channels:
            for part, variable in picked[role]:
                if role in (load, "ambient_degC"):
                    part.use_input(variable)
                else:
                    part.use_output(variable)
        drive = channels.pop(load, None) if load else None
        return Wiring(load, drive, channels.pop("ambient_degC", None), channels, connections)

    def _load(self, picked: dict[str, list[tuple[Part, Any]]]) -> str | None:
        """The role that drives the plant. ConfigError if two do, or if nothing tells the current."""
        driving = [role for role in LOADS if picked[role] and self._is_free(picked[role])]
        named = [role for role in driving if self._table.variables.get(role)]
        load = next(iter(named or driving), None)
        if len(named) > 1:
            raise self._wrong(named[1], named[1], f"one input only that drives the plant, beside {named[0]}")
        for role in ("power_W", "supply_V"):
            if role != load:
                picked[role] = []
        if load != "current_A" and self._is_free(picked["current_A"]):
            picked["current_A"] = []
        if not picked["current_A"] and load != "power_W":
            path, near = self._parts[0].path, [v.name for p in self._parts for v in p.description.modelVariables]
            if load is None:
                inputs = [v.name for p in self._parts for v in p.description.modelVariables if v.causality == "input"]
                expected = (
                    f"an input for current, power_W or supply_V (the FMU's inputs: {', '.join(inputs[:8]) or 'none'})"
                )
            else:
                expected = f"an output, as the plant is driven by {load} (the FMU has {', '.join(near[:8])})"
            given = self._table.variables.get("current_A", "current_A")
            raise ConfigError(path, key="variables.current_A", value=given, expected=expected)
        if not picked["voltage_V"] and load != "supply_V":
            raise self._wrong("voltage_V", "", "a variable of the FMU")
        return load

    def _is_free(self, picked: list[tuple[Part, Any]]) -> bool:
        """Whether these are inputs that nothing is connected to."""
        return bool(picked) and all(
            variable.causality == "input" and (part.name, variable.name) not in self._connected
            for part, variable in picked
        )

    def _picked(self, role: str) -> list[tuple[Part, Any]]:
        """The variables for a role; none if the FMUs have none."""
        key = f"variables.{role}"
        entry = self._table.variables.get(role)
        if entry == "":
            return []
        if entry is None:
            own = re.compile(rf"{role}(\[\d+\])?")  # one, or one for each cell
            having = [(p, v) for p in self._parts for v in p.description.modelVariables if own.fullmatch(v.name)]
            having = [pair for pair in having if ROLES[role].expected or pair[1].causality in ("input", "output")]
            if having or not ROLES[role].expected or len(self._parts) > 1:
                return [pair for pair in having if pair[0] is having[0][0]]
            if role == "voltage_V" and self._table.variables.get("supply_V"):
                return []
        names = entry.name if isinstance(entry, VariableTable) else role if entry is None else entry
        picked = [self._find(name, key) for name in ([names] if isinstance(names, str) else names)]
        for part, variable in picked:
            if role in _NEVER_READ and variable.causality != "input":
                expected = f"an input of the FMU for {role}"
                raise ConfigError(part.path, key=key, value=f"{variable.name}, {variable.causality}", expected=expected)
        return picked

    def _find(self, name: str, key: str) -> tuple[Part, Any]:
        """The variable called `name`, or `part.name` where there are several parts."""
        part = self._parts[0]
        if self._table.part:
            first, _, rest = name.partition(".")
            named = [part for part in self._parts if part.name == first]
            if not named or not rest:
                known = ", ".join(part.name for part in self._parts)
                expected = f"part.variable, with a part among {known}"
                raise ConfigError(self._table.label, key=key, value=name, expected=expected)
            part, name = named[0], rest
        variable = variable_named(part.path, part.description, name, key)
        if variable.type not in NUMBERS:
            raise ConfigError(
                part.path, key=key, value=f"{name}, of type {variable.type}", expected="a variable that is a number"
            )
        return part, variable

    def _channel(self, role: str, picked: list[tuple[Part, Any]]) -> Channel:
        entry = self._table.variables.get(role)
        own = entry if isinstance(entry, VariableTable) else VariableTable(name=role)
        sign = -1.0 if ROLES[role].signed and self._table.current_positive == "charge" else 1.0
        conversions = []
        for part, variable in picked:
            quantity = ROLES[role].quantity
            unit = own.unit if own.unit is not None else quantities.unit_of(variable)
            found = quantities.conversion(part.description, unit, quantity)
            if found is None:
                raise ConfigError(
                    part.path,
                    key=f"variables.{role}",
                    value=f"{variable.name} in {unit}",
                    expected=f"a variable in {quantity.unit}, or in a unit that can be converted to it"
                    f" ({quantities.known(quantity)})",
                )
            gain = found.factor * own.gain * sign
            if gain == 0:
                raise ConfigError(part.path, key=f"variables.{role}.gain", value=0.0, expected="another number")
            conversions.append((gain, (found.shift * own.gain + own.offset) * sign))
        return Channel(picked, conversions)

    def _connection(self, k: int) -> Connection:
        entry = self._table.connect[k]
        key = f"connect[{k}]"
        source, target = self._find(entry.source, f"{key}.from"), self._find(entry.to, f"{key}.to")
        part, variable = target
        if variable.causality != "input" or (part.name, variable.name) in self._connected:
            expected = "an input of the FMU that nothing else is connected to"
            raise ConfigError(part.path, key=f"{key}.to", value=entry.to, expected=expected)
        units = [(p.description, quantities.unit_of(v)) for p, v in (source, target)]
        found = quantities.between(units[0], units[1])
        if found is None:
            value, expected = f"{entry.to} in {units[1][1]}", f"a unit that {units[0][1]} can be converted to"
            raise ConfigError(part.path, key=f"{key}.to", value=value, expected=expected)
        self._connected.add((part.name, variable.name))
        source[0].use_output(source[1])
        part.use_input(variable)
        conversion = (found.factor * entry.gain, found.shift * entry.gain + entry.offset)
        return Connection(Channel([source], [conversion]), Channel([target], [(1.0, 0.0)]))

    def _wrong(self, role: str, value: str, expected: str) -> ConfigError:
        return ConfigError(self._parts[0].path, key=f"variables.{role}", value=value, expected=expected)
