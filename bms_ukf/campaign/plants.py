"""The plants whose traces the campaign runs on: how each FMU comes about, and which cell file stands for it."""

from __future__ import annotations

from typing import NamedTuple


class CampaignPlant(NamedTuple):
    """A plant of one cell. Capacity and limits are those of a user's data sheet: they scale loads, nothing else."""

    name: str
    cell: str  # the cell file that was identified from tests on it
    capacity_Ah: float  # between the voltage limits at rest; of a new cell
    nominal_Ah: float
    low_V: float
    high_V: float
    nominal_V: float
    resistance_ohm: float  # of a cell at half charge and 25 degC, after a second
    current_quantum_A: float
    maker: tuple[str, ...] = ()  # what plantmaker is told; empty: the FMU is a shipped one


PLANTS = {
    plant.name: plant
    for plant in (CampaignPlant("lgm50_spme", "lgm50_chen2020", 5.1532, 5.0, 2.5, 4.2, 3.63, 0.0253, 1e-3),)
}
