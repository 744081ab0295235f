"""The EKF's figures on measured cells, kept as a baseline, and this package's estimator listed against them.

    BMS_UKF_DATA=<folder> python tests/reference/golden_ekf.py            # run ours, list it against the baseline
    BMS_UKF_DATA=<folder> python tests/reference/golden_ekf.py --write    # make the baseline again, from the EKF of now

The baseline stands still while the cell files and the EKF change: `golden_ekf.json` names the commit of the EKF and the
cell files that made it, and the command. A group is a set (manifest), a temperature and a case of `bms-ukf score`.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import click

from bms_ukf import CellParams
from bms_ukf.score import Grid, score

ROOT = Path(__file__).resolve().parents[2]
FILE = Path(__file__).with_suffix(".json")
SETS = ("panasonic_ncr18650pf", "a123_lfp")
COMMAND = "bms-ukf score models/cells/manifests/{set}.toml --cell {set} --estimator ekf --json {set}.json"
KEPT = ("temperature_degC", "case", "recordings", "rmse_pct", "max_pct", "coverage95", "half_width_pct")


class Listed(NamedTuple):
    """One group: the baseline's RMSE, and ours; None where one of the two has no such group."""

    set: str
    temperature_degC: float
    case: str
    ekf_rmse_pct: float | None
    rmse_pct: float | None
    coverage95: float | None
    half_width_pct: float | None


def variants(name: str, estimator: str) -> list[dict[str, Any]]:
    """The figures of an estimator on a set, a group each."""
    manifest = ROOT / "models" / "cells" / "manifests" / f"{name}.toml"
    summary = score(
        manifest, CellParams.load(name), Grid((estimator,)), progress=lambda text: click.echo(text, err=True)
    )
    found: list[dict[str, Any]] = summary.summary["estimators"][estimator]["variants"]
    return found


def baseline() -> dict[str, Any]:
    """Return the content of `golden_ekf.json`, from the EKF of now."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True)
    sets = {}
    for name in SETS:
        file = ROOT / "models" / "cells" / f"{name}.toml"
        kept = [
            {key: round(found[key], 4) if isinstance(found[key], float) else found[key] for key in KEPT}
            for found in variants(name, "ekf")
        ]
        sets[name] = {"cell_sha256": hashlib.sha256(file.read_bytes()).hexdigest(), "variants": kept}
    return {"command": COMMAND, "commit": commit.stdout.strip(), "sets": sets}


def load() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def against(name: str, golden: dict[str, Any], ours: list[dict[str, Any]]) -> Iterator[Listed]:
    """Our figures on a set beside the baseline's."""

    def by_group(found: list[dict[str, Any]]) -> dict[tuple[float, str], dict[str, Any]]:
        return {(variant["temperature_degC"], variant["case"]): variant for variant in found}

    kept, now = by_group(golden["sets"][name]["variants"]), by_group(ours)
    for group in [*kept, *(group for group in now if group not in kept)]:
        mine = now.get(group, {})
        figures = (mine.get(key) for key in ("rmse_pct", "coverage95", "half_width_pct"))
        yield Listed(name, *group, kept.get(group, {}).get("rmse_pct"), *figures)


def main() -> None:
    if sys.argv[1:] == ["--write"]:
        FILE.write_text(json.dumps(baseline(), indent=1) + "\n", encoding="utf-8")
        return
    golden = load()
    rows = [row for name in SETS for row in against(name, golden, variants(name, "srukf"))]
    click.echo(f"{'set':22}{'degC':>6}  {'case':16}{'EKF then':>9}{'ours':>8}{'inside':>9}{'half-width':>12}")
    for row in rows:
        figures = "".join(
            f"{'–' if value is None else f'{factor * value:.2f}':>{width}}"
            for value, factor, width in zip(row[3:], (1, 1, 100, 1), (9, 8, 9, 12), strict=True)
        )
        click.echo(f"{row.set:22}{row.temperature_degC:6g}  {row.case:16}{figures}")
    both = [
        (row.rmse_pct, row.ekf_rmse_pct) for row in rows if row.rmse_pct is not None and row.ekf_rmse_pct is not None
    ]
    click.echo(f"ours below the baseline in {sum(ours < then for ours, then in both)} of {len(both)} groups")


if __name__ == "__main__":
    main()
