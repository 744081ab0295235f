"""Rests for hours: the same voltage again and again, cold and hot, with an offset of the current sensor."""

from __future__ import annotations

import numpy as np

from bms_ukf.campaign import spans
from bms_ukf.campaign.course import cut, prolong
from bms_ukf.campaign.cuts import HOUR_S, Lot, Mask, Which, measure, place, single
from bms_ukf.campaign.sensing import Errors, draw
from bms_ukf.campaign.situation import Situation
from bms_ukf.campaign.traces import Trace

VARIANTS = ("cold", "hot", "offset", "quantised")
COLD_degC, HOT_degC = 5.0, 30.0
LONG_S = 1200.0  # of a rest that is worth a run


def parked(lot: Lot) -> Situation | None:
    """A cell that rests for one to four hours, behind a load or at equilibrium."""
    hours = lot.uniform(1.0, 4.0)
    found = place(lot, _long, _at(lot.variant), rest_s=0.0) or place(lot, _long, rest_s=0.0)
    if found is None:
        return None
    trace, row = found
    of = spans.of(trace.name)
    course = cut(trace, row, round(min(of.resting_s[row], hours * HOUR_S)))
    missing_s = hours * HOUR_S - course.rows
    if missing_s > 0 and of.rested_s[row + course.rows - 1] >= HOUR_S:
        course = prolong(course, course.rows - 1, missing_s)
    return measure(lot, course, f"rest of {course.rows / HOUR_S:.1f} h, {lot.variant}", _errors(lot))


def _long(of: spans.Spans) -> Mask:
    return np.asarray((of.rested_s > 1.0) & (of.resting_s >= LONG_S))


def _at(variant: str) -> Which:
    def which(trace: Trace) -> bool:
        cold, hot = trace.ambient_degC <= COLD_degC, trace.ambient_degC >= HOT_degC
        return single(trace) and (cold if variant == "cold" else hot if variant == "hot" else True)

    return which


def _errors(lot: Lot) -> Errors | None:
    if lot.variant == "offset":
        return draw(lot.rng, ("current_offset_C",))
    if lot.variant == "quantised":
        return Errors(voltage_bit_V=0.005, voltage_noise_V=0.0003, current_bit_C=0.02, current_noise_C=0.001)
    return None
