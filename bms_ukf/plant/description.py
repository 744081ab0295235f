"""The variables of a described FMU: by name, as the child wants them, and the start values a user gives."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bms_ukf.errors import ConfigError
from bms_ukf.fmi import wire

FLOATS = ("Real", "Float64", "Float32")
NUMBERS = (
    *FLOATS,
    "Integer",
    "Enumeration",
    "Boolean",
    *(f"{u}Int{bits}" for u in ("", "U") for bits in (8, 16, 32, 64)),
)


def variable_named(path: Path, description: Any, name: str, key: str) -> Any:
    """The variable of that name; else a ConfigError that blames `key` and names the nearest."""
    for variable in description.modelVariables:
        if variable.name == name:
            return variable
    names = {variable.name.lower(): variable.name for variable in description.modelVariables}
    close = difflib.get_close_matches(name.lower(), names, n=3, cutoff=0.4)
    near = [names[lower] for lower in close] or sorted(names.values())[:5]
    raise ConfigError(path, key=key, value=name, expected=f"a variable of the FMU, such as {', '.join(near)}")


def size(description: Any, variable: Any, structural: Mapping[int, int]) -> int:
    """How many elements a variable has, given the structural parameters that are set, by value reference."""
    lengths = []
    for dimension in variable.dimensions:
        if dimension.start is not None:
            lengths.append(int(dimension.start))
        else:
            lengths.append(structural.get(dimension.valueReference, int(dimension.variable.start or 0)))
    return math.prod(lengths)


def number(text: Any) -> float | None:
    """A number of the model description, which fmpy leaves as text; None if it is none."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return None


def start_of(variable: Any) -> float | None:
    """The start value of a number, the first of an array's; None if it declares none."""
    text = next(iter(str(variable.start or "").split()), "")
    return float(text == "true") if text in ("true", "false") else number(text)


def wired(description: Any, variable: Any, structural: Mapping[int, int]) -> wire.Variable:
    """The variable as the child wants it."""
    return {
        "name": variable.name,
        "type": variable.type,
        "reference": variable.valueReference,
        "size": size(description, variable, structural),
    }


def settings(
    path: Path, description: Any, parameters: Mapping[str, Any], taken: Sequence[str]
) -> tuple[list[wire.Setting], list[wire.Setting]]:
    """The structural and the other start values, checked; ConfigError for a name or a value that cannot be.

    `taken` are the names of inputs that are set at every step.
    """
    found = [(variable_named(path, description, name, "parameters"), value) for name, value in parameters.items()]
    is_structural = [variable.causality == "structuralParameter" for variable, _ in found]
    structural = {v.valueReference: value for (v, value), yes in zip(found, is_structural, strict=True) if yes}
    lists: tuple[list[wire.Setting], list[wire.Setting]] = ([], [])
    for (variable, value), yes in zip(found, is_structural, strict=True):
        key = f"parameters.{variable.name}"
        if variable.name in taken:
            raise ConfigError(path, key=key, expected="no variable that has a role already")
        if (
            variable.variability == "constant"
            or variable.initial == "calculated"
            or variable.causality == "independent"
        ):
            raise ConfigError(path, key=key, value=variable.causality, expected="a variable that can be set")
        shape = wired(description, variable, structural)
        given = value if isinstance(value, list) else [value]
        if len(given) != shape["size"]:
            raise ConfigError(path, key=key, value=value, expected=f"{shape['size']} values")
        values = [_typed(path, key, variable, item) for item in given]
        lists[0 if yes else 1].append({**shape, "values": values})
    return lists


def structural_values(structural: Sequence[wire.Setting]) -> dict[int, int]:
    return {setting["reference"]: setting["values"][0] for setting in structural}


def _typed(path: Path, key: str, variable: Any, value: Any) -> Any:
    """A user's value for a variable's type; an item of an enumeration may be given by name."""
    items = variable.declaredType.items if variable.type == "Enumeration" and variable.declaredType else []
    for item in items:
        if item.name == value:
            return int(item.value)
    kinds: dict[str, type | tuple[type, ...]] = {"Boolean": bool, "String": str}
    kind = kinds.get(variable.type, (float, int) if variable.type in FLOATS else int)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        expected = f"a value of FMI type {variable.type}"
        if items:
            expected += f": {', '.join(item.name for item in items)}"
        raise ConfigError(path, key=key, value=value, expected=expected)
    return value
