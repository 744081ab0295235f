"""What another node on the bus makes of the daemon's frames."""

from __future__ import annotations

from collections.abc import Iterable

from bms_ukf.dbc import Field, own_matrix
from bms_ukf.frames import Frame
from bms_ukf.hil.cells import CellDecoder
from bms_ukf.node import EstimateDecoder
from bms_ukf.records import Estimate, Stored


class Receiver:
    """Checks CRC and alive counter as every receiver should. `stored` is what BmsState last said of the state file.

    `cells` has what is told of each of several cells.
    """

    def __init__(self, cells: int = 1) -> None:
        matrix = own_matrix()
        self._decoder = EstimateDecoder()
        self.cells = CellDecoder(cells) if cells > 1 else None
        self._state_id = matrix.message("BmsState").frame_id
        self._stored = Field(*matrix.find("BmsState.StoredState")).raw()
        self.stored = Stored.NONE
        self.frames = 0

    def read(self, frames: Iterable[Frame], t_ns: int) -> Estimate | None:
        """The last estimate among frames received at `t_ns`; None if there is none that is valid."""
        last = None
        for identifier, extended, data in frames:
            self.frames += 1
            if identifier == self._state_id:
                self.stored = Stored(self._stored(data))
            if self.cells is not None:
                self.cells.decode(identifier, extended, data, t_ns)
            last = self._decoder.decode(identifier, extended, data, t_ns) or last
        return last
