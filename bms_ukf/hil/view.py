"""What came of scenarios, on the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from bms_ukf.hil.result import Result

_STYLE = {"passed": "green", "failed": "bold red", "not run": "yellow"}
_COLUMNS = ("scenario", "outcome", "met", "error", "detected", "recovery", "speed", "trace")


class Shown:
    """The bar: how many scenarios are done, and which one was last."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        self._progress, self._task = progress, task
        self._done = 0

    def step(self, step: int, steps: int) -> None:
        """Within a scenario."""
        self._progress.update(self._task, completed=self._done + step / steps)

    def done(self, count: int, result: Result) -> None:
        self._done = count
        self._progress.update(self._task, completed=count, last=f"{result.name}: {result.outcome}", count=count)


@contextmanager
def progress(console: Console, scenarios: int) -> Iterator[Shown]:
    columns = (
        BarColumn(30),
        TextColumn(f"{{task.fields[count]}} of {scenarios}"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[last]}", style="dim"),
    )
    with Progress(*columns, console=console, transient=True) as shown:
        yield Shown(shown, shown.add_task("hil", total=scenarios, last="", count=0))


def show(results: Sequence[Result], console: Console) -> None:
    """A row a scenario, then what was found in place of what was expected, then the count."""
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 1), collapse_padding=True)
    for name in _COLUMNS:
        table.add_column(name, justify="left" if name in {"scenario", "outcome", "trace"} else "right", no_wrap=True)
    for result in results:
        table.add_row(*_row(result))
    console.print(table)
    for result in results:
        for verdict in result.verdicts:
            if not verdict.passed:
                told = f"{result.name}: {verdict.wanted}; found {verdict.found}"
                console.print(told, style="red", highlight=False, soft_wrap=True)
        if result.outcome == "not run":
            console.print(f"{result.name}: not run: {result.reason}", style="yellow", highlight=False, soft_wrap=True)
    counts = {word: sum(result.outcome == word for result in results) for word in _STYLE}
    line = ", ".join(f"[{_STYLE[word]}]{count} {word}[/]" for word, count in counts.items() if count)
    wall_s, late = sum(result.wall_s for result in results), sum(result.overruns for result in results)
    console.print(f"{line} in {wall_s:.1f} s" + (f"; {late} steps began late" if late else ""), highlight=False)


def _row(result: Result) -> list[str]:
    outcome = f"[{_STYLE[result.outcome]}]{result.outcome}[/]"
    if result.record is None:
        return [result.name, outcome]
    error, met = result.soc_error_max, sum(verdict.passed for verdict in result.verdicts)
    return [
        result.name,
        outcome,
        f"{met}/{len(result.verdicts)}",
        "–" if error is None else f"{100 * error:.2f} %",
        _worst([figures.detected_s for figures in result.matrix]),
        _worst([figures.recovered_s for figures in result.matrix]),
        f"{result.realtime_factor:.0f} x",
        (result.trace_hash or "")[:8],
    ]


def _worst(times_s: Sequence[float | None]) -> str:
    """The longest of those there are; of several faults, each has its own in the report."""
    known = [time_s for time_s in times_s if time_s is not None]
    return f"{max(known):.1f} s" if known else "–"
