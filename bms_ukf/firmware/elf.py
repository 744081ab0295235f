"""What an ELF object file holds: the bytes of its sections, and the names it leaves to the linker.

System V ABI, chapter 4 (object files). Only what LLVM writes here: little endian, 32 or 64 bits.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

_SHF_ALLOC = 2
_SHT_SYMTAB, _SHT_NOBITS = 2, 8


class _Section(NamedTuple):
    name: str
    kind: int
    flags: int
    offset: int
    size: int
    link: int


def flash(data: bytes) -> dict[str, int]:
    """Bytes of every section that goes into the image, by its name, without those that are empty."""
    return {s.name: s.size for s in _sections(data) if s.flags & _SHF_ALLOC and s.kind != _SHT_NOBITS and s.size}


def undefined(data: bytes) -> list[str]:
    """Names that the object needs and does not have, sorted."""
    sections = list(_sections(data))
    return sorted(
        name
        for section in sections
        if section.kind == _SHT_SYMTAB
        for name, defined_in in _symbols(data, section, sections[section.link])
        if name and defined_in == 0
    )


def _sections(data: bytes) -> Iterator[_Section]:
    wide = data[4] == 2
    offset, size, count, names = (
        (*struct.unpack_from("<Q", data, 40), *struct.unpack_from("<3H", data, 58))
        if wide
        else (*struct.unpack_from("<I", data, 32), *struct.unpack_from("<3H", data, 46))
    )
    fields = struct.Struct("<IIQQQQI" if wide else "<7I")  # name, type, flags, address, offset, size, link
    headers = [fields.unpack_from(data, offset + size * k) for k in range(count)]
    strings = headers[names][4]
    for name, kind, flags, _, start, length, link in headers:
        yield _Section(_text(data, strings + name), kind, flags, start, length, link)


def _symbols(data: bytes, table: _Section, strings: _Section) -> Iterator[tuple[str, int]]:
    wide = data[4] == 2
    fields = struct.Struct("<IBBHQQ" if wide else "<IIIBBH")
    for values in fields.iter_unpack(data[table.offset : table.offset + table.size]):
        yield _text(data, strings.offset + values[0]), values[3] if wide else values[5]


def _text(data: bytes, at: int) -> str:
    return data[at : data.index(b"\0", at)].decode()
