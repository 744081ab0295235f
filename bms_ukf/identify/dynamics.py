"""Fits the tables of the cell model to tests, by least squares of the open-loop voltage error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from bms_ukf.cell import ZERO_CELSIUS_K
from bms_ukf.identify import effective, ocv
from bms_ukf.identify.ocv_rows import OcvRows
from bms_ukf.identify.samples import Samples
from bms_ukf.identify.simulate import Place, between, drop, lowpass
from bms_ukf.identify.tables import CORE_WEIGHT, OCV_SOC, SOC, Structure, Unknowns

Array = NDArray[np.float64]

SOC_ERROR = 0.005  # of the count: where the OCV is steep, a row says less
REACH_K = 10.0  # beyond the rows of the tables: so far their logarithms go on over 1/T
SCALE_V = 1e-3  # residuals are in mV
ROWS = {"drive": 1600.0, "charge": 800.0, "pulse": 400.0}  # what a test weighs, as rows of error
KEPT = 700  # rows of a test that enter the least squares

SPLINES = CubicSpline(OCV_SOC, np.eye(OCV_SOC.size), bc_type="natural")  # cardinal: one column for each knot


@dataclass(slots=True)
class Model:
    """A fitted model, still in the fit's own terms."""

    unknowns: Unknowns
    ocv: OcvRows
    capacity_Ah: float
    x: Array
    sigma: Array | None = None  # of x, one standard error
    held_out_mV: dict[str, float] = field(default_factory=dict)  # error on rows left out, by structure

    @property
    def core(self) -> tuple[float, float] | None:
        """K/W and s of the core temperature, the last two unknowns; None without."""
        if self.unknowns.structure.core is None:
            return None
        return float(self.x[-2]) / self.capacity_Ah, float(np.exp(self.x[-1]))

    def simulate(self, test: Samples) -> Array:
        """Predicted terminal voltage at every row, V."""
        return self._run(self.x, test, 0)[0]

    def _run(self, x: Array, test: Samples, stride: int) -> tuple[Array, Array]:
        """Voltage, and its derivatives by the unknowns at every stride-th row (none for 0)."""
        unknowns = self.unknowns
        temperature_degC = test.temperature_degC + self._core_rise_K(x, test)
        # As in the cell file, which has rows beyond: a loaded cell is warmer, or as if colder, than its tests.
        reach_degC = unknowns.temperature_degC[[0, -1]] + np.array([-REACH_K, REACH_K])
        coldest, warmest = (-1000 / (reach_degC + ZERO_CELSIUS_K)).tolist()
        inverse_K = -1000 / (temperature_degC + ZERO_CELSIUS_K)
        place = Place(*between(inverse_K, unknowns.inverse_K, (coldest, warmest)), *between(test.soc, SOC))
        rows = slice(0, 0) if stride == 0 else slice(None, None, stride)
        kept = np.arange(test.soc.size)[rows]
        out = np.empty(test.soc.size)
        by_table = np.empty((kept.size, np.prod(unknowns.shape) + 1))
        per_charge = float(np.exp(x[unknowns.rate])) / (3600 * self.capacity_Ah)
        rate = per_charge if unknowns.structure.hysteresis else 0.0
        currents = (test.current_A, test.current_at_end_A)
        drop(test.step_s, *currents, place, unknowns.tables(x), rate, max(stride, 1), out, by_table)
        left, part = between(temperature_degC, unknowns.temperature_degC)
        weights = np.zeros((test.soc.size, unknowns.temperature_degC.size))
        np.put_along_axis(weights, left[:, None], (1 - part)[:, None], axis=1)
        np.put_along_axis(weights, left[:, None] + 1, part[:, None], axis=1)
        spline = SPLINES(np.clip(test.soc, 0, 1))
        voltage_V = np.sum(spline * (weights @ unknowns.correction_V(x)), axis=1) - out
        by_scale = np.zeros((kept.size, unknowns.temperature_degC.size))
        scale = np.exp(x[unknowns.scale])
        for column, share in ((left, 1 - part), (left + 1, part)):
            drawn = (1 - test.soc) * scale[column]
            value_V, slope = self.ocv(column, 1 - drawn)
            voltage_V += share * value_V
            by_scale[np.arange(kept.size), column[rows]] -= (share * slope * drawn)[rows]
        if stride == 0:
            return voltage_V, by_scale
        by_ocv = (weights[rows][:, :, None] * spline[rows][:, None, :]).reshape(kept.size, -1)
        columns = [-by_table[:, :-1] @ unknowns.to_tables, -by_table[:, -1:], by_ocv, by_scale]
        for k in range(unknowns.size, x.size):
            shifted = x.copy()
            shifted[k] += 0.02
            columns.append((self._run(shifted, test, 0)[0] - voltage_V)[rows, None] / 0.02)
        return voltage_V, np.hstack(columns)

    def _core_rise_K(self, x: Array, test: Samples) -> Array:
        """Core above surface; its heat from the measured voltage."""
        if self.unknowns.structure.core is None:
            return np.zeros(test.soc.size)
        row = np.argmin(np.abs(self.unknowns.temperature_degC - 25))
        ocv_V, _ = self.ocv(np.full(test.soc.size, row), test.soc)
        heat_W = test.current_A * (ocv_V - test.voltage_V)
        return np.asarray(x[-2] / self.capacity_Ah * lowpass(test.step_s, heat_W, float(np.exp(x[-1]))))


def unfitted(structure: Structure, tests: Sequence[Samples], slow: ocv.Slow) -> Model:
    """Return the model of a structure as it is believed to be before any data."""
    temperature_degC = temperature_rows(tests, slow)
    half = None
    if structure.hysteresis and slow.half_width_V is not None:
        half = np.interp(SOC, ocv.SOC, slow.half_width_V)
    unknowns = Unknowns(
        structure,
        temperature_degC,
        slow.capacity_Ah,
        ocv_slope_V(slow),
        half,
        both_branches=slow.half_width_V is not None,
    )
    start = unknowns.start
    if structure.core is not None:
        start = np.concatenate([start, _core_unknowns(structure.core.start)])
    return Model(unknowns, OcvRows([slow.at(T) for T in temperature_degC]), slow.capacity_Ah, start)


def temperature_rows(tests: Sequence[Samples], slow: ocv.Slow) -> Array:
    """Return the rows of the tables, degC: the temperatures of the tests, and one as warm as any of them became.

    Without tests, those of the slow ones.
    """
    rows = sorted({float(test.test.temperature_degC) for test in tests})
    rows = rows or [curve.temperature_degC for curve in slow.curves]
    warmest = max((float(np.quantile(test.temperature_degC, 0.999)) for test in tests), default=rows[-1])
    if warmest > rows[-1] + 4 or len(rows) == 1:
        rows.append(max(5 * np.ceil(warmest / 5), rows[-1] + 5))
    return np.array(rows)


def ocv_slope_V(slow: ocv.Slow) -> Array:
    """dOCV/dSoC at the SoC knots of the tables, about 25 degC, over a tenth of SoC; from 0.05 V."""
    voltage_V = slow.at(25.0)
    left, right = np.clip(SOC - 0.05, 0, 1), np.clip(SOC + 0.05, 0, 1)
    rise_V = np.interp(right, ocv.SOC, voltage_V) - np.interp(left, ocv.SOC, voltage_V)
    return np.clip(rise_V / (right - left), 0.05, 3.0)


def fit(
    model: Model, tests: Sequence[Samples], *, evaluations: int, kept: int, ftol: float = 1e-3, uncertain: bool = False
) -> Model:
    """`model` fitted to the counted rows of the tests, from where it stands; with standard errors if `uncertain`."""
    strides = [max(1, test.soc.size // kept) for test in tests]
    every = [_weights(model, test, stride) for test, stride in zip(tests, strides, strict=True)]
    rows = [np.flatnonzero(weight) for weight in every]  # the others cost time and say nothing
    weights = [weight[kept] for weight, kept in zip(every, rows, strict=True)]
    unknowns = model.unknowns
    extra = model.x.size - unknowns.size
    prior = np.hstack([unknowns.prior, np.zeros((len(unknowns.prior), extra))])
    target = unknowns.prior_target
    if unknowns.structure.core is not None:
        prior = np.vstack([prior, np.diag(CORE_WEIGHT) @ np.eye(model.x.size)[-extra:]])
        target = np.concatenate([target, [0.0, CORE_WEIGHT[1] * np.log(unknowns.structure.core.start[1])]])

    def residuals(x: Array) -> Array:
        errors = [
            (model._run(x, test, 0)[0] - test.voltage_V)[::stride][kept] / SCALE_V * weight
            for test, stride, kept, weight in zip(tests, strides, rows, weights, strict=True)
        ]
        return np.concatenate([*errors, prior @ x - target])

    def jacobian(x: Array) -> Array:
        blocks = [
            model._run(x, test, stride)[1][kept] * (weight / SCALE_V)[:, None]
            for test, stride, kept, weight in zip(tests, strides, rows, weights, strict=True)
        ]
        return np.vstack([*blocks, prior])

    lower, upper = bounds(model)
    start = np.clip(model.x, lower + 1e-6, upper - 1e-6)
    found = least_squares(
        residuals, start, jac=jacobian, bounds=(lower, upper), x_scale="jac", ftol=ftol, max_nfev=evaluations
    )
    edges = np.cumsum([weight.size for weight in weights])[:-1]
    sigma = None
    if uncertain:
        parts = np.split(found.jac[: -len(prior)], edges), np.split(found.fun[: -len(prior)], edges)
        sigma = effective.standard_errors(*parts, prior)
    return Model(unknowns, model.ocv, model.capacity_Ah, found.x, sigma, dict(model.held_out_mV))


def bounds(model: Model) -> tuple[Array, Array]:
    """Wide limits in which the numbers stay physical, and the time constants in order."""
    lower, upper = np.full(model.x.size, -np.inf), np.full(model.x.size, np.inf)
    unknowns = model.unknowns
    for columns, low, high in unknowns.limits():
        lower[columns], upper[columns] = low, high
    if unknowns.structure.core is not None:
        lower[-2:], upper[-2:] = map(_core_unknowns, (unknowns.structure.core.lower, unknowns.structure.core.upper))
    return lower, upper


def with_core(without: Model, structure: Model) -> Model:
    """A fit without core as the start of one with it: the core where its structure starts."""
    core = structure.unknowns.structure.core
    assert core is not None
    start = np.concatenate([without.x, _core_unknowns(core.start)])
    return Model(structure.unknowns, structure.ocv, structure.capacity_Ah, start)


def _core_unknowns(core: tuple[float, float]) -> Array:
    """K Ah/W as it is, the time constant as a logarithm."""
    return np.array([core[0], np.log(core[1])])


def _weights(model: Model, test: Samples, stride: int) -> Array:
    """What every stride-th row's error in mV weighs; a test's squares sum to its `ROWS` on a flat OCV."""
    _, slope = model.ocv(np.zeros(test.soc.size, dtype=np.int64), test.soc)
    weight = (test.counted & ~test.exhausted) / np.hypot(1.0, SOC_ERROR * slope / 0.01)
    kept = weight[::stride]
    first, last = test.test.part
    count = max(int(np.count_nonzero(test.counted[::stride])), 1)
    return np.asarray(kept * np.sqrt((last - first) * ROWS[test.test.role] / count))
