"""Gaps: the bus of a running daemon is silent, while the cell rests, drives or is charged."""

from __future__ import annotations

import math

import numpy as np

from bms_ukf.campaign import spans
from bms_ukf.campaign.course import Course, cut, prolong
from bms_ukf.campaign.cuts import HOUR_S, Lot, Mask, measure, place
from bms_ukf.campaign.situation import Situation

BEFORE_S, AFTER_S = 900.0, 2400.0
SHORTEST_S, LONGEST_S = 10.0, 12 * HOUR_S
SIGMA = 0.03  # of the configured SoC, which is honest: these runs are about the gap
RELAXED_S = HOUR_S  # a longer rest may be prolonged

VARIANTS = ("at rest", "driven", "charged")


def silence(lot: Lot) -> Situation | None:
    """Nothing is received for 10 s to 12 h."""
    gap_s = lot.spread(SHORTEST_S, LONGEST_S)
    found = _at_rest(lot, gap_s) if lot.variant == "at rest" else _in_use(lot, gap_s)
    if found is None:
        return None
    course, from_s, gap_s = found
    soc = float(np.clip(course.soc[0, 0] + SIGMA * lot.rng.standard_normal(), 0.0, 1.0))
    words = f"silent for {gap_s / 60:.1f} min, {lot.variant}"
    situation = measure(lot, course, words, tuning={"initial_soc": soc, "initial_soc_sigma": SIGMA})
    silent = (course.t_s > from_s) & (course.t_s <= from_s + gap_s)
    situation.current_A[silent] = situation.temperature_degC[silent] = math.nan
    situation.voltage_V[silent] = math.nan
    return situation


Found = tuple[Course, float, float]  # where the gap begins, and for how long it lasts


def _in_use(lot: Lot, gap_s: float) -> Found | None:
    """A gap that begins in a drive or a charge, no longer than the trace allows."""

    def where(of: spans.Spans) -> Mask:
        return (of.driven_s if lot.variant == "driven" else of.charged_s) > 60.0

    found = place(lot, where, rest_s=AFTER_S + SHORTEST_S)
    if found is None:
        return None
    trace, row = found
    first = max(row - round(BEFORE_S), 0)
    gap_s = min(gap_s, trace.rows - row - AFTER_S)
    return cut(trace, first, row - first + round(gap_s + AFTER_S)), float(row - first), gap_s


def _at_rest(lot: Lot, gap_s: float) -> Found | None:
    """A gap within a rest behind a load or a charge; a long rest is prolonged to hold a long gap."""
    ahead_s = lot.spread(1.0, 600.0)

    def where(of: spans.Spans) -> Mask:
        return np.isfinite(of.rested_s) & (np.abs(of.rested_s - ahead_s) <= 0.6)

    found = place(lot, where, rest_s=600.0)
    if found is None:
        return None
    trace, row = found
    end = row + round(spans.of(trace.name).resting_s[row])
    first = max(row - round(BEFORE_S), 0)
    course = cut(trace, first, end - first + round(AFTER_S))
    missing_s = gap_s - (end - row - 60)
    if missing_s > 0 and spans.of(trace.name).rested_s[end - 1] >= RELAXED_S:
        course = prolong(course, end - 1 - first, missing_s)
    elif missing_s > 0:
        gap_s = max(gap_s - missing_s, SHORTEST_S)
    return course, float(row - first), gap_s
