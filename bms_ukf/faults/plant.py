"""Faults of the plant: what is driven stops answering, ends, or gives what is no number."""

from __future__ import annotations

from typing import Literal

from bms_ukf.faults.base import Injection


class PlantFault(Injection):
    """Stays to the end: a plant that has failed has lost its state."""

    for_s: None = None


class Hang(PlantFault):
    """A step is not answered."""

    kind: Literal["plant_hang"]


class Crash(PlantFault):
    """Its process ends."""

    kind: Literal["plant_crash"]


class Nan(PlantFault):
    """Its outputs are not finite."""

    kind: Literal["plant_nan"]


AnyFault = Hang | Crash | Nan
