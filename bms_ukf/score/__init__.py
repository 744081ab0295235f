"""`bms-ukf score`: the blind benchmark's grid over a user's recordings, for three estimators from one cell file.

result = score(Path("manifest.toml"), CellParams.load("panasonic_ncr18650pf"))
result.summary["estimators"]["srukf"]["weighted_rmse_pct"]
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bms_ukf import measured, metrics
from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.manifest import Manifest, MeasuredTest
from bms_ukf.offline.estimators import ESTIMATORS, Columns, Runner, followed, prepare
from bms_ukf.score import cases, recorded
from bms_ukf.score.cases import Case
from bms_ukf.score.recorded import Recorded
from bms_ukf.score.summary import summarise
from bms_ukf.score.weights import Outcome
from bms_ukf.tuning import Tuning


@dataclass(slots=True, frozen=True)
class Grid:
    """Estimators, rate and options of a score."""

    estimators: tuple[str, ...] = tuple(ESTIMATORS)
    step_s: float | None = recorded.STEP_S  # between rows; None: as recorded
    health: bool = True  # of srukf: learn the capacity on the way, as the daemon does
    force: bool = False  # run recordings that do not fit the cell, too


@dataclass(slots=True)
class Score:
    """What came of a score."""

    summary: dict[str, Any]  # as `summary` documents it
    recordings: list[Recorded]  # those that count
    nominal: dict[tuple[str, str], Columns]  # by recording and estimator


def score(
    path: Path,
    cell: CellParams,
    grid: Grid | None = None,
    *,
    tuning: Tuning | None = None,
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
    run = Run(path, tests, grid or Grid(), tuning or Tuning())
    run.add(scored, cell, progress)
    return run.score(cell)


class Run:
    """The outcomes of one manifest's tests, test by test."""

    def __init__(self, path: Path, tests: Manifest, grid: Grid, tuning: Tuning) -> None:
        self._path, self._tests, self._grid, self._tuning = path, tests, grid, tuning
        files = {test.file for test in tests.test if test.role in recorded.SCORED_ROLES}
        self._files = Counter(Path(file).name for file in files)
        self._outcomes: list[Outcome] = []
        self._held_out: list[Recorded] = []
        self._nominal: dict[tuple[str, str], Columns] = {}

    def add(self, scored: Sequence[MeasuredTest], cell: CellParams, progress: Callable[[str], None]) -> None:
        """Run the cases of these tests with estimators from `cell`."""
        runners = {name: self._runner(name, cell) for name in self._grid.estimators}
        for test in scored:
            progress(f"scoring {Path(test.file).name}")
            recording = measured.load(self._path, self._tests, test, force=self._grid.force)
            if test.use == "fit" and recording.soc_ref is None:
                continue
            name = recording.name if self._files[Path(test.file).name] == 1 else test.file
            loaded = recorded.sample(recording, test, name, self._grid.step_s)
            if test.use == "validate":
                self._held_out.append(loaded)
            for case in cases.of(loaded, self._tuning.initial_soc_sigma):
                if test.use == "fit" and case.kind != cases.NOMINAL:
                    continue
                progress(f"scoring {loaded.name}: {case.name}")
                for estimator, run in runners.items():
                    columns = run(case.signals, case.told)
                    self._outcomes.append(_outcome(estimator, loaded, case, columns))
                    if case.kind == cases.NOMINAL and test.use == "validate":
                        self._nominal[loaded.name, estimator] = columns

    def score(self, cell: CellParams) -> Score:
        """The figures of all that was added; name and capacity are those of `cell`."""
        grid = {"step_s": self._grid.step_s, "health": self._grid.health}
        summary = summarise(self._path, cell, self._held_out, self._outcomes) | grid
        return Score(summary, self._held_out, self._nominal)

    def _runner(self, name: str, cell: CellParams) -> Runner:
        if name == "srukf" and self._grid.health:
            return lambda signals, told: followed(cell, self._tuning, signals, told)[0]
        return prepare(name, cell, self._tuning)


def _outcome(estimator: str, loaded: Recorded, case: Case, columns: Columns) -> Outcome:
    test, rows = loaded.test, slice(case.padded, None)
    interval = columns["soc_low"][rows], columns["soc_high"][rows]
    figures = metrics.score(
        case.signals.time_s[rows], columns["soc"][rows], interval, case.soc_ref[rows], test.soc_ref_sigma
    )
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
