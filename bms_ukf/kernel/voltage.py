"""What the measured voltages say: look the OCV up, compare, gate, fuse."""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import bias
from bms_ukf.kernel import layout as k
from bms_ukf.kernel.adapt import FAST_S, LEAN_MOST, VOLTAGE_ERROR_S
from bms_ukf.kernel.ecm import between_rows, is_number, ocv_cubic, ocv_interval
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real, whole
from bms_ukf.kernel.srukf import innovate, update
from bms_ukf.records import Fault

AT_ONCE_S = (
    1e-3  # voltages closer than this count as so far apart: float32 has to tell their variance from the crowding's
)
R0_LEAST = -0.55  # a belief with a smaller r0 error explains the voltage by a resistance that no cell has
REPEATS_MOST = 300.0  # readings that count as one at most
INNOVATION_REJECTED = float(Fault.INNOVATION_REJECTED)


@inline
def look_up(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """The OCV at the mean SoC and at the two sigma points that move it; Y_OCV_D turns from fraction to voltage.

    Finding the interval and reading it are two loops: the first is arithmetic, the second are gathers.
    """
    W = m.lanes
    for c in range(lanes):
        soc = w[W * (m.x + k.SOC) + c]
        spread = p[k.P_GAMMA] * w[W * m.root + c]
        # A lane without a belief must not give an index.
        spread = spread if is_number(spread) else real(p, 0)
        soc = soc if soc - soc == real(p, 0) else real(p, 0.5)
        row_at, f = between_rows(p, k.P_OCV, y[W * k.Y_T + c])
        y[W * k.Y_OCV_F + c] = f
        here, d = ocv_interval(p, row_at, soc)
        y[W * k.Y_OCV_AT + c] = here
        y[W * k.Y_OCV_D + c] = d
        here, d = ocv_interval(p, row_at, soc + spread)
        y[W * (k.Y_OCV_AT + 1) + c] = here
        y[W * (k.Y_OCV_D + 1) + c] = d
        here, d = ocv_interval(p, row_at, soc - spread)
        y[W * (k.Y_OCV_AT + 2) + c] = here
        y[W * (k.Y_OCV_D + 2) + c] = d
    for point in range(3):
        for c in range(lanes):
            here = whole(y[W * (k.Y_OCV_AT + point) + c])
            d, f = y[W * (k.Y_OCV_D + point) + c], y[W * k.Y_OCV_F + c]
            y[W * (k.Y_OCV_D + point) + c] = ocv_cubic(p, here, d, f)


@inline
def innovations(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """Predict every lane's voltage and compare it with the one measured."""
    W = m.lanes
    for c in range(lanes):
        z = y[W * k.Y_VOLTAGE + c]
        sigma = y[W * k.Y_DROP_SIGMA + c]
        # Neither sensor nor model errors are new at every reading: readings that crowd are each worth less.
        age = max(w[W * k.H_VOLTAGE_AGE + c], real(p, AT_ONCE_S))
        error, scale = y[W * (k.Y_DYN + k.D_ERROR) + c], w[W * k.H_VOLTAGE_SCALE + c]
        noise, fast = error * error * p[k.P_VAR_VOLTAGE] + sigma * sigma, error * error * p[k.P_FAST_VAR]
        r = noise * max(real(p, VOLTAGE_ERROR_S) / age, real(p, 1)) + fast * max(real(p, FAST_S) / age, real(p, 1))
        # A reading that repeats has the same quantisation error: together they count as one.
        r *= scale / (real(p, 1 + 1 / REPEATS_MOST) - w[W * k.H_REPEATS + c])
        y[W * k.Y_CROWDED + c] = r - scale * (noise + fast)
        g0, g_plus, g_minus = y[W * k.Y_OCV_D + c], y[W * (k.Y_OCV_D + 1) + c], y[W * (k.Y_OCV_D + 2) + c]
        innovate(p, w, y, c, m, z, y[W * k.Y_DROP + c], g0, g_plus, g_minus, r)
        if m.bias:
            by_soc = p[k.P_W] * p[k.P_GAMMA] * (g_plus - g_minus)
            bias.weigh(p, y, m, c, by_soc * by_soc)


@inline
def compare(p: Any, w: Any, y: Any, m: Any, lanes: int) -> int:
    """Innovate every lane, and decide which voltages are fused. Returns whether any lane needs more than `update`.

    A lane is compared by its Gaussian. Where that is too wide to be one, or is only the summary of components, the
    components fuse the voltage (`parts`).
    """
    W = m.lanes
    zero = real(p, 0)
    innovations(p, w, y, m, lanes)
    special, adapts = 0, p[k.P_ADAPT] > zero
    for c in range(lanes):
        innovation = y[W * k.Y_INNOVATION + c]
        heard = is_number(y[W * k.Y_VOLTAGE + c]) & (y[W * k.Y_ALIVE + c] > zero)
        sound = innovation + y[W * k.Y_VARIANCE + c]
        compared = heard & (sound - sound == zero)
        # A single reading is judged by what it may be off by, however little it tells.
        expected = y[W * k.Y_VARIANCE + c] - y[W * k.Y_CROWDED + c]
        accepted = innovation * innovation <= p[k.P_GATE2] * expected
        refused = compared & (not accepted)
        fuse = compared & accepted
        since = w[W * k.H_REJECTED_S + c]
        since = since if is_number(since) else zero
        waited = w[W * k.H_REJECTED_S + c]
        waited = since if refused else waited
        waited = real(p, math.nan) if fuse else waited
        w[W * k.H_REJECTED_S + c] = waited
        code = real(p, INNOVATION_REJECTED) if refused else zero
        y[W * k.Y_CODE + c] += real(p, math.nan) if heard & (not compared) else code  # NaN: to be refused
        held = w[W * k.H_PARTS + c] > zero
        wide = fuse & (held | is_wide(p, w, m, c))
        impossible = w[W * (m.x + m.r0) + c] < real(p, R0_LEAST)
        leans = (abs(w[W * k.H_LEAN + c]) > real(p, LEAN_MOST)) | impossible
        doubt = (refused & (since >= p[k.P_REJECT_S])) | (fuse & leans & adapts)
        special |= 1 if held | wide | doubt else 0
        how = real(p, k.BY_SIGMA_POINTS) if fuse else real(p, k.IGNORE)
        how = real(p, k.BY_PARTS) if wide else how
        y[W * k.Y_FUSE + c] = real(p, k.DOUBT) if doubt else how
    return special


@inline
def is_wide(p: Any, w: Any, m: Any, c: int) -> Any:
    """Whether a Gaussian of this width is too coarse for a curved OCV, or the belief is one that begins."""
    return (w[m.lanes * k.H_FRESH + c] > real(p, 0)) | (w[m.lanes * m.root + c] > p[k.P_WIDE_SIGMA])


@inline
def fuse(p: Any, w: Any, y: Any, m: Any, lanes: int) -> None:
    """Update every lane whose voltage was accepted."""
    W = m.lanes
    zero = real(p, 0)
    for c in range(lanes):
        update(w, y, c, m)
    for c in range(lanes):
        fused = y[W * k.Y_FUSE + c] == real(p, k.BY_SIGMA_POINTS)
        age, unseen = w[W * k.H_VOLTAGE_AGE + c], w[W * k.H_UNSEEN_S + c]
        w[W * k.H_VOLTAGE_AGE + c] = zero if fused else age
        w[W * k.H_UNSEEN_S + c] = zero if fused else unseen
