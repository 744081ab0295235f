"""A cell of the same family, larger or smaller than the one a cell file describes."""

from __future__ import annotations

from bms_ukf.cell import CellParams


def scaled(cell: CellParams, capacity: float, resistance: float | None = None) -> CellParams:
    """The cell with `capacity` times the capacity and `resistance` times the resistances (None: 1 / capacity).

    The OCV, the time constants and the errors in volts stay: it is the same electrode, with more or less of its area.
    Current limits and knees grow with the capacity, and the core warms as much at the same C-rate.
    """
    factor = 1.0 / capacity if resistance is None else resistance
    limits, dynamics = cell.cell, cell.dynamics
    tables = dict.fromkeys(("r0_ohm", "r0_charge_ohm", "r1_ohm", "r2_ohm", "r3_ohm"), factor) | {"r0_knee_A": capacity}
    made = cell.model_copy(
        update={
            "cell": limits.model_copy(
                update={
                    "capacity_Ah": limits.capacity_Ah * capacity,
                    "current_limits_A": [limit * capacity for limit in limits.current_limits_A],
                }
            ),
            "dynamics": dynamics.model_copy(
                update={
                    key: [[value * by for value in row] for row in table]
                    for key, by in tables.items()
                    if (table := getattr(dynamics, key)) is not None
                }
            ),
        }
    )
    if cell.thermal is not None:
        per_W = cell.thermal.core_K_per_W / (capacity * capacity * factor)
        made = made.model_copy(update={"thermal": cell.thermal.model_copy(update={"core_K_per_W": per_W})})
    return CellParams.model_validate(made.model_dump())
