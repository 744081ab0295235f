"""Sensors that fail: from the first sample, or while the daemon runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bms_ukf.campaign import sensing
from bms_ukf.campaign.cuts import Lot, Mask, measure, run
from bms_ukf.campaign.situation import Failure, Situation
from bms_ukf.campaign.spans import Spans

Array = NDArray[np.float64]

RUN_S = 3000.0
BEFORE_S = (300.0, 1200.0)
FROM_THE_START = 0.25  # share of the runs
DRIVE_S, CONSTANT_S, SCALE_S = 120.0, 600.0, 60.0  # time under load until a failure must be named

CURRENT = ("dead", "dead with noise", "stuck", "flipped", "halved", "saturated", "no charge", "no discharge")
VOLTAGE = ("stuck", "jumping")


def current(lot: Lot) -> Situation | None:
    """The current sensor fails in a drive; a dead one under constant load, too."""
    dead = lot.variant.startswith("dead")
    constant = dead and lot.rng.random() < 0.25

    def where(spans: Spans) -> Mask:
        return spans.loaded_s > 20.0 if constant else spans.driven_s > 60.0

    course = run(lot, where, RUN_S)
    if course is None:
        return None
    at_s = _fails_at(lot)
    within_s = None
    if at_s > 0.0 and lot.variant in {"dead", "dead with noise", "flipped", "halved"}:
        within_s = CONSTANT_S if constant else DRIVE_S if dead else SCALE_S
    situation = measure(lot, course, _words(lot, "current", at_s), failure=Failure("current", at_s, within_s))
    rows = course.t_s > at_s
    bit_A = sensing.Errors().current_bit_C * course.capacity_Ah
    failed = _CURRENT[lot.variant](lot.rng, situation.current_A[rows], bit_A)
    situation.current_A[rows] = failed
    return situation


def voltage(lot: Lot) -> Situation | None:
    """The voltage sensor fails in a drive."""
    course = run(lot, lambda spans: spans.driven_s > 60.0, RUN_S)
    if course is None:
        return None
    at_s = _fails_at(lot)
    situation = measure(lot, course, _words(lot, "voltage", at_s), failure=Failure("voltage", at_s))
    rows = course.t_s > at_s
    shown_V = situation.voltage_V[rows]
    situation.voltage_V[rows] = shown_V + _VOLTAGE[lot.variant](lot.rng, shown_V)
    return situation


def _fails_at(lot: Lot) -> float:
    return 0.0 if lot.rng.random() < FROM_THE_START else lot.uniform(*BEFORE_S)


def _words(lot: Lot, sensor: str, at_s: float) -> str:
    return f"{sensor} {lot.variant} from {f'{at_s:.0f} s' if at_s else 'the first sample'} on"


_Current = Callable[[np.random.Generator, Array, float], Array]  # generator, readings and bit, to readings
_CURRENT: dict[str, _Current] = {
    "dead": lambda rng, shown_A, bit_A: np.zeros_like(shown_A),
    "dead with noise": lambda rng, shown_A, bit_A: bit_A * np.rint(0.7 * rng.standard_normal(shown_A.size)),
    "stuck": lambda rng, shown_A, bit_A: np.full_like(shown_A, shown_A[0]),
    "flipped": lambda rng, shown_A, bit_A: -shown_A,
    "halved": lambda rng, shown_A, bit_A: 0.5 * shown_A,
    "saturated": lambda rng, shown_A, bit_A: np.clip(shown_A, -0.5 * np.ptp(shown_A), 0.25 * np.ptp(shown_A)),
    "no charge": lambda rng, shown_A, bit_A: np.maximum(shown_A, 0.0),
    "no discharge": lambda rng, shown_A, bit_A: np.minimum(shown_A, 0.0),
}


def _jumps(rng: np.random.Generator, shown_V: Array) -> Array:
    """Return jumps of up to half a volt, each for some 20 s."""
    changes = rng.random(len(shown_V)) < 1 / 20
    levels = np.where(rng.random(len(shown_V)) < 0.5, 0.0, rng.uniform(-0.5, 0.5, len(shown_V)))
    last = np.maximum.accumulate(np.where(changes, np.arange(len(shown_V)), 0))
    return levels[last][:, None]


_VOLTAGE: dict[str, Callable[[np.random.Generator, Array], Array]] = {  # generator and readings, to errors
    "stuck": lambda rng, shown_V: shown_V[0] - shown_V,
    "jumping": _jumps,
}
