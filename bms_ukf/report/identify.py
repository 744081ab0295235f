"""Writes the report of an identification: errors, warnings, plots and where it all came from, on one page.

Importing this does not import matplotlib; writing a report does.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bms_ukf.identify import Identified, ocv, uncertainty
from bms_ukf.identify.tables import SOC
from bms_ukf.report.page import write_page


def write_report(target: Path, found: Identified) -> Path:
    """Write the page `target` if it ends in .html, else `report.html` and the plots as PNG into the folder `target`.

    Returns the page's path. Raises ConfigError if the place cannot be written.
    """
    from bms_ukf.report.identify_plots import render

    return write_page(
        target,
        "identify.html.j2",
        list(render(found)),
        title=found.cell.cell.name,
        errors=error_rows(found),
        warnings=found.warnings,
        slow=slow_rows(found),
        parameters=parameter_rows(found),
        temperatures=[f"{T:g} °C" for T in found.cell.dynamics.temperature_degC],
        structure=str(found.model.unknowns.structure),
        held_out=[(name, f"{error:.1f} mV") for name, error in found.model.held_out_mV.items()],
        provenance=[(key, value) for key, value in found.cell.provenance.items() if isinstance(value, str)],
    )


def error_rows(found: Identified) -> list[tuple[str, str, str, str, str]]:
    """Name, use, RMSE, bias and temperatures of every test, as text."""
    rows = []
    for use, predictions in found.predictions.items():
        for prediction in predictions:
            inside = prediction.counted & (prediction.soc > 0.1) & (prediction.soc < 0.9)
            bias_mV = 1e3 * float(np.mean(prediction.error_V[inside])) if inside.any() else float("nan")
            low, high = prediction.temperature_degC.min(), prediction.temperature_degC.max()
            rmse = f"{1e3 * prediction.rmse_V():.1f} mV"
            rows.append((prediction.name, use, rmse, f"{bias_mV:+.1f} mV", f"{low:.0f} to {high:.0f} °C"))
    return rows


def slow_rows(found: Identified) -> list[tuple[str, str, str, str, str]]:
    """For each temperature with a slow test: capacities, charge efficiency, and the error of the OCV, as text."""
    slow = found.slow
    inside = (ocv.SOC >= 0.1) & (ocv.SOC <= 0.9)
    rows = []
    for curve in slow.curves:
        T = curve.temperature_degC
        drawn_Ah, charged_Ah = slow.drawn_Ah.get(T), slow.charged_Ah.get(T)
        both = drawn_Ah is not None and charged_Ah is not None
        sigma_mV = 1e3 * curve.sigma_V[inside]
        rows.append(
            (
                f"{T:g} °C, {' and '.join(curve.directions)}",
                "–" if drawn_Ah is None else f"{drawn_Ah:.3f} Ah",
                "–" if charged_Ah is None else f"{charged_Ah:.3f} Ah",
                f"{drawn_Ah / charged_Ah:.4f}" if both and drawn_Ah and charged_Ah else "–",
                f"{np.median(sigma_mV):.2f} mV, at most {sigma_mV.max():.2f} mV",
            )
        )
    return rows


def parameter_rows(found: Identified) -> list[tuple[str, list[str]]]:
    """For each table: the medians of its middle values and of their standard errors, by temperature, as text."""
    rows = []
    middle = SOC[uncertainty.MIDDLE]
    for key, sigma in found.rows.known().items():
        cells = []
        for T, row in zip(found.cell.dynamics.temperature_degC, sigma, strict=True):
            at_T = found.cell.dynamics_at(middle, T)
            values = at_T.get(key)
            if values is not None:
                error = float(np.median(row[uncertainty.MIDDLE]))
                cells.append(f"{np.median(values):.3g} ±{100 * error:.0f} %")
        rows.append((key, cells))
    return rows
