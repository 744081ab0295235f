"""What came in: which measurement is plausible, what is held instead, for how long, and what is missing."""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import clamp, is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real
from bms_ukf.records import Fault

CURRENT_MISSING = float(Fault.CURRENT_MISSING)
VOLTAGE_MISSING = float(Fault.VOLTAGE_MISSING)
TEMPERATURE_MISSING = float(Fault.TEMPERATURE_MISSING)
CURRENT_IMPLAUSIBLE = float(Fault.CURRENT_IMPLAUSIBLE)
VOLTAGE_IMPLAUSIBLE = float(Fault.VOLTAGE_IMPLAUSIBLE)
TEMPERATURE_IMPLAUSIBLE = float(Fault.TEMPERATURE_IMPLAUSIBLE)

REPEATS_S = 60.0
UNKNOWN_TEMPERATURE = 25.0  # where tables are read for a cell that has no belief yet


@inline
def take(p: Any, w: Any, y: Any, io: Any, first: int, rows: int, m: Any, lanes: int, dt: Any, current: Any) -> None:
    """Age what is held, then take what was measured and is plausible, from `io[row * rows + first + lane]`."""
    W = m.lanes
    zero, nan = real(p, 0), real(p, math.nan)
    for c in range(lanes):
        own, bleed = io[rows * k.IN_CURRENT + first + c], io[rows * k.IN_BLEED + first + c]
        through = own if is_number(own) else current
        fresh = (p[k.P_CURRENT_MIN] <= through) & (through <= p[k.P_CURRENT_MAX])
        code = real(p, CURRENT_IMPLAUSIBLE) if (not fresh) & is_number(through) else zero
        held = w[W * k.H_CURRENT + c]
        age = w[W * k.H_CURRENT_AGE + c] + dt
        held = through if fresh else held
        w[W * k.H_CURRENT + c] = held
        w[W * k.H_THROUGH + c] = held + bleed if is_number(bleed) else held
        w[W * k.H_CURRENT_AGE + c] = zero if fresh else age

        measured = io[rows * k.IN_TEMPERATURE + first + c]
        plausible = (p[k.P_TEMPERATURE_MIN] <= measured) & (measured <= p[k.P_TEMPERATURE_MAX])
        held = w[W * k.H_TEMPERATURE + c]
        age = w[W * k.H_TEMPERATURE_AGE + c] + dt
        w[W * k.H_TEMPERATURE + c] = measured if plausible else held
        w[W * k.H_TEMPERATURE_AGE + c] = zero if plausible else age
        code += real(p, TEMPERATURE_IMPLAUSIBLE) if (not plausible) & is_number(measured) else zero

        measured = io[rows * k.IN_VOLTAGE + first + c]
        plausible = (p[k.P_VOLTAGE_MIN] <= measured) & (measured <= p[k.P_VOLTAGE_MAX])
        heard = w[W * k.H_HEARD_AGE + c] + dt
        refused = w[W * k.H_REJECTED_S + c] + dt
        # Refusals with a silence between them are not an unbroken row.
        w[W * k.H_REJECTED_S + c] = nan if plausible & (heard > p[k.P_VOLTAGE_TIMEOUT]) else refused
        y[W * k.Y_SINCE_HEARD + c] = heard if is_number(heard) else zero
        w[W * k.H_HEARD_AGE + c] = zero if plausible else heard
        w[W * k.H_VOLTAGE_AGE + c] += dt
        y[W * k.Y_VOLTAGE + c] = measured if plausible else nan
        last, repeats = w[W * k.H_LAST_V + c], w[W * k.H_REPEATS + c]
        repeats = repeats if is_number(repeats) else zero
        same = real(p, 1) if measured == last else zero
        since = heard if is_number(heard) else zero  # not dt: of one instant the current may have come before
        repeats += (same - repeats) * (since / (since + real(p, REPEATS_S))) if plausible else zero
        w[W * k.H_REPEATS + c] = repeats
        w[W * k.H_LAST_V + c] = measured if plausible else last
        code += real(p, VOLTAGE_IMPLAUSIBLE) if (not plausible) & is_number(measured) else zero
        y[W * k.Y_CODE + c] = code


@inline
def share(p: Any, w: Any, y: Any, m: Any, lanes: int, dt: Any) -> int:
    """Split the step into the part whose current is known and the gap; past its timeout no charge is invented.

    Returns whether any lane has a gap.
    """
    W = m.lanes
    zero = real(p, 0)
    gaps = 0
    for c in range(lanes):
        age = w[W * k.H_CURRENT_AGE + c]
        fresh = age <= zero
        # A current that comes after the voltage of its moment ends a gap, too.
        before = w[W * k.H_GAP_S + c]
        w[W * k.H_GAP_S + c] = zero if fresh & (dt <= zero) else before
        span = dt if fresh else age
        gap = clamp(span - p[k.P_CURRENT_TIMEOUT], zero, dt)
        y[W * k.Y_GAP + c] = gap
        y[W * k.Y_KNOWN + c] = dt - gap
        gaps |= 1 if gap > zero else 0
    return gaps


@inline
def missing(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """Note which inputs are older than their timeout, or were never seen; a gap of the current, too."""
    W = m.lanes
    zero = real(p, 0)
    for c in range(lanes):
        code = y[W * k.Y_CODE + c]
        held = (w[W * k.H_CURRENT_AGE + c] <= p[k.P_CURRENT_TIMEOUT]) & (y[W * k.Y_GAP + c] <= zero)
        code += zero if held else real(p, CURRENT_MISSING)
        held = w[W * k.H_VOLTAGE_AGE + c] <= p[k.P_VOLTAGE_TIMEOUT]
        code += zero if held else real(p, VOLTAGE_MISSING)
        held = w[W * k.H_TEMPERATURE_AGE + c] <= p[k.P_TEMPERATURE_TIMEOUT]
        code += zero if held else real(p, TEMPERATURE_MISSING)
        y[W * k.Y_CODE + c] = code
