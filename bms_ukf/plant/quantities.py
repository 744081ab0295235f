"""Units of FMU variables: from what an FMU declares to the project's own, for each quantity.

A declared unit is converted by the FMU's own definition of it (base units, factor and offset, as the FMI standard has
it), else by its name.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from bms_ukf import units
from bms_ukf.units import Conversion


class Quantity(NamedTuple):
    """What a role's values are: the project's unit, and its exponents in kg, m, s, A, K."""

    name: str
    unit: str
    exponents: tuple[int, int, int, int, int]
    shift: float = 0.0  # of the project's unit against SI


CURRENT = Quantity("current", "A", (0, 0, 0, 1, 0))
VOLTAGE = Quantity("voltage", "V", (1, 2, -3, -1, 0))
POWER = Quantity("power", "W", (1, 2, -3, 0, 0))
TEMPERATURE = Quantity("temperature", "degC", (0, 0, 0, 0, 1), shift=-273.15)
RATIO = Quantity("ratio", "1", (0, 0, 0, 0, 0))

_BASE = ("kg", "m", "s", "A", "K")
_OTHER = ("mol", "cd", "rad")
_NAMED = {
    "power": {"w": Conversion(1.0), "mw": Conversion(1e-3), "kw": Conversion(1e3)},
    "ratio": {
        **dict.fromkeys(("", "1", "-", "p.u.", "pu"), Conversion(1.0)),
        **dict.fromkeys(("%", "percent", "pct"), Conversion(0.01)),
    },
}
_KNOWN = {"power": "W, mW, kW", "ratio": "1, %"}


def unit_of(variable: Any) -> str | None:
    """The unit that fmpy's variable declares, itself or by its type; None if it has none."""
    declared = variable.declaredType
    return variable.unit or (declared.unit if declared is not None else None)


def definition(description: Any, unit: str) -> tuple[tuple[int, ...], Conversion] | None:
    """Exponents of a unit and its conversion to SI as the FMU itself defines it; None if it does not."""
    for defined in description.unitDefinitions:
        if defined.name == unit and defined.baseUnit is not None:
            base = defined.baseUnit
            exponents = tuple(int(getattr(base, name)) for name in (*_BASE, *_OTHER))
            return exponents, Conversion(float(base.factor), float(base.offset))
    return None


def conversion(description: Any, unit: str | None, quantity: Quantity) -> Conversion | None:
    """What turns a value in an FMU's `unit` into the quantity's; None if it cannot be. No unit: taken as it is."""
    if unit is None:
        return Conversion(1.0)
    defined = definition(description, unit)
    if defined is not None and (any(defined[0]) or quantity is RATIO):
        if defined[0] != (*quantity.exponents, 0, 0, 0):
            return None
        return Conversion(defined[1].factor, defined[1].shift + quantity.shift)
    if quantity.name in _NAMED:
        return _NAMED[quantity.name].get(unit.strip().lower())
    return units.conversion(quantity.name, unit)  # type: ignore[arg-type]  # the three it knows


def known(quantity: Quantity) -> str:
    """The units of a quantity that go by their name."""
    return _KNOWN.get(quantity.name) or units.known(quantity.name)  # type: ignore[arg-type]


def between(source: tuple[Any, str | None], target: tuple[Any, str | None]) -> Conversion | None:
    """What turns a value of one FMU's unit into one of another's, each a (description, unit); None if it cannot be."""
    (from_fmu, from_unit), (to_fmu, to_unit) = source, target
    if from_unit is None or to_unit is None or from_unit == to_unit:
        return Conversion(1.0)
    for quantity in (CURRENT, VOLTAGE, POWER, TEMPERATURE, RATIO):
        first, last = conversion(from_fmu, from_unit, quantity), conversion(to_fmu, to_unit, quantity)
        if first is not None and last is not None:
            return Conversion(first.factor / last.factor, (first.shift - last.shift) / last.factor)
    first_si, last_si = definition(from_fmu, from_unit), definition(to_fmu, to_unit)
    if first_si is None or last_si is None or first_si[0] != last_si[0]:
        return None
    (a, b), (c, d) = first_si[1], last_si[1]
    return Conversion(a / c, (b - d) / c)
