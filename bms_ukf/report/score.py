"""Writes the report of a score: tables, plots and where it all came from, on one page.

Importing this does not import matplotlib; writing a report does.
"""

from __future__ import annotations

from pathlib import Path

from bms_ukf.report.page import machine, write_page
from bms_ukf.score import Score, tables


def write_report(target: Path, found: Score) -> Path:
    """Write the page `target` if it ends in .html, else `report.html` and the plots as PNG into the folder `target`.

    Returns the page's path. Raises ConfigError if the place cannot be written.
    """
    from bms_ukf.report.score_plots import render

    summary = found.summary
    return write_page(
        target,
        "score.html.j2",
        list(render(found)),
        title=summary["cell"],
        tables=tables.every(summary),
        runs=[tables.runs(summary, name) for name in summary["estimators"]],
        notes=tables.notes(summary),
        provenance=[("Cell file", summary["cell"]), ("Manifest", summary["manifest"]), *machine()],
    )
