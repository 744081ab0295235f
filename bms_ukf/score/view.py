"""A score on the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from bms_ukf.score import tables


def show(summary: dict[str, Any], console: Console) -> None:
    """Print the tables of a score. MAE, max, band and settling time are those of the first estimator, ours."""
    for found in tables.every(summary):
        table = Table(title=found.title, title_justify="left", title_style="bold", header_style="dim", box=None)
        for column, name in enumerate(found.header):
            table.add_column(name, justify="right" if column else "left", style="bold" if name == "bms-ukf" else "")
        for row in found.rows:
            table.add_row(*row, style="bold" if row[0] == "weighted" else "")
        console.print(table)
        console.print()
    for note in tables.notes(summary):
        console.print(note, style="dim", highlight=False)
