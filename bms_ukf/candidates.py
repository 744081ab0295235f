"""Which signals of a vehicle's DBC look like which role: by unit, by name, and by what their raw values can say."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from cantools.database.can import Message, Signal

from bms_ukf.dbc import Field
from bms_ukf.units import Quantity, conversion

# What the names of a traction battery's own signals contain, and those of everything else with the same unit.
_BATTERY = re.compile(r"bat|pack|(?:^|[^a-z])hv(?![a-z]*ac)|bms|accu|(?:^|_)lb_|traction|cell|brick")
_NAMED: dict[Quantity, re.Pattern[str]] = {
    "current": re.compile(r"cur|amp|(?:^|_)i_|ibat"),
    "voltage": re.compile(r"vol|(?:^|_)[uv]_|ubat|vbat|[uv]pack"),
    "temperature": re.compile(r"temp|(?:^|_)t_|tbat|warm"),
}
_OTHER = re.compile(
    r"limit|target|req|avail|motor|12v|(?:^|_)lv|coil|debug|dbg|aux|phase[0-9]|hvac|ptc|dcdc|reg_|reg[A-Z]|fan|pump|thresh|inv"
    r"|igbt|link|plug|inlet|ambient|cabin|coolant|oil|duct|front|rear|steer|brake|seat|obc|charger|hist|deviat|offset"
    r"|fc[A-Z]|_fc|mux|hvil|cable|shunt|dissip|flow|start|reserve|vcfront|vcright|vcleft|pcs"
)
_EXTREME = re.compile(r"max|min|high|low")
_NUMBER = re.compile(r"\d+")
_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")
_CELLS = 4  # so many numbered voltages of one message are cells, and not the supplies of something
_WORDS_OPEN, _WORDS_CLOSED = re.compile(r"open|off", re.IGNORECASE), re.compile(r"clos|(?:^|_)on(?:$|_)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A signal that may play a role; the higher the score, the likelier."""

    message: Message
    signal: Signal
    score: int

    @property
    def name(self) -> str:
        return f"{self.message.name}.{self.signal.name}"


def ranked(messages: Iterable[Message], quantity: Quantity) -> list[Candidate]:
    """Signals with a unit of that quantity that look like the battery's, best first."""
    found = []
    for message in messages:
        for signal in message.signals:
            if conversion(quantity, signal.unit or "") is not None:
                score = _score(message, signal, quantity)
                if score > 0:
                    found.append(Candidate(message, signal, score))
    return sorted(found, key=lambda candidate: -candidate.score)


def cells(messages: Iterable[Message]) -> list[list[str]]:
    """Rows of numbered voltages such as cells have, each in the order of its numbers, the longest first."""
    rows: dict[tuple[str, str, str], dict[int, str]] = defaultdict(dict)
    for message in messages:
        for signal in message.signals:
            match = _NUMBERED.fullmatch(signal.name)
            if match and conversion("voltage", signal.unit or "") is not None and _like_a_cell(message, signal):
                stem, number, tail = match.groups()
                rows[message.name if not stem else "", stem, tail][int(number)] = f"{message.name}.{signal.name}"
    complete = [row for row in rows.values() if len(row) >= _CELLS and max(row) - min(row) == len(row) - 1]
    return sorted(([row[n] for n in sorted(row)] for row in complete), key=lambda row: -len(row))


def alike(found: Sequence[Candidate]) -> list[str]:
    """The names of those that differ from the best in their numbers only, in the order of these, itself included."""
    if not found:
        return []
    stem = _NUMBER.sub("#", found[0].name)
    numbered = {tuple(map(int, _NUMBER.findall(c.name))): c.name for c in found if _NUMBER.sub("#", c.name) == stem}
    return [numbered[numbers] for numbers in sorted(numbered)]


def contactors(messages: Iterable[Message]) -> list[tuple[str, list[str]]]:
    """Signals of the main contactors, each with the names of the values that say open."""
    found = []
    for message in messages:
        for signal in message.signals:
            words = [str(word) for word in (signal.choices or {}).values()]
            named = re.search(r"contactor|relay", signal.name, re.IGNORECASE) and not _others(signal.name)
            is_open = [word for word in words if _WORDS_OPEN.search(word) and not re.search("OPENING", word.upper())]
            if named and is_open and any(_WORDS_CLOSED.search(word) for word in words):
                found.append((f"{message.name}.{signal.name}", is_open))
    return found


def protective(message: Message) -> tuple[list[Signal], list[Signal]]:
    """The signals of a message that look like its CRC, and those that look like its counter."""
    crc = [s for s in message.signals if re.search(r"crc|checksum|chksum", s.name, re.IGNORECASE)]
    count = [s for s in message.signals if re.search(r"counter|alive|prun|rolling", s.name, re.IGNORECASE)]
    return crc, [s for s in count if s not in crc]


def _score(message: Message, signal: Signal, quantity: Quantity) -> int:
    name, around = signal.name.lower(), message.name.lower()
    field = Field(message, signal)
    low, high = sorted(field.span())
    score = (
        3 * bool(_NAMED[quantity].search(name)) + 4 * bool(_BATTERY.search(name)) + 2 * bool(_BATTERY.search(around))
    )
    score -= 6 * _others(signal.name) + 3 * _others(message.name) + 2 * bool(_EXTREME.search(name))
    if quantity == "current":
        score += 4 if low < 0 < high else -6  # what is charged and discharged has two signs
        score -= 2 * (field.sign != 0 and signal.offset != 0)
    if quantity == "voltage":
        to_V = conversion(quantity, signal.unit or "")
        score += 2 if to_V is not None and high * to_V.factor > 60 else -3
        score += 2 * ("total" in name)
    if quantity == "temperature":
        score += 2 * bool(re.search("avg|mean", name))
    return score if _BATTERY.search(name) or _BATTERY.search(around) or _named_exactly(name, quantity) else 0


def _named_exactly(name: str, quantity: Quantity) -> bool:
    return name.strip("_0123456789") == quantity


def _others(name: str) -> int:
    """How much of a name speaks of something else."""
    return max(len(_OTHER.findall(name)), len(_OTHER.findall(name.lower())))


def _like_a_cell(message: Message, signal: Signal) -> bool:
    to_V = conversion("voltage", signal.unit or "")
    _, high = sorted(Field(message, signal).span())
    belongs = _BATTERY.search(signal.name.lower()) or _BATTERY.search(message.name.lower())
    return bool(to_V is not None and 3.0 <= high * to_V.factor <= 70.0 and belongs and not _others(signal.name))
