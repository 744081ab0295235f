"""Drives a plant with a load, measures it, has the estimator follow over a link, and records what came of it.

load -> Plant.step -> sensors -> Sample -> link (direct, or frames over a bus) -> Estimate -> trace
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bms_ukf import metrics, resources
from bms_ukf.cell import CellParams
from bms_ukf.config import Bus
from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.estimator import Estimator
from bms_ukf.links import BusLink, DirectLink, Link
from bms_ukf.loads.demand import Demand
from bms_ukf.plant import PlantState, open_plant
from bms_ukf.records import NAN, Estimate, Sample
from bms_ukf.scenario import Scenario
from bms_ukf.sensors import SensorSet
from bms_ukf.trace import Trace


@dataclass(slots=True)
class Progress:
    """Where a run stands after a step."""

    step: int
    steps: int
    wall_s: float
    sample: Sample
    estimate: Estimate
    true: PlantState
    frames_in: int
    frames_out: int


Watch = Callable[[Progress], None]


def run(scenario: Scenario, path: Path, watch: Watch | None = None) -> tuple[Trace, dict[str, Any]]:
    """Run a scenario (found at `path`) to the end of its load: the trace, a row per step, and the summary.

    `watch` is called after every step, and told how many there are at most. If the plant fails on the way the run ends
    there, or goes on with nothing measured, as the scenario says, and the summary says why under `plant_failure`.
    Raises ConfigError for what the scenario names and is not usable, and for a load without a step; PlantError if the
    plant fails in the first.
    """
    step_ns = round(scenario.step_s * 1e9)
    sensors = SensorSet(scenario.sensors)
    estimator = _estimator(scenario, path)
    failure: PlantError | None = None
    started = time.perf_counter()
    with open_plant(scenario.plant, path.parent) as plant:
        if np.ndim(plant.state.voltage_V):
            expected = "the voltage of one cell; bms-ukf hil takes several"
            raise ConfigError(path, key="plant.variables.voltage_V", expected=expected)
        # Where a part of the plant drives it, the load only says how long.
        driven_by = plant.input or "current_A"
        demand = scenario.load.demand(scenario.step_s, plant_input=driven_by, relative_to=path.parent)
        trace = Trace(min(demand.steps_at_most, 100_000))
        link = _link(scenario, path, estimator)
        true = plant.state
        try:
            while (asked := _next(demand, plant.state)) is not None:
                if failure is None:
                    try:
                        true = plant.step(asked, step_ns)
                    except PlantError as error:
                        failure = error
                if failure is not None:
                    if scenario.plant.on_failure == "end":
                        break
                    true = PlantState(true.t_ns + step_ns, current_A=NAN)
                given = Sample(true.t_ns, float(true.current_A), float(true.voltage_V), float(true.temperature_degC))
                sample = sensors.measure(given.t_ns, given.current_A, given.voltage_V, given.temperature_degC)
                estimate = link.exchange(sample)
                trace.append(sample, estimate, float(true.soc), given)
                if watch is not None:
                    wall_s, frames = time.perf_counter() - started, (link.frames_in, link.frames_out)
                    watch(Progress(len(trace), demand.steps_at_most, wall_s, sample, estimate, true, *frames))
        finally:
            link.close()
    if not len(trace):
        raise failure or ConfigError(path, key="load", expected="at least one step before its limits are reached")
    summary = _summary(scenario, trace, link, time.perf_counter() - started)
    return trace, summary | {"plant_failure": None if failure is None else str(failure)}


def _next(demand: Demand, state: PlantState) -> float | None:
    return demand.next(state.voltage_V, state.soc, float(state.current_A))


def _estimator(scenario: Scenario, path: Path) -> Estimator:
    if scenario.cells > 1:
        raise ConfigError(path, key="cells", value=scenario.cells, expected="1: bms-ukf hil is for several")
    cell_path = resources.find(scenario.estimator.cell, "cells", ".toml", relative_to=path.parent)
    cell, tuning = CellParams.load(cell_path), scenario.estimator.tuning
    tuning.check(cell, path, "estimator.tuning.sensor_spec")
    return Estimator(cell, tuning=tuning)


def _link(scenario: Scenario, path: Path, estimator: Estimator) -> Link:
    if scenario.bus.interface == "direct":
        return DirectLink(estimator)
    return BusLink(estimator, Bus(interface=scenario.bus.interface, channel=scenario.bus.channel), str(path))


def _summary(scenario: Scenario, trace: Trace, link: Link, wall_s: float) -> dict[str, Any]:
    """What users' scripts read from the JSON: the run, its last state, and the scores where the plant knows its SoC."""
    duration_s = float(trace.t_s[-1])
    return {
        "scenario": scenario.name,
        "cell": scenario.estimator.cell,
        "plant": scenario.plant.label,
        "bus": scenario.bus.interface,
        "seed": scenario.sensors.seed,
        "n": len(trace),
        "duration_s": duration_s,
        "wall_s": wall_s,
        "realtime_factor": duration_s / wall_s,
        "frames_in": link.frames_in,
        "frames_out": link.frames_out,
        "final_soc": _or_none(trace["soc"][-1]),
        "soc_sigma_final": _or_none(trace["soc_sigma"][-1]),
        "soc_low_final": _or_none(trace["soc_low"][-1]),
        "soc_high_final": _or_none(trace["soc_high"][-1]),
        **metrics.score(trace.t_s, trace["soc"], trace.interval, trace["soc_ref"]),
    }


def _or_none(value: float) -> float | None:
    """NaN is not JSON."""
    return None if math.isnan(value) else float(value)
