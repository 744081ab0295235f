"""When something goes wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from bms_ukf import toml

NonNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, le=1)]
Text = Annotated[str, Field(min_length=1)]


class Injection(toml.Section):
    """A fault from `at_s` on, for `for_s` (None: to the end), in seconds of the scenario.

    It acts on what is measured, sent or asked for at times t with at_s <= t < at_s + for_s.
    """

    kind: str
    at_s: NonNegative
    for_s: Positive | None = None
    name: Text | None = None  # by which expectations refer to it; None: its kind

    @property
    def label(self) -> str:
        return self.name or self.kind

    @property
    def end_s(self) -> float:
        """Infinite if it stays."""
        return math.inf if self.for_s is None else self.at_s + self.for_s

    def active(self, t_ns: int) -> bool:
        return round(self.at_s * 1e9) <= t_ns < (math.inf if self.for_s is None else round(self.end_s * 1e9))

    def since_s(self, t_ns: int) -> float:
        return (t_ns - round(self.at_s * 1e9)) * 1e-9


def generators(seed: int, faults: Sequence[Injection]) -> list[np.random.Generator]:
    """Dice for each fault: its own, so that another fault on the timeline does not change how they fall."""
    return [np.random.default_rng([seed, *fault.label.encode()]) for fault in faults]
