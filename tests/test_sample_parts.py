"""The parts of a sample: a bus brings current, voltages and temperatures one after the other, of one time.

The current closes the interval that ends then, and tables are read at the temperature of then. So the current, and a
temperature that changes, come with the first part; how all else is split, and in which order, makes no difference.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from drives import drive, variant

from bms_ukf import Estimate, Estimator, Sample, Tuning
from bms_ukf.kernel import layout

NAN = math.nan
NEVER = 1 << 62
STEPS = 700
FORMS = {
    "two RC pairs, a bias": (variant(2, False), Tuning()),
    "one RC pair, no bias": (variant(1, False), Tuning(current_bias=False)),
    "hysteresis": (variant(2, True), Tuning(initial_soc=0.6, initial_soc_sigma=0.1)),
    "all there is": (variant(3, True, core=True), Tuning()),
}
# Not r0_ohm: a part after the voltage shows the table of the SoC that the voltage has found.
SHOWN = ["soc", "soc_sigma", "soc_low", "soc_high", "age_s"]
HELD = [name for name in vars(layout) if name.startswith("H_") and name not in ("H_GAP_S", "H_PART_WALK", "H_SOC_WALK")]


def samples(cells: int, seed: int, troubled: bool) -> Iterator[Sample]:
    """A drive with a rest that shows the offset; `troubled`: with sensors silent or wrong for a minute, too."""
    rng = np.random.default_rng(seed)
    t_ns = 0
    for k, (dt, current, voltage, degC) in enumerate(drive(STEPS, varying_dt=True, seed=seed)):
        t_ns += round(dt * 1e9)
        wrong = 0.25 if troubled and 330 <= k < 370 else 0.0
        voltages = voltage + wrong + 0.003 * rng.standard_normal(cells)
        if k > 0:
            voltages[rng.random(cells) < 0.1] = NAN
        silent = (troubled and 200 <= k < 280) or (k > 0 and rng.random() < 0.03)
        rests = 480 <= k < 620
        open_circuit = rests and k % 7 == 0
        if open_circuit:  # it shows the offset, which moves SoC a little: a voltage after it has another table row
            voltages[:] = NAN
        yield Sample(
            t_ns,
            NAN if silent else 0.001 if rests else current,
            float(voltages[0]) if cells == 1 else voltages,
            NAN if k > 0 and rng.random() < 0.2 else degC,
            open_circuit=open_circuit,
        )


def split(whole: Sample, cells: int, rng: np.random.Generator) -> Iterator[Sample]:
    """The parts of a sample: first the current and the temperature, alone or with some of the voltages."""
    heard = ~np.isnan(np.atleast_1d(whole.voltage_V))
    part_of = np.where(heard, rng.integers(0, 4, cells), -1)
    first = True
    for part in (0, *rng.permutation([1, 2, 3])):
        here = part_of == part
        if first or here.any() or rng.random() < 0.3:
            voltage = np.where(here, whole.voltage_V, NAN)
            yield Sample(
                whole.t_ns,
                whole.current_A if first else NAN,
                float(voltage[0]) if cells == 1 else voltage,
                # The held temperature again is no change.
                whole.temperature_degC if first or rng.random() < 0.5 else NAN,
                open_circuit=whole.open_circuit and first,
            )
        first = False


def held(estimator: Estimator) -> dict[str, np.ndarray]:
    return {name: estimator._state[:, getattr(layout, name)] for name in HELD}


@pytest.mark.parametrize("cells", [1, 18])
@pytest.mark.parametrize("form", FORMS)
def test_however_a_sample_is_split_the_estimate_is_that_of_the_whole(form, cells):
    cell, tuning = FORMS[form]
    with_components = with_gaussians = 0
    for seed, troubled in enumerate([True, False]):
        if not troubled:
            tuning = tuning.model_copy(update={"wide_soc_sigma": 0.2})
        rng = np.random.default_rng(100 + seed)
        whole, parts = Estimator(cell, cells, tuning), Estimator(cell, cells, tuning)
        whole._share_ns = parts._share_ns = NEVER
        for estimator in (whole, parts):  # a table row of a temperature nearby would do, and each may have another
            estimator._params[layout.P_CACHE_TEMPERATURE] = 0.0
        for k, sample in enumerate(samples(cells, seed, troubled)):
            if not troubled and k == 100:  # one Gaussian takes over, as after a sleep
                for estimator in (whole, parts):
                    estimator._state[:, layout.H_PARTS] = 0
            expected = whole.step(sample)
            for part in split(sample, cells, rng):
                got = parts.step(part)
            same(got, expected, k)
            for name, value in held(whole).items():
                np.testing.assert_allclose(held(parts)[name], value, rtol=1e-8, atol=1e-10, err_msg=f"{name} at {k}")
            in_components = whole._state[0, layout.H_PARTS, 0] > 0
            with_components, with_gaussians = with_components + in_components, with_gaussians + (not in_components)
    assert with_components > 100
    assert with_gaussians > 100


def same(got: Estimate, expected: Estimate, k: int) -> None:
    for name in SHOWN:
        values, others = getattr(got, name), getattr(expected, name)
        np.testing.assert_allclose(values, others, rtol=1e-8, atol=1e-10, err_msg=f"{name} at {k}")
