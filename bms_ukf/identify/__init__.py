"""From measured tests of a cell to its cell file.

`run` is the whole recipe: read and check the tests, open-circuit voltage from the slow ones, dynamics by open-loop
simulation of the others, noise from errors on tests that were not fitted, and the cell file checked as it will be
loaded.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bms_ukf import measured, toml
from bms_ukf.cell import CellParams
from bms_ukf.identify import (
    beyond,
    cellfile,
    choice,
    dynamics,
    errorbar,
    noise,
    ocv,
    ocv_rests,
    ocv_table,
    openloop,
    rests,
    samples,
    warn,
)
from bms_ukf.identify.samples import Samples
from bms_ukf.identify.tables import Structure
from bms_ukf.manifest import Manifest, MeasuredTest
from bms_ukf.recordings import Recording


@dataclass(slots=True)
class Identified:
    """A cell file and what there is to know of how it came about."""

    tests: Manifest
    text: str  # the cell file
    cell: CellParams
    model: dynamics.Model
    slow: ocv.Slow
    rows: beyond.Extended  # of the cell file's tables
    predictions: dict[str, list[openloop.Prediction]]  # of the cell file, by "fit" and "validate"
    warnings: list[str] = field(default_factory=list)


def run(
    path: Path, progress: Callable[[str], None] = lambda _: None, tests: Sequence[MeasuredTest] | None = None
) -> Identified:
    """Return the cell file of the manifest at `path`, or of some of its `tests` only.

    Raises ConfigError for data that cannot be used.
    """
    with threadpool_limits(1, user_api="blas"):  # its threads wait for each other: ten times slower on a busy machine
        manifest = Manifest.load(path)
        return _run(path, manifest if tests is None else manifest.model_copy(update={"test": list(tests)}), progress)


def _run(path: Path, tests: Manifest, progress: Callable[[str], None]) -> Identified:
    slow, chosen, efficiency, warnings = load(path, tests, progress)
    fitted = chosen["fit"]
    model = choice.identify(fitted, slow, progress) if fitted else dynamics.unfitted(Structure(2), fitted, slow)
    progress("noise and checks")
    rows = beyond.Extended(model)
    found = cellfile.sections(tests, rows, slow, fitted, efficiency)
    draft = _loaded(found | {"noise": _draft_noise(model)}, path)
    judged = {use: [openloop.predict(draft, test) for test in group] for use, group in chosen.items()}
    found["noise"] = rows.noise(_noise(judged, model, found))
    progress("error bar")
    drafted = _loaded(found, path)
    drives = [test for test in chosen["validate"] or fitted if test.test.role != "pulse"]
    factor = errorbar.factor(drafted, drives)
    found["noise"] |= errorbar.grown(drafted, factor)
    rmse_mV = {
        use: {_label(test): round(1e3 * seen.rmse_V(), 1) for test, seen in zip(group, judged[use], strict=True)}
        for use, group in chosen.items()
    }
    found |= cellfile.provenance(path, tests, model.held_out_mV, rmse_mV) | rows.provenance(slow)
    title = f"{tests.cell}: {tests.chemistry}, identified from measured tests; bms_ukf/cell.py explains every key."
    text = cellfile.to_toml(found, title)
    warnings += warn.about(model, slow, chosen, judged)
    return Identified(tests, text, _loaded(found, path), model, slow, rows, judged, warnings)


def load(
    path: Path, tests: Manifest, progress: Callable[[str], None] = lambda _: None
) -> tuple[ocv.Slow, dict[str, list[Samples]], float, list[str]]:
    """All tests of a manifest: the slow ones analysed, the others sampled by use; charge efficiency; warnings."""
    recordings: list[tuple[MeasuredTest, Recording]] = []
    tables, warnings = [], []
    for test in tests.test:
        progress(f"reading {Path(test.file).name}")
        if test.role == "ocv_table":
            curve, doubts = ocv_table.load(path, test)
            tables.append(curve)
        else:
            recordings.append((test, measured.load(path, tests, test)))
            doubts = recordings[-1][1].warnings
        warnings += doubts
    progress("open-circuit voltage")
    moving = [pair for pair in recordings if pair[0].role != "ocv"]
    still = [pair for pair in recordings if pair[0].role == "ocv"]
    if still or tables:
        slow = ocv.analyse(tests, still, str(path), tables)
        slow = ocv_rests.reconcile(slow, ocv_rests.found(_counted(moving, slow.capacity_Ah)))
    else:
        slow = _from_rests(tests, moving, path)
    warnings += slow.warnings
    efficiency = (
        samples.coulombic_efficiency([pair for pair in moving if pair[0].use == "fit"], slow.capacity_Ah) or 1.0
    )
    chosen: dict[str, list[Samples]] = {"fit": [], "validate": []}
    for test, recording in moving:
        if test.initial_soc == "rest":
            soc, doubts = rests.counted_soc(recording, test, slow, efficiency)
            warnings += doubts
        else:
            soc = samples.counted_soc(recording, test, slow.capacity_Ah, efficiency)
        warnings += warn.about_count(recording, test, soc, str(path))
        chosen[test.use].append(samples.sample(recording, test, soc, tests.voltage_limits_V[0]))
    return slow, chosen, efficiency, warnings


def _from_rests(tests: Manifest, moving: list[tuple[MeasuredTest, Recording]], path: Path) -> ocv.Slow:
    pulses = [pair for pair in moving if pair[0].role == "pulse"]
    drawn_Ah = ocv_rests.drawn_from_full(tests, [pair for pair in pulses if pair[0].use == "fit"])
    capacity_Ah = tests.capacity_Ah or drawn_Ah or 1.0  # `from_rests` refuses a manifest without a capacity
    slow = ocv_rests.from_rests(tests, _counted(pulses, capacity_Ah), str(path), tests.capacity_Ah or drawn_Ah)
    if tests.capacity_Ah is None:
        slow.warnings.append(f"capacity_Ah is the {capacity_Ah:.4g} Ah that the pulse test drew from full to empty")
    return slow


def _counted(
    moving: list[tuple[MeasuredTest, Recording]], capacity_Ah: float
) -> list[tuple[MeasuredTest, Recording, NDArray[np.float64]]]:
    """Return the tests to fit whose SoC does not come from the OCV, with that SoC."""
    fair = [(test, recording) for test, recording in moving if test.use == "fit" and test.initial_soc != "rest"]
    return [(test, recording, samples.counted_soc(recording, test, capacity_Ah, 1.0)) for test, recording in fair]


def _noise(
    judged: dict[str, list[openloop.Prediction]], model: dynamics.Model, found: dict[str, Any]
) -> dict[str, Any]:
    """From tests never fitted; without any, from the fitted ones, enlarged as rows left out of the choice tell."""
    pairs = model.unknowns.structure.pairs
    if not any(judged.values()):
        return _assumed_noise(model)
    if judged["validate"] or not model.held_out_mV:
        values = noise.estimate(judged["validate"], pairs)
    else:
        seen_mV = float(np.nanmean([1e3 * prediction.rmse_V() for prediction in judged["fit"]]))
        left_out_mV = model.held_out_mV[str(model.unknowns.structure)]
        values = noise.estimate(judged["fit"], pairs, factor=max(1.5, left_out_mV / max(seen_mV, 0.1)))
    seen = [prediction for group in judged.values() for prediction in group]
    where = noise.error_map(seen, values, model.unknowns.temperature_degC.tolist())
    if "hysteresis" in found:
        values["hysteresis_sigma_V"] = round(max(0.3 * float(np.median(found["hysteresis"]["max_V"])), 5e-4), 4)
    return {**values, **where}


def _assumed_noise(model: dynamics.Model) -> dict[str, float]:
    """Return the noise of resistances that nobody measured: wrong by up to a factor."""
    values = dict.fromkeys(("r0_rel_sigma", "rc_rel_sigma"), noise.MOST_REL)
    return _draft_noise(model) | values


def _draft_noise(model: dynamics.Model) -> dict[str, float]:
    """Something to load the file with before its noise is known."""
    pairs = model.unknowns.structure.pairs
    values = {"voltage_sigma_V": 0.01, "r0_rel_sigma": 0.1, "rc_rel_sigma": 0.1}
    values |= {f"v_rc{j + 1}_sigma_V": 0.01 for j in range(pairs)}
    return values | ({"hysteresis_sigma_V": 0.01} if model.unknowns.structure.hysteresis else {})


def _loaded(found: dict[str, dict[str, Any]], path: Path) -> CellParams:
    """The sections as the cell file they will be."""
    return toml.validate(tomllib.loads(cellfile.to_toml(found, "draft")), CellParams, f"the cell file from {path.name}")


def _label(test: Samples) -> str:
    first, last = test.test.part
    whole = (first, last) == (0.0, 1.0)
    return test.name if whole else f"{test.name} {100 * first:.0f}-{100 * last:.0f} %"
