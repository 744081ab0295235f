"""Plants: FMI co-simulation FMUs that play the cell, each in a process of its own."""

from bms_ukf.plant.plant import Plant, PlantState, open_plant
from bms_ukf.plant.table import PlantTable

__all__ = ["Plant", "PlantState", "PlantTable", "open_plant"]
