"""Plots of a score: groups and temperatures for all estimators, and every recording as ours saw it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from bms_ukf.report.plots import ESTIMATE, STYLE, TRUTH, envelope
from bms_ukf.score import Score
from bms_ukf.score.recorded import Recorded
from bms_ukf.score.tables import SHOWN

COLOURS = {"srukf": ESTIMATE, "ekf": "#e69f00", "coulomb": "#009e73"}


@dataclass(slots=True, frozen=True)
class ScorePlot:
    name: str
    caption: str
    draw: Callable[[Figure], None]
    height_in: float


def render(found: Score) -> Iterator[tuple[ScorePlot, bytes]]:
    """Every plot as PNG."""
    plots = [
        ScorePlot(
            "groups",
            "RMSE by group; the weighted score is made of those with a weight.",
            lambda f: _groups(found, f),
            3.2,
        ),
        ScorePlot("temperatures", "RMSE by temperature, nominal.", lambda f: _temperatures(found, f), 2.8),
    ]
    for recorded in found.recordings:
        plots.append(_recording(found, recorded, len(plots)))
    for plot in plots:
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(9.6, plot.height_in), dpi=150, layout="constrained")
            plot.draw(figure)
            buffer = BytesIO()
            figure.savefig(buffer, format="png", metadata={"Software": None})
        yield plot, buffer.getvalue()


def _groups(found: Score, figure: Figure) -> None:
    weights = found.summary["weights"]
    ours = next(iter(found.summary["estimators"].values()))
    labels = {name: name.replace(" ", "\n", 1) for name in ours["groups"] if name != "nominal"}
    apart = {name: f"{label}\n(no weight)" for name, label in labels.items() if name not in weights}
    _bars(found, figure, "groups", labels | apart)


def _temperatures(found: Score, figure: Figure) -> None:
    ours = next(iter(found.summary["estimators"].values()))
    _bars(found, figure, "temperatures", {degree: f"{degree} °C" for degree in ours["temperatures"]})


def _bars(found: Score, figure: Figure, section: str, labels: dict[str, str]) -> None:
    axes = figure.subplots()
    estimators = found.summary["estimators"]
    width = 0.8 / len(estimators)
    for rank, (name, estimator) in enumerate(estimators.items()):
        heights = [estimator[section][key]["rmse_pct"] for key in labels]
        places = np.arange(len(labels)) + (rank - (len(estimators) - 1) / 2) * width
        bars = axes.bar(places, heights, 0.92 * width, color=COLOURS[name], label=SHOWN[name])
        axes.bar_label(bars, fmt="%.1f", fontsize=7.5, padding=1.5)
    axes.set_xticks(np.arange(len(labels)), list(labels.values()))
    axes.set_ylabel("RMSE [% SoC]")
    axes.grid(axis="x", visible=False)
    axes.legend(ncols=len(estimators), loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)


def _recording(found: Score, recorded: Recorded, rank: int) -> ScorePlot:
    caption = (
        f"{recorded.name}: reference (grey) and estimate with its 95 % band; errors of all estimators over the rows "
        "that count."
    )
    return ScorePlot(f"recording_{rank - 1}", caption, lambda figure: _soc(found, recorded, figure), 4.4)


def _soc(found: Score, recorded: Recorded, figure: Figure) -> None:
    soc, error = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    time_h = (recorded.signals.time_s - recorded.signals.time_s[0]) / 3600
    names = [name for recording, name in found.nominal if recording == recorded.name]
    ours = found.nominal[recorded.name, names[0]]
    low, high = 100 * ours["soc_low"], 100 * ours["soc_high"]
    soc.fill_between(time_h, low, high, color=ESTIMATE, alpha=0.2, linewidth=0)
    soc.plot(*envelope(time_h, 100 * recorded.soc_ref), color=TRUTH, linewidth=1.8, alpha=0.6)
    soc.plot(*envelope(time_h, 100 * ours["soc"]), color=ESTIMATE, linewidth=1.0)
    soc.set(title=recorded.name, ylabel="SoC [%]", ylim=(-5, 105))
    rows = recorded.counted & np.isfinite(recorded.soc_ref)
    low, high = (bound[rows] - 100 * ours["soc"][rows] for bound in (low, high))
    error.fill_between(time_h[rows], low, high, color=ESTIMATE, alpha=0.2, linewidth=0)
    shown = []
    for name in reversed(names):
        off = 100 * (found.nominal[recorded.name, name]["soc"] - recorded.soc_ref)[rows]
        shown.append(np.nanpercentile(np.abs(off), 99) if np.isfinite(off).any() else 1.0)
        error.plot(*envelope(time_h[rows], off), color=COLOURS[name], linewidth=1.0, label=SHOWN[name])
    limit = max(2.0, 1.1 * max(shown[-1], np.percentile(high - low, 90) / 2 if low.size else 0.0))
    error.axhline(0, color=TRUTH, linewidth=0.8)
    error.set(xlabel="Time [h]", ylabel="Error [% SoC]", ylim=(-limit, limit))
    error.legend(ncols=len(names), loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
