"""`bms-ukf score`: the blind benchmark's grid over a user's recordings, for three estimators from one cell file.

result = score(Path("manifest.toml"), CellParams.load("panasonic_ncr18650pf"))
result.summary["estimators"]["srukf"]["weighted_rmse_pct"]
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bms_ukf import measured, metrics
from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.manifest import Manifest
from bms_ukf.offline.estimators import ESTIMATORS, Columns, prepare
from bms_ukf.score import cases, recorded
from bms_ukf.score.cases import Case
from bms_ukf.score.recorded import Recorded
from bms_ukf.score.summary import summarise
from bms_ukf.score.weights import Outcome
from bms_ukf.tuning import Tuning


@dataclass(slots=True)
class Score:
    """What came of a score."""

    summary: dict[str, Any]  # as `summary` documents it
    recordings: list[Recorded]  # those that count
    nominal: dict[tuple[str, str], Columns]  # by recording and estimator


def score(
    path: Path,
    cell: CellParams,
    *,
    tuning: Tuning | None = None,
    estimators: tuple[str, ...] = tuple(ESTIMATORS),
    progress: Callable[[str], None] = lambda _: None,
) -> Score:
    """Run every case of every `drive` and `charge` test of the manifest at `path` that was not fitted.

    Fitted ones that have a reference are run in their nominal case only and reported apart. `tuning` is for all
    estimators. Raises ConfigError for data that cannot be used.
    """
    tests = Manifest.load(path)
    scored = [test for test in tests.test if test.role in recorded.SCORED_ROLES]
    if not any(test.use == "validate" for test in scored):
        expected = 'at least one test of role "drive" or "charge" with use = "validate"'
        raise ConfigError(path, key="test", expected=expected)
    sensors = tuning or Tuning()
    files = Counter(Path(file).name for file in {test.file for test in scored})
    runners = {name: prepare(name, cell, sensors) for name in estimators}
    outcomes: list[Outcome] = []
    held_out: list[Recorded] = []
    nominal: dict[tuple[str, str], Columns] = {}
    for test in scored:
        progress(f"scoring {Path(test.file).name}")
        recording = measured.load(path, tests, test)
        if test.use == "fit" and recording.soc_ref is None:
            continue
        name = recording.name if files[Path(test.file).name] == 1 else test.file
        loaded = recorded.sample(recording, test, name)
        if test.use == "validate":
            held_out.append(loaded)
        for case in cases.of(loaded, sensors.initial_soc_sigma):
            if test.use == "fit" and case.kind != cases.NOMINAL:
                continue
            for estimator, run in runners.items():
                columns = run(case.signals, case.told)
                outcomes.append(_outcome(estimator, loaded, case, columns))
                if case.kind == cases.NOMINAL and test.use == "validate":
                    nominal[loaded.name, estimator] = columns
    return Score(summarise(path, cell, held_out, outcomes), held_out, nominal)


def _outcome(estimator: str, loaded: Recorded, case: Case, columns: Columns) -> Outcome:
    test = loaded.test
    interval = columns["soc_low"], columns["soc_high"]
    figures = metrics.score(case.signals.time_s, columns["soc"], interval, case.soc_ref, test.soc_ref_sigma)
    return Outcome(
        estimator,
        loaded.name,
        test.role,
        test.group,
        test.temperature_degC,
        test.use,
        case.kind,
        case.value,
        case.name,
        figures,
    )
