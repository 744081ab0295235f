"""Expectations of the single cells of a pack."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bms_ukf.expectations.base import Soc, Windowed, pct
from bms_ukf.expectations.record import Record


class CellSocError(Windowed):
    """Every cell's SoC is told in the window, and never further than `below` from that cell's own."""

    kind: Literal["cell_soc_error"]
    below: Soc

    def wanted(self) -> str:
        return f"of every cell at most {pct(self.below)} {self.where()}"

    def judge(self, record: Record) -> tuple[bool, str]:
        error = np.abs(record.cell_error()[record.within(*self.window)])
        told = np.isfinite(error).any(axis=0)
        if not told.all() or not told.size:
            return False, f"no SoC of {told.size - int(told.sum())} cells" if told.size else "no cells"
        worst = np.nanmax(error, axis=0)
        cell = int(worst.argmax())
        return bool(worst[cell] <= self.below), f"{pct(worst[cell])} of cell {cell + 1}"


class LowestCell(Windowed):
    """In every row with an answer this cell is named as the lowest, which it is, with a SoC at most `below` off.

    That it is the lowest in truth is judged, too: a scenario in which it is not tests nothing.
    """

    kind: Literal["lowest_cell"]
    cell: Annotated[int, Field(ge=1, le=400)]
    below: Soc

    def wanted(self) -> str:
        return f"cell {self.cell}, with an error of at most {pct(self.below)}, {self.where()}"

    def judge(self, record: Record) -> tuple[bool, str]:
        rows = record.within(*self.window) & record.answered
        true = record.cell_ref[rows]
        if not true.size:
            return False, "no cells"
        if others := sorted({int(cell) + 1 for cell in true.argmin(axis=1)} - {self.cell}):
            return False, f"in truth cell {others[0]} is the lowest at some time"
        named = record.lowest_cell[rows]
        if (wrong := named[named != self.cell]).size:
            return False, "none" if np.isnan(wrong[0]) else f"cell {wrong[0]:.0f}"
        error = float(np.max(np.abs(record.lowest_soc[rows] - true.min(axis=1))))
        return error <= self.below, f"an error of {pct(error)}"
