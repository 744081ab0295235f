"""All traces that a situation may be cut from: those of plants, and recordings of real cells where they are."""

from __future__ import annotations

from functools import lru_cache

from bms_ukf.campaign import recorded, traces
from bms_ukf.campaign.recorded import RECORDED
from bms_ukf.campaign.traces import Trace


def plants() -> list[str]:
    """Return the plants with traces, then the cells with recordings; of these none without BMS_UKF_DATA."""
    real = () if recorded.missing() else dict.fromkeys(each.cell for each in RECORDED.values())
    return [*traces.plants(), *real]


def names(plant: str) -> list[str]:
    """Return the names of a plant's traces, or of a cell's recordings."""
    return [name for name, each in RECORDED.items() if each.cell == plant] or traces.names(plant)


@lru_cache(maxsize=64)
def load(name: str) -> Trace:
    """Return a trace by its name, decoded once. Raises ConfigError for a name that does not exist."""
    return recorded.load(name) if name in RECORDED else traces.load(name)
