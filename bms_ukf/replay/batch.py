"""`bms-ukf replay`: which recordings, what is written of each, and how many are run at a time."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.replay import rerun
from bms_ukf.replay.rerun import RECORDINGS, Options
from bms_ukf.tuning import Tuning


@dataclass(slots=True, frozen=True)
class Job:
    """One recording and where its results go; None: nowhere."""

    recording: Path
    cell: CellParams
    other: CellParams | None
    options: Options
    tuning: Tuning
    out: Path | None
    json: Path | None
    report: Path | None


@dataclass(slots=True, frozen=True)
class Done:
    """What came of a job: a summary, or the line that says what is wrong."""

    recording: Path
    summary: dict[str, Any] | None
    mistake: str | None = None


def recordings(given: Sequence[Path]) -> list[Path]:
    """The recordings meant: files as they are, of folders all that look like one, by name. Raises ConfigError."""
    found: list[Path] = []
    for path in given:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.name.endswith(RECORDINGS))
            if not inside:
                raise ConfigError(path, expected=f"a folder with recordings ({', '.join(RECORDINGS)})")
            found += inside
        else:
            found.append(path)
    names: dict[str, Path] = {}
    for path in found:
        twin = names.setdefault(stem(path), path)
        if twin is not path:
            raise ConfigError(path, expected=f"another name than {twin}: their results would overwrite each other")
    return found


def stem(path: Path) -> str:
    """The name of a recording without what says its format."""
    return next((path.name.removesuffix(suffix) for suffix in RECORDINGS if path.name.endswith(suffix)), path.stem)


def places(folder: Path | None, suffix: str, found: Sequence[Path], *, several: bool) -> list[Path | None]:
    """Where each result of a kind goes: to `folder` as it is for one recording, else into it, which is then made."""
    if folder is None:
        return [None] * len(found)
    if not several:
        if suffix != ".html" and (folder.is_dir() or not folder.parent.is_dir()):
            raise ConfigError(folder, expected="a file to be written, in a folder that exists")
        return [folder]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(folder, expected=f"a folder, as there are several recordings ({error.strerror})") from None
    return [folder / f"{stem(path)}{suffix}" for path in found]


def run(jobs: Sequence[Job], workers: int) -> Iterator[Done]:
    """Results in the order of the jobs, as they come."""
    if workers == 1 or len(jobs) == 1:
        yield from map(work, jobs)
        return
    # Forked processes would share the locks of a compiler that runs threads.
    with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=get_context("spawn")) as pool:
        yield from pool.map(work, jobs)


def work(job: Job) -> Done:
    """Run one recording and write what is asked for. A mistake in it is returned: the others are to go on."""
    try:
        return Done(job.recording, _work(job))
    except ConfigError as error:
        return Done(job.recording, None, str(error))


def _work(job: Job) -> dict[str, Any]:
    recording = rerun.load(job.recording, job.options)
    trace, summary = rerun.rerun(recording, job.cell, job.options, job.tuning)
    more: list[Any] = []
    if job.other is not None:
        second, found = rerun.rerun(recording, job.other, job.options, job.tuning)
        summary["diff"] = found | {"from_first": rerun.difference(trace, second)}
        if job.report is not None:
            from bms_ukf.report import diff_plot

            more = [diff_plot.render(trace, second, (job.cell.cell.name, job.other.cell.name))]
    if job.out is not None:
        trace.write_csv(job.out)
    if job.json is not None:
        try:
            job.json.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise ConfigError(job.json, expected=f"a file that can be written ({error.strerror})") from None
    if job.report is not None:
        from bms_ukf.report.html import write_report

        compared = {} if job.other is None else {"compared": job.other.cell.name}
        write_report(job.report, trace, summary | compared, title=recording.name, judged=False, more=more)
    return summary
