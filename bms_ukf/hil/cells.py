"""What another node on the bus knows of the cells of a pack, one by one."""

from __future__ import annotations

import numpy as np

from bms_ukf.dbc import Field, own_matrix
from bms_ukf.expectations.record import CellsTold
from bms_ukf.frames import Inbox
from bms_ukf.records import NAN

PER_PAGE = 3


class CellDecoder(Inbox[None]):
    """Reads the pages of CellSoc, and of BmsState and SocDetail which cell is lowest and at which SoC."""

    def __init__(self, cells: int) -> None:
        matrix = own_matrix()

        def field_of(name: str) -> Field:
            return Field(*matrix.find(name))

        self._cells = cells
        self._page = field_of("CellSoc.Page").raw()
        self._soc = [field_of(f"CellSoc.Cell{k + 1}").extract(0.01) for k in range(cells)]
        self._lowest_soc = field_of("BmsState.SocMin").extract(0.01)
        self._lowest_cell = field_of("SocDetail.MinCell").extract()
        self._told = self._nothing()
        super().__init__(
            {
                matrix.message("CellSoc"): self._read_page,
                matrix.message("BmsState"): self._read_state,
                matrix.message("SocDetail"): self._read_detail,
            }
        )

    def take(self) -> CellsTold:
        """What was told since the last call."""
        told, self._told = self._told, self._nothing()
        return told

    def _nothing(self) -> CellsTold:
        return CellsTold(np.full(self._cells, NAN))

    def _read_page(self, data: bytes, _: int) -> None:
        first = PER_PAGE * self._page(data)
        for k in range(first, min(first + PER_PAGE, self._cells)):
            self._told.soc[k] = self._soc[k](data)

    def _read_state(self, data: bytes, _: int) -> None:
        self._told.lowest_soc = self._lowest_soc(data)

    def _read_detail(self, data: bytes, _: int) -> None:
        self._told.lowest_cell = self._lowest_cell(data)
