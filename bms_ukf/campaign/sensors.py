"""Sensors within their specification: each error alone, and all together."""

from __future__ import annotations

from dataclasses import replace

from bms_ukf.campaign.cuts import Lot, measure, run
from bms_ukf.campaign.sensing import RESOLUTIONS, SIGMAS, Errors, draw
from bms_ukf.campaign.situation import Situation
from bms_ukf.campaign.starts import anywhere

RUN_S = 3600.0
ALONE = (*SIGMAS, *RESOLUTIONS)


def alone(lot: Lot) -> Situation | None:
    """One error; the other channels have noise and resolution alone."""
    errors = draw(lot.rng, (lot.variant,)) if lot.variant in SIGMAS else replace(Errors(), **_coarse(lot, lot.variant))
    return _driven(lot, errors, lot.variant.rpartition("_")[0].replace("_", " ") or lot.variant)


def together(lot: Lot) -> Situation | None:
    """All errors at a time."""
    coarse = {name: value for kind in RESOLUTIONS for name, value in _coarse(lot, kind).items()}
    return _driven(lot, replace(draw(lot.rng), **coarse), "all errors")


def _coarse(lot: Lot, name: str) -> dict[str, float]:
    return {name: lot.spread(*RESOLUTIONS[name])}


def _driven(lot: Lot, errors: Errors, words: str) -> Situation | None:
    course = run(lot, anywhere, RUN_S)
    return course and measure(lot, course, words, errors)
