"""The benchmark's weights, over the groups that recordings of one cell can fill.

A group's figure is the mean over its recordings of the RMSE, in % SoC; the score is the weighted sum over the groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bms_ukf.score.cases import INITIAL, NOMINAL, OFFSET, STARTUP

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
    """Means over a group's outcomes of `rmse_pct, mae_pct, coverage95, settled_s`, and its largest `max_pct`.

    A run without any estimate counts as wrong by 100 %: silence must not win. `settled_s` is None if one never settled.
    """
    late = name.startswith("start-up")
    seen = [outcome.figures["after_600s"] if late else outcome.figures for outcome in outcomes]
    settled = [outcome.figures["settled_s"] for outcome in outcomes]
    rmse = [_or(found["rmse_pct"], 100.0) for found in seen]
    if name == "temperatures":
        degrees = np.array([outcome.temperature_degC for outcome in outcomes])
        rmse = [float(np.mean(np.array(rmse)[degrees == degree])) for degree in np.unique(degrees)]
    return {
        "rmse_pct": float(np.mean(rmse)),
        "mae_pct": float(np.mean([_or(found["mae_pct"], 100.0) for found in seen])),
        "max_pct": max(_or(found["max_pct"], 100.0) for found in seen),
        "coverage95": float(np.mean([_or(found["coverage95"], 0.0) for found in seen])),
        "settled_s": None if None in settled else float(np.mean(settled)),
    }


def normalised(groups: Sequence[str]) -> dict[str, float]:
    """The weights of the groups there are, summing to 1."""
    present = {name: weight for name, weight in WEIGHTS.items() if name in groups}
    total = sum(present.values())
    return {name: weight / total for name, weight in present.items()}


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
