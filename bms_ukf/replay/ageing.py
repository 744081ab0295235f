"""What a replay found of how the cells have aged, for its summary.

| key | meaning |
|---|---|
| `soh`, `soh_sigma` | capacity as a share of the cell file's, of the cell with least; null: nothing has told of it |
| `soh_segments` | between rests, that have told of that cell's |
| `r0_scale`, `r0_scale_sigma` | r0 as a multiple of the cell file's, of the cell with most; null: not told |
"""

from __future__ import annotations

import math

from bms_ukf.pack import Health


def ageing(health: Health | None) -> dict[str, float | int | None]:
    """The keys above; all null or 0 without a `health`."""
    known = None if health is None else health.ageing()
    capacity = resistance = None
    if known is not None and not math.isnan(known.capacity_min):
        capacity = known.capacity_min, known.capacity_sigma
    if known is not None and not math.isnan(known.resistance_max):
        resistance = known.resistance_max, known.resistance_sigma
    soh, soh_sigma = capacity or (None, None)
    r0_scale, r0_scale_sigma = resistance or (None, None)
    return {
        "soh": soh,
        "soh_sigma": soh_sigma,
        "soh_segments": 0 if known is None else known.segments,
        "r0_scale": r0_scale,
        "r0_scale_sigma": r0_scale_sigma,
    }
