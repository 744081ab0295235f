"""What may go wrong on a scenario's timeline: the `[[fault]]` tables, and what each does to what passes through it."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bms_ukf.faults import can, plant, sensor, system

Fault = Annotated[sensor.AnyFault | can.AnyFault | plant.AnyFault | system.AnyFault, Field(discriminator="kind")]
