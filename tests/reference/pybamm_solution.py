"""PyBaMM's own solution of a plant: its solver, its output variables, on the plant's mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pybamm

from bms_ukf.plantmaker import models

Solve = Callable[[Sequence[float], float, float, float], np.ndarray]


def solution_of(model: str, parameter_set: str, thermal: str = "lumped") -> Solve:
    """A function of currents (A), step (s), initial SoC and ambient (degC): voltage and temperature after each step."""
    solver = pybamm.IDAKLUSolver(rtol=1e-8, atol=1e-9)
    cell = models.load(model, parameter_set, thermal, solver=solver)

    def solve(currents: Sequence[float], step_s: float, soc: float, ambient: float) -> np.ndarray:
        solution, trace = None, []
        for current in currents:
            inputs = {"Current function [A]": current, "Ambient temperature [K]": ambient + 273.15, "soc_initial": soc}
            solution = solver.step(solution, cell.simulation.built_model, step_s, save=False, inputs=inputs)
            trace.append([solution[name].data[-1] for name in cell.outputs[:2]])
        return np.array(trace)

    return solve
