"""The figures of a score, as `bms-ukf score --json` writes them.

| key | meaning |
|---|---|
| `manifest`, `cell`, `capacity_Ah` | what was scored |
| `weights` | of each group that the recordings fill, renormalised to a sum of 1 |
| `missing` | what of the benchmark they do not fill; an initial SoC needs a drive that comes by it |
| `offsets_c_rate` | each current offset, A, as a share of the capacity per hour |
| `estimators` | by name (`srukf`: ours, `ekf`, `coulomb`), see below |
| `step_s` | between the rows that were scored; null: rows as recorded |
| `health` | whether ours learned the capacity on the way |
| `outcomes` | every run: `estimator, recording, role, group, temperature_degC, use, kind, value, case`, and `figures` |

An estimator has `weighted_rmse_pct`; `groups` and `temperatures` (by degC), each with `rmse_pct, mae_pct, max_pct,
coverage95, half_width_pct, settled_s` (`weights.figures`); `variants`, the same for each temperature and case, with
`temperature_degC`, `case` and `recordings` (how many); and `fitted`, nominal figures of the recordings the cell file
was fitted to, which count for nothing else (None if there are none). `figures` are those of `metrics.score`. Errors
are in % SoC.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bms_ukf.cell import CellParams
from bms_ukf.score import cases, weights
from bms_ukf.score.recorded import Recorded
from bms_ukf.score.weights import Outcome


def summarise(
    path: Path, cell: CellParams, recordings: Sequence[Recorded], outcomes: Sequence[Outcome]
) -> dict[str, Any]:
    names = list(dict.fromkeys(outcome.estimator for outcome in outcomes))
    filled = weights.grouped(outcomes)
    capacity_Ah = cell.cell.capacity_Ah
    return {
        "manifest": str(path),
        "cell": cell.cell.name,
        "capacity_Ah": capacity_Ah,
        "weights": weights.normalised(list(filled)),
        "missing": _missing(filled, recordings),
        "offsets_c_rate": {f"{offset_A:+g}": offset_A / capacity_Ah for offset_A in cases.OFFSETS_A},
        "estimators": {name: _estimator([o for o in outcomes if o.estimator == name]) for name in names},
        "outcomes": [outcome._asdict() for outcome in outcomes],
    }


def _estimator(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    grouped = weights.grouped(outcomes)
    groups = {name: weights.figures(name, found) for name, found in grouped.items()}
    shares = weights.normalised(list(groups))
    degrees = sorted({outcome.temperature_degC for outcome in grouped["nominal"]}, reverse=True)
    fitted = [outcome for outcome in outcomes if outcome.use == "fit"]
    return {
        "weighted_rmse_pct": sum(share * (groups[name]["rmse_pct"] or 0.0) for name, share in shares.items()),
        "groups": groups,
        "temperatures": {
            f"{degree:g}": weights.figures("", [o for o in grouped["nominal"] if o.temperature_degC == degree])
            for degree in degrees
        },
        "variants": [
            {**variant._asdict(), "recordings": len(found), **weights.figures("", found)}
            for variant, found in weights.variants(outcomes).items()
        ],
        "fitted": weights.figures("", fitted) if fitted else None,
    }


def _missing(filled: dict[str, list[Outcome]], recordings: Sequence[Recorded]) -> list[str]:
    missing = [name for name in weights.WEIGHTS if name not in filled]
    cut = {(outcome.recording, outcome.value) for outcome in filled.get("initial SoC", [])}
    for level in cases.LEVELS:
        drives = [recorded.name for recorded in recordings if recorded.test.role == "drive"]
        uncut = [name for name in drives if (name, level) not in cut]
        if uncut:
            missing.append(f"initial SoC {level:g} ({', '.join(uncut)})")
    return missing
