"""Hysteresis of the open-circuit voltage, which PyBaMM's one-curve electrodes do not have, beside the model's states.

A Preisach-like sum of elements with memories of different depth: h_k follows the sign of the current over a share
`DEPTHS[k]` of the capacity, so that a short reversal turns only the shallow ones. All are 0 at the start.

    dh_k/dt = -|i| / (3600 Q d_k) (h_k + sign i),     v = v_model + H sum_k w_k h_k       (i > 0: discharge)
"""

from __future__ import annotations

from typing import Any

import casadi

DEPTHS = (0.004, 0.02, 0.08)  # of the capacity
WEIGHTS = (0.3, 0.4, 0.3)


def rates(h: Any, current_A: Any, capacity_Ah: float) -> Any:
    """dh/dt, 1/s; shape of `h`."""
    moved = current_A / (3600 * capacity_Ah)
    return casadi.vertcat(*(-(casadi.fabs(moved) * h[k] + moved) / depth for k, depth in enumerate(DEPTHS)))


def voltage_V(h: Any, half_width_V: float) -> Any:
    """What the elements add to the terminal voltage."""
    return half_width_V * casadi.dot(casadi.DM(WEIGHTS), h)
