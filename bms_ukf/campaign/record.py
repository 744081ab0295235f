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
from bms_ukf.campaign.plants import PLANTS, CampaignPlant
from bms_ukf.campaign.recipes import AGED_CAPACITY, AGED_RESISTANCE, Recipe
from bms_ukf.campaign.traces import Trace
from bms_ukf.loads import Load
from bms_ukf.plant import PlantState, open_plant
from bms_ukf.plantmaker.__main__ import main as make_plant

SPREAD = ("--spread-capacity", "0.01", "--spread-resistance", "0.1", "--spread-soc", "0.015", "--seed", "4")


def record(plant: CampaignPlant, recipe: Recipe, fmu: Path | str) -> Trace:
    """Runs a recipe on the FMU of a plant, to the end of its load."""
    load = Load.model_validate(recipe.load)
    parameters = {"soc_initial": recipe.soc_initial} | (_aged(plant) if recipe.aged else {})
    step_ns = round(recipe.step_s * 1e9)
    current_A: list[float] = []
    states: list[PlantState] = []
    with open_plant(fmu, parameters=parameters, ambient_degC=recipe.ambient_degC) as running:
        demand = load.demand(recipe.step_s)
        soc_start = np.atleast_1d(running.state.soc)
        while (asked := demand.next(running.state.voltage_V, running.state.soc)) is not None:
            exact_A = round(asked / plant.current_quantum_A) * plant.current_quantum_A
            states.append(running.step(exact_A, step_ns))
            current_A.append(exact_A)
    current, soc = np.array(current_A), _rows(states, "soc")
    return Trace(
        name=f"{plant.name}/{recipe.name}",
        plant=plant.name,
        cell=plant.cell,
        kind=recipe.kind,
        step_s=recipe.step_s,
        current_A=current,
        voltage_V=_rows(states, "voltage_V"),
        temperature_degC=_rows(states, "temperature_degC").mean(axis=1),
        soc=soc,
        ambient_degC=recipe.ambient_degC,
        capacity_Ah=_capacity_Ah(current * recipe.step_s / 3600, soc, soc_start),
        aged=recipe.aged,
        soc_ref_sigma=0.0,
    )


def record_all(plant: CampaignPlant, folder: Path) -> Iterator[Trace]:
    """Records all recipes of a plant, one by one, with FMUs made in `folder`."""
    made: dict[int, Path | str] = {}
    for recipe in recipes.of(plant):
        if recipe.cells not in made:
            made[recipe.cells] = _fmu(plant, recipe.cells, folder)
        yield record(plant, recipe, made[recipe.cells])


def _aged(plant: CampaignPlant) -> dict[str, float]:
    """A smaller cell has more resistance by itself: the rest is put in series."""
    more_ohm = (AGED_RESISTANCE - 1 / AGED_CAPACITY) * plant.resistance_ohm
    return {"capacity_factor": AGED_CAPACITY, "resistance_ohm": more_ohm}


def _fmu(plant: CampaignPlant, cells: int, folder: Path) -> Path | str:
    if not plant.maker and cells == 1:
        return plant.name
    if not plant.maker and cells == 96:
        return "pack_96s"
    path = folder / f"{plant.name}_{cells}.fmu"
    series = ("--series", str(cells), "--fmi", "3", *SPREAD) if cells > 1 else ()
    if make_plant([str(path), *(plant.maker or ("--parameters", "Chen2020")), *series]):
        raise SystemExit(2)
    return path


def _rows(states: list[PlantState], name: str) -> NDArray[np.float64]:
    return np.array([np.atleast_1d(getattr(state, name)) for state in states])


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
        traces.save(done, path, plant.current_quantum_A)
        sys.stdout.write(f"{path}: {path.stat().st_size} bytes\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
