"""What else may be different: the age of the cell, the sampling, the number of cells, the temperature."""

from __future__ import annotations

import math

from bms_ukf.campaign.course import resample, tile
from bms_ukf.campaign.cuts import Lot, Which, measure, run, single
from bms_ukf.campaign.sensing import usual
from bms_ukf.campaign.situation import Situation
from bms_ukf.campaign.starts import anywhere
from bms_ukf.campaign.traces import Trace

RUN_S = 3600.0

AGE = ("capacity", "resistance", "both")
AGED_CAPACITY, AGED_RESISTANCE = 0.9, 1.5
STEPS_S = {"10 s": 10.0, "2 s": 2.0, "10 Hz": 0.1, "100 Hz": 0.01}
FAST_S = {0.1: 900.0, 0.01: 150.0}  # of a run, shorter for their number of rows
CELLS = {"4": 4, "96": 96}
MANY_S = 900.0  # of a run of more than ten cells
TEMPERATURES = {
    "below -5": (-math.inf, -5.0),
    "-5 to 10": (-5.0, 10.0),
    "10 to 30": (10.0, 30.0),
    "above 30": (30.0, math.inf),
}


def aged(lot: Lot) -> Situation | None:
    """The cell has 10 % less capacity or 50 % more resistance than its file says, or both."""
    both = lot.variant == "both"
    course = run(lot, anywhere, 2 * RUN_S, (lambda trace: trace.aged and trace.cells == 1) if both else single)
    if course is None:
        return None
    # The file of a larger cell, or of one of less resistance, is what a file has become when its cell has aged.
    config = {
        "capacity": {"capacity_scale": 1 / AGED_CAPACITY, "resistance_scale": 1.0},
        "resistance": {"resistance_scale": 1 / AGED_RESISTANCE},
        "both": {},
    }[lot.variant]
    return measure(lot, course, f"aged: {lot.variant}", config=config)


def sampled(lot: Lot) -> Situation | None:
    """Samples every 10 s to every 10 ms."""
    step_s = STEPS_S[lot.variant]
    fast = run(lot, anywhere, FAST_S[step_s], _fast) if step_s < 1.0 else None
    course = fast or run(lot, anywhere, FAST_S.get(step_s, 4 * RUN_S if step_s > 5.0 else RUN_S))
    if course is None:
        return None
    timeout_s = max(5.0, 2.5 * step_s)
    tuning = {"current_timeout_s": timeout_s, "voltage_timeout_s": timeout_s}
    config = {"silence_s": max(2.0, 2.5 * step_s)}
    return measure(lot, resample(course, step_s), f"samples: {lot.variant}", tuning=tuning, config=config)


def packs(lot: Lot) -> Situation | None:
    """Cells in series, with a voltage sensor each."""
    cells = CELLS[lot.variant]
    run_s = MANY_S if cells > 10 else RUN_S
    course = run(lot, anywhere, run_s, lambda trace: trace.cells == cells)
    if course is None:  # a plant without a pack: equal cells that the sensors tell apart
        course = run(lot, anywhere, run_s)
        course = course and tile(course, cells)
    return course and measure(lot, course, f"{cells} cells", usual(lot.rng))


def temperatures(lot: Lot) -> Situation | None:
    """Drives, charges and rests in one range of temperatures."""
    low, high = TEMPERATURES[lot.variant]
    course = run(lot, anywhere, RUN_S, _between(low, high))
    return course and measure(lot, course, f"at {course.temperature_degC.mean():.0f} degC")


def _fast(trace: Trace) -> bool:
    return trace.cells == 1 and trace.step_s < 1.0


def _between(low_degC: float, high_degC: float) -> Which:
    def which(trace: Trace) -> bool:
        return single(trace) and low_degC <= trace.ambient_degC < high_degC

    return which
