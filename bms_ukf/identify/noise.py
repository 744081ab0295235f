"""How far an identified model is to be trusted: the [noise] of a cell file, from its errors.

The estimator takes the voltage error e of the model to be white noise plus an Ornstein-Uhlenbeck process in each of
its RC states, with relative parts that grow with the current. Over a stretch of driving, with mean <.>, it expects

    <e(t) e(t + L)> = [L = 0] (voltage_sigma^2 + r0_rel_sigma^2 <(r0 i)^2>)
                      + sum_j exp(-L / tau_j) (v_rcj_sigma^2 + rc_rel_sigma^2 <p_j>)

where p_j is (r_j i)^2 passed through a low-pass of time constant tau_j / 2: the variance that the estimator's process
noise builds up. The squares of the sigmas are the non-negative least-squares solution over all stretches and lags,
each stretch weighted by the <e^2> that the solution itself expects of it (iterated). At last they are scaled to cover
nine stretches of ten: errors are not spread evenly over a drive, and a filter that is told their mean is too sure where
they are large. What even the best stretches show is an error of the OCV, made by no current: the slowest pair has it.

Where in SoC and temperature the errors are larger than these sigmas expect, `error_map` has by how much.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from bms_ukf.identify.openloop import Prediction
from bms_ukf.identify.simulate import lowpass

Array = NDArray[np.float64]

STEP_S = 1.0
STRETCH = 900  # rows: longer than the fast pairs' memory, shorter than a change of SoC that matters
LAGS = np.array([0, 1, 2, 5, 10, 20, 50, 100, 200, 400])
HELD = 0.9  # the share of the stretches whose <e^2> the sigmas shall cover
BEST = 0.2  # the share of the stretches that count as the best
FLOOR_V = 1e-3  # no voltage model is better than this on a real cell
MAP_SOC = np.array([0.0, 0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95, 1.0])
MAP_ROW_S = 600.0  # of an error that is worth one observation
MAP_MOST = 8.0
MOST_V, MOST_REL = 0.3, 0.5  # more says that the tests did not show the thing at all


def estimate(predictions: Sequence[Prediction], pairs: int, *, factor: float = 1.0) -> dict[str, float]:
    """The [noise] values that explain the errors between 10 and 90 % SoC, each error multiplied by `factor`."""
    expected, seen = [], []
    for prediction in predictions:
        rows, covariances = _stretches(prediction, pairs, factor)
        expected += rows
        seen += covariances
    if not expected:
        spread = max(factor * max((p.rmse_V() for p in predictions), default=0.01), FLOOR_V)
        return _named(np.array([spread, 0.05, *[spread] * pairs, 0.1]), pairs)
    a, b = np.array(expected), np.array(seen)
    squares = np.zeros(a.shape[2])
    for _ in range(30):
        weight = 1 / np.maximum(a[:, :1] @ squares, FLOOR_V**2)
        weighted = (a * weight[:, :, None]).reshape(-1, a.shape[2])
        unit = np.sqrt(np.mean(weighted**2, axis=0)) + 1e-30
        squares = nnls(weighted / unit, (b * weight).ravel())[0] / unit
    squares *= np.quantile(b[:, 0] / np.maximum(a[:, 0] @ squares, FLOOR_V**2), HELD)
    sigmas = np.sqrt(squares)
    sigmas[1 + pairs] = max(sigmas[1 + pairs], float(np.sqrt(np.quantile(b[:, 0], BEST))))
    return _named(sigmas, pairs)


def error_map(
    predictions: Sequence[Prediction], sigmas: dict[str, float], temperature_degC: Sequence[float]
) -> dict[str, Array]:
    """By how much the errors of the tests exceed what `sigmas` expect, over SoC and the `temperature_degC` seen.

    Returns `soc, temperature_degC, error_scale` of a cell file's [noise]; the scale is never below 1, and the nearer to
    1 the less was seen.
    """
    rows = np.array(sorted(temperature_degC))
    times, count = np.zeros((2, rows.size, MAP_SOC.size))
    for prediction in predictions:
        places = nearest(rows, prediction.temperature_degC), nearest(MAP_SOC, prediction.soc)
        weight = prediction.counted * prediction.step_s / MAP_ROW_S
        np.add.at(times, places, weight * prediction.error_V**2 / _variance(prediction, sigmas))
        np.add.at(count, places, weight)
    scale = np.sqrt((times + 1) / (count + 1)).clip(1.0, MAP_MOST).round(2)
    known = count.sum(axis=1) > 0
    return {"soc": MAP_SOC, "temperature_degC": rows[known], "error_scale": scale[known]}


def nearest(knots: Array, x: Array) -> NDArray[np.intp]:
    """Index of the knot nearest to each x."""
    return np.asarray(np.argmin(np.abs(np.asarray(x)[:, None] - knots), axis=1))


def _variance(prediction: Prediction, sigmas: dict[str, float]) -> Array:
    """Of the voltage error at every row, as the estimator expects it, V^2."""
    variance = sigmas["voltage_sigma_V"] ** 2 + (sigmas["r0_rel_sigma"] * prediction.ohmic_V) ** 2
    for j, (r, tau) in enumerate(zip(prediction.r_ohm, prediction.tau_s, strict=True)):
        power = lowpass(prediction.step_s, (r * prediction.current_A) ** 2, float(np.median(tau)) / 2)
        variance = variance + sigmas[f"v_rc{j + 1}_sigma_V"] ** 2 + sigmas["rc_rel_sigma"] ** 2 * power
    return np.asarray(variance)


def _stretches(prediction: Prediction, pairs: int, factor: float) -> tuple[list[Array], list[Array]]:
    """For each stretch on a grid of one second: what the sigmas expect at every lag, and what was seen."""
    time_s = np.cumsum(prediction.step_s)
    grid_s = np.arange(time_s[0], time_s[-1], STEP_S)
    take = np.clip(np.searchsorted(time_s, grid_s), 0, time_s.size - 1)
    fair = (prediction.counted & (prediction.soc > 0.1) & (prediction.soc < 0.9))[take]
    error_V = factor * prediction.error_V[take]
    rows, covariances = [], []
    ohmic = prediction.ohmic_V[take] ** 2
    power = [
        lowpass(prediction.step_s, (r * prediction.current_A) ** 2, float(np.median(tau)) / 2)[take]
        for r, tau in zip(prediction.r_ohm, prediction.tau_s, strict=True)
    ]
    for start in range(0, grid_s.size - STRETCH, STRETCH):
        part = slice(start, start + STRETCH)
        if not fair[part].all():
            continue
        e = error_V[part]
        covariances.append(np.array([np.mean(e[: STRETCH - lag] * e[lag:]) for lag in LAGS]))
        now = (LAGS == 0).astype(float)
        fades = [np.exp(-LAGS / np.mean(tau[take][part])) for tau in prediction.tau_s]
        relative = sum(fade * p[part].mean() for fade, p in zip(fades, power, strict=True))
        rows.append(np.stack([now, now * ohmic[part].mean(), *fades, relative], axis=1))
    return rows, covariances


def _named(sigmas: Array, pairs: int) -> dict[str, float]:
    volts = np.clip(sigmas[[0, *range(2, 2 + pairs)]], FLOOR_V, MOST_V).round(4)
    named = {"voltage_sigma_V": float(volts[0]), "r0_rel_sigma": round(min(float(sigmas[1]), MOST_REL), 3)}
    named |= {f"v_rc{j + 1}_sigma_V": float(volts[1 + j]) for j in range(pairs)}
    return named | {"rc_rel_sigma": round(min(float(sigmas[-1]), MOST_REL), 3)}
