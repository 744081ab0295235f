"""Signals and sensors in words, for `bms-ukf run --check`: a line for each role, then the sensor specification."""

from __future__ import annotations

from collections.abc import Sequence

from bms_ukf.cell import CellParams
from bms_ukf.config import Signals
from bms_ukf.dbc import protection
from bms_ukf.sensor_spec import BOUND_SIGMAS
from bms_ukf.signals import Bound
from bms_ukf.tuning import Tuning
from bms_ukf.units import BASE

_SHOWN = 3  # of many signals of one role


def explained(bound: Sequence[Bound], signals: Signals | None) -> list[str]:
    """A line for each signal of the map, of many alike the first and last."""
    lines = []
    for role in ("current", "voltage", "temperature", "contactor", "balancing"):
        here = [b for b in bound if b.role == role]
        told = here if len(here) <= _SHOWN else [here[0], here[-1]]
        lines += [f"  {role}{_number(b, len(here))}: {b.name} {_described(b, signals)}" for b in told]
        if len(told) < len(here):
            lines.insert(len(lines) - 1, f"  … {len(here) - len(told)} more …")
    return lines


def sensors_explained(tuning: Tuning, cell: CellParams) -> list[str]:
    """Return the lines about errors of the sensors, their resolution, and the doubt of the capacity."""
    spec = tuning.sensor_spec
    offset_A = BOUND_SIGMAS * spec.current_offset_sigma_A(cell.cell.capacity_Ah)
    steps = (
        ("current", spec.current_resolution_A, "A"),
        ("voltage", spec.voltage_resolution_V, "V"),
        ("temperature", spec.temperature_resolution_K, "K"),
    )
    return [
        f"sensors, 95 % bounds: voltage ± {1e3 * spec.voltage_offset_V:g} mV ± {100 * spec.voltage_gain:g} %, "
        f"current ± {offset_A:.3g} A ± {100 * spec.current_gain:g} %, temperature ± {spec.temperature_K:g} K, "
        f"current and voltage measured within {spec.skew_s:g} s",
        "sensors, resolution: "
        + ", ".join(f"{name} {step:g} {unit}" if step else f"{name} exact" for name, step, unit in steps)
        + f"; voltage noise {1e3 * tuning.voltage_noise_V:g} mV (one sigma)",
        f"capacity of the cell file ± {100 * BOUND_SIGMAS * tuning.capacity_doubt:.3g} % (95 % bound)",
    ]


def _number(bound: Bound, count: int) -> str:
    return f" {bound.index + 1}" if count > 1 else ""


def _described(bound: Bound, signals: Signals | None) -> str:
    message = bound.message
    width = 8 if message.is_extended_frame else 3
    parts = [f"(0x{message.frame_id:0{width}X}"]
    if bound.signal.multiplexer_ids:
        parts.append(f"page {', '.join(str(page) for page in bound.signal.multiplexer_ids)}")
    if bound.role in BASE:
        parts.append(f"{bound.lowest:g}..{bound.highest:g} {BASE[bound.role]}")
        parts.append(f"{bound.bit:g} a bit")
    if bound.role == "balancing":
        parts.append(f"{bound.lowest:g}..{bound.highest:g} A taken from a cell")
    if signals is not None:
        parts += _from_config(bound, signals)
    own = signals is not None and message.name in signals.e2e
    parts.append("CRC or counter checked" if own or protection(message) else "no CRC, no counter")
    return ", ".join(parts) + ")"


def _from_config(bound: Bound, signals: Signals) -> list[str]:
    parts = []
    if bound.role == "current":
        positive = signals.current_positive  # one for all, or one for each
        parts.append(f"positive on the bus is {positive[bound.index % len(positive)]}")
        parts += [f"shared by {signals.parallel_cells} cells"] if signals.parallel_cells > 1 else []
    if bound.role == "voltage" and signals.pack_voltage is not None:
        parts.append(f"the sum of {signals.series_cells} cells")
    if bound.role == "contactor":
        apart = ", and parts the strings from each other" if len(signals.current) > 1 else ""
        parts.append(f"open is {', '.join(str(value) for value in signals.contactor_open)}{apart}")
    codes = signals.not_available.get(bound.name, [])
    parts += [f"no value is {', '.join(str(code) for code in codes)}"] if codes else []
    if bound.name in signals.plausible:
        low, high = signals.plausible[bound.name]
        parts.append(f"plausible {low:g} to {high:g}")
    lag_s = getattr(signals.lag_s, bound.role, 0.0)
    parts += [f"{lag_s:g} s late"] if lag_s else []
    return parts
