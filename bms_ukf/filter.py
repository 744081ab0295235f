"""The filter alone, in three steps, for whoever has a gate, timeouts and a clock of their own.

`Estimator` is what most want: it holds what is missing, refuses what is implausible, starts itself and starts again,
tracks r0 and the voltage error, and learns the sensor's offset at rest. Here all of that is left to the caller.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bms_ukf.cell import CellParams
from bms_ukf.kernel import entry, layout
from bms_ukf.kernel.params import BITS, Precision, aligned, form_of, params, state_names
from bms_ukf.records import Fault
from bms_ukf.tuning import Tuning

Array = NDArray[np.float64]


class Filter:
    """predict, innovate, update: between the last two the caller may look at the innovation, and leave it unfused.

    Each step is computed aside and committed last. One whose result would not be finite returns `Fault.NUMERIC` and
    leaves the belief bit for bit as it was; nothing is raised. `states` names the elements of `x`.
    """

    __slots__ = ("_addresses", "_form", "_params", "_state", "_steps", "_work", "states")

    def __init__(
        self,
        cell: CellParams,
        x: ArrayLike,
        sigma: ArrayLike,
        tuning: Tuning | None = None,
        precision: Precision = "f64",
    ) -> None:
        """Start from the mean `x` (n,) and independent errors of `sigma` (n,): SoC in 0..1, voltages in V, bias in A.

        ValueError for another length, or a sigma that is not above 0.
        """
        tuning, bits = tuning or Tuning(), BITS[precision]
        self.states = (*state_names(cell), *(["current_bias_A"] if tuning.current_bias else []))
        mean, sigmas = np.asarray(x, float), np.asarray(sigma, float)
        if mean.shape != (len(self.states),) or sigmas.shape != mean.shape:
            raise ValueError(f"x and sigma as {len(self.states)} numbers: {', '.join(self.states)}")
        if not (np.isfinite(mean).all() and np.isfinite(sigmas).all() and (sigmas > 0).all()):
            raise ValueError("x finite and sigma above 0")
        m = self._form = form_of(cell, tuning, 1, bits)
        self._params = params(cell, tuning, bits)
        self._state = aligned(m.size, bits)
        self._work = aligned(layout.VALUES, bits)
        self._state[: m.x] = 0
        self._state[m.carry : m.cache] = 0
        self._state[layout.H_VOLTAGE_AGE] = self._state[layout.H_HEARD_AGE] = 1
        self._state[layout.H_REJECTED_S] = np.nan
        self._state[layout.H_UNSEEN_S] = self._state[layout.H_PARTS] = self._state[layout.H_REPEATS] = 0
        self._state[layout.H_POLARISED : layout.HELD] = 0
        for slot in ("VOLTAGE_SCALE", "FRESH", "PER_CAPACITY", "RESISTANCE"):
            self._state[getattr(layout, f"H_{slot}")] = 1
        self._state[m.x : m.root] = mean
        self._state[m.root : m.carry] = np.diag(sigmas)[np.tril_indices(m.n)]
        self._addresses = self._params.ctypes.data, self._state.ctypes.data, self._work.ctypes.data
        self._steps = entry.three_steps(m, bits)

    def predict(self, dt_s: float, current_A: float, temperature_degC: float) -> Fault:
        """Move the belief on by `dt_s` > 0 under a current that was constant, positive = discharge."""
        if not dt_s > 0:
            return Fault.NUMERIC
        return Fault(self._steps.predict(*self._addresses, dt_s, current_A, temperature_degC))

    def innovate(self, voltage_V: float) -> Fault:
        """Compare a voltage with its prediction; `INNOVATION_REJECTED` if it is farther off than `gate_sigmas`."""
        return Fault(self._steps.innovate(*self._addresses, voltage_V))

    def update(self) -> Fault:
        """Fuse the voltage that was compared last, once; NUMERIC if there is none since the last `predict`."""
        return Fault(self._steps.update(*self._addresses))

    @property
    def x(self) -> Array:
        """(n,) mean, a copy; as `states`."""
        return np.array(self._state[self._form.x : self._form.root], float)

    @property
    def sqrt_P(self) -> Array:
        """(n, n) lower triangle whose product with its transpose is the covariance; a copy."""
        m = self._form
        full = np.zeros((m.n, m.n))
        full[np.tril_indices(m.n)] = self._state[m.root : m.carry]
        return full

    @property
    def voltage_pred_V(self) -> float:
        """As `innovate` left it."""
        return self._value(layout.Y_PREDICTED)

    @property
    def innovation_V(self) -> float:
        """Measured minus predicted, as `innovate` left it; NaN once it is fused, or of another belief."""
        return self._value(layout.Y_INNOVATION)

    @property
    def innovation_var_V2(self) -> float:
        """Of one reading by itself, as in `Estimate`: what `update` adds for readings that crowd is not in it."""
        return self._value(layout.Y_VARIANCE) - self._value(layout.Y_CROWDED)

    def _value(self, slot: int) -> float:
        work: Any = self._work
        return float(work[slot])
