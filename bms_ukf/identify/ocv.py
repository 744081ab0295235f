"""Open-circuit voltage from slow tests: branches, their mean, hysteresis and capacity, per temperature.

The curve is the least-squares fit of a smooth and strictly rising one: its unknowns are the rises between neighbouring
knots, each bounded below, so that no monotone repair is needed afterwards. A running maximum would bend the curve
wherever noise makes it fall, which on a plateau costs several times the error in SoC.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from bms_ukf.errors import ConfigError
from bms_ukf.identify import effective
from bms_ukf.manifest import Manifest, MeasuredTest
from bms_ukf.recordings import Recording

Array = NDArray[np.float64]

SOC = np.unique(
    np.round(np.concatenate([np.linspace(0, 0.1, 21), np.linspace(0.1, 0.9, 81), np.linspace(0.9, 1, 21)]), 4)
)
LEAST_SLOPE_V = 2e-3  # per unit of SoC: flat enough for any plateau, and strictly rising
CLOSES = 0.90  # a charge branch that reaches the upper limit below this SoC has lost count, or the cell its capacity
SAME = 0.05  # two counts of the same capacity agree within this share
REST_S, FEWEST_RESTS, REST_ERROR_V = 900.0, 6, 5e-3  # a rest that tells the OCV, how many, and how well
SMOOTHING = 2e-4  # V: what a kink of 1 V per unit SoC and knot costs, against 1 V of misfit


@dataclass(slots=True)
class Curve:
    """The slow test of one temperature; arrays over `SOC`."""

    temperature_degC: float
    voltage_V: Array  # mean of the branches, or the one there is
    sigma_V: Array
    half_width_V: Array | None  # half of charge branch minus discharge branch; None with one branch only
    current_A: float  # size of the current
    directions: tuple[str, ...]


@dataclass(slots=True)
class Run:
    """One stretch of one direction."""

    direction: str
    start_soc: float
    moved_Ah: Array  # shape (n,), rising from 0
    voltage_V: Array  # shape (n,)
    size_A: float


@dataclass(slots=True)
class Slow:
    """What the slow tests say together."""

    capacity_Ah: float
    curves: list[Curve]  # by temperature
    drawn_Ah: dict[float, float] = field(default_factory=dict)  # full to lower limit, by temperature
    charged_Ah: dict[float, float] = field(default_factory=dict)  # and back to the upper limit
    warnings: list[str] = field(default_factory=list)

    def at(self, temperature_degC: float) -> Array:
        """OCV over `SOC`: linear between the tests' temperatures, held beyond."""
        rows = np.array([curve.voltage_V for curve in self.curves])
        knots = [curve.temperature_degC for curve in self.curves]
        return np.array([np.interp(temperature_degC, knots, column) for column in rows.T])

    @property
    def half_width_V(self) -> Array | None:
        """Half the width between the branches over `SOC`, without what the current's polarisation adds in the cold.

        The narrowest over the temperatures. None if no test has both branches.
        """
        both = [curve.half_width_V for curve in self.curves if curve.half_width_V is not None]
        return np.maximum(np.min(both, axis=0), 0.0) if both else None

    @property
    def entropic_V_per_K(self) -> Array | None:
        """dOCV/dT over `SOC`, by least squares over the tests' temperatures; None with a single one."""
        if len(self.curves) < 2:
            return None
        rows = np.array([curve.voltage_V for curve in self.curves])
        return np.asarray(np.polyfit([curve.temperature_degC for curve in self.curves], rows, 1)[0])


def analyse(
    tests: Manifest,
    recordings: Sequence[tuple[MeasuredTest, Recording]],
    source: str,
    tables: Sequence[Curve] = (),
) -> Slow:
    """Curves of all `ocv` tests; a table goes before a test at its temperature.

    Raises ConfigError if they give no capacity or no curve.
    """
    branches: dict[float, dict[str, Run]] = {}
    warnings: list[str] = []
    for test, recording in recordings:
        for run in _runs(recording, test):
            if test.direction in (None, run.direction):
                found = branches.setdefault(test.temperature_degC, {})
                if run.direction not in found or run.moved_Ah[-1] > found[run.direction].moved_Ah[-1]:
                    found[run.direction] = run
    if not branches and not tables:
        raise ConfigError(source, key="test", expected="a test of role 'ocv' with a full charge or discharge in it")
    low, high = tests.voltage_limits_V
    drawn_Ah = {
        T: float(found["discharge"].moved_Ah[-1])
        for T, found in sorted(branches.items())
        if "discharge" in found and found["discharge"].voltage_V[-1] < low + 0.15
    }
    charged_Ah = {
        T: float(found["charge"].moved_Ah[-1])
        for T, found in sorted(branches.items())
        if T in drawn_Ah and "charge" in found and found["charge"].voltage_V[-1] > high - 0.03
    }
    capacity_Ah = tests.capacity_Ah or _capacity(drawn_Ah, source)
    _compare_capacity(tests, drawn_Ah, source, warnings)
    counts_Ah = _counts(branches, drawn_Ah, capacity_Ah)
    given = {table.temperature_degC for table in tables}
    found_here = [_curve(T, found, counts_Ah, high, warnings) for T, found in branches.items() if T not in given]
    curves = sorted([*tables, *found_here], key=lambda curve: curve.temperature_degC)
    both = [curve for curve in curves if curve.half_width_V is not None]
    left_out = [f"{curve.temperature_degC:g}" for curve in curves if curve.half_width_V is None]
    if both and left_out:
        warnings.append(f"OCV at {', '.join(left_out)} degC left out: other temperatures have both branches")
    return Slow(capacity_Ah, both or curves, drawn_Ah, charged_Ah, warnings)


def rising(soc: Array, voltage_V: Array, *, smoothing: float = SMOOTHING) -> tuple[Array, Array]:
    """The smooth, strictly rising curve over `SOC` nearest to points of it, and its standard error.

    Unknowns are the value at 0 and the rises from knot to knot; the rises have a lower bound.
    """
    index = np.clip(np.searchsorted(SOC, soc, side="right") - 1, 0, SOC.size - 2)
    share = np.clip((soc - SOC[index]) / (SOC[index + 1] - SOC[index]), 0, 1)
    design = (np.arange(SOC.size) <= index[:, None]).astype(float)  # 1 for the value at 0 and every rise passed
    design[np.arange(soc.size), index + 1] = share
    step = np.diff(SOC)
    slope = np.diag(1 / step)
    kink = np.diff(slope, axis=0) * smoothing * np.sqrt(soc.size)
    kink = np.hstack([np.zeros((len(kink), 1)), kink])
    system = np.vstack([design, kink])
    lower = np.concatenate([[-np.inf], LEAST_SLOPE_V * step])
    target = np.concatenate([voltage_V, np.zeros(len(kink))])
    fitted = lsq_linear(system, target, bounds=(lower, np.full(SOC.size, np.inf)), method="bvls", tol=1e-9).x
    residual_V = (design @ fitted - voltage_V)[np.argsort(soc, kind="stable")]
    error_V = float(np.sqrt(np.sum(residual_V**2) / effective.rows(residual_V)))
    covariance = np.linalg.pinv(system.T @ system, hermitian=True)
    to_voltage = np.tril(np.ones((SOC.size, SOC.size)))
    sigma_V = error_V * np.sqrt(np.maximum(np.diag(to_voltage @ covariance @ to_voltage.T), 0))
    return np.cumsum(fitted), np.asarray(sigma_V)


def _runs(recording: Recording, test: MeasuredTest) -> list[Run]:
    """Stretches of one direction that move at least a fifth of all charge."""
    busy = np.abs(recording.current_A) > 0.1 * np.abs(recording.current_A).max()
    sign = np.where(busy, np.sign(recording.current_A), 0)
    edges = np.flatnonzero(np.diff(sign, prepend=0, append=0))
    whole_Ah = np.abs(np.diff(recording.drawn_Ah)).sum()
    runs = []
    for start, end in pairwise(edges.tolist()):
        moved_Ah = np.abs(recording.drawn_Ah[start:end] - recording.drawn_Ah[max(start - 1, 0)])
        if sign[start] and end - start > 20 and moved_Ah[-1] > whole_Ah / 5:
            direction = "discharge" if sign[start] > 0 else "charge"
            given = test.initial_soc if start == edges[0] else None
            start_soc = given if isinstance(given, float) else float(direction == "discharge")
            size_A = float(np.median(np.abs(recording.current_A[start:end])))
            runs.append(Run(direction, start_soc, moved_Ah, recording.voltage_V[start:end], size_A))
    return runs


def _counts(
    branches: dict[float, dict[str, Run]], drawn_Ah: dict[float, float], capacity_Ah: float
) -> dict[str, float]:
    """Charge of the slow tests that is a SoC of 1, by direction, Ah.

    A slow test counts by itself: from full to the lower limit at about 25 degC is all there is, and so is what brings
    the cell back to the upper limit, whatever capacity another cell or another day has.
    """
    counts = dict.fromkeys(("discharge", "charge"), capacity_Ah)
    if not drawn_Ah:
        return counts
    nearest = min(drawn_Ah, key=lambda temperature: abs(temperature - 25))
    if abs(nearest - 25) < 10 and abs(drawn_Ah[nearest] / capacity_Ah - 1) < SAME:
        counts = dict.fromkeys(counts, drawn_Ah[nearest])
        back = branches[nearest].get("charge")
        if back is not None and abs(back.moved_Ah[-1] / drawn_Ah[nearest] - 1) < SAME:
            counts["charge"] = float(back.moved_Ah[-1])
    return counts


def _capacity(drawn_Ah: dict[float, float], source: str) -> float:
    if not drawn_Ah:
        expected = "capacity_Ah, or an ocv test that discharges from full to the lower voltage limit"
        raise ConfigError(source, key="capacity_Ah", expected=expected)
    return drawn_Ah[min(drawn_Ah, key=lambda temperature: abs(temperature - 25))]


def _compare_capacity(tests: Manifest, drawn_Ah: dict[float, float], source: str, warnings: list[str]) -> None:
    """A stated capacity that is off by a factor is refused; a few percent are worth a warning."""
    if tests.capacity_Ah is None or not drawn_Ah:
        return
    warmest = _capacity(drawn_Ah, source)
    if not 0.7 < warmest / tests.capacity_Ah < 1.4:
        expected = f"about the {warmest:.4g} Ah that the slow discharge gave"
        raise ConfigError(source, key="capacity_Ah", value=tests.capacity_Ah, expected=expected)
    if abs(warmest / tests.capacity_Ah - 1) > 0.03:
        warnings.append(f"capacity_Ah is {tests.capacity_Ah:g}, but the slow discharge gave {warmest:.4g} Ah")


def _curve(
    temperature_degC: float, branches: dict[str, Run], counts_Ah: dict[str, float], upper_V: float, warnings: list[str]
) -> Curve:
    fitted: dict[str, tuple[Array, Array, NDArray[np.bool_]]] = {}
    for direction, run in branches.items():
        soc = run.start_soc + (run.moved_Ah if direction == "charge" else -run.moved_Ah) / counts_Ah[direction]
        if (
            direction == "charge"
            and run.voltage_V[-1] > upper_V - 0.03
            and soc[-1] < CLOSES
            and "discharge" in branches
        ):
            warnings.append(
                f"OCV at {temperature_degC:g} degC: the charge reached the upper limit after {100 * soc[-1]:.0f} % of"
                " the capacity drawn before; only the discharge is used (ageing, or lost count?)"
            )
            continue
        low, high = float(soc.min()), float(soc.max())
        if low > 0.05 or high < 0.95:
            warnings.append(f"OCV at {temperature_degC:g} degC, {direction}: covers SoC {low:.2f} to {high:.2f} only")
        inside = (soc > -0.02) & (soc < 1.02)
        if np.count_nonzero(inside) < 20:
            raise ConfigError(f"OCV at {temperature_degC:g} degC", expected="20 rows or more between SoC 0 and 1")
        curve, sigma = rising(soc[inside], run.voltage_V[inside])
        fitted[direction] = (curve, sigma, (low - 0.005 <= SOC) & (high + 0.005 >= SOC))
    current_A = float(np.mean([branches[direction].size_A for direction in fitted]))
    directions = tuple(sorted(fitted))
    if len(fitted) < 2:
        curve, sigma, _ = fitted[directions[0]]
        return Curve(temperature_degC, curve, sigma, None, current_A, directions)
    up, down = fitted["charge"], fitted["discharge"]
    both = up[2] & down[2]
    half = np.interp(SOC, SOC[both], (up[0] - down[0])[both] / 2)
    # Where only one branch reaches, the other is as far from it as where both end.
    middle = np.where(down[2], down[0] + half, up[0] - half)
    mean, _ = rising(SOC, middle, smoothing=SMOOTHING / 10)
    return Curve(temperature_degC, mean, np.hypot(up[1], down[1]) / 2, half, current_A, directions)
