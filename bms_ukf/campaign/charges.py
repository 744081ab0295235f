"""Charges: constant current, constant voltage, interrupted, with voltages of 1 to 10 mV resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bms_ukf.campaign import sensing, spans
from bms_ukf.campaign.course import cut
from bms_ukf.campaign.cuts import Lot, Mask, Where, measure, place
from bms_ukf.campaign.situation import Situation

VARIANTS = ("whole", "begun", "end", "interrupted")
RUN_S = 7200.0
END_S = 900.0


def charge(lot: Lot) -> Situation | None:
    """A charge from its rest on, from its middle on, its end with the rest behind it, or one with breaks."""
    found = place(lot, _where(lot.variant))
    if found is None:
        return None
    trace, row = found
    ahead = round(lot.uniform(60.0, 600.0)) if lot.variant in {"whole", "interrupted"} else 0
    first = max(row - ahead, 0)
    course = cut(trace, first, round(RUN_S))
    bit_V = lot.spread(0.001, 0.010)
    errors = replace(sensing.usual(lot.rng), voltage_bit_V=bit_V, voltage_noise_V=0.0005)
    return measure(lot, course, f"charge, {lot.variant}, {1e3 * bit_V:.0f} mV a bit", errors)


def _where(variant: str) -> Where:
    def where(of: spans.Spans) -> Mask:
        charging = of.charged_s > 0.0
        if variant == "begun":
            return np.asarray(of.charged_s > 60.0)
        if variant == "end":
            return np.asarray((of.charged_s > 600.0) & ~_later(charging, END_S))
        begins = charging & (np.diff(of.charged_s, prepend=0.0) > 0.0) & (of.charged_s <= 1.0)
        return begins if variant == "whole" else begins & _another(begins)

    return where


def _later(mask: Mask, by_s: float) -> Mask:
    """Return the mask of rows `by_s` later; False beyond the end."""
    rows = round(by_s)
    return np.concatenate([mask[rows:], np.zeros(rows, dtype=bool)])


def _another(begins: Mask) -> Mask:
    """Return the rows with another beginning in time for both to be in one run."""
    seen = np.cumsum(begins)
    ahead = np.minimum(np.arange(begins.size) + round(RUN_S - END_S), begins.size - 1)
    return np.asarray(seen[ahead] > seen)
