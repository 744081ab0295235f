"""Is an unscented Kalman filter worth it for this cell, at this uncertainty? The numbers that tell.

The belief is Gaussian in SoC; beyond 0..1 the OCV goes on with its edge slope, as in the filter. The cell is at rest:
a current moves the mean of the voltage, but neither the bias nor the spread, as only the OCV is non-linear in SoC. The
filter is the one without a state for the current sensor's offset, which a voltage at rest hardly shows.
"""

from __future__ import annotations

import math
import statistics
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf import unscented
from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.estimator import Estimator
from bms_ukf.kernel import entry, layout
from bms_ukf.kernel.params import SOC_SIGMA_MAX, params, state_names, voltage_sigmas
from bms_ukf.records import Estimate, Sample
from bms_ukf.tuning import Tuning

Array = NDArray[np.float64]

SIZES = {"small": 1 / 3, "medium": 1.0, "large": 2.0}  # of the uncertainty asked for
SLOPE_POINTS = 11
MAX_OUTSIDE = 0.01  # share of a belief beyond 0..1 from which the OCV's edge slope, not the cell, makes the figures
TIMED_STEPS, TIMED_ROUNDS = 500, 21


def diagnose(cell: CellParams, soc: float = 0.5, sigma: float = 0.1, temperature_degC: float = 25.0) -> dict[str, Any]:
    """The diagnosis of `cell` where SoC is `soc` (0..1) with one sigma of `sigma`; ready for JSON. SoC is 0..1 in it.

    cell, soc, soc_sigma, temperature_degC   what was asked
    voltage_error_mV     one sigma of a voltage at rest: the sensor's error, and the model's fast and lasting ones
    bias                 for a small, medium and large sigma (a third, once and twice `sigma`): `soc_sigma`; `outside`,
                         the share of the belief beyond 0..1; `update`, how such a belief meets its first voltage; and
                         `true`, `tangent_line`, `ukf`: `mean_V`, `bias_mV` (mean minus true mean) and `std_mV` of the
                         terminal voltage before the error of its measurement
    sigma_points         `alpha`, `beta`, `kappa` of the default tuning; per point its states, `soc`, `v_rc1_V`..,
                         `v_slow_V`, `r0_error`, `w_mean`, `w_cov`
    positive_definite    `guaranteed`; `r_mV2` and `least_mV2` = r + e^2 (beta + alpha^2 (n + kappa - 1)), what is left
                         of the innovation variance when all that the states explain is taken from it; `e_mV`, the
                         mean shift
    observability        along the curve: `soc`, `docv_dsoc_mV_per_pct`, `soc_sigma`, the sigma of SoC that the voltage
                         error means there, None from 1 up
    step_us              median time of `Estimator.step` here
    verdict              `worth_it`: true if the tangent line is farther off than a voltage is, in its mean or in its
                         sigma, and sigma points are less so; judged at the soc_sigma `judged_at`, the medium one, or
                         the small one if only that keeps the belief within 0..1; both None if neither does. `text`
                         says why

    Raises ConfigError, naming the option, for what cannot be diagnosed.
    """
    _require("--soc", soc, 0 <= soc <= 1, "a SoC in 0..1")
    _require("--sigma", sigma, 0 < sigma <= SOC_SIGMA_MAX, f"a SoC sigma above 0, at most {SOC_SIGMA_MAX:g}")
    low, high = cell.cell.temperature_limits_degC
    _require("--temperature", temperature_degC, low <= temperature_degC <= high, f"{low:g}..{high:g} degC, the cell's")

    tuning, curve = Tuning(), Curve(cell, temperature_degC)
    noise_var_V2, fast_var_V2, slow_var_V2, r0_var = (
        curve.params[place].item()
        for place in (layout.P_VAR_VOLTAGE, layout.P_FAST_VAR, layout.P_SLOW_VAR, layout.P_R0_VAR)
    )
    voltages_V = [*voltage_sigmas(cell), math.sqrt(slow_var_V2)]
    sigmas = [*voltages_V, math.sqrt(r0_var)]  # of the states beside SoC
    error_V = math.hypot(math.sqrt(noise_var_V2), math.sqrt(fast_var_V2), *voltages_V)
    weights = unscented.scaled(1 + len(sigmas), tuning.alpha, tuning.beta, tuning.kappa)
    bias = {name: _bias(curve, soc, times * sigma, sigmas, weights) for name, times in SIZES.items()}
    points = unscented.sigma_points([soc] + [0] * len(sigmas), np.diag([sigma, *sigmas]) ** 2, weights.spread)
    return {
        "cell": cell.cell.name,
        "soc": soc,
        "soc_sigma": sigma,
        "temperature_degC": temperature_degC,
        "voltage_error_mV": 1e3 * error_V,
        "bias": [
            {
                "size": name,
                "update": "components" if row["soc_sigma"] > tuning.wide_soc_sigma else "sigma points",
                **row,
            }
            for name, row in bias.items()
        ],
        "sigma_points": {
            **{name: getattr(tuning, name) for name in ("alpha", "beta", "kappa")},
            **{name: points[:, j].tolist() for j, name in enumerate(state_names(cell))},
            "w_mean": weights.w_mean.tolist(),
            "w_cov": weights.w_cov.tolist(),
        },
        "positive_definite": _positive_definite(
            1 + len(sigmas),
            1e3 * (bias["medium"]["ukf"]["mean_V"] - curve.at(soc)),
            1e6 * (noise_var_V2 + fast_var_V2),
            tuning,
        ),
        "observability": [_observability(curve, at, error_V) for at in np.linspace(0, 1, SLOPE_POINTS).tolist()],
        "step_us": _step_us(cell, curve.at(soc), temperature_degC),
        "verdict": _verdict([bias["medium"], bias["small"]], 1e3 * error_V),
    }


class Curve:
    """The OCV of a cell at one temperature, as the kernel has it."""

    def __init__(self, cell: CellParams, temperature_degC: float) -> None:
        self.params = params(cell, Tuning())
        self._temperature_degC = temperature_degC

    def at(self, soc: float) -> float:
        return entry.ocv()(self.params.ctypes.data, soc, self._temperature_degC)

    def voltage(self, x: Array) -> Array:
        """(m,) terminal voltages at rest, V, of points: SoC alone, or all states, of which the last is the r0 error."""
        ocv = np.array([self.at(soc) for soc in x[:, 0].tolist()])
        return np.asarray(ocv - x[:, 1:-1].sum(axis=1))


def _require(option: str, value: float, fine: bool, expected: str) -> None:
    if not fine:
        raise ConfigError(option, value=value, expected=expected)


def _bias(curve: Curve, soc: float, sigma: float, sigmas: list[float], weights: unscented.Scaled) -> dict[str, Any]:
    mean, covariance = [soc] + [0.0] * len(sigmas), np.diag([sigma, *sigmas]) ** 2
    ocv_mean, ocv_variance = unscented.quadrature(curve.voltage, soc, sigma)
    true = ocv_mean, ocv_variance + np.sum(np.square(sigmas[:-1]))  # the other voltages are linear and independent
    found = {
        "true": true,
        "tangent_line": unscented.tangent_line(curve.voltage, mean, covariance),
        "ukf": unscented.transform(curve.voltage, mean, covariance, weights),
    }
    return {
        "soc_sigma": sigma,
        "outside": _share_above(soc / sigma) + _share_above((1 - soc) / sigma),
        **{
            name: {
                "mean_V": m.item(),
                "bias_mV": 1e3 * (m - true[0]).item(),
                "std_mV": 1e3 * math.sqrt(variance.item()),
            }
            for name, (m, variance) in found.items()
        },
    }


def _share_above(sigmas: float) -> float:
    return math.erfc(sigmas / math.sqrt(2)) / 2


def _positive_definite(n: int, e_mV: float, r_mV2: float, tuning: Tuning) -> dict[str, Any]:
    factor = tuning.beta + tuning.alpha**2 * (n + tuning.kappa - 1)
    return {"guaranteed": factor >= 0, "r_mV2": r_mV2, "e_mV": e_mV, "least_mV2": r_mV2 + e_mV**2 * factor}


def _observability(curve: Curve, soc: float, error_V: float) -> dict[str, Any]:
    _, slope_squared = unscented.tangent_line(curve.voltage, soc, 1.0)
    slope_V = math.sqrt(slope_squared.item())
    return {
        "soc": soc,
        "docv_dsoc_mV_per_pct": 10 * slope_V,
        "soc_sigma": error_V / slope_V if slope_V > error_V else None,
    }


def _step_us(cell: CellParams, voltage_V: float, temperature_degC: float) -> float:
    estimator, out = Estimator(cell), Estimate()
    sample = Sample(0, 0.0, voltage_V, temperature_degC)
    rounds = []
    for _ in range(TIMED_ROUNDS):
        start = perf_counter()
        for _ in range(TIMED_STEPS):
            sample.t_ns += 1_000_000_000
            estimator.step(sample, out)
        rounds.append((perf_counter() - start) / TIMED_STEPS * 1e6)
    return statistics.median(rounds)


def _verdict(rows: list[dict[str, Any]], error_mV: float) -> dict[str, Any]:
    """Judge the first of `rows` that lies within 0..1."""
    within = [row for row in rows if row["outside"] <= MAX_OUTSIDE]
    if not within:
        text = "It cannot be told: much of this belief lies beyond SoC 0..1. "
        text += "Ask with a smaller sigma, or farther from empty and full."
        return {"worth_it": None, "judged_at": None, "text": text}
    row = within[0]
    tangent, ukf = (_errors_mV(row, name) for name in ("tangent_line", "ukf"))
    at = f"At ±{100 * row['soc_sigma']:.2g} % SoC the tangent line of an EKF is {tangent[0]:.2g} mV off in the mean of "
    at += f"the voltage and {tangent[1]:.2g} mV in its sigma; a voltage is good for {error_mV:.2g} mV."
    points = f"Sigma points are {ukf[0]:.2g} mV and {ukf[1]:.2g} mV off."
    worth_it = max(tangent) > error_mV and max(ukf) < max(tangent)
    if worth_it:
        text = f"Yes. {at} {points}"
    elif max(tangent) <= error_mV:
        text = f"No. {at} An EKF would do as well here."
    else:
        text = f"Not by sigma points. {at} {points}"
    return {"worth_it": worth_it, "judged_at": row["soc_sigma"], "text": text}


def _errors_mV(row: dict[str, Any], name: str) -> tuple[float, float]:
    """How far mean and sigma are from the true ones."""
    return abs(row[name]["bias_mV"]), abs(row[name]["std_mV"] - row["true"]["std_mV"])
