"""Published Python packages with an unscented or cubature filter, on the same cell: what `test_bench_peers` measures.

The problem: 2 A of discharge at 25 degC, a voltage every second, the states SoC and two RC voltages. Every peer is told
what the kernel believes of the cell, its states for errors that last as a part of R. It gets its model in the fastest
form it accepts: compiled functions of all sigma points at once, or, where it asks for one point at a time, plain
numbers in and out with only the OCV compiled.
Resistances and time constants are looked up once a step, as the kernel does; Q and R are set once, which spares the
peers what the kernel does in every step.

A package is imported when its adapter is made: `version` says beforehand whether it is there.
"""

from __future__ import annotations

import math
from importlib import metadata
from typing import Any, ClassVar, Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from bms_ukf import CellParams, Tuning
from bms_ukf.kernel import entry, layout
from bms_ukf.kernel.adapt import FAST_S
from bms_ukf.kernel.params import params

CURRENT_A, TEMPERATURE_DEGC, DT_S = 2.0, 25.0, 1.0
KNOTS = 1001  # of SoC from 0 to 1: resistances are those of the nearest, the OCV is straight in between
Array = NDArray[np.float64]


@numba.njit
def relax(points: Array, moved: float, a1: float, c1: float, a2: float, c2: float) -> Array:
    """Sigma points (m, 3) one step later."""
    after = np.empty((len(points), 3))
    for i in range(len(points)):
        after[i, 0] = points[i, 0] - moved
        after[i, 1] = a1 * points[i, 1] + c1
        after[i, 2] = a2 * points[i, 2] + c2
    return after


@numba.njit
def voltages(points: Array, ocv: Array, drop: float) -> Array:
    """Terminal voltages (m, 1) of sigma points (m, 3); `ocv` goes on by its edge slopes."""
    v = np.empty((len(points), 1))
    for i in range(len(points)):
        u = points[i, 0] * (len(ocv) - 1)
        k = min(max(int(u), 0), len(ocv) - 2)
        v[i, 0] = ocv[k] + (u - k) * (ocv[k + 1] - ocv[k]) - points[i, 1] - points[i, 2] - drop
    return v


class Model:
    """The cell at 2 A and 25 degC for any peer: x and P to start from, Q (3, 3), R in V^2, and the two functions.

    Q and R are the kernel's at the SoC of the start (`kernel.process`, `kernel.voltage`), x and P its first belief
    (`kernel.belief.start`). `schedule` chooses the parameters of the step to come.
    """

    def __init__(self, cell: CellParams, tuning: Tuning) -> None:
        self._params = p = params(cell, tuning)
        self._address, self._ocv = p.ctypes.data, entry.ocv()  # good for as long as the buffer is held
        soc = np.linspace(0, 1, KNOTS)
        at = cell.dynamics_at(soc, TEMPERATURE_DEGC)
        r, tau = np.array([at["r1_ohm"], at["r2_ohm"]]), np.array([at["tau1_s"], at["tau2_s"]])
        a = np.exp(-DT_S / tau)
        (a1, a2), (c1, c2) = a, (1 - a) * r * CURRENT_A
        drop = at["r0_ohm"] * at["r0_knee_A"] * np.arcsinh(CURRENT_A / at["r0_knee_A"])
        self.moved = float(CURRENT_A * DT_S / p[layout.P_CHARGE_COULOMB])
        self._table: list[tuple[float, ...]] = np.column_stack([a1, c1, a2, c2, drop]).tolist()
        self._ocv_V = cell.ocv_V(soc, TEMPERATURE_DEGC)
        self.schedule(tuning.initial_soc)

        k = self._knot(tuning.initial_soc)
        model_variance = p[layout.P_VAR_V : layout.P_VAR_V + 2]
        stationary = model_variance + (p[layout.P_RC_REL] * r[:, k] * CURRENT_A) ** 2
        moved = CURRENT_A * DT_S
        soc_walk = DT_S * p[layout.P_SOC_WALK_OFFSET] + p[layout.P_SOC_WALK_GAIN] * moved
        self.Q = np.diag([soc_walk, *((1 - a[:, k] ** 2) * stationary)])
        # Three states have none for the errors that last: they are part of R, as if new at every reading. The drop has
        # stood for longer than its own error lasts.
        offset_V = p[layout.P_BIAS_SIGMA] * (at["r0_ohm"][k] + r[:, k].sum())
        slow = p[layout.P_SLOW_VAR] + offset_V**2 + (p[layout.P_SLOW_REL] * r[:, k].sum() * CURRENT_A) ** 2
        resistance = p[layout.P_R0_VAR] * (drop[k] + r[:, k].sum() * CURRENT_A) ** 2
        crowded = p[layout.P_VAR_VOLTAGE] + p[layout.P_FAST_VAR] * FAST_S / DT_S
        self.R = float(crowded + slow + resistance)
        self.x = np.array([tuning.initial_soc, *(r[:, k] * CURRENT_A / 2)])
        unseen_A = math.hypot(p[layout.P_INITIAL_CURRENT], CURRENT_A / 2)
        self.P = np.diag([tuning.initial_soc_sigma**2, *(model_variance + (r[:, k] * unseen_A) ** 2)])

    @staticmethod
    def _knot(soc: float) -> int:
        return min(max(int(soc * (KNOTS - 1) + 0.5), 0), KNOTS - 1)

    def schedule(self, soc: float) -> None:
        """Take the parameters at `soc` and what the step moves it by."""
        self._a1, self._c1, self._a2, self._c2, self._drop = self._table[self._knot(soc - self.moved)]

    def transition(self, x: Array, dt: float) -> tuple[float, float, float]:
        """One sigma point (3,) later."""
        soc, v1, v2 = x.tolist()
        return soc - self.moved, self._a1 * v1 + self._c1, self._a2 * v2 + self._c2

    def measurement(self, x: Array) -> tuple[float]:
        """The terminal voltage of one sigma point (3,)."""
        soc, v1, v2 = x.tolist()
        return (self._ocv(self._address, soc, TEMPERATURE_DEGC) - v1 - v2 - self._drop,)

    def transitions(self, points: Array, dt: float = DT_S) -> Array:
        """All sigma points (m, 3) later."""
        return relax(points, self.moved, self._a1, self._c1, self._a2, self._c2)

    def measurements(self, points: Array) -> Array:
        """Their terminal voltages (m, 1)."""
        return voltages(points, self._ocv_V, self._drop)


class Peer(Protocol):
    """`step` fuses a voltage, V, that comes a second after the last, and returns the SoC."""

    package: ClassVar[str]  # its name on PyPI
    kind: ClassVar[str]

    def __init__(self, cell: CellParams, tuning: Tuning) -> None: ...

    def step(self, voltage_V: float) -> float: ...


def version(peer: type[Peer]) -> str | None:
    """Of the peer's package; None: not installed."""
    try:
        return metadata.version(peer.package)
    except metadata.PackageNotFoundError:
        return None


class Filterpy:
    """numpy, one sigma point at a time."""

    package, kind = "filterpy", "UKF"

    def __init__(self, cell: CellParams, tuning: Tuning) -> None:
        from filterpy import kalman

        self._start(kalman, Model(cell, tuning), tuning)

    def _start(self, kalman: Any, model: Model, tuning: Tuning) -> None:
        points = kalman.MerweScaledSigmaPoints(3, alpha=tuning.alpha, beta=tuning.beta, kappa=tuning.kappa)
        self._model = model
        self._filter = kalman.UnscentedKalmanFilter(3, 1, DT_S, model.measurement, model.transition, points)
        self._filter.x, self._filter.P, self._filter.Q = model.x, model.P, model.Q
        self._filter.R *= model.R

    def step(self, voltage_V: float) -> float:
        self._model.schedule(self._filter.x[0])
        self._filter.predict()
        self._filter.update(voltage_V)
        return float(self._filter.x[0])


class BayesianFilters(Filterpy):
    """A fork of filterpy, with the same interface."""

    package, kind = "bayesian-filters", "UKF"

    def __init__(self, cell: CellParams, tuning: Tuning) -> None:
        from bayesian_filters import kalman

        self._start(kalman, Model(cell, tuning), tuning)


class FastKalman:
    """C++, all sigma points in one call."""

    package, kind = "fast-kalman", "UKF"

    def __init__(self, cell: CellParams, tuning: Tuning) -> None:
        import kalman

        model = self._model = Model(cell, tuning)
        weights = {"alpha": tuning.alpha, "beta": tuning.beta, "kappa": tuning.kappa}
        noise = {"Q": model.Q.ravel().tolist(), "R": [model.R]}
        belief = {"x": model.x.tolist(), "P": model.P.ravel().tolist()}
        self._filter = kalman.UnscentedKalmanFilter(3, 1, **belief, **noise, **weights)
        self._soc = tuning.initial_soc

    def step(self, voltage_V: float) -> float:
        self._model.schedule(self._soc)
        self._filter.predict_batch(self._model.transitions)
        self._filter.correct_batch([voltage_V], self._model.measurements)
        self._soc = self._filter.x[0]
        return self._soc


class TurboCkf:
    """Rust, all sigma points in one call; the square-root form.

    A cubature filter has the sigma points of alpha = 1, kappa = 0, without the central one.
    """

    package, kind = "turbo-ckf", "SR-CKF"

    def __init__(self, cell: CellParams, tuning: Tuning) -> None:
        import turbo_ckf

        model = self._model = Model(cell, tuning)
        self._filter = turbo_ckf.TurboSRCKF(3, 1, DT_S, hx=model.measurements, fx=model.transitions)
        self._filter.x, self._filter.P, self._filter.Q, self._filter.R = model.x, model.P, model.Q, model.R
        self._soc = tuning.initial_soc

    def step(self, voltage_V: float) -> float:
        self._model.schedule(self._soc)
        self._filter.predict()
        self._soc = float(self._filter.update([voltage_V])[0])
        return self._soc


class KalmanPy:
    """numpy, all sigma points in one call; not in its square-root form, which is slower."""

    package, kind = "kalman-py", "UKF"

    def __init__(self, cell: CellParams, tuning: Tuning) -> None:
        import kalman_py

        model = self._model = Model(cell, tuning)
        weights = {"alpha": tuning.alpha, "beta": tuning.beta, "kappa": tuning.kappa}
        functions = model.transitions, model.measurements
        self._filter = kalman_py.UnscentedKalmanFilter(
            *functions, model.Q, [[model.R]], model.x, model.P, **weights, vectorized=True
        )

    def step(self, voltage_V: float) -> float:
        self._model.schedule(self._filter.x[0])
        self._filter.predict(DT_S)
        self._filter.update([voltage_V])
        return float(self._filter.x[0])


PEERS: tuple[type[Peer], ...] = (Filterpy, BayesianFilters, FastKalman, TurboCkf, KalmanPy)
