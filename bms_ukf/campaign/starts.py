"""Starts: the first rows that a daemon with no stored state gets."""

from __future__ import annotations

import math

import numpy as np

from bms_ukf.campaign.cuts import HOUR_S, MINUTE_S, Lot, Mask, measure, run
from bms_ukf.campaign.situation import Situation
from bms_ukf.campaign.spans import Spans

RUN_S = 2700.0


def after_hours(lot: Lot) -> Situation | None:
    """Rest for hours, and a drive within minutes."""
    ahead_s = lot.uniform(5.0, 600.0)

    def where(spans: Spans) -> Mask:
        loads = np.flatnonzero((spans.rested_s[:-1] >= HOUR_S) & (spans.rested_s[1:] == 0.0)) + 1
        loads = loads[spans.driven_s[np.minimum(loads + 300, spans.driven_s.size - 1)] > 0.0]
        found = np.zeros(spans.rested_s.size, dtype=bool)
        found[np.maximum(loads - round(ahead_s), 0)] = True
        return found

    course = run(lot, where, ahead_s + RUN_S)
    return course and measure(lot, course, f"drive after {ahead_s:.0f} s")


def after_minutes(lot: Lot) -> Situation | None:
    """Rest for 1 to 30 minutes behind a load."""
    rest_s = lot.spread(MINUTE_S, 30 * MINUTE_S)
    course = run(lot, lambda spans: np.abs(spans.rested_s - rest_s) < 0.2 * rest_s, RUN_S)
    return course and measure(lot, course, f"rested for {rest_s / MINUTE_S:.0f} min")


def under_load(lot: Lot) -> Situation | None:
    """A constant discharge current."""
    course = run(lot, lambda spans: spans.loaded_s > 20.0, RUN_S)
    return course and measure(lot, course, "constant load")


def under_charge(lot: Lot) -> Situation | None:
    """A constant charge current, or a constant charge voltage."""
    course = run(lot, lambda spans: spans.charged_s > 20.0, RUN_S)
    return course and measure(lot, course, "constant charge")


def in_drive(lot: Lot) -> Situation | None:
    """In the middle of a drive."""
    course = run(lot, lambda spans: spans.driven_s > 60.0, RUN_S)
    return course and measure(lot, course, "in mid-drive")


LATE = ("current", "voltage", "temperature")


def late(lot: Lot) -> Situation | None:
    """One signal comes later than the two others."""
    late_s = lot.spread(5.0, 300.0)
    course = run(lot, anywhere, late_s + RUN_S)
    if course is None:
        return None
    situation = measure(lot, course, f"{lot.variant} {late_s:.0f} s late")
    rows = situation.t_s <= late_s
    {
        "current": situation.current_A,
        "voltage": situation.voltage_V,
        "temperature": situation.temperature_degC,
    }[lot.variant][rows] = math.nan
    return situation


def told_wrong(lot: Lot) -> Situation | None:
    """A configured SoC that is wrong by far more than its sigma."""
    course = run(lot, anywhere, RUN_S)
    if course is None:
        return None
    soc, off, sigma = float(course.soc[0, 0]), lot.uniform(0.05, 0.4), lot.uniform(0.005, 0.02)
    signs = [sign for sign in (-1, 1) if 0.0 <= soc + sign * off <= 1.0]
    configured = min(max(soc + off * (lot.rng.choice(signs) if signs else 1), 0.0), 1.0)
    words = f"configured {100 * configured:.0f} ± {100 * sigma:.1f} %"
    return measure(lot, course, words, tuning={"initial_soc": configured, "initial_soc_sigma": sigma})


def anywhere(spans: Spans) -> Mask:
    return np.ones(spans.rested_s.size, dtype=bool)
