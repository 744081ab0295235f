"""A figure a scenario: SoC and its error with the faults shaded, and below them what the status was."""

from __future__ import annotations

from io import BytesIO

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from bms_ukf.expectations.record import WORDS, FaultFigures, Record
from bms_ukf.report.plots import ESTIMATE, LIMIT, STYLE, TRUTH

# Of the words of `record.WORDS`, in their order; blue is what is to be relied upon.
STATUS = ("#e69f00", ESTIMATE, "#f0c9a8", LIMIT, "#9a9a9a")
_ROWS_IN = (1.55, 1.3, 0.28)


def render(record: Record) -> bytes:
    """As PNG."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 4.1), dpi=110, layout="constrained")
        soc, error, status = figure.subplots(3, 1, sharex=True, height_ratios=_ROWS_IN)
        _soc(soc, record)
        _error(error, record)
        _status(status, record)
        _faults((soc, error), record.matrix(), float(record.t_s[-1]))
        buffer = BytesIO()
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _soc(axes: Axes, record: Record) -> None:
    t_s, trace = record.t_s, record.trace
    soc, low, high = (100 * trace[name] for name in ("soc", "soc_low", "soc_high"))
    axes.fill_between(t_s, low, high, color=ESTIMATE, alpha=0.2, linewidth=0, label="95 % interval")
    axes.plot(t_s, soc, color=ESTIMATE, linewidth=1.3, label="on the bus")
    axes.plot(t_s, 100 * trace["soc_ref"], color="black", linewidth=0.9, linestyle=(0, (4, 3)), label="true")
    axes.set_ylabel("SoC [%]")
    axes.legend(loc="lower left", ncols=3, bbox_to_anchor=(0.0, 1.0), borderaxespad=0.1, handlelength=1.6)


def _error(axes: Axes, record: Record) -> None:
    t_s = record.t_s
    error, soc, (low, high) = 100 * record.error(), record.trace["soc"], record.interval()
    axes.fill_between(t_s, 100 * (low - soc), 100 * (high - soc), color=ESTIMATE, alpha=0.2, linewidth=0)
    axes.plot(t_s, error, color=ESTIMATE, linewidth=1.2)
    axes.axhline(0, color=TRUTH, linewidth=0.8)
    largest = float(np.nanmax(np.abs(error))) if np.isfinite(error).any() else 1.0
    axes.set_ylim(-1.25 * max(largest, 0.5), 1.25 * max(largest, 0.5))
    axes.set_ylabel("Error [% SoC]")


def _status(axes: Axes, record: Record) -> None:
    """A strip of colour, with words for those that occur."""
    t_s, states = record.t_s, record.states()
    starts = np.flatnonzero(np.diff(states, prepend=-1))
    ends = np.append(t_s[starts[1:]], t_s[-1])
    for state in np.unique(states).tolist():
        of_it = states[starts] == state
        spans = list(zip(t_s[starts][of_it], (ends - t_s[starts])[of_it], strict=True))
        axes.broken_barh(spans, (0, 1), facecolors=STATUS[state], label=WORDS[state])
    axes.set(xlabel="Time [s]", ylim=(0, 1), yticks=[])
    axes.set_ylabel("status", rotation=0, ha="right", va="center")
    axes.grid(visible=False)
    axes.legend(loc="upper right", ncols=5, bbox_to_anchor=(1.0, -0.9), borderaxespad=0.0, handlelength=1.0)


def _faults(rows: tuple[Axes, ...], faults: list[FaultFigures], last_s: float) -> None:
    """A band from start to end of each, a line where it is over at once; names above, on two levels."""
    for k, fault in enumerate(faults):
        end_s = min(fault.end_s, last_s)
        for axes in rows:
            if end_s - fault.start_s > 0.002 * last_s:
                axes.axvspan(fault.start_s, end_s, color=LIMIT, alpha=0.12, linewidth=0)
            axes.axvline(fault.start_s, color=LIMIT, linewidth=0.9, alpha=0.7)
        place = blended_transform_factory(rows[0].transData, rows[0].transAxes)
        side = "right" if fault.start_s > 0.8 * last_s else "left"
        level = 0.97 - 0.13 * (k % 3)
        rows[0].text(
            fault.start_s, level, f" {fault.label} ", transform=place, fontsize=8, color=LIMIT, ha=side, va="top"
        )
