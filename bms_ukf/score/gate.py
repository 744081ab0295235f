"""`--gate NAME=LIMIT`: a score that must not be worse than this, for a user's CI."""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.errors import ConfigError


def parse(text: str) -> tuple[str, float]:
    """Name and limit of a gate. Raises ConfigError for what is neither."""
    name, _, limit = text.partition("=")
    try:
        value = float(limit)
    except ValueError:
        value = math.nan
    if not value >= 0:
        raise ConfigError("--gate", value=text, expected="weighted_rmse_pct=X with a limit X in % SoC")
    return name, value


def figures(summary: dict[str, Any]) -> dict[str, float]:
    """What a gate may name, of the first estimator: the weighted score and every group's."""
    ours = next(iter(summary["estimators"].values()))
    by_group = {f"{_key(name)}_rmse_pct": float(found["rmse_pct"]) for name, found in ours["groups"].items()}
    return {"weighted_rmse_pct": float(ours["weighted_rmse_pct"])} | by_group


def verdict(summary: dict[str, Any], name: str, limit: float) -> str | None:
    """What is wrong, None if nothing is. Raises ConfigError for a figure that this score does not have."""
    known = figures(summary)
    if name not in known:
        raise ConfigError("--gate", key=name, expected=f"one of {', '.join(known)}")
    return None if known[name] <= limit else f"{name} is {known[name]:.3f}, above its gate of {limit:g}"


def _key(group: str) -> str:
    return group.lower().replace(" ", "_").replace("-", "_")
