"""A file of two slots is whole after a kill at any instant, and what is damaged in it is not read."""

from __future__ import annotations

import importlib.util
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bms_ukf import slots
from bms_ukf.slots import Slot

KILLS = int(os.environ.get("BMS_UKF_KILLS", "40"))
OLD, NEW = Slot(5, b"old" * 100), Slot(9, b"new" * 120)

# A writer of ever larger numbers, each named on stdout once it is said to be stored.
WRITER = """
import importlib.util, itertools, os, sys
spec = importlib.util.spec_from_file_location("slots", sys.argv[1])
slots = importlib.util.module_from_spec(spec)
spec.loader.exec_module(slots)
path = slots.Path(sys.argv[2])
before = slots.read(path)[0] if path.exists() else None
for k in itertools.count(before.wall_ns + 1 if before else 0):
    slot = slots.Slot(k, str(k).encode() * 1000)
    slots.write(path, slot, before)
    before = slot
    os.write(1, b"%d\\n" % k)
"""


def test_a_kill_at_any_instant_loses_no_more_than_what_was_being_written(tmp_path):
    """BMS_UKF_KILLS says how many (40 unless set)."""
    path, dice, last = tmp_path / "state", random.Random(3), -1
    source = importlib.util.find_spec("bms_ukf.slots").origin
    for _ in range(KILLS):
        writer = subprocess.Popen([sys.executable, "-S", "-c", WRITER, source, str(path)], stdout=subprocess.PIPE)
        first = writer.stdout.readline()
        assert int(first) == last + 1, "it goes on from what is there"
        writer.send_signal(signal.SIGSTOP) if dice.random() < 0.1 else None
        try:
            writer.wait(dice.random() * 0.02)
        except subprocess.TimeoutExpired:
            writer.kill()
        said = [int(line) for line in (first + writer.communicate()[0]).split(b"\n") if line.strip()]
        newest, *older = slots.read(path)
        assert newest.wall_ns in {said[-1], said[-1] + 1}
        assert newest.content == str(newest.wall_ns).encode() * 1000
        assert [slot.wall_ns for slot in older] == ([newest.wall_ns - 1] if newest.wall_ns else [])
        last = newest.wall_ns
    assert last > KILLS


def test_what_was_written_is_read_newest_first(tmp_path):
    slots.write(tmp_path / "s", OLD)
    assert slots.read(tmp_path / "s") == [OLD]
    slots.write(tmp_path / "s", NEW, OLD)
    assert slots.read(tmp_path / "s") == [NEW, OLD]


def test_any_damage_to_the_newest_slot_leaves_the_one_before(tmp_path):
    path = tmp_path / "s"
    slots.write(path, NEW, OLD)
    data = path.read_bytes()
    length = len(data) - len(OLD.content) - 24
    dice = random.Random(5)
    for place in [*range(40), *dice.sample(range(40, length), 60)]:
        path.write_bytes(data[:place] + bytes([data[place] ^ (1 << dice.randrange(8))]) + data[place + 1 :])
        assert slots.read(path) == [OLD]


def test_no_part_of_a_file_is_taken_for_a_whole_one(tmp_path):
    path = tmp_path / "s"
    slots.write(path, NEW)
    data = path.read_bytes()
    for length in range(len(data)):
        path.write_bytes(data[:length])
        assert slots.read(path) == []


@pytest.mark.parametrize("content", [b"", b"\0" * 4096, b"BMSSLOT1" * 64, b"[bus]\n" * 50])
def test_what_is_no_such_file_has_no_slots(tmp_path, content):
    (tmp_path / "s").write_bytes(content)
    assert slots.read(tmp_path / "s") == []


def test_a_write_that_fails_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "s"
    slots.write(path, OLD)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(slots.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        slots.write(path, NEW, OLD)
    assert slots.read(path) == [OLD]


def test_a_reader_never_sees_a_file_that_is_missing(tmp_path):
    path = Path(tmp_path / "s")
    for k in range(50):
        slots.write(path, Slot(k, b"x"))
        assert path.exists()
    assert [p.name for p in tmp_path.iterdir()] == ["s"]
