"""Rows of a trace as they come: of one cell, or of a pack what its frames tell of it."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from bms_ukf.records import NAN, Estimate, PerCell, Sample
from bms_ukf.trace import Trace


class Rows:
    """What was measured last, and what was estimated. Of a pack mean SoC, largest sigma and NIS."""

    def __init__(self) -> None:
        self._t_ns: list[int] = []
        self._columns: dict[str, list[float]] = defaultdict(list)
        self._measured = {"current_A": NAN, "voltage_V": NAN, "temperature_degC": NAN}

    def measured(self, sample: Sample) -> None:
        """Take note of what this one carries."""
        for name in self._measured:
            value = _mean(getattr(sample, name))
            if value == value:  # noqa: PLR0124 - not NaN
                self._measured[name] = value

    def add(self, t_ns: int, estimate: Estimate) -> None:
        """A row."""
        worst = 0 if isinstance(estimate.nis, float) else int(np.argmax(np.nan_to_num(estimate.nis, nan=-1.0)))
        row = self._measured | {
            "soc": _mean(estimate.soc),
            "soc_sigma": float(np.max(estimate.soc_sigma)),
            "status": int(estimate.status),
            "faults": int(estimate.faults),
            "current_bias_A": _mean(estimate.current_bias_A),
        }
        for name in ("voltage_pred_V", "innovation_V", "nis", "r0_ohm"):
            values = getattr(estimate, name)
            row[name] = values if isinstance(values, float) else float(values[worst])
        self._t_ns.append(t_ns)
        for name, value in row.items():
            self._columns[name].append(value)

    def trace(self) -> Trace:
        """All rows."""
        columns = {name: np.asarray(values) for name, values in self._columns.items()}
        none = np.empty(0)
        return Trace.of(np.array(self._t_ns, np.int64), {"status": none, "faults": none} | columns)


def _mean(values: PerCell) -> float:
    if isinstance(values, float):
        return values
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else NAN
