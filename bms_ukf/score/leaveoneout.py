"""`bms-ukf score --leave-one-out`: each drive and charge file scored with a cell identified without it.

The manifest decides as ever which of the other tests are fitted and which give the noise. The file left out is out of
both, with all of its tests, and is scored as a whole.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.manifest import Manifest, MeasuredTest
from bms_ukf.score import Grid, Run, Score, recorded
from bms_ukf.tuning import Tuning


def score(
    path: Path,
    grid: Grid | None = None,
    *,
    tuning: Tuning | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Score:
    """Identify and score once for each file. Raises ConfigError for data that cannot be used.

    The summary's `cell` is the manifest's, its capacity that of the last cell identified.
    """
    tests = Manifest.load(path)
    files = list(dict.fromkeys(test.file for test in tests.test if test.role in recorded.SCORED_ROLES))
    if not files:
        raise ConfigError(path, key="test", expected='at least one test of role "drive" or "charge"')
    run = Run(path, tests, grid or Grid(), tuning or Tuning())
    for number, file in enumerate(files, start=1):
        place = f"file {number} of {len(files)}, without {Path(file).name}"
        here = partial(_tell, progress, place)
        cell = identify_without(path, tests, file, here)
        run.add(whole(tests, file), cell, here)
    return run.score(cell)


def _tell(progress: Callable[[str], None], place: str, text: str) -> None:
    progress(f"{place}: {text}")


def whole(tests: Manifest, file: str) -> list[MeasuredTest]:
    """The scored tests in a file, each as one unfitted test of all its rows, however many parts the manifest has."""
    found: dict[str, MeasuredTest] = {}
    for test in tests.test:
        if test.file == file and test.role in recorded.SCORED_ROLES:
            found.setdefault(repr(test.where), test.model_copy(update={"use": "validate", "part": [0.0, 1.0]}))
    return list(found.values())


def identify_without(path: Path, tests: Manifest, file: str, progress: Callable[[str], None]) -> CellParams:
    """The cell of the manifest at `path` without the tests in a file. Raises ConfigError if the others are too few."""
    from bms_ukf import identify  # imports scipy, which no other score needs

    others = [test for test in tests.test if test.file != file]
    try:
        return identify.run(path, progress, others).cell
    except ConfigError as error:
        if error.source != str(path):
            raise
        raise ConfigError(path, key=error.key, expected=f"{error.expected}, without {file}, too") from None
