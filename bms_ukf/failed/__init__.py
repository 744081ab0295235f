"""Current sensors that fail during a run, found from the physics of the cell: see `sensor`, which puts it together."""

from bms_ukf.failed.sensor import CurrentSensor
from bms_ukf.failed.watch import Watch

__all__ = ["CurrentSensor", "Watch"]
