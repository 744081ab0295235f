"""Chooses what a model has: as many RC pairs, and as much else, as the tests can tell.

One structure after the other is fitted to half of the rows, in alternating blocks, and judged by the other half; the
best is then fitted to all. A parameter that comes out with an error larger than itself is left out again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_ukf.identify import dynamics, ocv, uncertainty
from bms_ukf.identify.dynamics import KEPT, ROWS, Model, fit, with_core
from bms_ukf.identify.samples import Samples, at
from bms_ukf.identify.tables import CORES, Structure

Array = NDArray[np.float64]
Progress = Callable[[str], None]

BLOCK_SHARE = 1 / 24  # of a test, for the blocks that are left out in turn
WORTH_IT = 0.99  # share of the error on rows left out that another pair may leave at most
CORE_WORTH_IT = 0.985  # that a core may leave of the drives': it also takes up what other parts of the model lack


@dataclass(slots=True)
class Tried:
    """A structure fitted to half of the rows, and its squared errors on the others by test and block."""

    model: Model
    squares: list[Array]


def identify(tests: Sequence[Samples], slow: ocv.Slow, progress: Progress = lambda _: None) -> Model:
    """The best model of the tests, given their OCV."""
    hysteresis = _has_hysteresis(slow)

    def build(structure: Structure) -> Model:
        return dynamics.unfitted(structure, tests, slow)

    train, judge = alternate(tests, 0), alternate(tests, 1)
    weights = [ROWS[test.test.role] for test in judge]
    drives = [weight * (test.test.role == "drive") for weight, test in zip(weights, judge, strict=True)]
    held_out_mV: dict[str, float] = {}
    best: Tried | None = None
    for pairs in (1, 2, 3):
        tried = _try(build(Structure(pairs, hysteresis)), train, judge, held_out_mV, progress)
        if best is None or _is_better(tried, best, weights, WORTH_IT):
            best = tried
    assert best is not None
    coreless = best
    for core in CORES:
        # From the same start as the others: from where they ended, it seldom finds its own optimum.
        loaded = build(Structure(coreless.model.unknowns.structure.pairs, hysteresis, core))
        tried = _try(loaded, train, judge, held_out_mV, progress)
        # A pulse from rest has no heat of a load: it would only outvote the drives.
        if _is_better(tried, best, drives if any(drives) else weights, CORE_WORTH_IT):
            best = tried
    chosen: Structure | None = best.model.unknowns.structure
    while chosen is not None:
        progress(f"fitting {chosen} to all")
        if chosen.core is None:
            model = build(chosen)
            if chosen == best.model.unknowns.structure:
                model = best.model
            model = fit(model, tests, evaluations=40, kept=KEPT, ftol=2e-4, uncertain=True)
        else:  # fit the load's heat to what a fit without it leaves, not from where half of the rows led
            without = fit(build(replace(chosen, core=None)), tests, evaluations=15, kept=KEPT)
            model = fit(with_core(without, build(chosen)), tests, evaluations=20, kept=KEPT, ftol=2e-4, uncertain=True)
        chosen = simpler(model)
    # A structure without what is not known was not judged by itself.
    left_out_mV = held_out_mV[str(best.model.unknowns.structure)]
    model.held_out_mV = {str(model.unknowns.structure): left_out_mV} | held_out_mV
    return model


def simpler(model: Model) -> Structure | None:
    """Return the structure without a parameter whose error is larger than itself; None if there is no such parameter.

    A table counts as its median over SoC, and as the temperature at which it is known best.
    """
    structure = model.unknowns.structure
    if model.sigma is None:
        return None
    if structure.core is not None and model.sigma[-2] > abs(model.x[-2]):
        return replace(structure, core=None)
    known = uncertainty.tables(model)
    least = {key: float(np.median(table[:, uncertainty.MIDDLE], axis=1).min()) for key, table in known.items()}
    if structure.pairs > 1 and least[f"r{structure.pairs}_ohm"] > 1:
        return replace(structure, pairs=structure.pairs - 1)
    if structure.knee and least["r0_knee_A"] > 1:
        return replace(structure, knee=False)
    if structure.hysteresis and least["hysteresis_V"] > 1:
        return replace(structure, hysteresis=False)
    return None


def error_mV(model: Model, tests: Sequence[Samples], low: float = 0.1, high: float = 0.9) -> list[float]:
    """Root mean square error on the counted rows between two SoC, for each test; NaN if there are none."""
    found = []
    for test in tests:
        error = (model.simulate(test) - test.voltage_V)[test.counted & (test.soc > low) & (test.soc < high)]
        found.append(1e3 * float(np.sqrt(np.mean(error**2))) if error.size else float("nan"))
    return found


def squares_by_block(model: Model, tests: Sequence[Samples], low: float = 0.1, high: float = 0.9) -> list[Array]:
    """Return the sum of squared errors of each block of each test, V^2, on counted rows between two SoC."""
    found = []
    for test in tests:
        rows = test.counted & (test.soc > low) & (test.soc < high)
        squares = np.where(rows, (model.simulate(test) - test.voltage_V) ** 2, 0.0)
        found.append(np.bincount(_blocks(test), squares).astype(np.float64))
    return found


def gain(new: Sequence[Array], old: Sequence[Array], weights: Sequence[float]) -> tuple[float, float]:
    """Return the mean logarithm over tests of the error of `new` over that of `old`, and its standard error.

    Errors by block, as `squares_by_block` gives them; the blocks of a test are taken for independent.
    """
    change, variance, total = 0.0, 0.0, 0.0
    for ours, theirs, weight in zip(new, old, weights, strict=True):
        if ours.sum() > 0 and theirs.sum() > 0:
            total += weight
            change += weight * 0.5 * float(np.log(ours.sum() / theirs.sum()))
            variance += weight**2 * 0.25 * float(np.sum((ours / ours.sum() - theirs / theirs.sum()) ** 2))
    return (change / total, math.sqrt(variance) / total) if total else (0.0, 0.0)


def _try(
    model: Model, train: Sequence[Samples], judge: Sequence[Samples], held_out_mV: dict[str, float], progress: Progress
) -> Tried:
    name = str(model.unknowns.structure)
    progress(f"trying {name}")
    model = fit(model, train, evaluations=15, kept=KEPT // 2)
    # The geometric mean: a hard test must not outvote the others.
    held_out_mV[name] = float(np.exp(np.nanmean(np.log(error_mV(model, judge)))))
    return Tried(model, squares_by_block(model, judge))


def _is_better(tried: Tried, best: Tried, weights: Sequence[float], worth_it: float) -> bool:
    """Return whether the error on rows left out is smaller by what is worth it, and by more than chance."""
    change, error = gain(tried.squares, best.squares, weights)
    return change < min(math.log(worth_it), -error)


def alternate(tests: Sequence[Samples], phase: int) -> list[Samples]:
    """The tests with every other block of their counted rows counting."""
    return [at(test, test.counted & (_blocks(test) % 2 == phase)) for test in tests]


def _blocks(test: Samples) -> NDArray[np.int64]:
    """Number of the block that each row of a test is in."""
    time_s = test.time_s
    return np.asarray((time_s / (BLOCK_SHARE * float(time_s[-1]))).astype(np.int64))


def _has_hysteresis(slow: ocv.Slow) -> bool:
    """Whether the branches are further apart than the resistance of a cell explains, near 25 degC."""
    half = slow.half_width_V
    if half is None:
        return False
    current_A = min(curve.current_A for curve in slow.curves)
    plateau = (ocv.SOC > 0.1) & (ocv.SOC < 0.9)
    return bool(np.median(half[plateau]) > 2 * current_A * 0.1 / slow.capacity_Ah)
