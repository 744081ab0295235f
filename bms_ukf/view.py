"""What a run looks like on the terminal while it goes, and its verdict at the end.

On a terminal a panel of 80 by 24 characters is redrawn in place; anywhere else (a pipe, a CI log) a plain line is
printed every tenth of the run.
"""

from __future__ import annotations

import math
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from bms_ukf import metrics
from bms_ukf.records import Estimate, Fault, Status

if TYPE_CHECKING:
    from bms_ukf.cosim import Progress

WIDTH = 78
REDRAW_S = 0.1  # of wall time; a redraw costs some milliseconds, a step of a run some hundred microseconds
PLAIN_SHARE = 0.1  # of a run, between two plain lines
HISTORY = 52  # columns of the error's history, which span the whole run

# A column of the history is one of eight bars: its largest |error| is at most this many percent, the last is more.
BARS = "▁▂▃▄▅▆▇█"
BAR_TOPS_PCT = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
STATUS_STYLE = {
    Status.OK: "bold green",
    Status.DEGRADED: "bold yellow",
    Status.INITIALISING: "bold cyan",
    Status.INVALID: "bold red",
}


class LiveView:
    """Shows a run: `with LiveView(title) as view:`, and `view.update(progress)` after every step, which is cheap."""

    def __init__(self, title: str, console: Console | None = None) -> None:
        self._title = title
        self._console = console or Console()
        self._live: Live | None = None
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._live = Live(console=self._console, auto_refresh=False)
        self._worst_pct = [-1.0] * HISTORY  # below 0: nothing known yet
        self._redraw_at = 0.0
        self._plain_at = PLAIN_SHARE

    def __enter__(self) -> Self:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._live.stop()

    def update(self, progress: Progress) -> None:
        """Note the error; redraw if it is time to, and at the last step."""
        self._note_error(progress)
        share = progress.step / progress.steps
        last = progress.step == progress.steps
        if self._live is None:
            if share >= self._plain_at or last:
                self._console.print(Text(_plain_line(self._title, progress)), soft_wrap=True)
                self._plain_at = (math.floor(share / PLAIN_SHARE + 1e-9) + 1) * PLAIN_SHARE
            return
        now = monotonic()
        if now >= self._redraw_at or last:
            self._live.update(self.panel(progress), refresh=True)
            self._redraw_at = now + REDRAW_S

    def panel(self, progress: Progress) -> Panel:
        """The whole view, at most `WIDTH` wide and 20 lines high."""
        sample, estimate, true = progress.sample, progress.estimate, progress.true
        table = Table.grid(padding=(0, 2))
        for _ in range(2):
            table.add_column(width=15, style="dim")
            table.add_column(width=15, justify="right")
        table.add_row("SoC estimated", _number(100 * float(estimate.soc), "%", 2), "voltage", _volt(sample.voltage_V))
        table.add_row("95 % interval", _interval(estimate), "predicted", _volt(estimate.voltage_pred_V))
        table.add_row("SoC true", _number(100 * float(true.soc), "%", 2), "current", _number(sample.current_A, "A", 2))
        table.add_row(
            "SoC error", self._error(progress), "temperature", _number(float(sample.temperature_degC), "°C", 1)
        )
        frames = (
            f"{progress.frames_in} / {progress.frames_out}" if progress.frames_in or progress.frames_out else "no bus"
        )
        table.add_row("status", _status(estimate.status), "frames in / out", frames)
        faults = Text(_fault_words(estimate.faults), style="yellow")
        parts = Group(_head(progress), Text(), table, faults, self._history())
        return Panel(parts, title=f"bms-ukf · {self._title}", width=WIDTH, padding=(1, 2))

    def _note_error(self, progress: Progress) -> None:
        column = (progress.step - 1) * HISTORY // progress.steps
        error_pct = abs(_error_pct(progress))
        self._worst_pct[column] = max(self._worst_pct[column], error_pct)  # the first wins against NaN

    def _error(self, progress: Progress) -> Text:
        error_pct = _error_pct(progress)
        estimate = progress.estimate
        inside = estimate.soc_low <= min(max(float(progress.true.soc), 0.0), 1.0) <= estimate.soc_high
        style = "green" if inside else "red"
        return Text(_number(error_pct, "%", 2, "+"), style=style)

    def _history(self) -> Group:
        bars = Text("".join(_bar(value) for value in self._worst_pct), style="cyan")
        return Group(
            Text.assemble(("|SoC error|     ", "dim"), bars),
            Text(f"{'':16}▁ to 0.1 %   ▃ to 0.5 %   ▅ to 2 %   █ above 10 %", style="dim"),
        )


def verdict(
    summary: dict[str, Any], page: Path | None = None, console: Console | None = None, *, judged: bool = True
) -> None:
    """Print what a run reached, if `judged` against the project's goals, and where its report is."""
    console = console or Console()
    if not summary["n_scored"]:
        why = "No estimate where there is a reference SoC" if summary["n_unavailable"] else "No reference SoC"
        console.print(f"{why}: nothing is scored.")
    else:
        table = Table.grid(padding=(0, 2))
        table.add_column(width=26)
        table.add_column(width=12, justify="right")
        table.add_column(width=18, style="dim")
        table.add_column(width=4)
        checks = metrics.judge(summary)
        for check in checks:
            word = Text("pass", style="bold green") if check.passed else Text("FAIL", style="bold red")
            against = (check.goal, word) if judged else ()
            table.add_row(check.name, _number(check.value, "%", 2), *against)
        table.add_row("Largest SoC error", _number(summary["max_pct"], "%", 2))
        settled_s = summary["settled_s"]
        table.add_row("Error stays within 2 %", "never" if settled_s is None else f"after {settled_s:.0f} s")
        if summary["n_unavailable"]:
            table.add_row("Rows without an estimate", str(summary["n_unavailable"]))
        if "realtime_factor" in summary:
            simulated = _clock(summary["duration_s"])
            table.add_row(
                f"Simulated in {summary['wall_s']:.1f} s", simulated, f"{summary['realtime_factor']:.0f} × real time"
            )
        passed = all(check.passed for check in checks)
        title, style = ("PASSED", "green") if passed else ("FAILED", "red")
        if not judged:
            title, style = "RESULT", "cyan"
        console.print(Panel(table, title=title, border_style=style, width=WIDTH, padding=(1, 2)))
    if page is not None:
        console.print(f"Report: {page}", soft_wrap=True, highlight=False, markup=False)


def _head(progress: Progress) -> Table:
    head = Table.grid(padding=(0, 2))
    simulated_s = progress.sample.t_ns * 1e-9
    factor = simulated_s / progress.wall_s if progress.wall_s > 0 else 0.0
    head.add_row(
        ProgressBar(total=progress.steps, completed=progress.step, width=26, complete_style="cyan"),
        f"{progress.step / progress.steps:4.0%}  simulated {_clock(simulated_s)}  {factor:.0f} × real time",
    )
    return head


def _interval(estimate: Estimate) -> str:
    low, high = 100 * float(estimate.soc_low), 100 * float(estimate.soc_high)
    return "–" if math.isnan(low + high) else f"{low:.2f}–{high:.2f} %"


def _plain_line(title: str, progress: Progress) -> str:
    estimate = progress.estimate
    simulated_s = progress.sample.t_ns * 1e-9
    return (
        f"{title}: {progress.step / progress.steps:4.0%}  {_clock(simulated_s)}  "
        f"SoC {_number(100 * float(estimate.soc), '%', 2)} ({_interval(estimate)})  "
        f"true {_number(100 * float(progress.true.soc), '%', 2)}  error {_number(_error_pct(progress), '%', 2, '+')}  "
        f"{estimate.status.word}"
    )


def _error_pct(progress: Progress) -> float:
    return 100 * (float(progress.estimate.soc) - float(progress.true.soc))


def _number(value: float | None, unit: str, digits: int, sign: str = "") -> str:
    """A value with its unit, or a dash for one that is not there; `sign` is "", "+" (always signed) or "±"."""
    if value is None or math.isnan(value):
        return "–"
    return f"{'±' if sign == '±' else ''}{value:{'+' if sign == '+' else ''}.{digits}f} {unit}"


def _volt(value: Any) -> str:
    return _number(float(value), "V", 4)


def _status(status: Status) -> Text:
    return Text(status.word, style=STATUS_STYLE[status])


def _fault_words(faults: Fault) -> str:
    return ", ".join(fault.name.lower().replace("_", " ") for fault in faults if fault.name)


def _bar(worst_pct: float) -> str:
    return BARS[sum(worst_pct > top for top in BAR_TOPS_PCT)] if worst_pct >= 0 else " "


def _clock(seconds: float) -> str:
    minutes, second = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{second:02d}"
