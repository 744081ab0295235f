"""Makes the base traces of the campaign's plants: `python -m bms_ukf.campaign.record [--plant NAME] [--out DIR]`

A plant that is not shipped needs the `plant` extra and a C compiler. Every run gives the same traces.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf import resources
from bms_ukf.campaign import recipes, traces
from bms_ukf.campaign.driving import Leg, drive
from bms_ukf.campaign.plants import PLANTS, CampaignPlant
from bms_ukf.campaign.recipes import AGED_CAPACITY, AGED_RESISTANCE, Recipe
from bms_ukf.campaign.traces import Trace
from bms_ukf.plant import open_plant

LEAD_SOC = 0.2  # by which a cell with hysteresis is charged or discharged before a trace begins


def record(plant: CampaignPlant, recipe: Recipe, fmu: Path | str) -> Trace:
    """Runs a recipe on the FMU of a plant, to the end of its load."""
    parameters, legs = _parameters(plant, recipe, fmu), [Leg(recipe.load, recipe.ambient_degC, recipe.step_s)]
    if plant.hysteresis:
        charged = recipe.soc_initial > 0.5
        parameters["soc_initial"] += -LEAD_SOC if charged else LEAD_SOC
        legs.insert(0, Leg({"segments": _lead(plant, charged, recipe.soc_initial)}, recipe.ambient_degC))
    run = drive(fmu, parameters, *legs)
    empty, full = plant.empty_full
    soc, soc_start = ((value - empty) / (full - empty) for value in (run.soc, run.soc_start))
    return Trace(
        name=f"{plant.name}/{recipe.name}",
        plant=plant.name,
        cell=plant.cell,
        kind=recipe.kind,
        step_s=recipe.step_s,
        current_A=run.current_A,
        voltage_V=run.voltage_V,
        temperature_degC=run.temperature_degC.mean(axis=1),
        soc=soc,
        ambient_degC=recipe.ambient_degC,
        capacity_Ah=_capacity_Ah(run.current_A * recipe.step_s / 3600, soc, soc_start),
        aged=recipe.aged,
        soc_ref_sigma=0.0,
    )


def record_all(plant: CampaignPlant, folder: Path) -> Iterator[Trace]:
    """Records all recipes of a plant, one by one, with FMUs made in `folder`."""
    for recipe in recipes.of(plant):
        yield record(plant, recipe, plant.fmu(folder, recipe.cells))


def _lead(plant: CampaignPlant, charged: bool, soc: float) -> list[dict[str, float]]:
    """A trace of a cell with hysteresis begins at rest on one of its branches, as a car does that was used before."""
    limit = {"until_above_soc": soc} if charged else {"until_below_soc": soc}
    current_A = plant.nominal_Ah / 3 * (-1 if charged else 1)
    return [{"current_A": current_A, "duration_s": 7200.0} | limit, {"rest_s": 10800.0}]


def _parameters(plant: CampaignPlant, recipe: Recipe, fmu: Path | str) -> dict[str, float]:
    """A smaller cell has more resistance by itself; what an aged one has beyond that is put in series."""
    parameters = {"soc_initial": recipe.soc_initial}
    if recipe.aged:
        more_ohm = (AGED_RESISTANCE - 1 / AGED_CAPACITY) * _resistance_ohm(plant, fmu)
        parameters |= {"capacity_factor": AGED_CAPACITY * plant.parallel, "resistance_ohm": more_ohm}
    return parameters


def _resistance_ohm(plant: CampaignPlant, fmu: Path | str) -> float:
    """Of a new cell, by the first second of 1C from half charge at 25 degC."""
    with open_plant(fmu, parameters={"soc_initial": 0.5}, ambient_degC=25.0) as running:
        rest_V = float(running.state.voltage_V)
        return round((rest_V - float(running.step(plant.nominal_Ah, 1_000_000_000).voltage_V)) / plant.nominal_Ah, 4)


def _capacity_Ah(charge_Ah: NDArray[np.float64], soc: NDArray[np.float64], start: NDArray[np.float64]) -> Any:
    """Present capacities, by what the charge through the cells made of their SoC."""
    taken_Ah = np.cumsum(charge_Ah)
    return (taken_Ah @ taken_Ah) / (taken_Ah @ (start - soc))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bms_ukf.campaign.record", description="Makes the base traces.")
    parser.add_argument("--plant", choices=sorted(PLANTS), action="append", help="one of them; may be given again")
    parser.add_argument("--out", type=Path, default=resources.folder("campaign"), help="folder to write to")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.plant or sorted(PLANTS):
        plant, done = PLANTS[name], []
        with tempfile.TemporaryDirectory() as folder:
            for trace in record_all(plant, Path(folder)):
                done.append(trace)
                range_ = f"SoC {trace.soc[0].mean():.2f} to {trace.soc[-1].mean():.2f}"
                lowest, highest = trace.voltage_V.min(), trace.voltage_V.max()
                sys.stdout.write(f"{trace.name}: {trace.rows} rows, {range_}, {lowest:.3f} to {highest:.3f} V\n")
                sys.stdout.flush()
        path = given.out / f"{name}{traces.SUFFIX}"
        traces.save(done, path)
        sys.stdout.write(f"{path}: {path.stat().st_size} bytes\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
