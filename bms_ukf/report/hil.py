"""Writes the report of scenarios: the fault matrix, then each scenario with its verdicts and its figure.

Importing this does not import matplotlib; writing a report does.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bms_ukf.expectations.record import FaultFigures
from bms_ukf.faults import can, plant, sensor, system
from bms_ukf.hil.result import Result
from bms_ukf.report.page import machine, write_page

_FAMILIES = {"Sensors": sensor, "Bus": can, "Plant": plant, "Machine": system}


def write_report(target: Path, results: Sequence[Result]) -> Path:
    """Write the page `target` if it ends in .html, else `report.html` in the folder `target`; returns the page's path.

    Raises ConfigError if the place cannot be written.
    """
    outcomes = [result.outcome for result in results]
    return write_page(
        target,
        "hil.html.j2",
        [],
        title=f"{outcomes.count('passed')} of {len(results)} scenarios passed",
        matrix=_matrix(results),
        scenarios=[_scenario(result) for result in results],
        provenance=[("Interfaces", ", ".join(sorted({result.interface for result in results}))), *machine()],
    )


def _matrix(results: Sequence[Result]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Family of faults, and a row for each time one was injected."""
    rows = [(result, figures) for result in results for figures in result.matrix]
    largest = max((figures.soc_error_max or 0.0 for _, figures in rows), default=0.0) or 1.0
    families = []
    for family, module in _FAMILIES.items():
        kinds = [part.model_fields["kind"].annotation.__args__[0] for part in module.AnyFault.__args__]
        mine = sorted(
            ((result, figures) for result, figures in rows if figures.kind in kinds),
            key=lambda row: kinds.index(row[1].kind),
        )
        if mine:
            families.append((family, [_row(result, figures, largest) for result, figures in mine]))
    return families


def _row(result: Result, figures: FaultFigures, largest: float) -> dict[str, Any]:
    error = figures.soc_error_max
    return {
        "kind": figures.kind,
        "scenario": result.name,
        "outcome": result.outcome,
        "error": "–" if error is None else f"{100 * error:.2f} %",
        "share": 0.0 if error is None else 100 * error / largest,
        "detected": _seconds(figures.detected_s),
        "told": figures.told.replace("_", " ") or "–",
        "recovered": _seconds(figures.recovered_s),
    }


def _scenario(result: Result) -> dict[str, Any]:
    found: dict[str, Any] = {
        "name": result.name,
        "outcome": result.outcome,
        "reason": result.reason,
        "verdicts": result.verdicts,
        "figure": None,
        "facts": "",
    }
    if result.record is not None and len(result.record.trace):
        from bms_ukf.report.hil_plots import render  # matplotlib takes half a second that a run without one need not

        found["figure"] = b64encode(render(result.record)).decode()
        facts = [
            f"{result.duration_s:g} s over {result.interface}, {result.realtime_factor:.0f} times real time",
            f"{result.frames_in} frames to the daemon and {result.frames_out} from it",
            f"seed {result.seed}, trace {result.trace_hash}",
        ]
        found["facts"] = "; ".join([*facts, *([f"{result.overruns} steps late"] if result.overruns else [])])
    return found


def _seconds(time_s: float | None) -> str:
    return "–" if time_s is None else f"{time_s:.1f} s"
