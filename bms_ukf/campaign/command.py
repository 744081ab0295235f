"""`bms-ukf campaign`: which runs there are, who does them, and what they are together."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, NamedTuple

from bms_ukf.campaign import classes, goals
from bms_ukf.campaign.classes import NoTraceError
from bms_ukf.campaign.figures import RunFigures, of_class, of_run
from bms_ukf.errors import ConfigError

RUNS, QUICK_RUNS = 60, 12  # of a class
_LONGEST_FIRST = ("packs", "sampling", "rests", "charges", "age")


Task = tuple[str, int, tuple[str, ...]]


class Plan(NamedTuple):
    """Which runs: `runs` seeds of each class from `first` on; `quick`: with an allowance for chance."""

    names: tuple[str, ...]
    plants: tuple[str, ...]
    first: int
    runs: int
    quick: bool

    @property
    def tasks(self) -> list[Task]:
        """Classes, seeds and plants, those that take longest first."""
        order = sorted(self.names, key=lambda name: name not in _LONGEST_FIRST)
        return [(name, seed, self.plants) for name in order for seed in range(self.first, self.first + self.runs)]


def plan(
    name: str | None = None,
    seed: int | None = None,
    quick: bool = False,
    first: int = 0,
    runs: int | None = None,
    plants: Sequence[str] = (),
) -> Plan:
    """Return the runs that a user asked for. ConfigError for a class, a seed or a plant that does not exist."""
    names, among = tuple(classes.named(name)), classes.plants(plants)
    if seed is not None:
        first, runs, quick = seed, 1, True
    runs = runs or (QUICK_RUNS if quick else RUNS)
    for given in (first, first + runs - 1):
        if not 0 <= given < classes.SEEDS:
            expected = f"a seed from 0 to {classes.SEEDS - 1}"
            raise ConfigError("--seed" if seed is not None else "--first-seed", value=given, expected=expected)
    return Plan(names, among, first, runs, quick)


def campaign(
    wanted: Plan, jobs: int | None = None, watch: Callable[[RunFigures], None] | None = None
) -> list[RunFigures]:
    """Run all tasks in `jobs` processes (None: as many as cores), and return their figures by class and seed.

    What no trace of the plants serves is left out. NoTraceError if that is everything.
    """
    tasks = wanted.tasks
    jobs = min(jobs or len(os.sched_getaffinity(0)), len(tasks))
    found: list[RunFigures] = []
    untraced: NoTraceError | None = None
    with _quiet():
        for figures in _serial(tasks) if jobs == 1 else _parallel(tasks, jobs):
            if isinstance(figures, NoTraceError):
                untraced = figures
                continue
            found.append(figures)
            if watch is not None:
                watch(figures)
    if untraced is not None and not found:
        raise untraced
    order = {name: place for place, name in enumerate(wanted.names)}
    return sorted(found, key=lambda run: (order[run.name], run.seed))


def _serial(tasks: Sequence[Task]) -> Iterator[RunFigures | NoTraceError]:
    for task in tasks:
        yield _work(task)


def _parallel(tasks: Sequence[Task], jobs: int) -> Iterator[RunFigures | NoTraceError]:
    # Forked processes would share the locks of a compiler that runs threads.
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for done in as_completed([pool.submit(_work, task) for task in tasks]):
            yield done.result()


def _work(task: Task) -> RunFigures | NoTraceError:
    with _quiet():
        try:
            return of_run(*task)
        except NoTraceError as error:
            return error


@contextmanager
def _quiet() -> Iterator[None]:
    """Hide the daemon's own log: it names sensors that are wrong on purpose."""
    logger = logging.getLogger("bms_ukf")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def summary(wanted: Plan, runs: Sequence[RunFigures]) -> dict[str, Any]:
    """Return what `--json` writes: the figures and goals of each class, each run, the average and the verdict."""
    found: dict[str, Any] = {}
    for name in wanted.names:
        mine = [run for run in runs if run.name == name]
        if not mine:
            continue
        figures = of_class(mine)
        missed = goals.missed(name, figures, wanted.quick)
        found[name] = figures | {
            "goals": {goal.figure: _goal(goal, figures["runs"], wanted.quick) for goal in goals.of(name)},
            "missed": [goal.figure for goal in missed],
            "each": [_run(run) for run in mine],
        }
    beyond = [figures["beyond_pct"] for figures in found.values() if figures["beyond_pct"] is not None]
    average_pct = sum(beyond) / len(beyond) if beyond else None
    # A single class has no average over classes.
    fine = len(found) == 1 or goals.AVERAGE.met(average_pct, len(runs), wanted.quick)
    return {
        "quick": wanted.quick,
        "plants": list(wanted.plants),
        "first_seed": wanted.first,
        "runs_per_class": wanted.runs,
        "classes": found,
        "average": {
            "beyond_pct": average_pct,
            "goals": {"beyond_pct": _goal(goals.AVERAGE, len(runs), wanted.quick)},
            "missed": [] if fine else ["beyond_pct"],
        },
        "passed": fine and not any(figures["missed"] for figures in found.values()),
    }


def _goal(goal: goals.Goal, runs: int, quick: bool) -> dict[str, Any]:
    return {"at_least" if goal.at_least else "at_most": goal.limit, "allowed": goal.allowed(runs, quick)}


def _run(run: RunFigures) -> dict[str, Any]:
    share = {"inside_pct": (run.inside, run.known), "beyond_pct": (run.beyond, run.ok), "ok_pct": (run.ok, run.rows)}
    return {
        "seed": run.seed,
        "draw": run.words,
        "plant": run.plant,
        **{name: 100.0 * part / whole if whole else None for name, (part, whole) in share.items()},
        "rmse_pct": None if run.rmse is None else 100.0 * run.rmse,
        "half_width_pct": 100.0 * float(sorted(run.half_widths)[run.half_widths.size // 2])
        if run.half_widths.size
        else None,
        "named_s": run.named_s,
        "named_within_s": run.within_s,
    }
