"""`bms-ukf init DBC...`: a CONFIG that reads a vehicle's own messages, as far as its DBC files tell how.

What they do not tell stands in a comment that begins with FILL IN; `bms-ukf run --check` names what is still missing.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

from cantools.database.can import Message

from bms_ukf import candidates
from bms_ukf.candidates import Candidate
from bms_ukf.dbc import Field, Matrix
from bms_ukf.sensor_spec import SensorSpec
from bms_ukf.units import Quantity, known

_SHOWN = 6  # candidates beside the one proposed
_MOST_CELLS = 400
_SIGN = re.compile(
    r"(positive|negative|\+|-)\W*(?:=|is|means|when|while|for|during)?\W*(charg|discharg)", re.IGNORECASE
)


def propose(paths: Sequence[Path], out: Path | None = None) -> tuple[str, list[str]]:
    """The text of a CONFIG to be written to `out`, and what the user has to fill in. ConfigError for a bad DBC."""
    matrix = Matrix(paths, strict=False)
    messages = matrix.sound()
    gaps: list[str] = []
    current, current_lines = _best(messages, "current", "current", gaps)
    temperature, temperature_lines = _best(messages, "temperature", "temperature", gaps)
    voltage_lines, cells, voltages = _voltages(messages, gaps)
    mapped = [candidate for candidate in (current, temperature, *voltages) if candidate is not None]
    folder = (out.parent if out is not None else Path()).resolve()
    names = [_relative(path, folder) for path in paths]
    lines = [
        f"# A skeleton made from {', '.join(path.name for path in paths)}. Look through it, then: bms-ukf run --check",
        *[f"# warning: {warning}" for warning in matrix.warnings],
        "format = 1",
        'cell = "lgm50_chen2020"          # FILL IN: your cell file, or a shipped cell of the same chemistry, and then',
        "# capacity_scale = 1.0           # how many times as large your cell (or those in parallel) is",
        f"cells = {cells}",
        'transmit = "periodic"            # or "on_update": after every scan of the voltages, however fast they come',
        "period_s = 0.1",
        "",
        "[bus]",
        'interface = "socketcan"',
        'channel = "can0"',
        "",
        *_sensors(),
        "",
        "[signals]",
        f"dbc = {json.dumps(names)}",
        current_lines[0],
        *_sign(current, gaps),
        *current_lines[1:],
        *voltage_lines,
        *temperature_lines,
        *_contactor(messages),
        *_codes(mapped),
    ]
    for message in dict.fromkeys(candidate.message for candidate in mapped):
        lines += _protection(message)
    return "\n".join(lines) + "\n", gaps


def _sensors() -> list[str]:
    """The table [sensor_spec] as a comment, each key with its default."""
    lines = ["# How far off your sensors are, as 95 % bounds. These are the defaults; see models/configs/example.toml."]
    lines.append("# [sensor_spec]")
    for name, field in SensorSpec.model_fields.items():
        if field.default is not None:
            lines.append(f"# {name} = {field.default:g}")
        elif name == "current_offset_A":
            lines.append(f"# {name} = 0.1   # default: a fiftieth of the capacity in Ah")
        else:
            lines.append(f"# {name} = 0.01   # default: the scale of the signal in the DBC")
    return lines


def _relative(path: Path, folder: Path) -> str:
    resolved = path.resolve()
    return str(resolved.relative_to(folder)) if resolved.is_relative_to(folder) else str(resolved)


def _best(
    messages: Sequence[Message], quantity: Quantity, key: str, gaps: list[str]
) -> tuple[Candidate | None, list[str]]:
    """The likeliest signal of a role, and its lines with the others as comments."""
    found = candidates.ranked(messages, quantity)
    if not found:
        gaps.append(f"signals.{key}: no signal of the battery has a unit of {quantity} ({known(quantity)})")
        value = '["Message.Signal"]' if key == "temperature" else '"Message.Signal"'
        return None, [f"# {key} = {value}   # FILL IN: none found with a unit of {quantity}"]
    best, *others = found
    value = json.dumps([best.name] if key == "temperature" else best.name)
    strings = candidates.alike(found) if key == "current" else []
    parallel = (
        [f"#   or, of parallel strings, with pack.string_of: {key} = {json.dumps(strings)}"] if strings[1:] else []
    )
    return best, [f"{key} = {value}{_about(best)}", *parallel, *_others(others)]


def _others(others: Sequence[Candidate]) -> list[str]:
    lines = [f"#   or {other.name}{_about(other)}" for other in others[:_SHOWN]]
    return lines + ([f"#   … and {len(others) - _SHOWN} more"] if len(others) > _SHOWN else [])


def _about(candidate: Candidate) -> str:
    comment = " ".join((candidate.signal.comment or "").split())
    return f"   # {comment[:70]}" if comment else ""


def _sign(current: Candidate | None, gaps: list[str]) -> list[str]:
    said = _SIGN.search((current.signal.comment or "") if current is not None else "")
    if said is not None:
        positive, charging = said[1].lower() in {"positive", "+"}, said[2].lower() == "charg"
        return [f'current_positive = "{"charge" if positive == charging else "discharge"}"   # as its comment says']
    gaps.append('signals.current_positive: the DBC does not say what a positive current is, "charge" or "discharge"')
    return ['# current_positive = "charge"   # FILL IN: or "discharge"; the DBC does not say']


def _voltages(messages: Sequence[Message], gaps: list[str]) -> tuple[list[str], int, list[Candidate]]:
    """Lines of the voltages, how many cells are measured one by one, and the signal for the pack if that is used."""
    rows = [row for row in candidates.cells(messages) if len(row) <= _MOST_CELLS]
    pack = candidates.ranked(messages, "voltage")
    if rows:
        row = rows[0]
        lines = [
            "cell_voltage = [",
            *(f'    "{name}",' for name in row),
            "]   # take away those your pack does not have",
        ]
        return lines + [f"#   or in its place: pack_voltage = {json.dumps(p.name)}" for p in pack[:1]], len(row), []
    if pack:
        gaps.append("signals.series_cells: how many cells in series pack_voltage is the sum of")
        lines = [f'pack_voltage = "{pack[0].name}"{_about(pack[0])}', *_others(pack[1:])]
        return [*lines, "# series_cells = 96   # FILL IN: how many cells pack_voltage is the sum of"], 1, pack[:1]
    gaps.append(f"signals.pack_voltage: no signal of the battery has a unit of voltage ({known('voltage')})")
    return ['# pack_voltage = "Message.Signal"   # FILL IN: none found with a unit of voltage'], 1, []


def _contactor(messages: Sequence[Message]) -> list[str]:
    lines = []
    for name, is_open in candidates.contactors(messages)[:_SHOWN]:
        lines += [f'# contactor = "{name}"', f"# contactor_open = {json.dumps(is_open)}"]
    return lines


def _codes(mapped: Sequence[Candidate]) -> list[str]:
    """The highest raw value of a signal is a code, and no value, where the DBC's own range leaves it out."""
    codes = {}
    for candidate in mapped:
        signal, field = candidate.signal, Field(candidate.message, candidate.signal)
        if signal.minimum is None or signal.maximum is None or signal.minimum >= signal.maximum or field.is_float:
            continue
        raw = field.sign - 1 if field.sign else field.mask
        if not signal.minimum <= raw * field.scale + field.offset <= signal.maximum and raw not in field.codes:
            codes[candidate.name] = [raw]
    told = ", ".join(f"{json.dumps(name)} = {raw}" for name, raw in codes.items())
    return [f"not_available = {{ {told} }}   # highest raw value, outside the DBC's range"] if codes else []


def _protection(message: Message) -> list[str]:
    crc, count = candidates.protective(message)
    if not crc and not count:
        return []
    lines = ["", f"# {message.name} has what looks like protection. To have it checked (models/configs/example.toml):"]
    lines.append(f"# [signals.e2e.{message.name}]")
    lines += [f'# counter = "{signal.name}"' for signal in count[:1]]
    for signal in crc[:1]:
        byte = (Field(message, signal).shift if signal.byte_order == "little_endian" else signal.start) // 8
        lines.append(
            f"# crc = {{ width = {signal.length}, polynomial = 0x1D, byte = {byte} }}   # FILL IN the polynomial"
        )
    return lines
