"""A small file that is whole at any instant: two slots, the newest content and the one before it.

A write makes a new file beside the old, brings it to the medium and renames it over the old one. A process or a machine
that dies leaves one or the other; the second slot is for a medium that gives back what it was never told. Each slot:

    magic, 8 bytes · content's length, uint32 · wall time of writing in ns, int64 · CRC-32 of all else, uint32 · content

little-endian.
"""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path
from typing import NamedTuple

_HEADER = struct.Struct("<8sIqI")
_MAGIC = b"BMSSLOT1"
_LARGEST = 1 << 26  # bytes that are read: a file that is larger is none of ours


class Slot(NamedTuple):
    """What was stored, and when by the wall clock."""

    wall_ns: int
    content: bytes


def read(path: Path) -> list[Slot]:
    """The slots that are whole, newest first; none if the file is damaged from its start. OSError as of reading."""
    with path.open("rb") as file:
        data = file.read(_LARGEST)
    slots = []
    first = data.find(_MAGIC)
    while first >= 0:
        slot = _slot(data[first:])
        if slot is not None:
            slots.append(slot)
        first = data.find(_MAGIC, first + (len(_packed(slot)) if slot else 1))
    return slots


def write(path: Path, newest: Slot, before: Slot | None = None) -> None:
    """Replace the file by these two. OSError, and the file is as it was, if that fails."""
    beside = path.with_name(f"{path.name}.new")
    descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(_packed(newest) + (_packed(before) if before else b""))
        file.flush()
        os.fsync(file.fileno())
    os.replace(beside, path)
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(folder)  # the new name, too
    finally:
        os.close(folder)


def _packed(slot: Slot) -> bytes:
    bare = _HEADER.pack(_MAGIC, len(slot.content), slot.wall_ns, 0)
    crc = zlib.crc32(slot.content, zlib.crc32(bare))
    return _HEADER.pack(_MAGIC, len(slot.content), slot.wall_ns, crc) + slot.content


def _slot(data: bytes) -> Slot | None:
    """The slot at the start of `data`, None if it is not whole."""
    if len(data) < _HEADER.size:
        return None
    _, length, wall_ns, _ = _HEADER.unpack_from(data)
    slot = Slot(wall_ns, data[_HEADER.size : _HEADER.size + length])
    return slot if data.startswith(_packed(slot)) and len(slot.content) == length else None
