"""A scan ends when every cell has been read; a cell that says nothing does not hold the others up."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from bms_ukf.scan import Scan


def page(*cells: int) -> NDArray[np.intp]:
    return np.array(cells, dtype=np.intp)


@pytest.mark.parametrize(
    ("pages", "ends"),
    [
        ([page(0, 1, 2), page(3, 4, 5)] * 2, [False, True, False, True]),
        ([page(3, 4, 5), page(0, 1, 2)] * 2, [False, True, False, True]),  # whichever page comes last
        ([page(0, 1, 2), page(3, 4)] * 3, [False, False, True, False, True, False]),  # the last cell is dead
        ([page(1, 2), page(3, 4, 5)] * 3, [False, False, True, False, True, False]),  # the first one is
        ([page(0, 1, 2), page(0, 1, 2), page(3, 4, 5)], [False, True, True]),  # a page was lost
        ([page(), page(0), page()], [False, False, False]),
    ],
)
def test_the_end_of_a_scan(pages: list[NDArray[np.intp]], ends: list[bool]) -> None:
    scan = Scan(6)
    assert [scan.ends_with(heard) for heard in pages] == ends


def test_every_voltage_of_a_single_cell_is_a_scan() -> None:
    scan = Scan(1)
    assert [scan.ends_with(v) for v in (3.7, math.nan, 3.7)] == [True, False, True]
