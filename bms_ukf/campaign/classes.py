"""The classes of situations, and how a class and a seed become one situation."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from bms_ukf.campaign import charges, failures, gaps, library, rests, sensors, starts, variants
from bms_ukf.campaign.cuts import Lot
from bms_ukf.campaign.situation import Situation
from bms_ukf.errors import ConfigError

SEEDS = 10_000  # seeds are 0 to 9999


class NoTraceError(ConfigError):
    """None of the plants has a trace that a situation could be cut from, as that of a pack."""


class SituationClass(NamedTuple):
    """A class: its family, how to draw a situation, and the variants that are drawn in turn."""

    name: str
    family: str
    draw: Callable[[Lot], Situation | None]
    variants: Sequence[str] = ("",)


CLASSES = {
    kind.name: kind
    for kind in (
        SituationClass("start_after_hours", "starts", starts.after_hours),
        SituationClass("start_after_minutes", "starts", starts.after_minutes),
        SituationClass("start_under_load", "starts", starts.under_load),
        SituationClass("start_under_charge", "starts", starts.under_charge),
        SituationClass("start_in_drive", "starts", starts.in_drive),
        SituationClass("start_late_signal", "starts", starts.late, starts.LATE),
        SituationClass("start_told_wrong", "starts", starts.told_wrong),
        SituationClass("gaps", "gaps", gaps.silence, gaps.VARIANTS),
        SituationClass("rests", "rests", rests.parked, rests.VARIANTS),
        SituationClass("charges", "charges", charges.charge, charges.VARIANTS),
        SituationClass("sensor_error_alone", "sensors", sensors.alone, sensors.ALONE),
        SituationClass("sensor_errors_together", "sensors", sensors.together),
        SituationClass("current_fails", "failures", failures.current, failures.CURRENT),
        SituationClass("voltage_fails", "failures", failures.voltage, failures.VOLTAGE),
        SituationClass("age", "age", variants.aged, variants.AGE),
        SituationClass("sampling", "sampling", variants.sampled, tuple(variants.STEPS_S)),
        SituationClass("packs", "packs", variants.packs, tuple(variants.CELLS)),
        SituationClass("temperatures", "temperatures", variants.temperatures, tuple(variants.TEMPERATURES)),
    )
}
FAMILIES = tuple(dict.fromkeys(kind.family for kind in CLASSES.values()))


def named(name: str | None) -> list[str]:
    """Return the classes of that name or family, all for None. Raise ConfigError for an unknown name."""
    found = [kind.name for kind in CLASSES.values() if name is None or name in {kind.name, kind.family}]
    if not found:
        expected = f"a class ({', '.join(CLASSES)}) or a family of classes ({', '.join(FAMILIES)})"
        raise ConfigError("--class", value=name, expected=expected)
    return found


def plants(given: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the plants of that name, all for none. ConfigError for one without traces."""
    known = library.plants()
    for name in given:
        if name not in known:
            raise ConfigError("--plant", value=name, expected=f"a plant with traces: {', '.join(known)}")
    return tuple(given) or tuple(known)


def situation(name: str, seed: int, given: Sequence[str] = ()) -> Situation:
    """Draw the situation of a class and a seed, on the `given` plants or on all. The same arguments give the same.

    Variants and plants take turns in an order of their own for each class, so that a dozen seeds have seen all.
    """
    kind, among = CLASSES[name], plants(given)
    rng = _generator(name, "run", seed)
    variant = in_turn(name, "variant", seed, kind.variants)
    first = in_turn(name, "plant", seed, among)
    for plant in (first, *(other for other in among if other != first)):
        found = kind.draw(Lot(rng, plant, variant))
        if found is not None:
            return found
    raise NoTraceError(name, value=seed, expected=f"a trace to cut it from, of {', '.join(among)}")


def in_turn(name: str, what: str, seed: int, values: Sequence[str]) -> str:
    """Return one of `values`: every block of as many seeds has each once, in an order of its own."""
    block, place = divmod(seed, len(values))
    return values[int(_generator(name, what, block).permutation(len(values))[place])]


def _generator(name: str, what: str, number: int) -> np.random.Generator:
    digest = hashlib.sha256(f"{name} {what}".encode()).digest()
    return np.random.default_rng([number, *digest[:8]])
