"""Writes the report of an identification: errors, warnings, plots and where it all came from, on one page.

Importing this does not import matplotlib; writing a report does.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bms_ukf.identify import Identified
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
