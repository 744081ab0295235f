"""The figures of one run, and of all runs of a class together.

Every set that counts is one row; a pack has a row for each of its cells. Sharpness, the share of ok rows and the
half-width, is that of runs whose cell is not LFP and whose temperature the cell file covers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf import honesty
from bms_ukf.campaign import classes
from bms_ukf.campaign.run import Published, judged, run
from bms_ukf.campaign.situation import Situation
from bms_ukf.records import Fault, Status

TEN_MINUTES_S, HALF_HOUR_S = 600.0, 1800.0
WARM_degC = 10.0
SETTLED = 0.03  # error of SoC ten minutes after a start
EVERY = 10  # rows of which one half-width is kept for the median


class RunFigures(NamedTuple):
    """What one run adds to its class: counts of rows, sums, and what is asked of it alone."""

    name: str
    seed: int
    words: str
    plant: str
    cell: str
    flat: bool
    sharp: bool  # held to the floor and the ceiling
    warm: bool
    rows: int
    known: int  # rows with a SoC, ok or degraded
    inside: int
    ok: int
    beyond: int  # of the ok rows
    squared: float  # sum of squared errors over the known rows
    half_widths: NDArray[np.float32]
    late_known: int  # from half an hour on
    late_squared: float
    error_10min: float | None  # largest of the cells
    half_width_10min: float | None
    within_s: float | None  # limit on the time under load until a failed sensor is named
    named_s: float | None  # that time; None: never, or no sensor fails

    @property
    def rmse(self) -> float | None:
        return (self.squared / self.known) ** 0.5 if self.known else None

    @property
    def in_time(self) -> bool:
        return self.within_s is None or (self.named_s is not None and self.named_s <= self.within_s)

    @property
    def badness(self) -> tuple[float, float, float]:
        """Larger for a worse run: rows that lie, rows outside, error."""
        outside = 1.0 - self.inside / self.known if self.known else 0.0
        return self.beyond / max(self.rows, 1), outside, self.rmse or 0.0


def of_run(name: str, seed: int, plants: Sequence[str] = ()) -> RunFigures:
    """Draw the situation of a class and a seed on these plants (none: all), run it, and return its figures."""
    situation = classes.situation(name, seed, plants)
    return judge(name, seed, situation, run(situation))


def judge(name: str, seed: int, situation: Situation, published: Published) -> RunFigures:
    """Return the figures of a run."""
    kept = judged(published)
    t_s, soc, truth = published.t_s[kept], published.soc[kept], published.truth[kept]
    low, high = published.low[kept], published.high[kept]
    known = np.isfinite(soc)
    ok = known & (published.status[kept] == Status.OK)[:, None]
    error = soc - np.clip(truth, 0.0, 1.0)
    squared = np.where(known, error, 0.0) ** 2
    half_width = (high - low) / 2
    late = t_s >= HALF_HOUR_S
    after = np.flatnonzero((t_s >= TEN_MINUTES_S) & known.all(axis=1))
    failure = situation.failure
    return RunFigures(
        name,
        seed,
        situation.words,
        situation.plant,
        situation.cell,
        published.flat,
        published.covered and not published.flat,
        situation.true_degC >= WARM_degC,
        int(known.size),
        int(known.sum()),
        int(honesty.inside(low, high, truth, published.ref_sigma)[known].sum()),
        int(ok.sum()),
        int(honesty.beyond(low, high, truth, published.ref_sigma)[ok].sum()),
        float(squared.sum()),
        half_width[::EVERY][known[::EVERY]].astype(np.float32),
        int(known[late].sum()),
        float(squared[late].sum()),
        float(np.abs(error[after[0]]).max()) if after.size else None,
        float(half_width[after[0]].max()) if after.size else None,
        *(_naming(situation, published) if failure else (None, None)),
    )


def _naming(situation: Situation, published: Published) -> tuple[float | None, float | None]:
    """Return the limit on, and the time under load from the failure until a fault bit of that sensor appears.

    The limit is None where the class sets none or the run ends before it; the time is None if no bit appears.
    """
    failure = situation.failure
    assert failure is not None
    bits = sum(bit for bit in Fault if (bit.name or "").startswith(f"{failure.sensor.upper()}_"))
    rows = np.flatnonzero((published.t_s > failure.at_s) & (published.faults & bits != 0))
    loaded_s = np.where(situation.loaded, np.diff(situation.t_s, prepend=0.0), 0.0)

    def under_load_s(until_s: float) -> float:
        return float(loaded_s[(situation.t_s > failure.at_s) & (situation.t_s <= until_s)].sum())

    named_s = under_load_s(published.t_s[rows[0]]) if rows.size else None
    within_s = failure.within_s
    if within_s is not None and named_s is None and under_load_s(np.inf) < within_s:
        within_s = None
    return within_s, named_s


def of_class(runs: Sequence[RunFigures]) -> dict[str, Any]:
    """Return the figures of runs together, by the keys of the JSON; None where there is nothing to judge."""
    sharp, warm = [run for run in runs if run.sharp], [run for run in runs if run.sharp and run.warm]
    errors = [run.error_10min for run in warm]
    asked = [run for run in runs if run.within_s is not None]
    worst = max(runs, key=lambda run: run.badness)
    return {
        "runs": len(runs),
        "rows": sum(run.rows for run in runs),
        "inside_pct": _pct(sum(run.inside for run in runs), sum(run.known for run in runs)),
        "beyond_pct": _pct(sum(run.beyond for run in runs), sum(run.ok for run in runs)),
        "ok_pct": _pct(sum(run.ok for run in sharp), sum(run.rows for run in sharp)),
        "half_width_pct": _median_pct([run.half_widths for run in sharp]),
        "rmse_pct": _rmse_pct(sum(run.squared for run in runs), sum(run.known for run in runs)),
        "sharp_runs": len(sharp),
        "warm_half_width_pct": _median_pct([run.half_widths for run in warm]),
        "warm_rmse_pct": _rmse_pct(sum(run.squared for run in warm), sum(run.known for run in warm)),
        "error_10min_pct": _pct(sum(error is not None and error <= SETTLED for error in errors), len(errors)),
        "half_width_10min_pct": _median_pct([[run.half_width_10min] for run in warm if run.half_width_10min]),
        "flat_inside_pct": _flat(runs, "inside", "known", _pct),
        "flat_rmse_30min_pct": _flat(runs, "late_squared", "late_known", _rmse_pct),
        "named_pct": _pct(sum(run.in_time for run in asked), len(asked)),
        "named_s": float(np.median(named))
        if (named := [run.named_s for run in runs if run.named_s is not None])
        else None,
        "worst_seed": worst.seed,
    }


def _flat(runs: Sequence[RunFigures], over: str, under: str, share: Any) -> float | None:
    flat = [run for run in runs if run.flat]
    found: float | None = share(sum(getattr(run, over) for run in flat), sum(getattr(run, under) for run in flat))
    return found


def _pct(part: float, whole: float) -> float | None:
    return 100.0 * part / whole if whole else None


def _rmse_pct(squared: float, count: float) -> float | None:
    return 100.0 * float(np.sqrt(squared / count)) if count else None


def _median_pct(parts: Sequence[Any]) -> float | None:
    values = np.concatenate([np.asarray(part, dtype=float) for part in parts]) if parts else np.empty(0)
    return 100.0 * float(np.median(values)) if values.size else None
