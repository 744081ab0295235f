"""Which variable of an FMU has which role, from names, units and causality: a proposal for a user to check."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from bms_ukf.plant import quantities
from bms_ukf.plant.description import NUMBERS
from bms_ukf.plant.plant import PlantState
from bms_ukf.plant.roles import ROLES

# What names of variables tend to contain, for a role that neither its own name nor the unit settles.
_HINTS = {
    "current_A": ("current", "i_cell", "i_pack", "i_batt"),
    "power_W": ("power", "load"),
    "supply_V": ("voltage", "supply", "u_set", "v_set"),
    "ambient_degC": ("amb", "cool", "environment"),
    "voltage_V": ("terminal", "voltage", "ocv"),
    "temperature_degC": ("temp", "t_cell", "t_pack"),
    "soc": ("soc", "charge"),
}
# What modellers call them, at the end of a path.
_SHORT = {
    "current_A": {"i"},
    "power_W": {"p"},
    "supply_V": {"u", "v"},
    "voltage_V": {"u", "v"},
    "temperature_degC": {"t"},
}

Entry = str | list[str] | dict[str, str]  # of [plant.variables]


def roles(description: Any) -> tuple[str | None, dict[str, Entry]]:
    """The role that drives the plant, and what to write for each role; "" where nothing fits or stands out."""
    variables = [v for v in description.modelVariables if v.type in NUMBERS]
    inputs = [v for v in variables if v.causality == "input"]
    outputs = [v for v in variables if v.causality == "output"]
    inner = [v for v in variables if v.causality == "local"]
    found: dict[str, Entry] = {}
    drive = None
    for role in ("current_A", "power_W", "supply_V"):
        if drive is None and (names := _matching(description, role, inputs)):
            drive, found[role] = role, _entry(names)
    found.setdefault("current_A", "")
    for role in ROLES.keys() - {"power_W", "supply_V", "ambient_degC"} - {drive}:
        names = _matching(description, role, outputs) or _matching(description, role, inner, strict=True)
        found[role] = _entry(names)
    found["ambient_degC"] = _entry(_matching(description, "ambient_degC", inputs))
    if drive == "supply_V" or (not found["current_A"] and drive == "power_W"):
        found = {role: entry for role, entry in found.items() if entry or role not in ("voltage_V", "current_A")}
    return drive, {role: found[role] for role in ROLES if role in found}


def _matching(description: Any, role: str, variables: Sequence[Any], *, strict: bool = False) -> list[Any]:
    """The variables that fit a role best: one, or all elements of one; `strict`: only those of the role's name."""
    quantity = ROLES[role].quantity
    fit, by_unit = [], []
    for variable in variables:
        unit = quantities.unit_of(variable)
        if quantities.conversion(description, unit, quantity) is not None:
            fit.append(variable)
            if unit is not None and quantity is not quantities.RATIO:
                by_unit.append(variable)
    named = [v for v in fit if v.name == role]
    if not named and not strict:
        with_unit = [v for v in by_unit if _hinted(role, v.name)]
        named = with_unit or [v for v in fit if _hinted(role, v.name)]
    if not named and not strict:
        named = by_unit if len({_stem(v.name) for v in by_unit}) == 1 else []
    return [v for v in named if _stem(v.name) == _stem(named[0].name)] if named else []


def _hinted(role: str, name: str) -> bool:
    last = re.sub(r"\[\d+\]$|_?\d+$", "", name).rpartition(".")[2].lower()
    return any(hint in name.lower() for hint in _HINTS[role]) or last in _SHORT.get(role, ())


def _stem(name: str) -> str:
    """A name without its indices: cell[1].v and cell[2].v are of one stem, as are v_1 and v_2."""
    return re.sub(r"\[\d+\]|_?\d+(?=$|\.)", "#", name)


def _entry(matching: Sequence[Any]) -> Entry:
    if not matching:
        return ""
    names = [variable.name for variable in matching]
    if len(names) > 1:
        return names
    return str(matching[0].name)


def undeclared_units(description: Any, roles: dict[str, Entry], state: PlantState) -> dict[str, Entry]:
    """The entries, with the unit that the values at the start suggest where the FMU declares none."""
    suggested = dict(roles)
    units = {v.name: quantities.unit_of(v) for v in description.modelVariables}
    for role, unit, least in (("soc", "%", 1.5), ("temperature_degC", "K", 200.0)):
        name = roles.get(role)
        if isinstance(name, str) and units.get(name) is None and np.max(getattr(state, role)) > least:
            suggested[role] = {"name": name, "unit": unit}
    return suggested
