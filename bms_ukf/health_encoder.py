"""How the cells have aged, to frames of the project's own DBC."""

from __future__ import annotations

from dataclasses import dataclass

from bms_ukf.frames import Frame
from bms_ukf.pack import Health
from bms_ukf.pack_encoder import SELDOM_NS, Told
from bms_ukf.records import NAN

ROUND_NS = 60_000_000_000  # in which every cell of a pack is told once, if sets come so fast

TOGETHER = {
    "CapacityHealth": {
        "CapacityMin": ("capacity_min", 0.01),
        "CapacityMean": ("capacity_mean", 0.01),
        "CapacitySigma": ("capacity_sigma", 0.01),
        "CapacityCell": ("capacity_cell", 1.0),
        "CapacitySegments": ("segments", 1.0),
    },
    "ResistanceHealth": {
        "ResistanceMax": ("resistance_max", 0.01),
        "ResistanceMean": ("resistance_mean", 0.01),
        "ResistanceSigma": ("resistance_sigma", 0.01),
        "ResistanceCell": ("resistance_cell", 1.0),
    },
}
EACH = {
    "HealthCell": ("cell", 1.0),
    "CellCapacity": ("capacity", 0.01),
    "CellCapacitySigma": ("capacity_sigma", 0.01),
    "CellResistance": ("resistance", 0.01),
    "CellResistanceSigma": ("resistance_sigma", 0.01),
}


@dataclass(slots=True)
class _Cell:
    cell: int
    capacity: float
    capacity_sigma: float
    resistance: float
    resistance_sigma: float


class HealthEncoder:
    """Turns a `Health` into frames; the alive counters are as those of `encoder.Encoder`.

    CapacityHealth and ResistanceHealth go once a second. Of several cells CellHealth tells one after the other, at most
    one with a set.
    """

    def __init__(self, health: Health) -> None:
        self._health, self._cells = health, health.estimator.cells
        self._together = [Told(name, signals) for name, signals in TOGETHER.items()]
        self._each = Told("CellHealth", EACH)
        self._seldom_ns = self._cell_ns = None  # type: int | None
        self._cell = 0

    def encode(self, t_ns: int, accepted: int) -> list[Frame]:
        """What is due with a set that is sent at `t_ns`."""
        frames: list[Frame] = []
        if self._seldom_ns is None or t_ns - self._seldom_ns >= SELDOM_NS:
            self._seldom_ns, ageing = t_ns, self._health.ageing()
            frames += [message.frame(ageing, accepted) for message in self._together]
        if self._cells > 1 and (self._cell_ns is None or t_ns - self._cell_ns >= ROUND_NS // self._cells):
            self._cell_ns = t_ns
            frames.append(self._each.frame(self._of(self._cell), accepted))
            self._cell = (self._cell + 1) % self._cells
        return frames

    def _of(self, cell: int) -> _Cell:
        health = self._health
        capacity, resistance = float(health.told_capacity[cell]), float(health.told_resistance[cell])
        sigmas = float(health.capacity_sigma[cell]), float(health.resistance_sigma[cell])
        return _Cell(
            cell,
            capacity,
            sigmas[0] if capacity == capacity else NAN,  # noqa: PLR0124 - not NaN
            resistance,
            sigmas[1] if resistance == resistance else NAN,  # noqa: PLR0124
        )
