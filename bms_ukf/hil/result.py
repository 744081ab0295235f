"""What came of one scenario."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bms_ukf.expectations.base import Verdict
from bms_ukf.expectations.record import FaultFigures, Record

Outcome = Literal["passed", "failed", "not run"]


@dataclass(slots=True)
class Result:
    """`record` is None if the scenario was not run; `reason` then says why, or why a run could not go on."""

    name: str
    path: Path
    interface: str
    seed: int
    record: Record | None = None
    verdicts: Sequence[Verdict] = ()
    reason: str | None = None
    wall_s: float = 0.0
    overruns: int = 0  # steps that began late, in real time
    frames_in: int = 0  # that reached the daemon
    frames_out: int = 0  # that it sent
    matrix: list[FaultFigures] = field(default_factory=list)

    @property
    def outcome(self) -> Outcome:
        """A run that could not go on has failed, unless that was expected of it."""
        if self.record is None:
            return "not run"
        return "passed" if all(verdict.passed for verdict in self.verdicts) else "failed"

    @property
    def duration_s(self) -> float:
        """How much time of the scenario passed."""
        return float(self.record.t_s[-1]) if self.record is not None and len(self.record.trace) else 0.0

    @property
    def realtime_factor(self) -> float:
        return self.duration_s / self.wall_s if self.wall_s else 0.0

    @property
    def soc_error_max(self) -> float | None:
        """Largest |error| of a SoC on the bus, 0..1."""
        error = np.abs(self.record.error()) if self.record is not None else np.array([])
        return float(np.nanmax(error)) if np.isfinite(error).any() else None

    @property
    def trace_hash(self) -> str | None:
        return None if self.record is None else self.record.digest()

    def summary(self) -> dict[str, Any]:
        """What users' scripts read from the JSON."""
        error = self.soc_error_max
        return {
            "scenario": self.name,
            "file": str(self.path),
            "outcome": self.outcome,
            "reason": self.reason,
            "interface": self.interface,
            "seed": self.seed,
            "trace_sha256": self.trace_hash,
            "duration_s": self.duration_s,
            "wall_s": self.wall_s,
            "realtime_factor": self.realtime_factor,
            "overruns": self.overruns,
            "frames_in": self.frames_in,
            "frames_out": self.frames_out,
            "soc_error_max_pct": None if error is None else 100 * error,
            "expectations": [asdict(verdict) for verdict in self.verdicts],
            "faults": [_figures(figures) for figures in self.matrix],
        }


def _figures(figures: FaultFigures) -> dict[str, Any]:
    error, end_s = figures.soc_error_max, figures.end_s
    return {
        "fault": figures.label,
        "kind": figures.kind,
        "start_s": figures.start_s,
        "end_s": end_s if np.isfinite(end_s) else None,
        "soc_error_max_pct": None if error is None else 100 * error,
        "detected_s": figures.detected_s,
        "told": figures.told,
        "recovered_s": figures.recovered_s,
    }
