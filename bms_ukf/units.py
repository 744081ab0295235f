"""The units a DBC may give to a current, a voltage or a temperature, and what they are in A, V and degC."""

from __future__ import annotations

from typing import Literal, NamedTuple

Quantity = Literal["current", "voltage", "temperature"]


class Conversion(NamedTuple):
    """Value in A, V or degC = value in the unit * factor + shift."""

    factor: float
    shift: float = 0.0


BASE: dict[Quantity, str] = {"current": "A", "voltage": "V", "temperature": "degC"}

# By lower case, as DBCs differ in that; "mA" and "MA" are therefore the same, and nobody's battery has megaamperes.
_KNOWN: dict[Quantity, dict[str, Conversion]] = {
    "current": {
        **dict.fromkeys(("a", "amp", "amps", "ampere", "amperes"), Conversion(1.0)),
        **dict.fromkeys(("ma", "milliampere"), Conversion(1e-3)),
        **dict.fromkeys(("ka",), Conversion(1e3)),
        **dict.fromkeys(("ua", "µa"), Conversion(1e-6)),
    },
    "voltage": {
        **dict.fromkeys(("v", "volt", "volts"), Conversion(1.0)),
        **dict.fromkeys(("mv", "millivolt"), Conversion(1e-3)),
        **dict.fromkeys(("kv",), Conversion(1e3)),
        **dict.fromkeys(("uv", "µv"), Conversion(1e-6)),
    },
    "temperature": {
        **dict.fromkeys(("c", "degc", "deg c", "deg_c", "°c", "celsius", "grad c", "gradc"), Conversion(1.0)),
        **dict.fromkeys(("k", "kelvin", "degk"), Conversion(1.0, -273.15)),
        **dict.fromkeys(("f", "degf", "deg f", "°f", "fahrenheit"), Conversion(5 / 9, -160 / 9)),
    },
}


def conversion(quantity: Quantity, unit: str) -> Conversion | None:
    """What turns a value in `unit` into A, V or degC; None if it is no unit of that quantity."""
    return _KNOWN[quantity].get(unit.strip().lower())


def known(quantity: Quantity) -> str:
    """The units of a quantity, for a message; each may be written in other ways, too."""
    return {"current": "A, mA, kA, uA", "voltage": "V, mV, kV, uV", "temperature": "degC, K, degF"}[quantity]
