"""How far an identified model is to be trusted: the [noise] of a cell file, from the residuals of tests never fitted.

The estimator takes the voltage error e of the model to be white noise plus two Ornstein-Uhlenbeck processes carried by
its RC states, with relative parts that grow with the current. Over a stretch of driving, with mean <.>, it expects

    <e(t) e(t + L)> = [L = 0] (voltage_sigma^2 + r0_rel_sigma^2 <(r0 i)^2>)
                      + sum_j exp(-L / tau_j) (v_rcj_sigma^2 + rc_rel_sigma^2 <p_j>)

where p_j is (r_j i)^2 passed through a low-pass of time constant tau_j / 2: the variance that the estimator's process
noise q_j = (1 - exp(-2 dt / tau_j)) (v_rcj_sigma^2 + (rc_rel_sigma r_j i)^2) builds up. The squares of the five sigmas
are the non-negative least-squares solution over all stretches and lags. Each stretch is weighted by the <e^2> that the
solution itself expects of it (iterated): weighted by its own, the luckiest stretches would rule, and the sigmas come
out too small. At last they are scaled to cover nine stretches of ten: errors are not spread evenly over a drive, and a
filter that is told their mean is too sure where they are large.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from ecm_fit import Array, Recording, Tables, lowpass
from scipy.optimize import nnls

STRETCH = 900  # rows of 1 s: longer than the slow time constant, shorter than a change of SoC that matters
LAGS = np.array([0, 1, 2, 5, 10, 20, 50, 100, 200, 400])
HELD = 0.9  # the share of the stretches whose <e^2> the sigmas shall cover
FLOOR_V = 5e-4  # no voltage model is better than this on a real cell


class Noise(NamedTuple):
    voltage_sigma_V: float
    r0_rel_sigma: float
    v_rc1_sigma_V: float
    v_rc2_sigma_V: float
    rc_rel_sigma: float


def estimate_noise(recordings: Sequence[Recording], tables: Tables, ocv: Callable[[Array], Array]) -> Noise:
    """The [noise] values that explain the residuals of `tables` on recordings with 1 s rows."""
    rows, seen = [], []
    for record in recordings:
        error = tables.simulate(record, ocv) - record.voltage_V
        r0, r1, r2 = tables.resistances(record)
        r0_i, r1_i, r2_i = r0 * tables.bent_current(record), r1 * record.current_A, r2 * record.current_A
        p1, p2 = (
            lowpass(np.exp(-2 * record.step_s / tau), (x**2)[:, None])[:, 0]
            for x, tau in zip((r1_i, r2_i), tables.tau_s, strict=True)
        )
        for start in range(0, len(error) - STRETCH, STRETCH):
            part = slice(start, start + STRETCH)
            e = error[part]
            covariance = np.array([np.mean(e[: STRETCH - lag] * e[lag:]) for lag in LAGS])
            now = (LAGS == 0).astype(float)
            fade1, fade2 = (np.exp(-LAGS / tau) for tau in tables.tau_s)
            relative = fade1 * p1[part].mean() + fade2 * p2[part].mean()
            rows.append(np.stack([now, now * np.mean(r0_i[part] ** 2), fade1, fade2, relative], axis=1))
            seen.append(covariance)
    a, b = np.array(rows), np.array(seen)
    squares = np.zeros(5)
    for _ in range(30):
        weight = 1 / np.maximum(a[:, :1] @ squares, FLOOR_V**2)
        weighted = (a * weight[:, :, None]).reshape(-1, 5)
        unit = np.sqrt(np.mean(weighted**2, axis=0))
        squares = nnls(weighted / unit, (b * weight).ravel())[0] / unit
    squares *= np.quantile(b[:, 0] / (a[:, 0] @ squares), HELD)
    white, r0_rel, slow1, slow2, rc_rel = np.sqrt(squares)
    volts = [round(max(float(x), FLOOR_V), 4) for x in (white, slow1, slow2)]
    return Noise(volts[0], round(float(r0_rel), 3), volts[1], volts[2], round(float(rc_rel), 3))
