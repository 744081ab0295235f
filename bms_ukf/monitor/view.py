"""The monitor's picture of a `Watch`: 80 by 24 characters, for one cell as for 400."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from bms_ukf.honesty import SIGMAS_95
from bms_ukf.monitor.watch import COLUMN_NS, COLUMNS, OPTIONAL, PUBLISHED, Protection, Track, Watch
from bms_ukf.records import NAN, Fault, Source, Stored
from bms_ukf.view import BARS, STATUS_STYLE

WIDTH = 80
INNER = WIDTH - 4
ROWS = 21  # between the frame's lines
GAUGE = 40
LABEL = 9  # characters of a line's name
MAP = 67  # cells in a line of the map

# Lowest to highest cell; the height of the bar says the same to who sees no colour.
HEAT = ("#3b528b", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725")
SPREAD_PCT = 2.0  # the map spans at least so much, or noise would look like trouble

FAULTS = {
    Fault.CURRENT_MISSING: "no current comes: no charge is counted",
    Fault.VOLTAGE_MISSING: "no voltage comes: SoC is predicted",
    Fault.TEMPERATURE_MISSING: "no temperature comes: the last is held",
    Fault.CURRENT_IMPLAUSIBLE: "current out of range",
    Fault.VOLTAGE_IMPLAUSIBLE: "a voltage is out of range",
    Fault.TEMPERATURE_IMPLAUSIBLE: "a temperature is out of range",
    Fault.INNOVATION_REJECTED: "a voltage is too far from its prediction",
    Fault.TIME_REVERSED: "time ran backwards",
    Fault.NUMERIC: "a step was not finite",
    Fault.OUT_OF_TABLE: "SoC or temperature beyond the cell file",
    Fault.E2E: "received frames refused",
    Fault.BUS: "frames lost or not sent",
    Fault.CURRENT_SIGN: "the sign of the current is wrong",
    Fault.CURRENT_SCALE: "the scale of the current is wrong",
    Fault.UNCERTAIN: "the interval of SoC is wide or in doubt",
    Fault.CURRENT_FAILED: "the current sensor has failed",
}
SOURCES = {
    Source.NONE: "nothing",
    Source.STORED: "the stored state",
    Source.START: "the first voltage",
    Source.VOLTAGE: "a voltage under load",
    Source.REST: "a voltage at rest",
}
COUNTS = {
    "FramesDropped": "frames dropped",
    "FramesRefused": "refused",
    "FramesNotSent": "not sent",
    "ClockSteps": "clock steps",
    "Reopened": "reopenings of the bus",
    "Contradictions": "currents through open contactors",
}
STATES = {Protection.OK: "green", Protection.NONE: "dim", Protection.STANDS_STILL: "yellow"}


def panel(watch: Watch, title: str, now_ns: int) -> Panel:
    """All of it, WIDTH wide and at most 23 lines high."""
    silent_s = watch.silent_s(now_ns)
    fresh = silent_s is not None and silent_s < 5.0
    parts: list[Text | Table] = [
        _soc(watch, fresh),
        _gauge(watch, fresh),
        _history(watch),
        *([_pack(watch)] if "UsableSoc" in watch.values else []),
        _figures(watch),
        *([_health(watch)] if "CapacityMin" in watch.values else []),
        *_cells(watch),
        *_strings(watch),
        _troubles(watch, silent_s),
    ]
    used = sum(_height(part) for part in parts)
    parts.append(_messages(watch.tracks.values(), now_ns, min(ROWS - used, 5)))
    return Panel(Group(*parts), title=f"bms-ukf monitor · {title}", width=WIDTH, padding=(0, 1))


def line(watch: Watch, now_ns: int) -> str:
    """The most important of it, for where there is no terminal."""
    silent_s = watch.silent_s(now_ns)
    if silent_s is None or silent_s > 5.0:
        return "no SoC frames" if silent_s is None else f"no SoC frames for {silent_s:.0f} s"
    faults = "; ".join(_fault_words(watch.faults))
    told = f"SoC {_number(watch.values.get('Soc', NAN), '%')} (95 %: {_interval(watch)})  {watch.status.word}"
    return f"{told}  {faults}" if faults else told


def _interval(watch: Watch) -> str:
    low, high = (watch.values.get(name, NAN) for name in ("SocLow", "SocHigh"))
    return "–" if math.isnan(low + high) else f"{low:.1f}–{high:.1f} %"


def _soc(watch: Watch, fresh: bool) -> Text:
    soc = watch.values.get("Soc", NAN) if fresh else NAN
    status = Text(watch.status.word, STATUS_STYLE[watch.status]) if fresh else Text("no frames", "bold red")
    known = Text("not available", "bold red") if math.isnan(soc) else Text(_number(soc, "%"), "bold")
    told = Text.assemble((f"{'SoC':{LABEL}}", "dim"), known)
    if not math.isnan(soc):
        told += Text.assemble((" 95 % ", "dim"), _interval(watch))
    told += Text.assemble(("   status ", "dim"), status, ("   by ", "dim"), SOURCES[watch.source])
    return told


def _gauge(watch: Watch, fresh: bool) -> Text:
    """SoC on a line from 0 to 100 %, and its interval."""
    soc, least, most = (watch.values.get(name, NAN) if fresh else NAN for name in ("Soc", "SocLow", "SocHigh"))
    marks = Text(f"{'':{LABEL}}0 ")
    for k in range(GAUGE):
        low, high = 100 * k / GAUGE, 100 * (k + 1) / GAUGE
        if math.isnan(soc):
            marks.append("·", "dim")
        elif low <= soc < high or (k == GAUGE - 1 and soc >= 100):
            marks.append("█", "bold")
        elif least < high and low < most:
            marks.append("▒", "cyan")
        else:
            marks.append("━" if low < soc else "·", "cyan" if low < soc else "dim")
    return marks.append(" 100 %")


def _history(watch: Watch) -> Text:
    known = [value for value in watch.history_pct if not math.isnan(value)]
    low, high = (min(known), max(known)) if known else (0.0, 0.0)
    span = max(high - low, 0.1)
    told = Text(f"{'history':{LABEL}}", "dim")
    for value in watch.history_pct:
        told.append(" " if math.isnan(value) else BARS[min(int((value - low) / span * len(BARS)), 7)], "cyan")
    minutes = COLUMNS * COLUMN_NS // 60_000_000_000
    words = f"\n{'':{LABEL}}{minutes} min, {low:.2f} to {high:.2f} %" if known else f"\n{'':{LABEL}}nothing yet"
    return told.append(words, "dim")


def _figures(watch: Watch) -> Table:
    v = watch.values
    table = Table.grid(padding=(0, 1))
    for width in (12, 22, 12, 22):
        table.add_column(width=width, style="dim" if width == 12 else "")
    innovation = _number(1000 * v.get("Innovation", NAN), "mV", 1)
    cell = "" if watch.cells == 1 else f" (cell {v.get('WorstCell', NAN):.0f})"
    table.add_row("for display", _number(v.get("SocSlewed", NAN), "%"), "predicted", _volt(v) + cell)
    table.add_row("information", f"{_number(v.get('InformationAge', NAN), 's')} old", "innovation", innovation)
    bias = _number(v.get("CurrentBias", NAN), "A")
    table.add_row("sensor bias", bias, "NIS", _number(v.get("Nis", NAN), ""))
    return table


def _pack(watch: Watch) -> Text:
    """What the pack gives: how far it reaches, with its 95 % band, and what a pulse may have."""
    v = watch.values
    usable = Text.assemble(
        (f"{'usable':{LABEL}}", "dim"),
        (_number(v["UsableSoc"], "%", 1), "bold"),
        (" ± ", "dim"),
        _number(SIGMAS_95 * v["UsableSocSigma"], "%", 1),
        ("  left ", "dim"),
        f"{_number(v['RemainingCharge'], 'Ah', 1)}, {_number(v.get('RemainingEnergy', NAN) / 1000, 'kWh', 1)}",
    )
    for name, words in (("TimeToEmpty", "empty"), ("TimeToFull", "full")):
        if not math.isnan(seconds := v.get(name, NAN)):
            usable += Text.assemble((f"  {words} in ", "dim"), _duration(seconds))
    pulses = Text.assemble((f"\n{'pulses':{LABEL}}", "dim"))
    for side, apart in (("Discharge", "   "), ("Charge", "")):
        current, power, cell = (v.get(f"{side}{what}", NAN) for what in ("Current", "Power", "Cell"))
        most = f"{_number(current, 'A', 0)}, {_number(power / 1000, 'kW', 1)}"
        pulses += Text.assemble(most, (f" (cell {_number(cell, '', 0)}){apart}", "dim"))
    return usable + pulses


def _health(watch: Watch) -> Text:
    """What the cells have become, the worst of them with its 95 % band."""
    told = Text.assemble((f"{'health':{LABEL}}", "dim"))
    for label, of in (("capacity ", "CapacityMin"), ("   r0 ", "ResistanceMax")):
        told.append(label, "dim")
        worst, what = watch.values.get(of, NAN), of[:-3]
        if math.isnan(worst):
            told.append("not told yet", "dim")
            continue
        band = SIGMAS_95 * watch.values[f"{what}Sigma"]
        told += Text.assemble(_number(worst, "", 1), (" ± ", "dim"), _number(band, "%", 1))
        if watch.cells > 1:
            told.append(f" (cell {watch.values[f'{what}Cell']:.0f})", "dim")
    return told


def _height(part: Text | Table) -> int:
    """In lines, those that wrap included."""
    if isinstance(part, Table):
        return part.row_count
    return sum(max(-(-len(told) // INNER), 1) for told in part.plain.split("\n"))


def _duration(seconds: float) -> str:
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"


def _volt(values: dict[str, float]) -> str:
    return _number(values.get("PredictedVoltage", NAN), "V", 4)


def _cells(watch: Watch) -> list[Text]:
    """A mark for each cell, lowest and highest named; nothing for a single one."""
    if watch.cells == 1:
        return []
    known = watch.of_cells_pct["CellSoc"][: watch.cells]
    if np.isnan(known).all():
        return []
    low, high = float(np.nanmin(known)), float(np.nanmax(known))
    middle, span = (low + high) / 2, max(high - low, SPREAD_PCT)
    told = Text.assemble(
        (f"{'cells':{LABEL}}", "dim"),
        f"{low:.1f} % ({int(np.nanargmin(known)) + 1}) to {high:.1f} % ({int(np.nanargmax(known)) + 1})",
        (f"   {watch.cells} cells" + (f", {MAP} a line" if watch.cells > MAP else ""), "dim"),
    )
    if (silent := watch.values.get("SilentCells", 0.0)) > 0:
        told.append(f"  {silent:.0f} silent ({watch.values['FirstSilentCell']:.0f})", "yellow")
    lines = [told]
    for first in range(0, watch.cells, MAP):
        row = Text(f"{first + 1:>{LABEL - 2}}  ", "dim")
        for value in known[first : first + MAP]:
            if math.isnan(value):
                row.append("?", "red")
            else:
                level = min(max(int((value - middle) / span * 8 + 4), 0), 7)
                row.append(BARS[level], HEAT[level])
        lines.append(row)
    return lines


def _strings(watch: Watch) -> list[Text]:
    """The bias of each string's current sensor; nothing for a single one."""
    known = np.flatnonzero(~np.isnan(watch.biases_A))
    if not known.size:
        return []
    told = ", ".join(f"{_number(watch.biases_A[k], 'A')} ({k + 1})" for k in known)
    line = Text.assemble((f"{'strings':{LABEL}}", "dim"), "bias ", told)
    line.truncate(INNER, overflow="ellipsis")
    return [line]


def _troubles(watch: Watch, silent_s: float | None) -> Text:
    words = [] if silent_s is not None else ["no SoC frames yet: is the daemon running, on this bus?"]
    if silent_s is not None and silent_s >= 5.0:
        words.append(f"no new SoC for {silent_s:.0f} s")
    words += _fault_words(watch.faults)
    if watch.stored > Stored.USED:
        words.append(f"the stored state was refused: {watch.stored.word}")
    counts = {what: watch.values.get(name, 0.0) for name, what in COUNTS.items()}
    if any(counts.values()):
        words.append("since the start " + ", ".join(f"{n:.0f} {what}" for what, n in counts.items() if n))
    told = Text("; ".join(words) or "no faults", "yellow" if words else "green")
    told.truncate(2 * INNER, overflow="ellipsis")
    return told


def _messages(tracks: Iterable[Track], now_ns: int, rows: int) -> Table:
    """Rate and protection of messages, two in a line: in trouble first, then the vehicle's, then the others'."""
    table = Table.grid(padding=(0, 1))
    for width in (16, 7, 12, 16, 7, 12):
        table.add_column(width=width, no_wrap=True, justify="right" if width == 7 else "left")
    found = [track for track in tracks if track.name not in OPTIONAL or track.state is not Protection.NONE]
    states = {track.name: track.seen(now_ns) for track in found}
    found.sort(key=lambda track: (states[track.name] is Protection.OK, track.name in PUBLISHED + OPTIONAL))
    places = 2 * rows if len(found) <= 2 * rows else 2 * rows - 1
    shown: list[list[Text]] = []
    for track in found[:places]:
        state = states[track.name]
        style = STATES.get(state, "red")
        shown.append(
            [Text(track.name, "dim"), Text(f"{track.rate_hz(now_ns):.0f} Hz", style), Text(state.value, style)]
        )
    if hidden := found[places:]:
        well = all(states[track.name] is Protection.OK for track in hidden)
        shown.append([Text(f"{len(hidden)} more", "dim"), Text(""), Text("ok" if well else "", "green")])
    for k in range(0, len(shown), 2):
        table.add_row(*(cell for row in shown[k : k + 2] for cell in row))
    return table


def _fault_words(faults: Fault) -> list[str]:
    return [words for fault, words in FAULTS.items() if fault & faults]


def _number(value: float, unit: str, digits: int = 2) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f} {unit}".strip()
