"""How the cells of a pack are wired: which temperature sensor and which string each belongs to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


class Wiring:
    """Indices, from 0, by cell. `None`: each cell has a temperature of its own, or shares the one that is given; all
    cells are in one string.

    With `sensor_of` a sample's `temperature_degC` has one number for each sensor, with `string_of` its
    `string_current_A` one for each string; NaN: not measured. A sensor or string that no cell belongs to is allowed.
    """

    __slots__ = ("sensor_of", "string_of")

    def __init__(self, sensor_of: Sequence[int] | None = None, string_of: Sequence[int] | None = None) -> None:
        """ValueError for an index below 0."""
        self.sensor_of = _indices(sensor_of, "sensor_of")
        self.string_of = _indices(string_of, "string_of")

    def check(self, cells: int) -> None:
        """ValueError unless every cell has its index."""
        for name in self.__slots__:
            indices = getattr(self, name)
            if indices is not None and len(indices) != cells:
                raise ValueError(f"{name} has {len(indices)} cells; expected {cells}")

    @property
    def strings(self) -> int:
        return 1 if self.string_of is None else int(self.string_of.max()) + 1

    def members(self) -> dict[int, NDArray[np.intp]]:
        """The cells of each string that has any, by its index; nothing without `string_of`."""
        of = self.string_of
        return {} if of is None else {int(string): np.flatnonzero(of == string) for string in np.unique(of)}


def _indices(given: Sequence[int] | None, name: str) -> NDArray[np.intp] | None:
    if given is None:
        return None
    indices = np.asarray(given, dtype=np.intp)
    if indices.ndim != 1 or not len(indices) or indices.min() < 0:
        raise ValueError(f"{name}: expected an index from 0 for each cell")
    return indices
