"""The goals of each class, and the allowance for chance that a campaign of few runs gets.

Honesty is asked of every class alike. The floor of the share of ok rows and the ceiling of the median half-width are
the class's own, so that a vague interval wins nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from bms_ukf import honesty

CHANCE = 0.05  # of missing a goal by bad luck, in a quick campaign
LUCK = 1.2  # factor on a median or an RMSE in a quick campaign


class Goal(NamedTuple):
    """A limit of one figure; a `share` is of runs, so that chance is binomial."""

    figure: str
    limit: float
    at_least: bool
    share: bool = True

    @property
    def words(self) -> str:
        return f"at {'least' if self.at_least else 'most'} {self.limit:g}"

    def allowed(self, runs: int, quick: bool) -> float:
        """Return the limit with the allowance for chance over so many runs; the limit itself in a full campaign."""
        if not quick:
            return self.limit
        if not self.share:
            return self.limit * (1 / LUCK if self.at_least else LUCK)
        chance = CHANCE if self.at_least else 1.0 - CHANCE
        return 100.0 * quantile(chance, max(runs, 1), self.limit / 100) / max(runs, 1)

    def met(self, value: float | None, runs: int, quick: bool) -> bool:
        """Return whether a figure meets the goal; without a figure there is nothing to miss."""
        if value is None:
            return True
        allowed = self.allowed(runs, quick)
        return value >= allowed - 1e-9 if self.at_least else value <= allowed + 1e-9


class Sharpness(NamedTuple):
    """Floor and ceiling of a class, in percent."""

    ok_pct: float
    half_width_pct: float
    more: tuple[Goal, ...] = ()


_HALF_WIDTH_10MIN = Goal("half_width_10min_pct", 3.0, at_least=False, share=False)
_SETTLED_10MIN = Goal("error_10min_pct", 95.0, at_least=True)
_NAMED = Goal("named_pct", 95.0, at_least=True)
_START = Sharpness(50.0, 4.0, (_HALF_WIDTH_10MIN,))

SHARPNESS: Mapping[str, Sharpness] = {
    "start_after_hours": Sharpness(
        95.0,
        3.0,
        (
            Goal("warm_half_width_pct", 1.6, at_least=False, share=False),
            Goal("warm_rmse_pct", 0.47, at_least=False, share=False),
            _SETTLED_10MIN,
        ),
    ),
    "start_after_minutes": _START,
    "start_under_load": _START,
    "start_under_charge": _START,
    "start_in_drive": Sharpness(
        50.0,
        4.0,
        (
            _HALF_WIDTH_10MIN,
            Goal("flat_inside_pct", 93.0, at_least=True),
            Goal("flat_rmse_30min_pct", 8.0, at_least=False, share=False),
        ),
    ),
    "start_late_signal": _START,
    "start_told_wrong": _START,
    "gaps": Sharpness(50.0, 4.0),
    "rests": Sharpness(90.0, 4.0),
    "charges": Sharpness(90.0, 4.0),
    "sensor_error_alone": Sharpness(90.0, 4.0),
    "sensor_errors_together": Sharpness(90.0, 4.0),
    "current_fails": Sharpness(0.0, 40.0, (_NAMED,)),
    "voltage_fails": Sharpness(0.0, 40.0),
    "age": Sharpness(80.0, 6.0),
    "sampling": Sharpness(80.0, 4.0),
    "packs": Sharpness(80.0, 4.0),
    "temperatures": Sharpness(80.0, 6.0),
}


def of(name: str) -> tuple[Goal, ...]:
    """Return the goals of a class."""
    sharpness = SHARPNESS[name]
    return (
        Goal("inside_pct", 100 * honesty.INSIDE_AT_LEAST, at_least=True),
        Goal("beyond_pct", 100 * honesty.BEYOND_AT_MOST, at_least=False),
        Goal("ok_pct", sharpness.ok_pct, at_least=True),
        Goal("half_width_pct", sharpness.half_width_pct, at_least=False, share=False),
        *sharpness.more,
    )


AVERAGE = Goal("beyond_pct", 100 * honesty.BEYOND_ON_AVERAGE, at_least=False)


def missed(name: str, figures: Mapping[str, Any], quick: bool) -> list[Goal]:
    """Return the goals that the figures of a class miss."""
    return [goal for goal in of(name) if not goal.met(figures[goal.figure], figures["runs"], quick)]


def quantile(probability: float, trials: int, success: float) -> int:
    """Return the smallest count whose binomial distribution function reaches `probability`."""
    total = 0.0
    for count in range(trials + 1):
        total += math.comb(trials, count) * success**count * (1.0 - success) ** (trials - count)
        if total >= probability - 1e-12:
            return count
    return trials
