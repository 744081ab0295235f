"""`bms-ukf cosim --inspect PLANT.fmu`: what an FMU offers, written as a SCENARIO file that drives it.

All that is said about the FMU stands in comments, so that the output can be saved and run as it is.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bms_ukf import resources
from bms_ukf.errors import BmsError
from bms_ukf.plant import archive, guess, quantities
from bms_ukf.plant.description import number, size, start_of
from bms_ukf.plant.guess import Entry
from bms_ukf.plant.plant import open_plant
from bms_ukf.plant.process import NotLoadedError
from bms_ukf.plant.roles import ROLES

_COLUMNS = ("name", "causality", "variability", "type", "unit", "start", "min", "max", "description")
_CAPABILITIES = {
    "canHandleVariableCommunicationStepSize": "variable communication step",
    "hasEventMode": "event mode",
    "mightReturnEarlyFromDoStep": "early return",
    "canGetAndSetFMUstate": "state get and set",
    "canSerializeFMUstate": "state serialisation",
    "providesDirectionalDerivative": "directional derivatives",
    "canBeInstantiatedOnlyOncePerProcess": "one instance per process only",
    "needsExecutionTool": "needs its tool installed",
}


def describe(given: Path) -> str:
    """The text for an FMU, a file or a shipped one by name.

    Raises ConfigError if it cannot be co-simulated here. What else is wrong with it is a warning: findings of fmpy's
    validation, a failure to start with its default values, and roles that the plant must have and nothing fits.
    """
    path = resources.find(given, "plants", ".fmu")
    with tempfile.TemporaryDirectory(prefix="plant-") as name:
        folder = Path(name).resolve()
        archive.unpack(path, folder)
        description = archive.describe(path, folder)
        platforms = archive.platforms(folder)
        archive.library(path, folder, description)
        findings = archive.findings(folder)
    drive, roles = guess.roles(description)
    warnings = [f"validation: {finding}" for finding in findings]
    warnings += _gaps(drive, roles)
    cells = 1
    if not _gaps(drive, roles):
        try:
            with open_plant(path, variables=roles, validate=False) as plant:
                cells = np.size(plant.state.voltage_V)
                roles = guess.undeclared_units(description, roles, plant.state)
        except NotLoadedError:
            raise
        except BmsError as error:
            warnings.append(f"it does not start with its default values: {error}")
    about = [*_heading(description, platforms), "", *_table(description)]
    about += ["", *(f"warning: {warning}" for warning in warnings)] if warnings else []
    comments = [f"# {line}".rstrip() for text in about for line in text.splitlines() or [""]]
    fmu_name = str(given) if path.parent == resources.folder("plants") else str(path.resolve())
    return "\n".join([*comments, "", *_scenario(fmu_name, description, drive, roles, cells, valid=not findings)])


def _gaps(drive: str | None, roles: dict[str, Entry]) -> list[str]:
    """What the plant must have, and nothing looks like."""
    gaps = []
    if drive is None:
        gaps.append("no input looks like current_A in A, power_W in W or supply_V in V: name it in [plant.variables]")
    needed = {"supply_V": "current_A"}.get(drive or "", "voltage_V")
    if not roles.get(needed):
        unit = ROLES[needed].quantity.unit
        gaps.append(f"no output looks like {needed} in {unit}: name it in [plant.variables]")
    return gaps


def _heading(description: Any, platforms: Sequence[str]) -> list[str]:
    interface = description.coSimulation
    capabilities = [words for name, words in _CAPABILITIES.items() if getattr(interface, name)]
    if interface.fixedInternalStepSize is not None:
        capabilities.append(f"internal step fixed to {interface.fixedInternalStepSize} s")
    tool, experiment = description.generationTool, description.defaultExperiment
    lines = [
        f"{description.modelName}: {description.description or 'no description'}",
        f"FMI {description.fmiVersion} co-simulation" + (f", made by {tool}" if tool else ""),
        f"platforms: {', '.join(platforms) or 'none, compiled from its sources'}",
        f"capabilities: {', '.join(capabilities) or 'none declared'}",
    ]
    if experiment is not None:
        shown = {"start": experiment.startTime, "stop": experiment.stopTime, "step": experiment.stepSize}
        shown["tolerance"] = experiment.tolerance
        lines.append(f"default experiment: {', '.join(f'{k} {v}' for k, v in shown.items() if v is not None)}")
    return lines


def _table(description: Any) -> list[str]:
    """The variables in columns; of local ones, which a tool may declare by the thousand, only the number."""
    variables = description.modelVariables
    shown = [variable for variable in variables if variable.causality not in ("local", "independent")]
    rows = [_COLUMNS, *(_row(description, variable) for variable in shown)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    hidden = sum(variable.causality == "local" for variable in variables)
    return [*lines, f"and {hidden} local variables"] if hidden else lines


def _row(description: Any, variable: Any) -> tuple[str, ...]:
    values = {column: getattr(variable, column) for column in _COLUMNS}
    values["unit"] = quantities.unit_of(variable)
    if variable.dimensions:
        values["type"] = f"{variable.type}[{size(description, variable, {})}]"
    return tuple("-" if value is None else " ".join(str(value).split()) or "-" for value in values.values())


def _scenario(
    fmu_name: str, description: Any, drive: str | None, roles: dict[str, Entry], cells: int, *, valid: bool
) -> list[str]:
    experiment = description.defaultExperiment
    suggested_s = number(experiment and experiment.stepSize) or 0.0
    step_s = suggested_s if 0.1 <= suggested_s <= 3600 else 1.0
    parameters = [v for v in description.modelVariables if v.causality in ("parameter", "structuralParameter")]
    return [
        "format = 1",
        f"name = {_quoted(description.modelName)}",
        f"step_s = {step_s!r}",
        *([f"cells = {cells}  # run it with bms-ukf hil"] if cells > 1 else []),
        "",
        "[plant]",
        f"fmu = {_quoted(fmu_name)}",
        *([] if valid else ["validate = false  # see the warnings"]),
        *([f"# step_s = {suggested_s!r}  # its own; left out: that of the scenario"] if suggested_s else []),
        *([] if roles["temperature_degC"] else ["ambient_degC = 25.0  # the FMU tells no temperature"]),
        '# current_positive = "charge"  # if its current or power is positive on charge',
        "",
        "[plant.parameters]",
        *(f"# {_quoted(v.name)} = {_literal(v)}" for v in parameters),
        "",
        '[plant.variables]  # "": the FMU has none',
        *(f"{role} = {_toml(entry)}" for role, entry in roles.items()),
        "",
        "[load]",
        f"segments = [{_segments(description, drive, roles)}]",
        "",
        "[estimator]",
        'cell = "lgm50_chen2020"  # the cell file of what the FMU models',
    ]


def _segments(description: Any, drive: str | None, roles: dict[str, Entry]) -> str:
    """Ten minutes of what the plant takes; positive = discharge."""
    if drive == "power_W":
        return "{ power_W = 0.0, duration_s = 60 }, { power_W = 4.0, duration_s = 540 }"
    if drive == "supply_V":
        given = next((v for v in description.modelVariables if v.name == roles["supply_V"]), None)
        unit = quantities.conversion(description, quantities.unit_of(given), quantities.VOLTAGE) if given else None
        start_V = (start_of(given) or 0.0) * unit.factor if given and unit else 0.0
        return f"{{ voltage_V = {start_V or 3.8!r}, duration_s = 600 }}"
    return "{ rest_s = 60 }, { current_A = 1.0, duration_s = 540 }"


def _literal(variable: Any) -> str:
    """A start value as TOML."""
    if variable.type == "String":
        return _quoted(variable.start or "")
    values = str(variable.start or "0").split()
    if variable.type == "Boolean":
        values = ["true" if value in ("true", "1", "True") else "false" for value in values]
    return f"[{', '.join(values)}]" if variable.dimensions else values[0]


def _toml(entry: Entry) -> str:
    if isinstance(entry, dict):
        return "{ " + ", ".join(f"{key} = {_quoted(value)}" for key, value in entry.items()) + " }"
    return _quoted(entry) if isinstance(entry, str) else f"[{', '.join(map(_quoted, entry))}]"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # a JSON string is a TOML basic string, but for surrogates
