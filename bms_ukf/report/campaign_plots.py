"""The figure of one run: SoC, interval and truth; the error beside the interval; the current; the status."""

from __future__ import annotations

from io import BytesIO

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bms_ukf import honesty
from bms_ukf.campaign.run import Published
from bms_ukf.campaign.situation import Situation
from bms_ukf.records import Status
from bms_ukf.report.plots import ESTIMATE, LIMIT, STYLE, TRUTH, envelope

Array = NDArray[np.float64]
_STATUS = ("#e69f00", ESTIMATE, "#f0c9a8", LIMIT)  # of `Status`; blue is a promise
_ROWS_IN = (1.6, 1.2, 0.7, 0.25)
_SETS = 2500  # drawn of a run


def render(situation: Situation, published: Published) -> bytes:
    """Return the figure as PNG; of a pack the cell whose truth is furthest outside."""
    every = max(published.t_s.size // _SETS, 1)
    cell = _worst_cell(published)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 4.8), dpi=110, layout="constrained")
        soc, error, current, status = figure.subplots(4, 1, sharex=True, height_ratios=_ROWS_IN)
        minutes = published.t_s[::every] / 60
        low, high = (100 * part[::every, cell] for part in (published.low, published.high))
        said, truth = (100 * part[::every, cell] for part in (published.soc, published.truth))
        _soc(soc, minutes, said, low, high, truth)
        _error(error, minutes, said, low, high, truth)
        _current(current, situation)
        _status(status, published.t_s / 60, published.status)
        _mark(figure.axes[:3], situation)
        status.set_xlim(0.0, max(situation.t_s[-1] / 60, 1e-6))
        buffer = BytesIO()
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _worst_cell(published: Published) -> int:
    """Return the cell with the most rows beyond three sigmas, or outside, or the first."""
    intervals = published.low, published.high, published.truth, published.ref_sigma
    far = honesty.beyond(*intervals).sum(axis=0)
    outside = np.isfinite(published.soc).sum(axis=0) - honesty.inside(*intervals).sum(axis=0)
    return int(np.lexsort((outside, far))[-1])


def _soc(axes: Axes, minutes: Array, said: Array, low: Array, high: Array, truth: Array) -> None:
    axes.fill_between(minutes, low, high, color=ESTIMATE, alpha=0.2, linewidth=0, label="95 % interval")
    axes.plot(minutes, said, color=ESTIMATE, linewidth=1.3, label="SoC")
    axes.plot(minutes, truth, color="black", linewidth=0.9, linestyle=(0, (4, 3)), label="truth")
    axes.set_ylabel("SoC [%]")
    axes.legend(loc="lower left", ncols=3, bbox_to_anchor=(0.0, 1.0), borderaxespad=0.1, handlelength=1.6)


def _error(axes: Axes, minutes: Array, said: Array, low: Array, high: Array, truth: Array) -> None:
    axes.fill_between(minutes, low - said, high - said, color=ESTIMATE, alpha=0.2, linewidth=0)
    axes.axhline(0, color=ESTIMATE, linewidth=1.0)
    axes.plot(minutes, truth - said, color="black", linewidth=0.9)
    largest = float(np.nanmax(np.abs(truth - said))) if np.isfinite(said).any() else 1.0
    axes.set_ylim(-1.25 * max(largest, 1.0), 1.25 * max(largest, 1.0))
    axes.set_ylabel("truth − SoC\n[% SoC]")


def _current(axes: Axes, situation: Situation) -> None:
    axes.plot(*envelope(situation.t_s / 60, situation.current_A), color=TRUTH, linewidth=0.6)
    axes.set_ylabel("measured\n[A]")


def _status(axes: Axes, minutes: Array, status: NDArray[np.int64]) -> None:
    """A strip of colour, with the words that occur."""
    starts = np.flatnonzero(np.diff(status, prepend=-1))
    ends = np.append(minutes[starts[1:]], minutes[-1:])
    for value in np.unique(status).tolist():
        mine = status[starts] == value
        spans = list(zip(minutes[starts][mine], (ends - minutes[starts])[mine], strict=True))
        axes.broken_barh(spans, (0, 1), facecolors=_STATUS[value], label=Status(value).word)
    axes.set(xlabel="Time [min]", ylim=(0, 1), yticks=[])
    axes.set_ylabel("status", rotation=0, ha="right", va="center")
    axes.grid(visible=False)
    axes.legend(loc="upper right", ncols=4, bbox_to_anchor=(1.0, -0.9), borderaxespad=0.0, handlelength=1.0)


def _mark(rows: list[Axes], situation: Situation) -> None:
    """Shade a silent bus, and draw a line where a sensor fails."""
    silent = np.flatnonzero(situation.silent)
    for axes in rows:
        if silent.size:
            axes.axvspan(
                situation.t_s[silent[0]] / 60, situation.t_s[silent[-1]] / 60, color=TRUTH, alpha=0.12, linewidth=0
            )
        if situation.failure is not None:
            axes.axvline(situation.failure.at_s / 60, color=LIMIT, linewidth=1.0)
