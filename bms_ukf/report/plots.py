"""Plots of a trace: one function each, drawn on a figure it is given; no global state of matplotlib is changed.

Colours (Okabe and Ito's, safe for colour-blind readers) mean the same everywhere: grey is measured or true, blue is the
estimate and its band, vermilion a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bms_ukf.honesty import SIGMAS_95
from bms_ukf.metrics import PAD_S
from bms_ukf.trace import Trace

Array = NDArray[np.float64]

TRUTH, ESTIMATE, LIMIT = "#4d4d4d", "#0072b2", "#d55e00"
CHI2_95 = 3.841  # 95 % quantile of chi-square with one degree of freedom
CLOSE_UP_S = 300.0
BUCKETS = 1200  # a plot is about this many pixels wide

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": "#8a8a8a",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.xmargin": 0.01,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "xtick.color": "#4d4d4d",
    "ytick.color": "#4d4d4d",
}


@dataclass(slots=True, frozen=True)
class Plot:
    name: str  # of the PNG file
    caption: str
    draw: Callable[[Trace, Figure], None]
    needs: tuple[str, ...]  # columns without which there is nothing to draw
    height_in: float = 3.2


def render(trace: Trace) -> Iterator[tuple[Plot, bytes]]:
    """Every plot that the trace has data for, as PNG."""
    for plot in PLOTS:
        if any(not np.isfinite(trace[column]).any() for column in plot.needs):
            continue
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(9.6, plot.height_in), dpi=150)
            # The same margins in inches for all: time axes line up from plot to plot.
            top, bottom = 1 - 0.35 / plot.height_in, 0.5 / plot.height_in
            figure.subplots_adjust(left=0.08, right=0.985, top=top, bottom=bottom, hspace=0.3)
            plot.draw(trace, figure)
            buffer = BytesIO()
            figure.savefig(buffer, format="png", metadata={"Software": None})
        yield plot, buffer.getvalue()


def envelope(t: Array, y: Array, buckets: int = BUCKETS) -> tuple[Array, Array]:
    """A line of at most `2 * buckets` points that covers the same pixels: lowest and highest value of each bucket."""
    if t.size <= 2 * buckets:
        return t, y
    starts = np.arange(buckets) * t.size // buckets
    low, high = np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)
    return np.repeat(t[starts], 2), np.column_stack([low, high]).ravel()


def _time(trace: Trace) -> tuple[Array, str]:
    """Time since the first row in the unit that reads best, and the label of its axis."""
    elapsed_s = trace.t_s - trace.t_s[0]
    for unit, seconds in (("h", 3600.0), ("min", 60.0)):
        if elapsed_s[-1] > 5 * seconds:
            return elapsed_s / seconds, f"Time [{unit}]"
    return elapsed_s, "Time [s]"


def _late(trace: Trace) -> NDArray[np.bool_]:
    """Rows by which an estimator should have found the state; all of them when the run is shorter."""
    elapsed_s = trace.t_s - trace.t_s[0]
    return np.asarray((elapsed_s >= PAD_S) | (elapsed_s[-1] < PAD_S))


def _line(axes: Axes, t: Array, y: Array, **style: object) -> None:
    axes.plot(*envelope(t, y), **style)  # type: ignore[arg-type]


def _band(axes: Axes, t: Array, low: Array, high: Array, label: str) -> None:
    """Filled between two lines; on a long trace between the lowest and the highest value of each bucket."""
    if t.size > BUCKETS:
        starts = np.arange(BUCKETS) * t.size // BUCKETS
        t, low, high = t[starts], np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)
    axes.fill_between(t, low, high, color=ESTIMATE, alpha=0.2, linewidth=0, label=label)


def _dots(axes: Axes, t: Array, y: Array, label: str) -> None:
    axes.plot(t, y, ".", color=TRUTH, markersize=2.5, markeredgewidth=0, alpha=0.6, label=label)


def _note(axes: Axes, text: str) -> None:
    axes.text(0.99, 0.96, text, transform=axes.transAxes, ha="right", va="top", fontsize=8.5, color=TRUTH)


def _symmetric(axes: Axes, shown: Array, everything: Array, unit: str) -> None:
    """Scale a symmetric axis to `shown`, and say so if something of `everything` lies beyond it."""
    limit = 1.15 * float(np.nanmax(np.abs(shown)))
    axes.axhline(0, color=TRUTH, linewidth=0.8)
    axes.set_ylim(-limit, limit)
    worst = float(np.nanmax(np.abs(everything)))
    if worst > limit:
        _note(axes, f"off scale at the start: up to {worst:.3g} {unit}")


def _legend(axes: Axes) -> None:
    """Above the axes at the right, beside the title."""
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        handles,
        labels,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=len(labels),
        borderaxespad=0.1,
        handlelength=1.6,
        markerscale=3.5,
    )


def _soc(trace: Trace, figure: Figure) -> None:
    axes = figure.subplots()
    t, label = _time(trace)
    soc, low, high = (100 * trace[name] for name in ("soc", "soc_low", "soc_high"))
    _band(axes, t, low, high, "95 % interval")
    _line(axes, t, soc, color=ESTIMATE, linewidth=1.4, label="estimated")
    if np.isfinite(trace["soc_ref"]).any():
        _line(axes, t, 100 * trace["soc_ref"], color="black", linewidth=0.9, linestyle=(0, (4, 3)), label="true")
    axes.set(title="State of charge", xlabel=label, ylabel="SoC [%]")
    _legend(axes)


def _soc_error(trace: Trace, figure: Figure) -> None:
    axes = figure.subplots()
    t, label = _time(trace)
    soc = trace["soc"]
    error, low, high = 100 * (soc - trace["soc_ref"]), 100 * (trace["soc_low"] - soc), 100 * (trace["soc_high"] - soc)
    _band(axes, t, low, high, "95 % interval")
    _line(axes, t, error, color=ESTIMATE, linewidth=1.2, label="estimated minus true")
    late = _late(trace)
    axes.set(title="SoC error", xlabel=label, ylabel="SoC error [%]")
    _symmetric(axes, np.concatenate([error[late], low[late], high[late], [0.5]]), error, "%")
    _legend(axes)


def _voltage(trace: Trace, figure: Figure) -> None:
    whole, close = figure.subplots(2, 1, height_ratios=[3, 2])
    t, label = _time(trace)
    hardest = int(np.nanargmax(np.where(_late(trace), np.abs(trace["current_A"]), 0.0)))
    near = np.abs(trace.t_s - trace.t_s[hardest]) <= CLOSE_UP_S / 2
    for axes, rows in ((whole, slice(None)), (close, near)):
        _line(axes, t[rows], trace["voltage_V"][rows], color=TRUTH, linewidth=1.8, alpha=0.5, label="measured")
        _line(axes, t[rows], trace["voltage_pred_V"][rows], color=ESTIMATE, linewidth=0.9, label="predicted")
        axes.set_ylabel("Cell voltage [V]")
    whole.set_title("Terminal voltage")
    close.set_title("Close-up around the largest current (shaded above)", fontsize=9, fontweight="normal")
    close.set_xlabel(label)
    whole.axvspan(*t[near][[0, -1]], color=LIMIT, alpha=0.25, linewidth=0)
    _legend(whole)


def _innovation(trace: Trace, figure: Figure) -> None:
    axes = figure.subplots()
    t, label = _time(trace)
    innovation_mV = 1000 * trace["innovation_V"]
    # sigma = |innovation| / sqrt(NIS); near zero both are a few bits of a frame, so those rows take their neighbours'.
    told = np.flatnonzero(trace["nis"] > 0.1)
    sigma_mV = np.abs(innovation_mV[told]) / np.sqrt(trace["nis"][told])
    band = SIGMAS_95 * (np.interp(t, t[told], sigma_mV) if told.size else np.full(t.size, np.nan))
    _dots(axes, t, innovation_mV, "measured minus predicted")
    _band(axes, t, -band, band, "95 % band")
    late = _late(trace)
    axes.set(title="Innovation", xlabel=label, ylabel="Innovation [mV]")
    _symmetric(axes, np.concatenate([innovation_mV[late], band[late], [1.0]]), innovation_mV, "mV")
    _legend(axes)


def _nis(trace: Trace, figure: Figure) -> None:
    axes = figure.subplots()
    t, label = _time(trace)
    fused = np.isfinite(trace["nis"])
    nis, t = trace["nis"][fused], t[fused]
    window = max(1, nis.size // 60)
    mean = np.convolve(nis, np.full(window, 1 / window), mode="valid")
    _dots(axes, t, nis, "NIS")
    _line(axes, t[window // 2 :][: mean.size], mean, color=ESTIMATE, linewidth=1.4, label="running mean")
    axes.axhline(CHI2_95, color=LIMIT, linestyle="--", label="χ² 95 % limit")
    top = max(6.0, 1.2 * float(np.percentile(nis, 99)))
    axes.set(title="Normalised innovation squared", xlabel=label, ylabel="NIS [–]", ylim=(0, top))
    above_pct = 100 * float(np.mean(nis > CHI2_95))
    _note(axes, f"mean {nis.mean():.2f}, {above_pct:.1f} % above the limit, largest {nis.max():.3g}")
    _legend(axes)


def _profile(trace: Trace, figure: Figure) -> None:
    current, temperature = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    t, label = _time(trace)
    _line(current, t, trace["current_A"], color=ESTIMATE, linewidth=0.7)
    current.axhline(0, color=TRUTH, linewidth=0.8)
    current.set(title="Load", ylabel="Cell current [A]\n(+ discharge)")
    _line(temperature, t, trace["temperature_degC"], color=LIMIT, alpha=0.6, linewidth=0.7, label="measured")
    if np.isfinite(trace["temperature_true_degC"]).any():
        _line(temperature, t, trace["temperature_true_degC"], color=TRUTH, label="true")
        _legend(temperature)
    temperature.set(xlabel=label, ylabel="Cell temperature [°C]")


PLOTS = (
    Plot("soc", "State of charge and the band that should hold the truth 95 % of the time.", _soc, ("soc",)),
    Plot(
        "soc_error", "Error of the estimate; an honest band holds it 95 % of the time.", _soc_error, ("soc", "soc_ref")
    ),
    Plot(
        "voltage",
        "Measured voltage and its prediction from the samples before it.",
        _voltage,
        ("voltage_V", "voltage_pred_V", "current_A"),
        5.0,
    ),
    Plot(
        "innovation", "What the prediction missed, and the spread the filter expects.", _innovation, ("innovation_V",)
    ),
    Plot(
        "nis",
        "Innovation squared over its variance: with a right model its mean is 1 and 5 % lie above the limit.",
        _nis,
        ("nis",),
    ),
    Plot(
        "profile",
        "Current and temperature as the estimator got them.",
        _profile,
        ("current_A", "temperature_degC"),
        4.2,
    ),
)
