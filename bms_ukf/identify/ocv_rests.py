"""The slow tests against the rests of the other tests: polarisation taken for an OCV, or for hysteresis, is found.

A slow discharge alone lies below the OCV by its polarisation, and half the distance of two branches is resistance as
well as hysteresis. A cell that rests for a quarter of an hour has lost most of the one and kept the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError
from bms_ukf.identify import ocv
from bms_ukf.manifest import Manifest, MeasuredTest
from bms_ukf.recordings import Recording

Array = NDArray[np.float64]

NEAR_K = 5.0  # a rest speaks of a slow test whose temperature is no further away
INSIDE = (0.08, 0.95)  # SoC: where the OCV is steep, an error of the count is one of many millivolts
TURNED = 0.01  # SoC that must flow in one direction before a rest has a branch
POLARISED_V = 3e-3  # of one branch, towards its current: worth a correction
OFF_V = 15e-3  # any other difference: rests err by millivolts themselves
HYSTERESIS = 0.15  # of half the width between the branches, left after a rest: less, and it was polarisation


class Rest(NamedTuple):
    """The end of a long rest."""

    soc: float
    voltage_V: float
    after: int  # 1: a discharge, -1: a charge


def found(recordings: Sequence[tuple[MeasuredTest, Recording, Array]]) -> dict[float, list[Rest]]:
    """Return the ends of long rests with a branch by temperature, from tests given with their SoC."""
    rests: dict[float, list[Rest]] = {}
    for test, recording, soc in recordings:
        for first, end in long_rests(recording):
            moved = soc[:first] - soc[first]
            turned = np.flatnonzero(np.abs(moved) > TURNED)
            if turned.size and INSIDE[0] < soc[first] < INSIDE[1]:
                rest = Rest(float(soc[end - 1]), rest_voltage_V(recording, first, end), int(np.sign(moved[turned[-1]])))
                rests.setdefault(test.temperature_degC, []).append(rest)
    return rests


def reconcile(slow: ocv.Slow, rests: dict[float, list[Rest]]) -> ocv.Slow:
    """Return the slow tests without the polarisation that the rests do not have, and say so in the warnings."""
    curves, warnings = [], list(slow.warnings)
    for curve in slow.curves:
        near = [rest for T, group in rests.items() if abs(T - curve.temperature_degC) <= NEAR_K for rest in group]
        enough = len(near) >= ocv.FEWEST_RESTS and np.ptp([rest.soc for rest in near]) > 0.5
        curves.append(_reconciled(curve, near, warnings) if enough else curve)
    return replace(slow, curves=curves, warnings=warnings)


def _reconciled(curve: ocv.Curve, rests: Sequence[Rest], warnings: list[str]) -> ocv.Curve:
    soc, voltage_V, after = np.array(sorted(rests)).T
    above_V = voltage_V - np.interp(soc, ocv.SOC, curve.voltage_V)
    name = f"OCV at {curve.temperature_degC:g} degC"
    if curve.half_width_V is not None:
        half_V = np.interp(soc, ocv.SOC, curve.half_width_V)
        kept = float(np.clip(-np.sum(above_V * after * half_V) / max(np.sum(half_V**2), 1e-12), 0.0, 1.0))
        widest_mV = 1e3 * float(np.median(half_V))
        if kept < HYSTERESIS and widest_mV > 1e3 * ocv.REST_ERROR_V:
            warnings.append(
                f"{name}: of the {widest_mV:.0f} mV from the mean to either branch, rests keep {100 * kept:.0f} %:"
                " polarisation by the current of the slow test, and no more than that taken for hysteresis"
            )
            curve = replace(curve, half_width_V=kept * curve.half_width_V)
        above_V = above_V + kept * half_V * after
    off_V = float(np.median(above_V))
    typical_V = float(np.median(np.abs(above_V)))
    side = {"discharge": 1.0, "charge": -1.0}.get(" ".join(curve.directions), 0.0)
    if typical_V < (POLARISED_V if off_V * side > 0 else OFF_V):
        return curve
    branches = f"the {curve.directions[0]} alone" if side else "the OCV"
    warnings.append(
        f"{name}: {branches} differs from {len(rests)} rests of other tests by {typical_V * 1e3:.0f} mV"
        f" ({1e3 * off_V:+.0f} mV in the middle): the rests are used"
    )
    # Three rests at a time: one rest alone may have been short, or miscounted.
    padded = np.pad(above_V, 1, mode="edge")
    smooth_V = np.median([padded[:-2], padded[1:-1], padded[2:]], axis=0)
    distinct, where = np.unique(soc, return_inverse=True)
    mean_V = np.bincount(where, smooth_V) / np.bincount(where)
    corrected, _ = ocv.rising(
        ocv.SOC, curve.voltage_V + np.interp(ocv.SOC, distinct, mean_V), smoothing=ocv.SMOOTHING / 10
    )
    left_V = voltage_V - np.interp(soc, ocv.SOC, corrected)
    sigma_V = np.hypot(curve.sigma_V, max(ocv.REST_ERROR_V, float(np.median(np.abs(left_V)))))
    return replace(curve, voltage_V=corrected, sigma_V=sigma_V)


def drawn_from_full(tests: Manifest, recordings: Sequence[tuple[MeasuredTest, Recording]]) -> float | None:
    """Return the charge, Ah, from full to the lower limit in the test nearest 25 degC; None if no test goes there."""
    low, _ = tests.voltage_limits_V
    found = [
        (abs(test.temperature_degC - 25), float(recording.drawn_Ah.max()))
        for test, recording in recordings
        if test.initial_soc in (None, 1.0) and recording.soc_ref is None and recording.voltage_V.min() < low + 0.05
    ]
    return min(found)[1] if found else None


def from_rests(
    tests: Manifest,
    recordings: Sequence[tuple[MeasuredTest, Recording, Array]],
    source: str,
    capacity_Ah: float | None = None,
) -> ocv.Slow:
    """The OCV from the ends of long rests, of tests given with their SoC, where there is no slow test.

    Raises ConfigError if the rests are too few to draw a curve through.
    """
    points: dict[float, list[tuple[float, float]]] = {}
    for test, recording, soc in recordings:
        for first, end in long_rests(recording):
            point = float(soc[end - 1]), rest_voltage_V(recording, first, end)
            points.setdefault(test.temperature_degC, []).append(point)
    curves = []
    for temperature, found in sorted(points.items()):
        soc, voltage_V = np.array(sorted(found)).T
        if soc.size >= ocv.FEWEST_RESTS and np.ptp(soc) > 0.5:
            curve, _ = ocv.rising(soc, voltage_V)
            curves.append(ocv.Curve(temperature, curve, np.full(ocv.SOC.size, ocv.REST_ERROR_V), None, 0.0, ("rest",)))
    capacity_Ah = tests.capacity_Ah or capacity_Ah
    if not curves or capacity_Ah is None:
        expected = (
            "a test of role 'ocv', or pulse tests with"
            f" {ocv.FEWEST_RESTS} rests of {ocv.REST_S:g} s or more, and capacity_Ah or pulses from full to empty"
        )
        raise ConfigError(source, key="test", expected=expected)
    return ocv.Slow(capacity_Ah, curves, warnings=["no slow test: the OCV is drawn through the ends of rests"])


def long_rests(recording: Recording) -> list[tuple[int, int]]:
    """Return first row and row after the last of every rest long enough to tell the OCV."""
    resting = np.abs(recording.current_A) < 0.01 * np.abs(recording.current_A).max()
    edges = np.flatnonzero(np.diff(resting.astype(int), prepend=0, append=0))
    found = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(a, b) for a, b in found if recording.time_s[b - 1] - recording.time_s[a] >= ocv.REST_S]


def rest_voltage_V(recording: Recording, first: int, end: int) -> float:
    """Return the voltage at the end of a rest, without its last row: that may have the voltage of the next load."""
    return float(np.median(recording.voltage_V[max(first, end - 6) : max(end - 1, first + 1)]))
