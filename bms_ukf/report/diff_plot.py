"""The plot that a comparison of two cell files over one recording adds to its report."""

from __future__ import annotations

from io import BytesIO

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from bms_ukf.report.plots import ESTIMATE, LIMIT, STYLE, TRUTH, Plot, envelope
from bms_ukf.trace import Trace


def render(first: Trace, second: Trace, names: tuple[str, str]) -> tuple[Plot, bytes]:
    """SoC by both cell files, and the second's minus the first's, as PNG; both traces have the same rows."""

    def draw(trace: Trace, figure: Figure) -> None:
        soc, difference = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        time_h = (trace.t_s - trace.t_s[0]) / 3600
        if np.isfinite(trace["soc_ref"]).any():
            soc.plot(
                *envelope(time_h, 100 * trace["soc_ref"]), color=TRUTH, linewidth=1.8, alpha=0.6, label="reference"
            )
        for other, name, colour in ((trace, names[0], ESTIMATE), (second, names[1], LIMIT)):
            soc.plot(*envelope(time_h, 100 * other["soc"]), color=colour, label=name)
        soc.set(title="Two cell files", ylabel="SoC [%]")
        soc.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
        difference.plot(*envelope(time_h, 100 * (second["soc"] - trace["soc"])), color=LIMIT)
        difference.axhline(0, color=TRUTH, linewidth=0.8)
        difference.set(xlabel="Time [h]", ylabel="Difference [% SoC]")

    caption = f"SoC by {names[0]} and by {names[1]}, and how much higher the second says it is."
    plot = Plot("diff", caption, draw, ("soc",), 4.4)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, plot.height_in), dpi=150, layout="constrained")
        draw(first, figure)
        buffer = BytesIO()
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return plot, buffer.getvalue()
