"""A signal map in words: what `bms-ukf run --check` says of each role."""

from __future__ import annotations

from collections.abc import Sequence

from bms_ukf.config import Signals
from bms_ukf.dbc import protection
from bms_ukf.signals import Bound
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
