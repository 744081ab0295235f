"""`bms-ukf replay`: from what the user gave to jobs, and what came of them to the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.replay import batch, results, view, workers
from bms_ukf.replay.rerun import CAN_LOGS, FLIGHT, RECORDINGS, Options
from bms_ukf.tuning import Tuning


class Places(NamedTuple):
    """Files for one recording, folders for several; None: not wanted."""

    out: Path | None
    json: Path | None
    report: Path | None


class Means(NamedTuple):
    """Who runs the recordings, and what is written of each."""

    jobs: int | None  # processes; None: one for each core
    scheduler: str | None  # of a Dask cluster
    parquet: bool


def replay(
    given: Sequence[Path],
    cell: str | None,
    config: Path | None,
    places: Places,
    diff: str | None,
    means: Means,
    options: dict[str, Any],
) -> list[str]:
    """Run all recordings, show what came of them and return the line of each that could not be run.

    Raises ConfigError for what is wrong whatever the recording.
    """
    if options["initial_sigma"] is not None and options["initial_soc"] is None:
        raise ConfigError("--initial-sigma", value=options["initial_sigma"], expected="--initial-soc beside it")
    found = batch.recordings(given, (*RECORDINGS, FLIGHT) if config is None else (*RECORDINGS, *CAN_LOGS, FLIGHT))
    _require_recordings(found, options)
    several = len(found) > 1 or any(path.is_dir() for path in given)
    loaded = None if cell is None else CellParams.load(cell)
    other = None if diff is None else CellParams.load(diff)
    tuning = Tuning() if config is None else _tuning(config, loaded)
    if means.parquet and places.out is None:
        raise ConfigError("--out", expected="where the results are to go, and stay for a run that resumes")
    suffixes = (results.SUFFIX if means.parquet else ".csv", ".json", ".html")
    targets = [
        batch.places(place, suffix, found, several=several) for place, suffix in zip(places, suffixes, strict=True)
    ]
    jobs = [
        batch.Job(path, loaded, other, Options(**options), tuning, config, *target)
        for path, *target in zip(found, *targets, strict=True)
    ]
    if means.scheduler is not None:
        coming = workers.cluster(jobs, means.scheduler)
    else:
        coming = workers.here(jobs, means.jobs or workers.cores())
    done = sorted(view.followed(coming, len(jobs)), key=lambda result: found.index(result.recording))
    view.show(done, Console())
    return [result.mistake for result in done if result.mistake is not None]


def _require_recordings(found: Sequence[Path], options: dict[str, Any]) -> None:
    """ConfigError for an option that would do nothing, as every recording is a CAN log or a flight."""
    if all(path.suffix.lower() in {*CAN_LOGS, FLIGHT} for path in found):
        for field in fields(Options):
            if options[field.name] != field.default:
                option = "--" + field.name.removesuffix("_A").removesuffix("_V").removesuffix("_degC")
                option = option.removesuffix("_s").replace("_", "-")
                expected = "no such option for CAN logs and flights: their configuration says how they are read"
                raise ConfigError(option, value=options[field.name], expected=expected)


def _tuning(config: Path, cell: CellParams | None) -> Tuning:
    from bms_ukf import toml
    from bms_ukf.config import Config  # brings cantools, which only this option needs

    return toml.load(config, Config).tuning(cell, config)
