"""`bms-ukf hil`: from what the user gave to runs, and what came of them to the terminal and to files."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from bms_ukf import scenario
from bms_ukf.errors import ConfigError
from bms_ukf.hil import junit, runner, view
from bms_ukf.hil.bench import IN_PROCESS
from bms_ukf.hil.result import Result
from bms_ukf.scenario import Scenario


class Place(NamedTuple):
    """The bus all scenarios are run over; None: that of each."""

    interface: str | None = None
    channel: str | None = None


Loaded = tuple[Scenario, Path]


def hil(given: Sequence[str], place: Place, workers: int, junit_path: Path | None) -> list[Result]:
    """Run scenarios in files, folders or shipped, show and write what came of them, and return it.

    Raises ConfigError for the first that cannot be read, before any is run.
    """
    loaded = [scenario.load(path) for path in _files(given)]
    console = Console()
    results = []
    with _quiet(), view.progress(console, len(loaded)) as shown:
        for result in _run(loaded, place, workers, shown.step):
            results.append(result)
            shown.done(len(results), result)
    view.show(results, console)
    if junit_path is not None:
        junit.write(junit_path, results)
    return results


def _files(given: Sequence[str]) -> Iterator[str | Path]:
    for name in given:
        if Path(name).is_dir():
            inside = sorted(Path(name).glob("*.toml"))
            if not inside:
                raise ConfigError(name, expected="a folder with scenarios (.toml)")
            yield from inside
        else:
            yield name


def _run(loaded: Sequence[Loaded], place: Place, workers: int, watch: Callable[[int, int], None]) -> Iterator[Result]:
    """Results in the order of the scenarios, as they come. A real bus is one: there they are run one by one."""
    one_bus = any((place.interface or found.bus.interface) not in IN_PROCESS for found, _ in loaded)
    if workers == 1 or len(loaded) == 1 or one_bus:
        for found, path in loaded:
            yield runner.run(found, path, *place, watch)
        return
    # Forked processes would share the locks of a compiler that runs threads.
    with ProcessPoolExecutor(min(workers, len(loaded)), mp_context=get_context("spawn")) as pool:
        yield from pool.map(partial(_work, place), loaded)


def _work(place: Place, loaded: Loaded) -> Result:
    with _quiet():
        return runner.run(*loaded, *place)


@contextmanager
def _quiet() -> Iterator[None]:
    """The daemon's own log tells of the faults it is given: on a terminal it would hide the results."""
    logger = logging.getLogger("bms_ukf")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
