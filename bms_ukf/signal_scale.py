"""What one bit of each signal is worth, compared with the cell whose current, voltage or temperature it carries."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.signals import Bound

_SPEC = {
    "current": "current_resolution_A",
    "voltage": "voltage_resolution_V",
    "temperature": "temperature_resolution_K",
}


def resolutions(bound: Sequence[Bound]) -> dict[str, float]:
    """Return the coarsest step of each quantity, per cell, by the names that `SensorSpec` has for it.

    A float signal has no step: 0.
    """
    return {
        name: max((b.bit for b in bound if b.role == role and not b.is_float), default=0.0)
        for role, name in _SPEC.items()
    }


def check_scale(bound: Bound, cell: CellParams, source: Path) -> None:
    """Raise ConfigError if a signal cannot carry the current, voltage or temperature of that cell."""
    limits = cell.cell
    low, high = {
        "current": (0.0, 0.1 * limits.capacity_Ah),
        "voltage": (limits.voltage_limits_V[0], limits.voltage_limits_V[1]),
        "temperature": (20.0, 30.0),
    }[bound.role]
    coarsest = {"current": limits.capacity_Ah, "voltage": 0.1, "temperature": 10.0}[bound.role]
    reaches = bound.lowest <= low and high <= bound.highest
    if bound.role == "current":  # of a sensor that sees one direction only
        reaches |= bound.lowest <= -high and bound.highest >= 0.0
    if not reaches or (bound.bit > coarsest and not bound.is_float):
        unit = {"current": "A", "voltage": "V", "temperature": "degC"}[bound.role]
        says = f"{bound.lowest:g} to {bound.highest:g}, {bound.bit:g} a bit"
        expected = (
            f"{low:g} to {high:g} {unit} in bits below {coarsest:g} for each {limits.name}; it can say {says} "
            f"(see unit, series_cells, parallel_cells, capacity_scale)"
        )
        raise ConfigError(source, key=f"signals.{bound.role}", value=bound.name, expected=expected)
