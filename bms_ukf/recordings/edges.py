"""Rests whose last record has the voltage of the load that follows.

Some cyclers write a record as a step begins, with the current of the step before. Taken for a rest, its voltage gives
a SoC that is wrong by the whole ohmic drop.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOAD = 0.2  # share of the largest current that makes a step worth a look
LEAST_V = 2e-3  # a smaller step of the voltage is noise, or a voltage column that lags
ARRIVED, LEFT = 0.5, 0.3  # shares of a step's usual voltage: seen before its current, and still to come with it


def early_voltages(current_A: Array, voltage_V: Array, at_rest: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Rows at rest, before a load, that have its voltage already. Current is positive on discharge.

    The row before must be at rest, too: a voltage alone does not say which of the two steps it belongs to.
    """
    found = np.zeros(current_A.size, dtype=bool)
    if current_A.size < 3:
        return found
    step_A = current_A[2:] - current_A[:-2]
    steps = np.abs(step_A) > LOAD * np.abs(current_A).max()
    if not steps.any():
        return found
    across_ohm = np.median(-(voltage_V[2:] - voltage_V[:-2])[steps] / step_A[steps])
    usual_V = -across_ohm * step_A
    arrived_V, left_V = np.diff(voltage_V)[:-1], np.diff(voltage_V)[1:]
    early = (arrived_V * np.sign(usual_V) > ARRIVED * np.abs(usual_V)) & (np.abs(left_V) < LEFT * np.abs(usual_V))
    steps &= np.abs(usual_V) > LEAST_V
    found[1:-1] = steps & at_rest[:-2] & at_rest[1:-1] & ~at_rest[2:] & early
    return found
