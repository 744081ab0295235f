"""A test as the fit sees it: thinned rows, SoC counted, and what its voltage weighs.

A row holds two currents: the mean over the interval that ends with it, which moves charge and polarisation, and the
current at its end, which makes the ohmic drop. So 10 Hz recordings are simulated at 1 Hz without blurring r0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_ukf.manifest import MeasuredTest
from bms_ukf.recordings import Recording

Array = NDArray[np.float64]

STEP_S = 1.0  # rows of a moving current
LONGEST_STEP_S = 30.0  # rows of a current that has long stood still
MOVED = 0.01  # share of the largest current that counts as a change of it
AT_LIMIT_V = 0.01  # above the lower voltage limit: the cycler holds it there, and the current follows


@dataclass(slots=True)
class Samples:
    """One test; arrays of shape (n,). Nothing here depends on the model."""

    test: MeasuredTest
    name: str
    step_s: Array  # the interval that ends at each row
    current_A: Array  # its mean current, positive = discharge
    current_at_end_A: Array
    voltage_V: Array
    temperature_degC: Array  # of the surface
    soc: Array
    counted: NDArray[np.bool_]  # rows of the test's `part`
    exhausted: NDArray[np.bool_]  # at the lower voltage limit, where the current is what the cell still gives

    @property
    def time_s(self) -> Array:
        return np.asarray(np.cumsum(self.step_s))


def counted_soc(recording: Recording, test: MeasuredTest, capacity_Ah: float, coulombic_efficiency: float) -> Array:
    """SoC at every row: from the start, by the charge that flowed; `rests.counted_soc` where that start is a rest."""
    drawn_Ah = np.diff(recording.drawn_Ah, prepend=recording.drawn_Ah[0])
    moved_Ah = np.where(drawn_Ah < 0, coulombic_efficiency * drawn_Ah, drawn_Ah)
    start = test.initial_soc
    if start is None or start == "rest":
        known = recording.soc_ref is not None and np.isfinite(recording.soc_ref[0])
        start = float(recording.soc_ref[0]) if known and recording.soc_ref is not None else 1.0
    return np.asarray(start - np.cumsum(moved_Ah) / capacity_Ah)


def coulombic_efficiency(recordings: Sequence[tuple[MeasuredTest, Recording]], capacity_Ah: float) -> float | None:
    """Charge efficiency by the files' own SoC references, nearest 25 degC; None if no file charges and has one."""
    found: list[tuple[float, float]] = []
    for test, recording in recordings:
        drawn_Ah = np.diff(recording.drawn_Ah)
        charged_Ah = np.concatenate([[0.0], np.cumsum(np.maximum(-drawn_Ah, 0))])
        if recording.soc_ref is None or charged_Ah[-1] < 0.2 * capacity_Ah:
            continue
        discharged_Ah = np.concatenate([[0.0], np.cumsum(np.maximum(drawn_Ah, 0))])
        counts = np.column_stack([np.ones_like(charged_Ah), discharged_Ah, charged_Ah])
        _, by_discharge, by_charge = np.linalg.lstsq(counts, recording.soc_ref, rcond=None)[0]
        if by_discharge < 0:
            found.append((abs(test.temperature_degC - 25), float(np.clip(-by_charge / by_discharge, 0.9, 1.0))))
    return min(found)[1] if found else None


def sample(recording: Recording, test: MeasuredTest, soc: Array, least_V: float) -> Samples:
    """Rows of about `STEP_S`, further apart the longer the current has not moved; `least_V` is the lower limit."""
    kept = _thin(recording.time_s, recording.current_A)
    rows = recording.rows(kept)
    first, last = (np.array(test.part) * (recording.time_s.size - 1)).round()
    return Samples(
        test=test,
        name=recording.name,
        step_s=rows.step_s,
        current_A=rows.current_A,
        current_at_end_A=recording.current_A[kept],
        voltage_V=rows.voltage_V,
        temperature_degC=rows.temperature_degC,
        soc=soc[kept],
        counted=(kept >= first) & (kept <= last),
        exhausted=rows.voltage_V < least_V + AT_LIMIT_V,
    )


def at(samples: Samples, counted: NDArray[np.bool_]) -> Samples:
    """The same test, with other rows counting."""
    return replace(samples, counted=counted)


def _thin(time_s: Array, current_A: Array) -> NDArray[np.int64]:
    """Indices of the rows to keep: the first, then one at least a step after the one before."""
    moved = np.abs(np.diff(current_A, prepend=current_A[0])) > MOVED * np.abs(current_A).max()
    last_move_s = np.maximum.accumulate(np.where(moved, time_s, time_s[0]))
    step_s = np.clip(0.1 * (time_s - last_move_s), STEP_S, LONGEST_STEP_S) - 1e-3
    kept = [0]
    latest = time_s[0]
    for k, (now, step) in enumerate(zip(time_s.tolist(), step_s.tolist(), strict=True)):
        if now - latest >= step:
            kept.append(k)
            latest = now
    return np.array(kept)
