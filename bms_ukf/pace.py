"""When sets of frames are published."""

from __future__ import annotations

from typing import NamedTuple


class Pace(NamedTuple):
    """When sets of frames are published, and how fast `SocSlewed` moves."""

    silence_s: float = 2.0  # after the last set a prediction is sent
    period_s: float | None = None  # None: an answer after every scan of the voltages
    soc_slew_per_s: float = 0.001
