"""The benchmark's weights, over the groups that recordings of one cell can fill.

A group's figure is the mean over its recordings of the RMSE, in % SoC; the score is the weighted sum over the groups.
Of current offsets only those of 0.3 A count.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf.score.cases import INITIAL, INITIAL_WEIGHTS, NOMINAL, OFFSET, STARTUP

WEIGHTS = {
    "withheld cell": 0.1,
    "open cells": 0.1,
    "charging": 0.1,
    "standard cycles": 0.1,
    "mixed cycles": 0.1,
    "initial SoC": 0.1,
    "current offset": 0.1,
    "payloads": 0.2,
    "temperatures": 0.1,
}
WEIGHTED_OFFSET_A = 0.3
APART = ("start-up after 600 s", "current offset 0.1 A", "nominal")  # reported beside the groups, without a weight


class Outcome(NamedTuple):
    """One estimator's run of one case."""

    estimator: str
    recording: str
    role: str
    group: str  # of the manifest's test: standard or mixed
    temperature_degC: float
    use: str
    kind: str
    value: float
    case: str
    figures: dict[str, Any]  # `metrics.score`


def grouped(outcomes: Sequence[Outcome]) -> dict[str, list[Outcome]]:
    """Outcomes of one estimator by group; groups that nothing fills are left out."""
    held_out = [outcome for outcome in outcomes if outcome.use == "validate"]
    nominal = [outcome for outcome in held_out if outcome.kind == NOMINAL]
    drives = [outcome for outcome in nominal if outcome.role == "drive"]
    offsets = [outcome for outcome in held_out if outcome.kind == OFFSET]
    groups = {
        "charging": [outcome for outcome in nominal if outcome.role == "charge"],
        "standard cycles": [outcome for outcome in drives if outcome.group == "standard"],
        "mixed cycles": [outcome for outcome in drives if outcome.group == "mixed"],
        "initial SoC": [outcome for outcome in held_out if outcome.kind == INITIAL],
        "current offset": [outcome for outcome in offsets if abs(outcome.value) == WEIGHTED_OFFSET_A],
        "temperatures": drives,
        "start-up after 600 s": [outcome for outcome in held_out if outcome.kind == STARTUP],
        "current offset 0.1 A": [outcome for outcome in offsets if abs(outcome.value) != WEIGHTED_OFFSET_A],
        "nominal": nominal,
    }
    return {name: found for name, found in groups.items() if found}


def figures(name: str, outcomes: Sequence[Outcome]) -> dict[str, float | None]:
    """Means over a group's outcomes of `rmse_pct, mae_pct, coverage95, half_width_pct, settled_s`; largest `max_pct`.

    A run without any estimate counts as wrong by 100 %: silence must not win. `settled_s` is None if one never settled.
    Of wrong starts, the mean at each cut is weighed as the benchmark does (`INITIAL_WEIGHTS`), over the cuts there are.
    Start-up runs count from 600 s on.
    """
    shares = _shares(outcomes)

    def mean(values: list[float]) -> float:
        return float(np.dot(shares, values))

    seen = [outcome.figures["after_600s"] if outcome.kind == STARTUP else outcome.figures for outcome in outcomes]
    settled = [outcome.figures["settled_s"] for outcome in outcomes]
    rmse = [_or(found["rmse_pct"], 100.0) for found in seen]
    if name == "temperatures":
        degrees = np.array([outcome.temperature_degC for outcome in outcomes])
        rmse_pct = float(np.mean([np.mean(np.array(rmse)[degrees == degree]) for degree in np.unique(degrees)]))
    else:
        rmse_pct = mean(rmse)
    return {
        "rmse_pct": rmse_pct,
        "mae_pct": mean([_or(found["mae_pct"], 100.0) for found in seen]),
        "max_pct": max(_or(found["max_pct"], 100.0) for found in seen),
        "coverage95": mean([_or(found["coverage95"], 0.0) for found in seen]),
        "half_width_pct": mean([_or(found["half_width_pct"], 50.0) for found in seen]),
        "settled_s": None if None in settled else mean(settled),
    }


def _shares(outcomes: Sequence[Outcome]) -> NDArray[np.float64]:
    """The weight of each outcome in the means of its group; their sum is 1."""
    cuts = Counter(outcome.value for outcome in outcomes if outcome.kind == INITIAL)
    weight = [
        INITIAL_WEIGHTS[outcome.value] / cuts[outcome.value] if outcome.kind == INITIAL else 1.0 for outcome in outcomes
    ]
    return np.array(weight) / sum(weight)


class Variant(NamedTuple):
    """Temperature and case: the smallest group whose interval is judged."""

    temperature_degC: float
    case: str


def variants(outcomes: Sequence[Outcome]) -> dict[Variant, list[Outcome]]:
    """Outcomes of one estimator on recordings that were not fitted: warmest first, cases in the order of the grid."""
    found: dict[Variant, list[Outcome]] = {}
    for outcome in outcomes:
        if outcome.use == "validate":
            found.setdefault(Variant(outcome.temperature_degC, outcome.case), []).append(outcome)
    order = (NOMINAL, OFFSET, INITIAL, STARTUP)

    def place(variant: Variant) -> tuple[float, int, float]:
        first = found[variant][0]
        value = first.value if first.kind == OFFSET else -first.value
        return -variant.temperature_degC, order.index(first.kind), value

    return {variant: found[variant] for variant in sorted(found, key=place)}


def normalised(groups: Sequence[str]) -> dict[str, float]:
    """The weights of the groups there are, summing to 1."""
    present = {name: weight for name, weight in WEIGHTS.items() if name in groups}
    total = sum(present.values())
    return {name: weight / total for name, weight in present.items()}


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
