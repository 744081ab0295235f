"""Refuses a recording whose numbers no cell of that size can have, and names the unit in which they would fit.

Evidence, in this order: how high the voltage stands, how far the reference SoC reaches, how large the current is, how
far the voltage jumps with the current, and how much charge the current and the time give against what a charge
counter, the reference SoC or the voltage at small currents show.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bms_ukf import plausible
from bms_ukf.errors import ConfigError
from bms_ukf.recordings.recording import Recording

Array = NDArray[np.float64]

NEAR_STEP_S = 60.0  # a change of the current over a longer interval has more than the resistance in it
FEWEST_JUMPS = 10
JUMP = 0.1  # of the largest current, at least
FOLLOWS = 0.3  # correlation of the jumps of voltage and current; below it their ratio is no resistance
SMALL_RATE_PER_H = 0.1  # a current at which the voltage shows SoC rather than the load
SWEPT = 0.5  # share of the cell's voltage window; with it at least a tenth of the charge must have moved
MOVED = 0.1
ROUNDING = 1.6  # a ratio within this factor of that of two units is taken for it
# The charge that current and time give, as a multiple of the true charge, and what it is then.
RATIOS = {
    1e3: "current in mA, or time in ms",
    1e-3: "current in kA",
    1 / 60: "time in minutes",
    1 / 3600: "time in hours",
}
OF_COUNTER = RATIOS | {1e-3: "current in kA, or the counter in mAh", 1 / 3600: "time in hours, or the counter in As"}
OF_SOC = RATIOS | {1e2: "SoC a fraction, under a header that says percent"}


def require_units(
    recording: Recording, voltage_limits_V: Sequence[float], capacity_Ah: float | None, *, hint: str = ""
) -> None:
    """Raise ConfigError for a recording that cannot be one of such a cell; `hint` ends its line.

    Without a capacity only voltage and reference SoC are looked at.
    """
    found = _voltage(recording.voltage_V, voltage_limits_V) or _soc(recording)
    if found is None and capacity_Ah is not None:
        found = _current(recording, capacity_Ah) or _charge(recording, voltage_limits_V, capacity_Ah)
    if found is not None:
        key, value, expected = found
        raise ConfigError(recording.name, key=key, value=value, expected=expected + hint)


def require_voltage(name: str, voltage_V: Array) -> None:
    """Raise ConfigError for the voltages of a table that cannot be those of a cell."""
    found = _voltage(voltage_V[np.isfinite(voltage_V)], None)
    if found is not None:
        key, value, expected = found
        raise ConfigError(name, key=key, value=value, expected=expected)


Evidence = tuple[str, str, str]  # key, what was seen, what was expected


def _voltage(voltage_V: Array, limits_V: Sequence[float] | None) -> Evidence | None:
    typical_V = float(np.median(voltage_V)) if voltage_V.size else 0.0
    seen = f"{typical_V:.4g} in the median"
    doubt = plausible.VOLTAGE_V.doubt(typical_V)
    if doubt:
        return "voltage_V", seen, doubt
    if limits_V is not None and not limits_V[0] - 0.1 <= typical_V <= limits_V[1] + 0.1:
        return "voltage_V", seen, f"within {limits_V[0]:g} to {limits_V[1]:g} V, the cell's limits"
    return None


def _soc(recording: Recording) -> Evidence | None:
    if recording.soc_ref is None or not np.isfinite(recording.soc_ref).any():
        return None
    most = float(np.nanmax(np.abs(recording.soc_ref)))
    if most > plausible.MOST_SOC:
        return "soc_ref", f"{most:.4g} at most", "fractions of 1: is it in percent, without % in the header?"
    return None


def _current(recording: Recording, capacity_Ah: float) -> Evidence | None:
    largest_A = float(np.abs(recording.current_A).max())
    doubt = plausible.RATE_PER_H.times(capacity_Ah).doubt(largest_A, f" for {capacity_Ah:g} Ah")
    if doubt and largest_A > 0:
        return "current_A", f"{largest_A:.4g} at most", doubt
    jump_A, jump_V = np.diff(recording.current_A), np.diff(recording.voltage_V)
    sudden = (np.abs(jump_A) > JUMP * largest_A) & (np.diff(recording.time_s) < NEAR_STEP_S)
    jump_A, jump_V = jump_A[sudden], jump_V[sudden]
    if jump_A.size < FEWEST_JUMPS or np.ptp(jump_A) == 0 or np.ptp(jump_V) == 0:
        return None
    if -np.corrcoef(jump_A, jump_V)[0, 1] < FOLLOWS:
        return None
    resistance_ohm = float(-np.sum(jump_A * jump_V) / np.sum(jump_A**2))
    span = plausible.DROP_AT_1C_V
    if span.low <= resistance_ohm * capacity_Ah <= span.high:
        return None
    unit = "mA" if resistance_ohm * capacity_Ah < span.low else "kA"
    seen = f"{largest_A:.4g} at most, and the voltage jumps by {1e3 * resistance_ohm:.3g} mV for each ampere"
    least, most = (1e3 * bound / capacity_Ah for bound in (span.low, span.high))
    return "current_A", seen, f"{least:.3g} to {most:.3g} mV/A for {capacity_Ah:g} Ah: is it in {unit}?"


def _charge(recording: Recording, limits_V: Sequence[float], capacity_Ah: float) -> Evidence | None:
    """Current and time against the file's charge counter, its SoC, and the voltage at small currents."""
    moved_Ah = np.cumsum(recording.current_A * recording.step_s) / 3600
    if np.ptp(moved_Ah) == 0:
        return None
    witnesses = [("its charge counter", recording.drawn_Ah, OF_COUNTER)]
    if recording.soc_ref is not None:
        witnesses.append(("soc_ref", -capacity_Ah * recording.soc_ref, OF_SOC))
    for witness, charge_Ah, ratios in witnesses:
        known = np.isfinite(charge_Ah)
        here_Ah, there_Ah = (float(np.ptp(moved[known])) if known.any() else 0.0 for moved in (moved_Ah, charge_Ah))
        if min(here_Ah, there_Ah) == 0 or max(here_Ah, there_Ah) < MOVED * capacity_Ah:
            continue
        ratio = here_Ah / there_Ah
        unit = next((unit for size, unit in ratios.items() if 1 / ROUNDING < ratio / size < ROUNDING), None)
        if unit:
            seen = f"{here_Ah:.3g} Ah of current and time"
            return "charge", seen, f"{there_Ah:.3g} Ah by {witness}: is the {unit}?"
    if np.ptp(moved_Ah) > capacity_Ah / MOVED:
        seen = f"{np.ptp(moved_Ah):.3g} Ah of current and time"
        return "charge", seen, f"no more than the {capacity_Ah:g} Ah of the cell: is the {RATIOS[1e3]}?"
    small = np.abs(recording.current_A) < SMALL_RATE_PER_H * capacity_Ah
    for stretch in np.split(np.arange(small.size), np.flatnonzero(recording.after_gap)):  # a gap may hide a charge
        rows = stretch[small[stretch]]
        if rows.size <= FEWEST_JUMPS:
            continue
        swept_V = float(np.ptp(np.percentile(recording.voltage_V[rows], [0.5, 99.5])))
        here_Ah = float(np.ptp(moved_Ah[stretch]))
        if swept_V > SWEPT * (limits_V[1] - limits_V[0]) and here_Ah < MOVED * capacity_Ah:
            seen = f"{here_Ah:.3g} Ah while the voltage goes over {swept_V:.2f} V"
            return "charge", seen, f"most of the {capacity_Ah:g} Ah of the cell: is the {RATIOS[1 / 60]} or hours?"
    return None
