"""Writes a run's report: goals, figures of merit, plots and where it all came from, on one page that needs no other.

Importing this does not import matplotlib; writing a report does.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_ukf import metrics
from bms_ukf.report.page import machine, write_page
from bms_ukf.trace import Trace

if TYPE_CHECKING:
    from bms_ukf.report.plots import Plot

# Figure, its key in the summary, the factor to what is shown, the format.
_FIGURES = (
    ("RMSE", "rmse_pct", 1.0, "{:.2f} %"),
    ("Mean absolute error", "mae_pct", 1.0, "{:.2f} %"),
    ("Largest absolute error", "max_pct", 1.0, "{:.2f} %"),
    ("Bias (estimated minus true)", "bias_pct", 1.0, "{:+.2f} %"),
    ("Rows inside the 95 % band", "coverage95", 100.0, "{:.1f} %"),
    ("Error stays within 2 % from", "settled_s", 1.0, "{:.0f} s"),
    ("Rows scored", "n_scored", 1.0, "{:.0f}"),
    ("Rows without an estimate", "n_unavailable", 1.0, "{:.0f}"),
)

# What the page says of the run, as far as the summary holds it.
_PROVENANCE = (
    ("Scenario", "scenario", "{}"),
    ("Recording", "recording", "{}"),
    ("Cell file", "cell", "{}"),
    ("Compared with", "compared", "{}"),
    ("Estimator", "estimator", "{}"),
    ("Plant", "plant", "{}"),
    ("Bus", "bus", "{}"),
    ("Sensor seed", "seed", "{}"),
    ("Capacity told from use", "soh", "{:.1%} of the cell file's"),
    ("r0 told from use", "r0_scale", "{:.1%} of the cell file's"),
    ("Length", "duration_s", "{:.0f} s"),
    ("Wall time", "wall_s", "{:.1f} s"),
    ("Speed", "realtime_factor", "{:.0f} times real time"),
)


def write_report(
    target: Path,
    trace: Trace,
    summary: dict[str, Any],
    *,
    title: str,
    judged: bool = True,
    more: Sequence[tuple[Plot, bytes]] = (),
) -> Path:
    """Write the page `target` if it ends in .html, else `report.html` and the plots as PNG into the folder `target`.

    `judged`: hold the figures against the project's goals for its demo. `more`: plots beside those of the trace.
    Returns the page's path. `summary` holds `metrics.score` of the trace and whatever of `_PROVENANCE` there is to say.
    Raises ConfigError if the place cannot be written.
    """
    scored = summary.get("n_scored", 0) > 0
    figures = _FIGURES if scored else ()
    return write_page(
        target,
        "page.html.j2",
        [*_plots(trace), *more],
        title=title,
        checks=metrics.judge(summary) if scored and judged else [],
        figures=[
            (name, _text(summary[key], factor, form), _text(summary["after_600s"][key], factor, form))
            for name, key, factor, form in figures
        ],
        provenance=[
            (name, form.format(summary[key])) for name, key, form in _PROVENANCE if summary.get(key) is not None
        ]
        + machine(),
    )


def _plots(trace: Trace) -> list[tuple[Plot, bytes]]:
    from bms_ukf.report.plots import render  # matplotlib takes half a second that a run without report need not pay

    return list(render(trace))


def _text(figure: float | None, factor: float, form: str) -> str:
    return "–" if figure is None else form.format(factor * figure)
