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

import math
import struct

import numpy as np
from numpy.typing import NDArray

from bms_ukf import beliefs
from bms_ukf.estimator import Estimator
from bms_ukf.kernel import layout
from bms_ukf.kernel.adapt import R0_SIGMA
from bms_ukf.kernel.params import voltage_sigmas
from bms_ukf.kernel.process import R0_SHAPE
from bms_ukf.records import Estimate, Sample, Status

Array = NDArray[np.float64]

REST_S = 1800.0  # so long without a load, and what is left of polarisation is what the cell file says it errs by
REST_C = 0.04  # what is no load, offset included, as a share of the capacity per hour
LEAST = 0.2  # change of SoC that tells of capacity
OLD = 0.05  # a segment in whose time so much of the capacity may have flowed unseen begins anew
GATE = 4.0  # sigmas: a segment farther off is no segment of this cell
FRESH_SIGMA = 0.1  # of the capacity of a cell that nothing is known of
WALK_PER_DAY = 2e-4  # how far a capacity moves, one sigma
RESISTANCE_TAU_S = 36000.0  # of driving, over which r0 is averaged
SLOPE_SPAN = 0.02  # of SoC, over which the OCV's slope is taken
DAY_S = 86400.0
_MAGIC = b"BMSHLTH1"
_HEAD = struct.Struct("<8sq?ddd")


class Health:
    """Follows every step of an estimator: `follow` after each `Estimator.step`.

    `capacity` and `resistance` are multiples of the cell file's, shape (cells,), `capacity_sigma` and
    `resistance_sigma` one standard deviation of them. `segments` counts what has told of each cell's capacity.
    """

    def __init__(self, estimator: Estimator) -> None:
        self.estimator = estimator
        cells = estimator.cells
        self._gain_sigma = estimator.tuning.current_gain_sigma
        self.capacity = estimator.capacity_scale
        self._variance = np.full(cells, FRESH_SIGMA**2)
        self.resistance = np.ones(cells)
        self.resistance_sigma = np.full(cells, R0_SIGMA)
        self.segments = np.zeros(cells, dtype=np.int64)
        self._model_V = math.hypot(*voltage_sigmas(estimator.cell))
        self._charge_Ah = np.zeros(cells)  # since the rest that a segment begins at
        self._shown_A = np.zeros(cells)  # by the sensors, mean of the present rest
        self._soc = np.full(cells, math.nan)  # at that rest; NaN: none yet
        self._soc_var = np.zeros(cells)
        self._offset_A = np.zeros(cells)  # and what the sensors showed
        self._since_s = np.zeros(cells)
        self._rest_s = self._walked_s = self._driven_s = 0.0
        self._broken = True  # the charge since then is not known
        self._t_ns: int | None = None

    @property
    def capacity_sigma(self) -> Array:
        """(cells,) with what the sensor's gain may make of it; equal for all cells of a sensor."""
        sigma: Array = np.hypot(np.sqrt(self._variance), self._gain_sigma * self.capacity * (self.segments > 0))
        return sigma

    def follow(self, sample: Sample, estimate: Estimate) -> None:
        """Take note of a step: `estimate` is what `sample` gave."""
        last_ns, self._t_ns = self._t_ns, sample.t_ns
        dt = 0.0 if last_ns is None else (sample.t_ns - last_ns) * 1e-9
        if dt < 0:
            self._t_ns = last_ns
            return
        current = self._currents(sample)
        if current is None:
            return self._wait(dt)
        if dt > self.estimator.tuning.current_timeout_s:
            self._broken, self._rest_s = True, 0.0
            return None
        ce = self.estimator.cell.cell.coulombic_efficiency
        flows = current + np.nan_to_num(self.estimator.bleed_A)
        self._charge_Ah += np.where(flows < 0, ce * flows, flows) * (dt / 3600)
        self._since_s += dt
        self._walked_s += dt
        if not np.max(np.abs(current)) <= REST_C * self.estimator.cell.cell.capacity_Ah:
            self._rest_s = 0.0
            self._learn_resistance(dt)
            return None
        before, self._rest_s = self._rest_s, self._rest_s + dt
        share = dt / self._rest_s if self._rest_s > 0 else 1.0
        self._shown_A += min(share, 1.0) * (current - self._shown_A)
        if before < REST_S <= self._rest_s and estimate.status in {Status.OK, Status.DEGRADED}:
            self._observe(estimate)
        return None

    def slept(self, off_s: float, t_ns: int) -> None:
        """`off_s` s have passed at rest, as `Estimator.sleep` lets them; the time is `t_ns` now."""
        self._t_ns = t_ns
        self._charge_Ah += self.estimator.tuning.standby_current_A * off_s / 3600
        self._since_s += off_s
        self._walked_s += off_s
        self._rest_s = min(self._rest_s + off_s, math.nextafter(REST_S, 0.0))

    def _wait(self, dt: float) -> None:
        """Without a current of its own a sample only takes time; the next current is of all of it."""
        if self._t_ns is not None:
            self._t_ns -= round(dt * 1e9)

    def _currents(self, sample: Sample) -> Array | None:
        """(cells,) through each cell's string, None if that is not known of every string."""
        string_of, strings_A = self.estimator.wiring.string_of, sample.string_current_A
        if string_of is None:
            known = math.isfinite(sample.current_A)
            return np.full(self.estimator.cells, sample.current_A) if known else None
        return strings_A[string_of] if strings_A is not None and np.isfinite(strings_A).all() else None

    def _learn_resistance(self, dt: float) -> None:
        """Average r0 over the time under load."""
        e = self.estimator
        scale = beliefs.per_cell(e._state, layout.H_R0_SCALE, e.cells)
        variance = beliefs.per_cell(e._state, layout.H_R0_VAR, e.cells)
        told = np.isfinite(scale) & (variance < (0.75 * R0_SIGMA) ** 2)  # else the time is long since a step
        self._driven_s += dt
        share = np.where(told, dt / min(max(self._driven_s, 1.0), RESISTANCE_TAU_S), 0.0)
        used = e.resistance_scale * (scale - np.clip(scale - 1, -R0_SHAPE, R0_SHAPE))
        self.resistance += share * np.nan_to_num(used - self.resistance)
        self.resistance_sigma += share * np.nan_to_num(np.sqrt(variance) - self.resistance_sigma)

    def _observe(self, estimate: Estimate) -> None:
        """A rest is long enough: what lies between it and the one before tells of capacity."""
        soc = np.array(np.atleast_1d(estimate.soc), dtype=float)
        sigma = np.atleast_1d(estimate.soc_sigma)
        fresh = np.atleast_1d(estimate.age_s) <= self.estimator.tuning.voltage_timeout_s
        variance = np.where(fresh, sigma**2 + (self._model_V / self._slope(soc)) ** 2, math.nan)
        ends = np.full(self.estimator.cells, True) if self._broken else self._learn_capacity(soc, variance)
        self._broken = False
        for held, new in ((self._soc, soc), (self._soc_var, variance), (self._offset_A, self._shown_A)):
            np.copyto(held, new, where=ends)
        self._charge_Ah[ends] = self._since_s[ends] = 0.0

    def _learn_capacity(self, soc: Array, variance: Array) -> NDArray[np.bool_]:
        """Returns the cells whose segment ends here; that of the others goes on to a later rest."""
        e = self.estimator
        capacity_Ah, hours = e.cell.cell.capacity_Ah, self._since_s / 3600
        self._variance += WALK_PER_DAY**2 * self._walked_s / DAY_S
        self._walked_s = 0.0
        most_A = 2.5 * float(e._params[layout.P_BIAS_SIGMA])
        offset = np.clip((self._offset_A + self._shown_A) / 2, -most_A, most_A)
        h = capacity_Ah * (self._soc - soc)
        unseen_Ah = float(e._params[layout.P_PARASITIC]) * hours
        noise = unseen_Ah**2 + (self.capacity * capacity_Ah) ** 2 * (self._soc_var + variance)
        innovation = self._charge_Ah - offset * hours - self.capacity * h
        spread = self._variance * h * h + noise
        known = np.isfinite(spread)
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

    def _slope(self, soc: Array) -> Array:
        """Of the OCV at 25 degC, V per unit of SoC, never 0."""
        cell = self.estimator.cell
        low, high = (
            np.asarray(cell.ocv_V(np.clip(soc + side, 0, 1), 25.0), float) for side in (-SLOPE_SPAN, SLOPE_SPAN)
        )
        slope: Array = np.maximum(np.abs(high - low) / (2 * SLOPE_SPAN), 1e-3)
        return slope

    def snapshot(self) -> bytes:
        """All that is known, for `restore` by the same number of cells."""
        times = self._rest_s, self._walked_s, self._driven_s
        head = _HEAD.pack(_MAGIC, len(self.capacity), self._broken, *times)
        return head + b"".join(array.tobytes() for array in self._arrays())

    def restore(self, snapshot: bytes) -> None:
        """Go back to a `snapshot`, the estimator with its capacities. ValueError, changing nothing, if it is none."""
        cells = self.estimator.cells
        size = _HEAD.size + 8 * cells * len(self._arrays())
        if len(snapshot) != size or _HEAD.unpack_from(snapshot)[:2] != (_MAGIC, cells):
            raise ValueError(f"not the health of {cells} cells by this version")
        _, _, self._broken, self._rest_s, self._walked_s, self._driven_s = _HEAD.unpack_from(snapshot)
        for k, array in enumerate(self._arrays()):
            array[:] = np.frombuffer(snapshot, array.dtype, cells, _HEAD.size + 8 * cells * k)
        self._t_ns = None
        self.estimator.capacity_scale = self.capacity

    def _arrays(self) -> list[NDArray[np.generic]]:
        known = [self.capacity, self._variance, self.resistance, self.resistance_sigma, self.segments]
        return [*known, self._charge_Ah, self._shown_A, self._soc, self._soc_var, self._offset_A, self._since_s]
