"""Writes the report of an identification: errors, warnings, plots and where it all came from, on one page.

Importing this does not import matplotlib; writing a report does.
"""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path

import jinja2
import numpy as np

from bms_ukf.errors import ConfigError
from bms_ukf.identify import Identified


def write_report(target: Path, found: Identified) -> Path:
    """Write the page `target` if it ends in .html, else `report.html` and the plots as PNG into the folder `target`.

    Returns the page's path. Raises ConfigError if the place cannot be written.
    """
    from bms_ukf.report.identify_plots import render

    plots = list(render(found))
    page = target if target.suffix == ".html" else target / "report.html"
    try:
        if page != target:
            target.mkdir(parents=True, exist_ok=True)
            for plot, png in plots:
                (target / f"{plot.name}.png").write_bytes(png)
        loader = jinja2.FileSystemLoader(Path(__file__).parent)
        environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
        held_out_mV = found.model.held_out_mV
        text = environment.get_template("identify.html.j2").render(
            title=found.cell.cell.name,
            errors=error_rows(found),
            warnings=found.warnings,
            structure=str(found.model.unknowns.structure),
            held_out=[(name, f"{error:.1f} mV") for name, error in held_out_mV.items()],
            plots=[(plot, b64encode(png).decode()) for plot, png in plots],
            provenance=[(key, value) for key, value in found.cell.provenance.items() if isinstance(value, str)],
        )
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(target, expected=f"a place that can be written ({error.strerror})") from None
    return page


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
