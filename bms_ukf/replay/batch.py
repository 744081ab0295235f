"""`bms-ukf replay`: which recordings, what is run of each, and what is written."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.replay import rerun, results
from bms_ukf.replay.rerun import CAN_LOGS, FLIGHT, RECORDINGS, Options
from bms_ukf.trace import Trace
from bms_ukf.tuning import Tuning


@dataclass(slots=True, frozen=True)
class Job:
    """One recording and where its results go; None: nowhere."""

    recording: Path
    cell: CellParams | None  # None: that of the configuration, for CAN logs
    other: CellParams | None
    options: Options
    tuning: Tuning
    config: Path | None
    out: Path | None
    json: Path | None
    report: Path | None


@dataclass(slots=True, frozen=True)
class Done:
    """What came of a job: a summary, or the line that says what is wrong."""

    recording: Path
    summary: dict[str, Any] | None
    mistake: str | None = None
    kept: bool = False  # from an earlier run


def recordings(given: Sequence[Path], suffixes: tuple[str, ...] = RECORDINGS) -> list[Path]:
    """The recordings meant: files as they are, of folders all with these endings, by name. Raises ConfigError."""
    found: list[Path] = []
    for path in given:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.name.endswith(suffixes))
            if not inside:
                raise ConfigError(path, expected=f"a folder with recordings ({', '.join(suffixes)})")
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
    return next(
        (path.name.removesuffix(suffix) for suffix in (*RECORDINGS, *CAN_LOGS, FLIGHT) if path.name.endswith(suffix)),
        path.stem,
    )


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


def work(job: Job) -> Done:
    """Run one recording and write what is asked for. Whatever is wrong with it is returned: the others are to go on.

    A result in Parquet that this very job has made before is kept.
    """
    try:
        if job.out is None or job.out.suffix != results.SUFFIX:
            return Done(job.recording, _work(job))
        key = results.key(job)
        summary = results.kept(job.out, key)
        return Done(job.recording, _work(job, key)) if summary is None else Done(job.recording, summary, kept=True)
    except ConfigError as error:
        return Done(job.recording, None, str(error))
    except Exception as error:
        return Done(job.recording, None, f"{job.recording}: {type(error).__name__}: {error}")


def _runner(job: Job) -> Callable[[CellParams | None], tuple[Trace, dict[str, Any]]]:
    """What runs this recording with a cell; it is read once if it can be."""
    if job.recording.suffix.lower() in CAN_LOGS:
        if job.config is None:
            raise ConfigError("--config", expected=f"the configuration by which {job.recording} is read")
        from bms_ukf.replay import canlog  # brings cantools, which only CAN logs need

        config = job.config
        return lambda cell: canlog.rerun(job.recording, config, cell)
    if job.recording.suffix == FLIGHT:
        from bms_ukf.replay import flight

        return lambda cell: flight.rerun(job.recording, cell)
    if job.cell is None:
        raise ConfigError("--cell", expected=f"a cell file, or the name of a shipped one, for {job.recording}")
    recording, given = rerun.load(job.recording, job.options, job.cell), job.cell
    return lambda cell: rerun.rerun(recording, cell or given, job.options, job.tuning)


def _work(job: Job, key: str = "") -> dict[str, Any]:
    run = _runner(job)
    trace, summary = run(job.cell)
    more: list[Any] = []
    if job.other is not None:
        second, found = run(job.other)
        summary["diff"] = found | {"from_first": rerun.difference(trace, second)}
        if job.report is not None:
            from bms_ukf.report import diff_plot

            more = [diff_plot.render(trace, second, (summary["cell"], job.other.cell.name))]
    if job.out is not None and key:
        results.write(job.out, trace, summary, key)
    elif job.out is not None:
        trace.write_csv(job.out)
    if job.json is not None:
        try:
            job.json.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise ConfigError(job.json, expected=f"a file that can be written ({error.strerror})") from None
    if job.report is not None:
        from bms_ukf.report.html import write_report

        compared = {} if job.other is None else {"compared": job.other.cell.name}
        write_report(job.report, trace, summary | compared, title=summary["recording"], judged=False, more=more)
    return summary
