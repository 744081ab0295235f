"""Where a run is cut out of the traces of a plant, and the situation that sensors make of the piece."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf.campaign import library, sensing, spans, traces
from bms_ukf.campaign.course import Course, cut
from bms_ukf.campaign.sensing import Errors
from bms_ukf.campaign.situation import Failure, Situation
from bms_ukf.campaign.spans import Spans
from bms_ukf.campaign.traces import Trace

Mask = NDArray[np.bool_]
Where = Callable[[Spans], Mask]  # rows at which a run may begin
Which = Callable[[Trace], bool]

MINUTE_S, HOUR_S = 60.0, 3600.0
SHORTEST_S = 900.0  # of a run


class Lot(NamedTuple):
    """One draw: its random numbers, the plant, and the variant of the class."""

    rng: np.random.Generator
    plant: str
    variant: str

    def uniform(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def spread(self, low: float, high: float) -> float:
        """Draw from `low` to `high`, uniform in the logarithm."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))


def single(trace: Trace) -> bool:
    """Return whether a trace is of one new cell, a row a second."""
    return trace.cells == 1 and not trace.aged and trace.step_s == 1.0


def place(lot: Lot, where: Where, which: Which = single, rest_s: float = SHORTEST_S) -> tuple[Trace, int] | None:
    """Draw a row at which `where` holds, with `rest_s` of trace behind it; None: the plant has none."""
    for name in lot.rng.permutation(library.names(lot.plant)):
        trace = library.load(str(name))
        if not which(trace):
            continue
        rows = np.flatnonzero(where(spans.of(trace.name)))
        rows = rows[rows < trace.rows - round(rest_s / trace.step_s)]
        if rows.size:
            return trace, int(lot.rng.choice(rows))
    return None


def run(lot: Lot, where: Where, run_s: float, which: Which = single) -> Course | None:
    """Cut a run of `run_s`, or to the end of the trace, that begins where `where` holds."""
    found = place(lot, where, which, min(SHORTEST_S, run_s))
    return None if found is None else cut(*found, round(run_s / found[0].step_s))


def measure(
    lot: Lot,
    course: Course,
    words: str,
    errors: Errors | None = None,
    *,
    tuning: dict[str, Any] | None = None,
    config: dict[str, Any] | None = None,
    failure: Failure | None = None,
) -> Situation:
    """Return what sensors make of a course; `errors` None: the usual ones, drawn."""
    rng, capacity_Ah = lot.rng, course.capacity_Ah
    errors = sensing.usual(rng) if errors is None else errors
    degC, soc = course.temperature_degC, float(course.soc[0].mean())
    return Situation(
        f"{words}; {course.trace.name} from SoC {100 * soc:.0f} %; {errors.words()}",
        course.trace.plant,
        str(traces.cell_file(course.trace)),
        course.t_s,
        sensing.current(errors, rng, course.t_s, course.current_A, capacity_Ah),
        sensing.voltage(errors, rng, course.voltage_V),
        sensing.temperature(errors, rng, degC),
        course.soc,
        course.loaded,
        float(degC.mean()),
        course.trace.soc_ref_sigma,
        tuning or {},
        config or {},
        failure,
    )
