"""What a recording says of itself: whether its current has the declared sign, and how far its voltage lags."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError
from bms_ukf.recordings.recording import Recording

Array = NDArray[np.float64]


def require_sign(recording: Recording, current_positive: str) -> None:
    """Raise ConfigError if the voltage rises with what should be discharge.

    Two witnesses: the voltage's jump when the current jumps (any load), and its way over a charge that moves the SoC
    (slow tests, whose current hardly jumps).
    """
    jump_A = np.diff(recording.current_A)
    sudden = (np.abs(jump_A) > 0.1 * np.abs(recording.current_A).max()) & (np.diff(recording.time_s) < 60)
    jump_V = np.diff(recording.voltage_V)[sudden]
    if sudden.sum() >= 3:
        resistance_ohm = -np.sum(jump_A[sudden] * jump_V) / np.sum(jump_A[sudden] ** 2)
        agreement = (
            np.corrcoef(jump_A[sudden], jump_V)[0, 1] if np.std(jump_V) > 0 and np.std(jump_A[sudden]) > 0 else 0
        )
        if agreement > 0.3:
            _refuse(
                recording,
                current_positive,
                f"the voltage jumps by {-1e3 * resistance_ohm:+.1f} mV for each ampere of it",
            )
    drawn = np.ptp(recording.drawn_Ah)
    if drawn > 0 and np.std(recording.voltage_V) > 0:
        trend = np.corrcoef(recording.drawn_Ah, recording.voltage_V)[0, 1]
        if trend > 0.7 and sudden.sum() < 3:
            _refuse(recording, current_positive, f"the voltage rises with the charge drawn (correlation {trend:.2f})")


def _refuse(recording: Recording, current_positive: str, evidence: str) -> None:
    other = "charge" if current_positive == "discharge" else "discharge"
    raise ConfigError(
        recording.name,
        key="current_positive",
        value=current_positive,
        expected=f"{other!r}: with discharge, {evidence}",
    )


def estimate_voltage_lag_s(recording: Recording, *, most_s: float = 0.5) -> float:
    """By how much the voltage lags the current, s, within +- `most_s`; 0 where rows are too far apart to tell.

    The lag at which the voltage's change over one sample follows the current's best, to a twentieth of a sample.
    """
    typical_s = float(np.median(recording.step_s[1:]))
    if typical_s > most_s / 2:
        return 0.0
    sampled = np.arange(recording.time_s[0] + most_s, recording.time_s[-1] - most_s, typical_s)
    # A current is the mean over its interval: half a sample earlier than its row.
    drawn_As = np.interp(sampled, recording.time_s, 3600 * recording.drawn_Ah)
    jump_A = np.diff(drawn_As, 2) / typical_s
    busy = np.abs(jump_A) > 0.02 * np.abs(recording.current_A).max()
    if busy.sum() < 30:
        return 0.0
    lags_s = np.arange(-most_s, most_s + 1e-9, typical_s / 20)

    def mismatch(lag_s: float) -> float:
        jump_V = np.diff(np.interp(sampled[1:] + lag_s, recording.time_s, recording.voltage_V))[busy]
        return float(np.corrcoef(jump_A[busy], jump_V)[0, 1])

    return float(lags_s[np.argmin([mismatch(lag) for lag in lags_s])])
