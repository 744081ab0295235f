"""How good an estimate was: errors against a reference SoC, whether the interval was honest, and the goals for both.

The keys and their meaning are part of the summary JSON that users' scripts read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bms_ukf import honesty

Array = NDArray[np.float64]

SETTLED_PCT = 2.0  # an estimate has settled when its error stays within this
PAD_S = 600.0  # the second set of figures leaves out the time the estimator needs to find the state


def score(
    t_s: ArrayLike,
    soc: ArrayLike,
    interval: tuple[ArrayLike, ArrayLike],
    soc_ref: ArrayLike,
    soc_ref_sigma: float = 0.0,
) -> dict[str, Any]:
    """Errors of an estimate (estimate minus reference) over all rows and, under `"after_600s"`, from 600 s on.

    All arrays have shape (n,), SoC and the bounds of its 95 % `interval` are 0..1, time increases. Rows without a
    reference (NaN) are left out; rows with a reference where the estimate or a bound is not available (NaN) are counted
    and cannot settle.

    Returns:
        `n_scored` and `n_unavailable`, then, None where there is nothing to score:
        `rmse_pct`, `mae_pct`, `max_pct` (largest absolute error), `bias_pct` (mean error), `coverage95` (share of rows
        whose reference is inside the interval, as `honesty.inside` has it), `settled_s` (seconds from the first row
        until the error stays within 2 %), `half_width_pct` (median of half the interval).
    """
    time_s = np.asarray(t_s, dtype=np.float64)
    elapsed_s = time_s - time_s[:1]
    reference = np.asarray(soc_ref, dtype=np.float64)
    error = np.asarray(soc, dtype=np.float64) - reference
    low, high = (np.asarray(bound, dtype=np.float64) for bound in interval)
    error = np.where(np.isfinite(low + high), error, np.nan)
    inside = honesty.inside(low, high, reference, soc_ref_sigma)

    known = np.isfinite(reference)
    elapsed_s, error, inside, half_width = elapsed_s[known], error[known], inside[known], (high - low)[known] / 2
    late = elapsed_s >= PAD_S
    after = _window(elapsed_s[late], error[late], inside[late], half_width[late])
    return _window(elapsed_s, error, inside, half_width) | {"after_600s": after}


def _window(elapsed_s: Array, error: Array, inside: NDArray[np.bool_], half_width: Array) -> dict[str, Any]:
    available = np.isfinite(error)
    counts = {"n_scored": int(available.sum()), "n_unavailable": int((~available).sum())}
    if not available.any():
        return counts | dict.fromkeys(
            ("rmse_pct", "mae_pct", "max_pct", "bias_pct", "coverage95", "settled_s", "half_width_pct")
        )
    error_pct = 100 * error[available]
    outside = ~available | (np.abs(100 * error) > SETTLED_PCT)
    first_settled = int(np.flatnonzero(outside)[-1]) + 1 if outside.any() else 0
    return counts | {
        "rmse_pct": float(np.sqrt(np.mean(error_pct**2))),
        "mae_pct": float(np.mean(np.abs(error_pct))),
        "max_pct": float(np.max(np.abs(error_pct))),
        "bias_pct": float(np.mean(error_pct)),
        "coverage95": float(np.mean(inside[available])),
        "settled_s": float(elapsed_s[first_settled]) if first_settled < elapsed_s.size else None,
        "half_width_pct": float(100 * np.median(half_width[available])),
    }


@dataclass(slots=True, frozen=True)
class Check:
    """One goal held against one figure of a summary."""

    name: str
    value: float | None  # None: nothing could be scored, which never passes
    goal: str
    passed: bool


def judge(summary: dict[str, Any]) -> list[Check]:
    """The goals, each with what the summary of a run reached, in percent. A run below 600 s has no goal after them."""
    late, coverage = summary["after_600s"], summary["coverage95"]
    covered = None if coverage is None else 100 * coverage
    checks = [
        Check("95 % interval holds the truth", covered, "90 to 100 %", covered is not None and 90 <= covered <= 100)
    ]
    if late["n_scored"] or late["n_unavailable"]:
        rmse = late["rmse_pct"]
        checks.insert(0, Check("SoC RMSE after 600 s", rmse, "at most 1 %", rmse is not None and rmse <= 1))
    return checks
