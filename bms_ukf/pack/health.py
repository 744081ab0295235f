"""State of health: what each cell's capacity and resistance have become, told from how it is used.

Capacity is charge over change of SoC, between two moments at which SoC is well observed: rests so long that the voltage
is the OCV. For a segment with the charge y = integral of i dt, A h, and the change of SoC x,

    y = q Q x + e,    var e = (sigma_b t)^2 + (q Q)^2 (sigma_1^2 + sigma_2^2)

q being the cell's capacity as a multiple of the cell file's Q. Both charge and change of SoC are in error (total least
squares); |x| >= LEAST makes what that costs a least-squares estimate of q no more than (sigma / x)^2 of it, 10^-3, so q
follows by one recursive update a segment. What keeps it honest:

- sigma_1, sigma_2 are those of SoC and of what the OCV table itself may err by, over the OCV's slope: on a plateau that
  is nearly all there is, and a segment that ends on one tells next to nothing.
- The offset of the current sensor is what it showed at the rests, known to what a cell may give at rest; not the bias
  that the filter tracks under load, which takes up what a capacity that is wrong does to SoC.
- A segment with a gap in its current is none.
- The sensor's gain cannot be told from capacity. Its sigma is in `capacity_sigma`, and is not averaged away.

A dual filter, which has q follow the innovations by the sensitivity of SoC to it, was measured on five simulated
days and not taken: beside a filter that corrects SoC and tracks the offset it finds 0.97 of a cell that has 0.90, and
claims to know it to 0.002; what the innovations could tell of q, the other two states have already taken up. Segments
between rests found 0.899.

q is written back to the estimator, so SoC is that of the capacity the cell has now: charge above empty over its own
capacity. Resistance is r0 as the filter tracks it, averaged over the time in which steps of the current tell it.
"""

from __future__ import annotations

import hashlib
import math
import struct

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bms_ukf import beliefs
from bms_ukf.cell import CellParams
from bms_ukf.estimator import Estimator
from bms_ukf.kernel import layout
from bms_ukf.kernel.params import R0_AGED_SIGMA, voltage_sigmas
from bms_ukf.pack.counted import Counted
from bms_ukf.pack.record import Ageing
from bms_ukf.records import Estimate, Sample, Status

Array = NDArray[np.float64]

LEAST = 0.2  # change of SoC that tells of capacity
OLD = 0.05  # a segment in whose time so much of the capacity may have flowed unseen begins anew
GATE = 4.0  # sigmas: a segment farther off is no segment of this cell
FRESH_SIGMA = 0.1  # of the capacity of a cell that nothing is known of
WALK_PER_DAY = 2e-4  # how far a capacity moves, one sigma
RESISTANCE_TAU_S = 36000.0  # of driving, over which r0 is averaged
SLOPE_SPAN = 0.02  # of SoC, over which the OCV's slope is taken
DAY_S = 86400.0
_BEGUN = ("soc", "soc_var", "charge_As", "shown_A", "passed_s", "counted_s")  # of a segment
_MAGIC = b"BMSHLTH2"
_HEAD = struct.Struct("<8sqq32s32s")  # cells, strings, SHA-256 of the cell file and of the numbers


class Health:
    """Follows every step of an estimator: `follow` after each `Estimator.step`.

    `capacity` and `resistance` are multiples of the cell file's, shape (cells,), `capacity_sigma` and
    `resistance_sigma` one standard deviation of them; before anything has told of them, what is assumed of a fresh
    cell. `segments` counts what has told of each cell's capacity, `told_s` the time that has told of its resistance.
    """

    def __init__(self, estimator: Estimator) -> None:
        """The capacities are those that the estimator has now."""
        self.estimator = estimator
        cells = estimator.cells
        self._gain_sigma = estimator.tuning.sensor_spec.current_gain_sigma
        self._model_V = math.hypot(*voltage_sigmas(estimator.cell))
        self._cell_hash = hashlib.sha256(estimator.cell.model_dump_json().encode()).digest()
        self.capacity = estimator.capacity_scale
        self._variance = np.full(cells, FRESH_SIGMA**2)
        self.segments = np.zeros(cells, dtype=np.int64)
        self.resistance = np.ones(cells)
        self.resistance_sigma = np.full(cells, R0_AGED_SIGMA)
        self.told_s = np.zeros(cells)
        self._counted = Counted(estimator)
        self._walked_s = 0.0  # of the time counted, until when the variance has grown
        self._observed = False  # the present rest
        self._from = np.full((len(_BEGUN), cells), math.nan)  # the rest that a cell's segment began at; NaN: none

    @property
    def told_capacity(self) -> Array:
        """(cells,) NaN where nothing has told of it."""
        return np.where(self.segments > 0, self.capacity, math.nan)

    @property
    def told_resistance(self) -> Array:
        """(cells,) NaN where nothing has told of it."""
        return np.where(self.told_s > 0, self.resistance, math.nan)

    @property
    def capacity_sigma(self) -> Array:
        """(cells,) with what the sensor's gain may make of it; equal for all cells of a sensor."""
        sigma: Array = np.hypot(np.sqrt(self._variance), self._gain_sigma * self.capacity * (self.segments > 0))
        return sigma

    def ageing(self) -> Ageing:
        """What has been told, in a few numbers."""
        told = Ageing()
        capacity, resistance = self.told_capacity, self.told_resistance
        if (known := np.isfinite(capacity)).any():
            cell = told.capacity_cell = int(np.nanargmin(capacity))
            told.capacity_min, told.capacity_mean = float(capacity[cell]), float(capacity[known].mean())
            told.capacity_sigma, told.segments = float(self.capacity_sigma[cell]), int(self.segments[cell])
        if (known := np.isfinite(resistance)).any():
            cell = told.resistance_cell = int(np.nanargmax(resistance))
            told.resistance_max, told.resistance_mean = float(resistance[cell]), float(resistance[known].mean())
            told.resistance_sigma = float(self.resistance_sigma[cell])
        return told

    def follow(self, sample: Sample, estimate: Estimate) -> None:
        """Take note of a step: `estimate` is what `sample` gave."""
        if self._counted.count(sample):
            self._look(estimate)

    def replay(
        self, t_ns: ArrayLike, current_A: ArrayLike, voltage_V: ArrayLike, temperature_degC: ArrayLike
    ) -> dict[str, NDArray[np.generic]]:
        """`Estimator.replay`, followed: adds `soh`, the capacity of every row, NaN before anything has told of it."""
        inputs = [np.asarray(values) for values in (t_ns, current_A, voltage_V, temperature_degC)]
        parts, begin, end, rows = [], 0, 0, len(inputs[0])
        while end < rows:
            more, due = self._counted.count_rows(*(values[end:] for values in inputs[:2]))
            end += more
            if due or end == rows:
                part = self.estimator.replay(*(values[begin:end] for values in inputs))
                parts.append(part | {"soh": np.full(end - begin, self.told_capacity[0])})
                begin = end
            if due:
                soc, sigma, age_s = (float(part[name][-1]) for name in ("soc", "soc_sigma", "age_s"))
                status = Status(int(part["status"][-1]))
                self._look(Estimate(soc=soc, soc_sigma=sigma, age_s=age_s, status=status))
        if not parts:
            return self.estimator.replay(*inputs) | {"soh": np.empty(0)}
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def slept(self, off_s: float, t_ns: int) -> None:
        """`off_s` s have passed at rest, as `Estimator.sleep` lets them; the time is `t_ns` now."""
        self._counted.slept(off_s, t_ns)
        self._observed = False

    def adopt(self) -> None:
        """Take the capacities that the estimator has for what is known of them, as of cells seen for the first time."""
        self.capacity = self.estimator.capacity_scale

    def lose(self) -> None:
        """What has flowed of late is not known: segments begin anew."""
        self._counted.whole = False

    def _look(self, estimate: Estimate) -> None:
        load_s = self._counted.looked()
        if load_s:
            self._learn_resistance(load_s)
        if not self._counted.whole:
            self._from[:] = math.nan
            self._counted.whole = True
        if not self._counted.rested:
            self._observed = False
        elif not self._observed and estimate.status in {Status.OK, Status.DEGRADED}:
            self._observed = self._observe(estimate)

    def _learn_resistance(self, load_s: float) -> None:
        """Average r0 over the time under load."""
        e = self.estimator
        scale, variance = beliefs.r0_scale(e._form, e._state, e.cells)
        used = e.resistance_scale * scale
        told = np.isfinite(used) & (variance < (0.75 * R0_AGED_SIGMA) ** 2)  # else the time is long since a step
        self.told_s += np.where(told, load_s, 0.0)
        share = np.where(told, load_s / np.clip(self.told_s, load_s, RESISTANCE_TAU_S), 0.0)
        self.resistance += share * np.nan_to_num(used - self.resistance)
        self.resistance_sigma += share * np.nan_to_num(np.sqrt(variance) - self.resistance_sigma)

    def _observe(self, estimate: Estimate) -> bool:
        """A rest is long enough: what lies between it and the one before tells of capacity. False without a voltage."""
        counted = self._counted
        soc = np.array(np.atleast_1d(estimate.soc), dtype=float)
        fresh = np.atleast_1d(estimate.age_s) <= self.estimator.tuning.voltage_timeout_s
        variance = np.atleast_1d(estimate.soc_sigma) ** 2 + (self._model_V / _slope(self.estimator.cell, soc)) ** 2
        heard = fresh & np.isfinite(soc + variance)
        now = np.empty_like(self._from)
        shown_A = counted.of_cells(counted.shown_A)
        values = soc, variance, counted.charge_As(), shown_A, counted.passed_s, counted.counted_s
        for row, value in zip(now, values, strict=True):
            row[:] = value
        ends = heard & self._learn_capacity(now, heard)
        self._from[:, ends] = now[:, ends]
        return bool(heard.any())

    def _learn_capacity(self, now: Array, heard: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Returns the cells whose segment ends here; that of the others goes on to a later rest."""
        e = self.estimator
        capacity_Ah = e.cell.cell.capacity_Ah
        self._variance += WALK_PER_DAY**2 * (self._counted.passed_s - self._walked_s) / DAY_S
        self._walked_s = self._counted.passed_s
        begun, ended = (dict(zip(_BEGUN, rows, strict=True)) for rows in (self._from, now))
        charge_Ah, hours, counted_h = ((ended[n] - begun[n]) / 3600 for n in ("charge_As", "passed_s", "counted_s"))
        most_A = 2.5 * float(e._params[layout.P_BIAS_SIGMA])
        offset_A = np.clip((begun["shown_A"] + ended["shown_A"]) / 2, -most_A, most_A)
        h = capacity_Ah * (begun["soc"] - ended["soc"])
        unseen_Ah = float(e._params[layout.P_PARASITIC]) * hours
        noise = unseen_Ah**2 + (self.capacity * capacity_Ah) ** 2 * (begun["soc_var"] + ended["soc_var"])
        innovation = charge_Ah - offset_A * counted_h - self.capacity * h
        spread = self._variance * h * h + noise
        known = heard & np.isfinite(spread)
        long = np.abs(h) >= LEAST * capacity_Ah
        tells = known & long & (innovation**2 <= GATE**2 * spread)
        gain = np.where(tells, self._variance * h / spread, 0.0)
        self.capacity = self.capacity + np.where(tells, gain * innovation, 0.0)
        self._variance -= np.where(tells, gain * h * self._variance, 0.0)
        self.segments += tells
        if tells.any():
            e.capacity_scale = self.capacity
        ends: NDArray[np.bool_] = ~known | long | (unseen_Ah > OLD * capacity_Ah)
        return ends

    def snapshot(self) -> bytes:
        """All that is known, for `restore` by as many cells of the same cell file."""
        numbers = np.concatenate([np.ravel(part) for part in self._parts()], dtype=np.float64).tobytes()
        strings = self.estimator.wiring.strings
        head = (_MAGIC, self.estimator.cells, strings, self._cell_hash, hashlib.sha256(numbers).digest())
        return _HEAD.pack(*head) + numbers

    def restore(self, snapshot: bytes) -> None:
        """Go back to a `snapshot`, the estimator with its capacities. ValueError, changing nothing, if it is none."""
        cells, strings = self.estimator.cells, self.estimator.wiring.strings
        if len(snapshot) < _HEAD.size or snapshot[: len(_MAGIC)] != _MAGIC:
            raise ValueError("not the health of cells by this version")
        head, numbers = _HEAD.unpack_from(snapshot), snapshot[_HEAD.size :]
        if head[1:3] != (cells, strings) or head[3] != self._cell_hash:
            raise ValueError(f"the health of {head[1]} cells in {head[2]} strings, or of another cell file")
        if head[4] != hashlib.sha256(numbers).digest():
            raise ValueError("a damaged health")
        ends = np.cumsum([np.size(part) for part in self._parts()])[:-1]
        learnt, begun, segments, walked_s, *counted = np.split(np.frombuffer(numbers).copy(), ends)
        self.capacity, self._variance, self.resistance, self.resistance_sigma, self.told_s = learnt.reshape(5, cells)
        self._from, self.segments = begun.reshape(self._from.shape), segments.astype(np.int64)
        self._walked_s = float(walked_s[0])
        self._counted.restore(*counted)
        self._observed = False
        self.estimator.capacity_scale = self.capacity

    def _parts(self) -> list[ArrayLike]:
        learnt = np.stack([self.capacity, self._variance, self.resistance, self.resistance_sigma, self.told_s])
        return [learnt, self._from, self.segments, self._walked_s, *self._counted.parts()]


def _slope(cell: CellParams, soc: Array) -> Array:
    """Of the OCV at 25 degC, V per unit of SoC, never 0."""
    ends = (np.asarray(cell.ocv_V(np.clip(soc + side, 0, 1), 25.0), float) for side in (-SLOPE_SPAN, SLOPE_SPAN))
    low, high = ends
    slope: Array = np.maximum(np.abs(high - low) / (2 * SLOPE_SPAN), 1e-3)
    return slope
