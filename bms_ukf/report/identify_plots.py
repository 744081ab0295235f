"""Plots of an identification: open-circuit voltage, tables, measured against simulated voltage, errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO

import matplotlib as mpl
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bms_ukf.identify import Identified
from bms_ukf.identify.ocv import SOC as MEASURED_SOC
from bms_ukf.identify.openloop import Prediction
from bms_ukf.identify.tables import SOC as TABLE_SOC
from bms_ukf.report.plots import ESTIMATE, STYLE, TRUTH, envelope

Array = NDArray[np.float64]

SOC = np.linspace(0, 1, 401)
MOST_TRACES = 8
MOST_NAMED = 10  # in a legend
MOST_SPREAD = 2.0  # of a logarithm: a table no test has seen must not set the scale for the others


@dataclass(slots=True, frozen=True)
class IdentifyPlot:
    name: str  # of the PNG file
    caption: str
    draw: Callable[[Identified, Figure], None]
    height_in: float


def render(found: Identified) -> Iterator[tuple[IdentifyPlot, bytes]]:
    """Every plot, as PNG."""
    traces = [(use, prediction) for use in ("validate", "fit") for prediction in found.predictions[use]]
    plots = [*PLOTS, *([_traces_plot(traces[:MOST_TRACES])] if traces else [])]
    for plot in plots:
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(9.6, plot.height_in), dpi=150, layout="constrained")
            plot.draw(found, figure)
            buffer = BytesIO()
            figure.savefig(buffer, format="png", metadata={"Software": None})
        yield plot, buffer.getvalue()


def _colour(rank: int, count: int) -> tuple[float, float, float, float]:
    """From cold to warm."""
    return colormaps["viridis"](0.9 * rank / max(count - 1, 1))


def _ocv(found: Identified, figure: Figure) -> None:
    curve, slope = figure.subplots(1, 2)
    temperatures = found.cell.ocv.temperature_degC
    sigmas_V = found.rows.ocv_sigma_V(found.slow)
    for rank, temperature in enumerate(temperatures):
        voltage_V = found.cell.ocv_V(SOC, temperature)
        colour = _colour(rank, len(temperatures))
        curve.plot(100 * SOC, voltage_V, color=colour, label=f"{temperature:g} °C")
        sigma_V = np.interp(SOC, MEASURED_SOC, sigmas_V[rank])
        curve.fill_between(100 * SOC, voltage_V - sigma_V, voltage_V + sigma_V, color=colour, alpha=0.25, linewidth=0)
        slope.plot(100 * SOC, 10 * np.gradient(voltage_V, SOC), color=colour)
    measured = found.slow.at(25.0)
    curve.plot(100 * MEASURED_SOC, measured, color=TRUTH, linestyle=":", label="slow test")
    curve.set(title="Open-circuit voltage", xlabel="SoC [%]", ylabel="OCV [V]")
    slope.set(title="Its slope", xlabel="SoC [%]", ylabel="dOCV/dSoC [mV/%]", yscale="log")
    curve.legend()


def _tables(found: Identified, figure: Figure) -> None:
    dynamics = found.cell.dynamics
    shown = [("r0_ohm", "r0 [mΩ]", 1e3)]
    if dynamics.r0_knee_A is not None:
        shown.append(("r0_knee_A", "knee of r0 [A]", 1.0))
    for j in range(dynamics.n_rc):
        shown += [(f"r{j + 1}_ohm", f"r{j + 1} [mΩ]", 1e3), (f"tau{j + 1}_s", f"tau{j + 1} [s]", 1.0)]
    if found.cell.hysteresis is not None:
        shown.append(("hysteresis_V", "hysteresis [mV]", 1e3))
    sigmas = found.rows.known()
    panels = figure.subplots((len(shown) + 1) // 2, 2, squeeze=False)
    for axes, (key, label, factor) in zip(panels.flat, shown, strict=False):
        for rank, temperature in enumerate(dynamics.temperature_degC):
            values = factor * found.cell.dynamics_at(SOC, temperature)[key]
            colour = _colour(rank, len(dynamics.temperature_degC))
            axes.plot(100 * SOC, values, color=colour, label=f"{temperature:g} °C")
            if key in sigmas:
                spread = np.exp(np.interp(SOC, TABLE_SOC, np.minimum(sigmas[key][rank], MOST_SPREAD)))
                axes.fill_between(100 * SOC, values / spread, values * spread, color=colour, alpha=0.15, linewidth=0)
        drawn = np.concatenate([line.get_ydata() for line in axes.lines])
        if np.ptp(drawn) < 1e-9 * drawn.max():  # the scale of a constant is not found by itself
            axes.set_ylim(0.5 * drawn.max(), 2 * drawn.max() + 1e-9)
        axes.set(ylabel=label, yscale="linear" if key == "hysteresis_V" else "log")
    for axes in panels.flat[len(shown) :]:
        axes.set_visible(False)
    panels[-1, 0].set_xlabel("SoC [%]")
    panels[0, 0].legend(ncols=2)


def _errors(found: Identified, figure: Figure) -> None:
    for axes, use in zip(figure.subplots(1, 2), ("fit", "validate"), strict=True):
        for rank, prediction in enumerate(found.predictions[use]):
            rows = prediction.counted & (prediction.soc > 0.1) & (prediction.soc < 0.9)
            if rows.any():
                colour = _colour(rank, len(found.predictions[use]))
                bins = np.linspace(-100, 100, 81)
                axes.hist(
                    1e3 * prediction.error_V[rows],
                    bins=bins,
                    histtype="step",
                    density=True,
                    color=colour,
                    label=prediction.name,
                )
        axes.set(title=f"Errors of the tests to {use}", xlabel="predicted minus measured [mV]", yticks=[])
        if 0 < len(found.predictions[use]) <= MOST_NAMED:
            axes.legend(fontsize=7)


def _traces_plot(traces: list[tuple[str, Prediction]]) -> IdentifyPlot:
    def draw(_: Identified, figure: Figure) -> None:
        panels = figure.subplots(len(traces), 2, squeeze=False, width_ratios=[3, 2])
        for (voltage, error), (use, prediction) in zip(panels, traces, strict=True):
            _trace(voltage, error, use, prediction)
        panels[-1, 0].set_xlabel("Time [h]")
        panels[-1, 1].set_xlabel("SoC [%]")

    caption = "Measured (grey) and predicted (blue) voltage from the current alone, and the error over SoC."
    return IdentifyPlot("voltage", caption, draw, 1.9 * len(traces) + 0.5)


def _trace(voltage: Axes, error: Axes, use: str, prediction: Prediction) -> None:
    time_h = np.cumsum(prediction.step_s) / 3600
    voltage.plot(*envelope(time_h, prediction.measured_V), color=TRUTH, linewidth=1.6, alpha=0.5)
    voltage.plot(*envelope(time_h, prediction.predicted_V), color=ESTIMATE, linewidth=0.8)
    voltage.set(title=f"{prediction.name} ({use})", ylabel="[V]")
    rows = prediction.counted
    error.plot(100 * prediction.soc[rows], 1e3 * prediction.error_V[rows], ".", color=ESTIMATE, markersize=1)
    error.axhline(0, color=TRUTH, linewidth=0.8)
    error.set(xlim=(100, 0), ylim=(-120, 120), ylabel="error [mV]")


PLOTS = (
    IdentifyPlot(
        "ocv",
        "Open-circuit voltage with one standard error, and its slope, by temperature; dotted: the slow test alone.",
        _ocv,
        3.6,
    ),
    IdentifyPlot(
        "tables",
        "Tables of the cell file over SoC with one standard error, from cold (dark) to warm (light).",
        _tables,
        9.0,
    ),
    IdentifyPlot("errors", "Distribution of the voltage error between 10 and 90 % SoC, test by test.", _errors, 3.4),
)
