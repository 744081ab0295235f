"""The kernel under what no test would think of: random loads, clocks, outliers, freezes, gaps and saturations.

`python -m soak 1e8` (see `make soak`) does 1e8 steps in float64 and as many in float32, spread over cells of every
form, and prints what was met; anything wrong ends it with exit code 1 and says with which seed.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import synthetic_cell
from drives import CELL, variant

from bms_ukf import CellParams, Estimator, Fault, SensorSpec, Tuning
from bms_ukf.kernel.params import SOC_SIGMA_MAX, SOC_SIGMA_MIN, Precision

CHUNK = 10_000


PERFECT = SensorSpec(voltage_offset_V=0.0, voltage_gain=0.0, current_gain=0.0, temperature_K=0.0, skew_s=0.0)


def cells() -> dict[str, tuple[CellParams, Tuning]]:
    """Cells and tunings whose filters have all the forms there are."""
    everything = variant(3, hysteresis=True, core=True)
    return {
        "LG M50": (CellParams.load("lgm50_chen2020"), Tuning()),
        "synthetic": (CELL, Tuning()),
        "classic alpha or 0.1": (CELL, Tuning(alpha=0.1)),
        "LFP plateau with hysteresis": (synthetic_cell.cell_of(synthetic_cell.plateau()), Tuning()),
        "3 RC, hysteresis, bias, core": (everything, Tuning(current_bias=True)),
        "trusting sensors": (
            CELL,
            Tuning(sensor_spec=PERFECT, voltage_noise_V=0.0, capacity_doubt=0.0, initial_soc_sigma=0.5),
        ),
    }


def inputs(cell: CellParams, rng: np.random.Generator, soc: float) -> tuple[np.ndarray, ...]:
    """dt, current, voltage and temperature of CHUNK steps from `soc` on, many spoilt in every way; and the SoC left."""
    charge, discharge = cell.cell.current_limits_A
    dt = rng.choice([0.0, 1e-4, 0.01, 0.1, 1.0, 1.0, 1.0, 10.0]) * rng.choice([1.0, rng.uniform(0.5, 1.5)], CHUNK)
    dt[rng.random(CHUNK) < 1e-3] = rng.choice([60.0, 3600.0, 1e6])
    current = rng.uniform(charge, discharge) * np.abs(np.sin(np.arange(CHUNK) / rng.uniform(5, 2000)))
    current += rng.normal(0, 0.2 * discharge, CHUNK) * (rng.random(CHUNK) < 0.5)
    if rng.random() < 0.2:
        current[:] = 0.0
    capacity = 3600 * cell.cell.capacity_Ah
    path = np.clip(soc - np.cumsum(current * np.minimum(dt, 10.0)) / capacity, 0, 1)
    ohm = sum(float(cell.dynamics_at(0.5, 25.0)[key]) for key in ("r0_ohm", "r1_ohm"))
    voltage = cell.ocv_V(path, 25.0) - ohm * current + rng.normal(0, rng.choice([0.0, 1e-3, 2e-2]), CHUNK)
    outliers = rng.random(CHUNK) < 0.01
    voltage[outliers] += rng.choice([-0.3, 0.3], outliers.sum())
    temperature = np.clip(25 + np.cumsum(rng.normal(0, 0.05, CHUNK)), -30, 60)
    if rng.random() < 0.4:
        return dt, current, voltage, temperature, path[-1]
    for column, extreme in ((current, 1e3), (voltage, 1e2), (temperature, 1e3)):
        spikes = rng.random(CHUNK) < rng.choice([0.0, 1e-3, 0.1])
        column[spikes] = rng.choice([np.nan, np.inf, -np.inf, 0.0, extreme, -extreme], spikes.sum())
        if rng.random() < 0.3:  # a sensor that freezes, or falls silent
            first = rng.integers(CHUNK)
            column[first : first + rng.integers(1, CHUNK)] = rng.choice([column[first], np.nan])
    return dt, current, voltage, temperature, path[-1]


def soak(cell: CellParams, tuning: Tuning, precision: Precision, steps: int, seed: int) -> dict[str, float]:
    """Step through at least `steps` spoilt samples. AssertionError, naming the seed, for anything that may not be.

    SoC and sigma are looked at after every step, the root of the covariance after every CHUNK.
    """
    rng = np.random.default_rng(seed)
    estimator = Estimator(cell, tuning=tuning, precision=precision)
    m, soc, t_ns = estimator._form, 0.8, 0
    met = {"steps": 0, "refused voltages": 0, "gaps": 0, "invalid": 0}
    while met["steps"] < steps:
        dt, current, voltage, temperature, soc = inputs(cell, rng, soc)
        t = t_ns + np.cumsum(np.round(dt * 1e9)).astype(np.int64)
        t_ns = int(t[-1])
        got = estimator.replay(t, current, voltage, temperature)
        where = f"seed {seed}, {precision}, after {met['steps']} steps"
        shown = got["status"] != 0
        sigma = got["soc_sigma"][shown]
        sigma, published = sigma[np.isfinite(sigma)], got["soc"][np.isfinite(got["soc"])]
        slack = 1 + 1e-6  # of float32's own rounding of the bounds
        assert not (got["faults"] & Fault.NUMERIC).any(), where
        # Of a belief that an end of SoC cuts off, less is left than its own sigma.
        assert ((sigma > 0) & (sigma <= SOC_SIGMA_MAX * slack)).all(), where
        assert ((published >= 0) & (published <= 1)).all(), where
        if shown[-1]:
            belief = estimator._state[0, m.x : m.carry, 0]
            diagonal = belief[[m.n + j * (j + 3) // 2 for j in range(m.n)]]
            assert np.isfinite(belief).all(), where
            assert SOC_SIGMA_MIN / slack <= belief[m.n] <= SOC_SIGMA_MAX * slack, where
            assert (diagonal > 0).all(), where
        met["steps"] += CHUNK
        met["refused voltages"] += int(((got["faults"] & Fault.INNOVATION_REJECTED) != 0).sum())
        met["gaps"] += int(((got["faults"] & Fault.CURRENT_MISSING) != 0).sum())
        met["invalid"] += int((got["status"] == 3).sum())
    return met


def main() -> int:
    steps = int(float(sys.argv[1])) if len(sys.argv) > 1 else 100_000_000
    for precision in ("f64", "f32"):
        for number, (name, (cell, tuning)) in enumerate(cells().items()):
            started = time.monotonic()
            try:
                met = soak(cell, tuning, precision, steps // len(cells()), seed=1000 + number)
            except AssertionError as failed:
                sys.stdout.write(f"{precision} {name}: FAILED, {failed}\n")
                return 1
            seconds = time.monotonic() - started
            counts = ", ".join(f"{count:.3g} {what}" for what, count in met.items())
            sys.stdout.write(f"{precision} {name}: {counts}; {seconds:.0f} s\n")
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
