"""The campaign on the terminal: a bar while it runs, then a table of the classes and the goals that were missed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from bms_ukf.campaign.figures import RunFigures

COLUMNS = {
    "inside": ("inside_pct", "{:.1f}"),
    "> 3 sigma": ("beyond_pct", "{:.2f}"),
    "ok": ("ok_pct", "{:.1f}"),
    "half-width": ("half_width_pct", "{:.2f}"),
    "RMSE": ("rmse_pct", "{:.2f}"),
    "10 min": ("half_width_10min_pct", "{:.2f}"),
    "named": ("named_pct", "{:.0f}"),
}
WORDS = {
    "inside_pct": "rows inside the interval, %",
    "beyond_pct": "ok rows beyond three sigmas, %",
    "ok_pct": "ok rows, %",
    "half_width_pct": "median half-width, % SoC",
    "rmse_pct": "RMSE, % SoC",
    "warm_half_width_pct": "at 10 °C or more: median half-width, % SoC",
    "warm_rmse_pct": "at 10 °C or more: RMSE, % SoC",
    "half_width_10min_pct": "median half-width after ten minutes, % SoC",
    "error_10min_pct": "runs within 3 % SoC after ten minutes, %",
    "flat_inside_pct": "LFP: rows inside the interval, %",
    "flat_rmse_30min_pct": "LFP: RMSE after half an hour, % SoC",
    "named_pct": "failed sensors named in time, %",
}


WIDTH = 110  # of the table, where no terminal sets another


def console() -> Console:
    """Return the console of the table, wide enough for it in a pipe, too."""
    made = Console()
    return made if made.is_terminal else Console(width=WIDTH)


@contextmanager
def progress(console: Console, runs: int) -> Iterator[Callable[[RunFigures], None]]:
    columns = (BarColumn(30), TextColumn("{task.completed} of {task.total} runs"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task("campaign", total=runs)
        yield lambda figures: shown.advance(task)


def show(summary: dict[str, Any], console: Console) -> None:
    """Print a row for each class in percent, the missed goals, and how to repeat the worst run of each."""
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 1), collapse_padding=True)
    for name in ("class", "runs", *COLUMNS, "worst", ""):
        table.add_column(name, justify="left" if name in {"class", ""} else "right", no_wrap=True)
    for name, found in summary["classes"].items():
        cells = [_cell(found, figure, form) for figure, form in COLUMNS.values()]
        verdict = "[bold red]missed[/]" if found["missed"] else "[green]met[/]"
        table.add_row(name, str(found["runs"]), *cells, str(found["worst_seed"]), verdict)
    average = summary["average"]
    table.add_row("average", "", "", _cell(average, "beyond_pct", "{:.2f}"))
    console.print(table)
    for line in misses(summary):
        console.print(line, style="red", highlight=False, soft_wrap=True)
    if summary["runs_per_class"] == 1:
        for name, found in summary["classes"].items():
            console.print(f"{name}: {found['each'][0]['draw']}", highlight=False, soft_wrap=True)
    verdict = "every goal is met" if summary["passed"] else "repeat a run: bms-ukf campaign --class CLASS --seed WORST"
    console.print(verdict, highlight=False)


def misses(summary: dict[str, Any]) -> list[str]:
    """Return one line for each missed goal."""
    lines = []
    for name, found in (*summary["classes"].items(), ("average over the classes", summary["average"])):
        for figure in found["missed"]:
            goal = found["goals"][figure]
            side, limit = ("least", goal["at_least"]) if "at_least" in goal else ("most", goal["at_most"])
            allowed = "" if goal["allowed"] == limit else f" ({goal['allowed']:.3g} with the allowance for chance)"
            lines.append(f"{name}: {WORDS[figure]}: {found[figure]:.2f}, goal at {side} {limit:g}{allowed}")
    return lines


def _cell(found: dict[str, Any], figure: str, form: str) -> str:
    value = found.get(figure)
    text = "–" if value is None else form.format(value)
    return f"[red]{text}[/]" if figure in found["missed"] else text
