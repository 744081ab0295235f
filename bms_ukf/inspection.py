"""`bms-ukf cosim --inspect PLANT.fmu`: what an FMU offers, written as a SCENARIO file that drives it.

All that is said about the FMU stands in comments, so that the output can be saved and run as it is.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from bms_ukf import fmu, resources
from bms_ukf.plant import ROLES

_COLUMNS = ("name", "causality", "variability", "type", "unit", "start", "min", "max", "description")
_CAPABILITIES = {
    "canHandleVariableCommunicationStepSize": "variable communication step",
    "canGetAndSetFMUstate": "state get and set",
    "canSerializeFMUstate": "state serialisation",
    "providesDirectionalDerivative": "directional derivatives",
    "canBeInstantiatedOnlyOncePerProcess": "one instance per process only",
    "needsExecutionTool": "needs its tool installed",
}
# What names of variables tend to contain, for a role that neither its own name nor the unit settles.
_HINTS = {
    "current_A": ("current",),
    "ambient_degC": ("amb",),
    "voltage_V": ("terminal", "voltage"),
    "temperature_degC": ("temp",),
    "soc": ("soc", "charge"),
}


def describe(given: Path) -> str:
    """The text for an FMU, a file or a shipped one by name.

    Raises ConfigError if it cannot be co-simulated here. Where no variable fits a role the plant must have, the
    scenario is left with a gap, which a warning names.
    """
    path = resources.find(given, "plants", ".fmu")
    description = fmu.describe(path)
    fmu.library(path, description.coSimulation.modelIdentifier)
    roles = {role: _match(role, description.modelVariables) for role in ROLES}
    warnings = [f"validation: {finding}" for finding in fmu.findings(path)]
    warnings += [
        f"no {wanted.causality} looks like {role} in {wanted.unit}: name it in [plant.variables]"
        for role, wanted in ROLES.items()
        if wanted.required and not roles[role]
    ]
    about = [*_heading(path, description), "", *_table(description.modelVariables)]
    about += ["", *(f"warning: {warning}" for warning in warnings)] if warnings else []
    comments = [f"# {line}".rstrip() for text in about for line in text.splitlines() or [""]]
    fmu_name = str(given) if path.parent == resources.folder("plants") else str(path.resolve())
    return "\n".join([*comments, "", *_scenario(fmu_name, description, roles)])


def _heading(path: Path, description: Any) -> list[str]:
    capabilities = [words for name, words in _CAPABILITIES.items() if getattr(description.coSimulation, name)]
    tool = description.generationTool
    return [
        f"{description.modelName}: {description.description or 'no description'}",
        f"FMI {description.fmiVersion} co-simulation" + (f", made by {tool}" if tool else ""),
        f"platforms: {', '.join(fmu.platforms(path))}",
        f"capabilities: {', '.join(capabilities) or 'none declared'}",
    ]


def _table(variables: Sequence[Any]) -> list[str]:
    """The variables in columns; of local ones, which a tool may declare by the thousand, only the number."""
    shown = [variable for variable in variables if variable.causality != "local"]
    rows = [_COLUMNS, *map(_row, shown)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    hidden = len(variables) - len(shown)
    return [*lines, f"and {hidden} local variables"] if hidden else lines


def _row(variable: Any) -> tuple[str, ...]:
    values = (getattr(variable, column) for column in _COLUMNS)
    return tuple("-" if value is None else " ".join(str(value).split()) for value in values)


def _match(role: str, variables: Iterable[Any]) -> str:
    """The name of the variable that fits a role best; "" if none does, or if none stands out."""
    wanted = ROLES[role]
    reals = [v for v in variables if (v.causality, v.type) == (wanted.causality, "Real")]
    fit = [v for v in reals if v.unit in (None, wanted.unit)]
    named = [v.name for v in fit if v.name == role] or [
        v.name for v in fit if any(hint in v.name.lower() for hint in _HINTS[role])
    ]
    by_unit = [v.name for v in fit if v.unit == wanted.unit and wanted.unit != "1"]
    candidates = named or (by_unit if len(by_unit) == 1 else [])
    return candidates[0] if candidates else ""


def _scenario(fmu_name: str, description: Any, roles: dict[str, str]) -> list[str]:
    experiment = description.defaultExperiment
    step_s = float((experiment.stepSize if experiment else None) or 1.0)
    parameters = [v for v in description.modelVariables if v.causality == "parameter"]
    return [
        "format = 1",
        f"name = {_quoted(description.modelName)}",
        f"step_s = {step_s!r}",
        "",
        "[plant]",
        f"fmu = {_quoted(fmu_name)}",
        "",
        "[plant.parameters]",
        *(f"# {_quoted(v.name)} = {_literal(v)}" for v in parameters),
        "",
        '[plant.variables]  # "": the FMU has none',
        *(f"{role} = {_quoted(name)}" for role, name in roles.items()),
        "",
        "[load]",
        "segments = [{ rest_s = 60 }, { current_A = 1.0, duration_s = 540 }]  # positive = discharge",
        "",
        "[estimator]",
        'cell = "lgm50_chen2020"  # the cell file of what the FMU models',
    ]


def _literal(variable: Any) -> str:
    """A start value as TOML."""
    if variable.type == "String":
        return _quoted(variable.start or "")
    if variable.type == "Boolean":
        return "true" if variable.start in ("true", "1", True) else "false"
    return str(0.0 if variable.start is None else variable.start)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # a JSON string is a TOML basic string, but for surrogates
