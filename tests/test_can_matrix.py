"""can/bms.dbc against everything else that states the same facts: the records, the README, its own rules."""

from __future__ import annotations

import re
from pathlib import Path

import cantools
import pytest
from cantools.database.can import Message

from bms_ukf.dbc import protection
from bms_ukf.records import Fault, Status, Stored

CAN = Path(__file__).parents[1] / "can"
DATABASE = cantools.database.load_file(CAN / "bms.dbc", strict=True)
MESSAGES: list[Message] = DATABASE.messages
SIGNALS = {(message.name, signal.name): signal for message in MESSAGES for signal in message.signals}
COUNTED = {"Nis", "WorstCell", "MinCell", "MaxCell", "DischargeCell", "ChargeCell", "SilentCells", "FirstSilentCell"}
COUNTED |= {"CapacityCell", "CapacitySegments", "ResistanceCell", "HealthCell"}
MEASURED = {key: s for key, s in SIGNALS.items() if s.unit or key[1] in COUNTED}
NAMES = [message.name for message in MESSAGES]
FAULTS = [name for _, name in SIGNALS if name.startswith("Fault")]


def rows(first_heading: str) -> list[list[str]]:
    """The cells of the README's table whose first column has that heading."""
    lines = (CAN / "README.md").read_text().splitlines()
    start = next(n for n, line in enumerate(lines) if line.startswith(f"| {first_heading} |"))
    table = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        table.append([cell.strip() for cell in line.strip("|").split("|")])
    return table


def test_status_words_and_numbers_are_those_of_the_records() -> None:
    choices = SIGNALS["SocEstimate", "Status"].choices
    assert choices is not None
    assert {int(number): str(word) for number, word in choices.items()} == {s.value: s.word for s in Status}


def test_words_and_numbers_of_a_stored_state_are_those_of_the_records() -> None:
    choices = SIGNALS["BmsState", "StoredState"].choices
    assert choices is not None
    assert {int(number): str(word) for number, word in choices.items()} == {s.value: s.word for s in Stored}


def test_fault_bits_follow_each_other_as_in_the_records_before_and_after_the_stored_state() -> None:
    stored = SIGNALS["BmsState", "StoredState"]
    later = stored.start + stored.length
    places = [*range(12, stored.start), later, later + 1]
    for k, (fault, place) in enumerate(zip(Fault, places, strict=True)):
        name = "Fault" + "".join(part.capitalize() for part in str(fault.name).split("_"))
        signal = SIGNALS["BmsState", name]
        assert (signal.start, signal.length, fault.value) == (place, 1, 1 << k)
    assert sum(name.startswith("Fault") for _, name in SIGNALS) == len(Fault)


def test_every_message_is_protected_and_leaves_room_for_it() -> None:
    for message in MESSAGES:
        profile = protection(message)
        assert profile is not None, message
        crc, counter = message.get_signal_by_name("Crc"), message.get_signal_by_name("AliveCounter")
        assert (crc.start, crc.length, counter.start, counter.length) == (0, 8, 8, 4), message
        assert message.length == 8, message
        assert message.comment, message
        assert message.cycle_time, message


def test_a_frame_cannot_pass_for_one_of_another_message() -> None:
    profiles = [protection(message) for message in MESSAGES]
    assert len({profile.seed for profile in profiles if profile}) == len(MESSAGES)


def test_every_measured_signal_has_its_codes_outside_its_range() -> None:
    for key, signal in MEASURED.items():
        full = 2**signal.length - 1
        codes = {str(name): raw for raw, name in (signal.choices or {}).items()}
        assert codes == {"NotAvailable": full, "Error": full - 1}, key
        assert signal.byte_order == "little_endian", key
        assert not signal.is_signed, key
        ends = [round((limit - signal.offset) / signal.scale) for limit in (signal.minimum, signal.maximum)]
        assert 0 <= ends[0] < ends[1] < full - 1, key


@pytest.mark.parametrize(
    ("name", "prefix", "count"),
    [
        ("CellVoltages", "Cell", 402),
        ("CellTemperatures", "Sensor", 48),
        ("CellSoc", "Cell", 402),
        ("CellSigma", "Cell", 402),
        ("CellLow", "Cell", 402),
        ("CellHigh", "Cell", 402),
    ],
)
def test_pages_carry_three_values_each_in_order(name: str, prefix: str, count: int) -> None:
    for k in range(count):
        signal = SIGNALS[name, f"{prefix}{k + 1}"]
        assert (signal.multiplexer_ids, signal.start, signal.length) == ([k // 3], 22 + 14 * (k % 3), 14)


@pytest.mark.parametrize("name", ["StringCurrents", "StringBias"])
def test_pages_of_strings_carry_two_in_order_as_finely_as_the_current_of_the_pack(name: str) -> None:
    for k in range(48):
        signal = SIGNALS[name, f"String{k + 1}"]
        assert (signal.multiplexer_ids, signal.start, signal.length) == ([k // 2], 22 + 21 * (k % 2), 21)
        assert signal.scale == SIGNALS["PackMeasurement", "PackCurrent"].scale


def test_the_readme_lists_every_message_as_it_is() -> None:
    listed = rows("id")
    assert [row[1] for row in listed] == NAMES
    for message, (identifier, _, sender, period, data_id, timeout) in zip(MESSAGES, listed, strict=True):
        profile = protection(message)
        assert profile is not None
        assert int(identifier, 16) == message.frame_id
        assert sender == message.senders[0]
        assert period == f"{message.cycle_time} ms"
        assert int(data_id, 16) == profile.data_id
        assert timeout == f"{profile.timeout_ns // 1_000_000} ms"


def test_the_readme_lists_every_signal_as_it_is() -> None:
    left = dict(SIGNALS)
    for message, names, place, worth, offset, limits, unit in rows("message"):
        numbers = [int(n) for n in re.findall(r"\d+", place)]
        for (owner, name), signal in SIGNALS.items():
            if message in {"all", owner} and belongs(name, names):
                del left[owner, name]
                low, high = (float(limit) for limit in limits.split(" to "))
                assert (signal.scale, signal.offset, signal.minimum, signal.maximum) == (
                    float(worth),
                    float(offset),
                    low,
                    high,
                )
                assert (signal.unit or "") == unit
                if "to" in place:  # a run of single bits
                    assert numbers[0] <= signal.start <= numbers[1]
                else:
                    assert signal.start in numbers[:-1]
                    assert signal.length == numbers[-1]
    assert not left


def belongs(name: str, listed: str) -> bool:
    """Whether `listed`, "Cell1 to Cell402" or a single name, covers `name`."""
    first, _, last = listed.partition(" to ")
    if not last:
        return name == first
    if first.startswith("Fault"):
        return name in FAULTS[FAULTS.index(first) : FAULTS.index(last) + 1]
    prefix = first.rstrip("0123456789")
    return bool(re.fullmatch(rf"{prefix}\d+", name)) and int(name[len(prefix) :]) <= int(last[len(prefix) :])


def test_400_cells_fit_on_a_500_kbit_bus() -> None:
    """At most 135 bits a frame of 8 bytes with an 11-bit identifier, stuffing and the pause between frames included."""
    pages = -(-400 // 3)
    frames_per_s = pages * 10 + 100 + 16 + 10 * 4
    assert pages <= 134
    assert frames_per_s * 135 < 0.5 * 500_000


def test_what_is_published_of_400_cells_is_a_small_share_of_a_500_kbit_bus() -> None:
    """The README has the number."""
    a_second = {m.name: 1000 / (m.cycle_time or 0) for m in MESSAGES if m.senders == ["Bms"]}
    del a_second["StringBias"]  # of several strings only
    pages = {name: a_second.pop(name) * -(-400 // 3) for name in ("CellSoc", "CellSigma", "CellLow", "CellHigh")}
    pages["CellHealth"] = a_second.pop("CellHealth") * 400  # a frame a cell
    frames_per_s = sum(a_second.values()) + sum(pages.values())
    share = frames_per_s * 135 / 500_000
    assert share < 0.04
    text = " ".join((CAN / "README.md").read_text().split())
    assert f"{frames_per_s:.0f} frames a second, {100 * share:.1f} %" in text
