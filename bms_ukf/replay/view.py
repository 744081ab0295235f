"""What came of a replay, on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from bms_ukf.replay.batch import Done

HEADER = ("recording", "cell", "rows", "SoC at the end", "RMSE", "max", "in band", "settled", "steps/s")


def followed(coming: Iterable[Done], count: int) -> Iterator[Done]:
    """The results as they come, with a bar that tells how many there are and when the last one is to be expected."""
    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task, failed = progress.add_task("replay", total=count), 0
        for result in coming:
            failed += result.mistake is not None
            progress.update(task, advance=1, description=f"replay, {failed} failed" if failed else "replay")
            yield result


def show(done: Sequence[Done], console: Console) -> None:
    """A row for each recording, two where cell files are compared; then what was doubtful."""
    table = Table(box=None, header_style="dim")
    for column, name in enumerate(HEADER):
        table.add_column(name, justify="right" if column > 1 else "left")
    for summary in (found.summary for found in done if found.summary is not None):
        table.add_row(*_row(summary))
        if "diff" in summary:
            table.add_row(*_row(summary["diff"]))
            apart = summary["diff"]["from_first"]
            shown = (
                ("–", "–") if apart["rms_pct"] is None else (f"{apart['rms_pct']:.2f} %", f"{apart['max_pct']:.2f} %")
            )
            table.add_row("", "difference", "", "", *shown, style="dim")
    if table.row_count:
        console.print(table)
    if kept := sum(found.kept for found in done):
        console.print(f"{kept} of {len(done)} kept from an earlier run", style="dim", highlight=False)
    for found in done:
        for warning in [] if found.summary is None else found.summary["warnings"]:
            console.print(f"warning: {warning}", style="yellow", highlight=False)


def _row(summary: dict[str, Any]) -> list[str]:
    soc, low, high = (summary[key] for key in ("final_soc", "soc_low_final", "soc_high_final"))
    end = "not available" if soc is None else f"{100 * soc:.1f} ({100 * low:.1f}–{100 * high:.1f}) %"
    figures = ["–"] * 4
    if summary.get("rmse_pct") is not None:
        settled = summary["settled_s"]
        figures = [
            f"{summary['rmse_pct']:.2f} %",
            f"{summary['max_pct']:.2f} %",
            f"{100 * summary['coverage95']:.0f} %",
            "never" if settled is None else f"{settled:.0f} s",
        ]
    speed = f"{summary['steps_per_s']:.3g}"
    return [summary["recording"], summary["cell"], str(summary["n"]), end, *figures, speed]
