"""Values of an FMU's variables in the C arrays that its setters and getters want, one array for each type."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any

from bms_ukf.fmi.wire import Variable

# FMI type: C type, and what makes of a value one that the C type takes.
Types = dict[str, tuple[Any, Callable[[Any], Any]]]


class Block:
    """Variables of one type: their value references, and room for their values."""

    def __init__(self, types: Types, variables: Sequence[Variable]) -> None:
        self.type = variables[0]["type"]
        ctype, self._convert = types[self.type]
        self._is_double = ctype is ctypes.c_double
        self.references = (ctypes.c_uint * len(variables))(*(variable["reference"] for variable in variables))
        self.size = sum(variable["size"] for variable in variables)
        self.values = (ctype * self.size)()

    def fill(self, values: Sequence[Any]) -> None:
        self.values[:] = values if self._is_double else [*map(self._convert, values)]


def blocks(types: Types, variables: Sequence[Variable]) -> list[Block]:
    """The blocks of `variables`, which are sorted by type, in their order."""
    return [Block(types, [*group]) for _, group in groupby(variables, key=lambda variable: variable["type"])]


def fill(targets: Sequence[Block], values: Sequence[Any]) -> None:
    """Spreads a row of values over blocks."""
    start = 0
    for block in targets:
        block.fill(values[start : start + block.size])
        start += block.size


def row(sources: Sequence[Block]) -> list[float]:
    """The values of all blocks in one row."""
    return [float(value) for block in sources for value in block.values]
