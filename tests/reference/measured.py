"""Recordings as a cycler would write them, of the physics-based plant: their truth is not the estimator's model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bms_ukf import resources
from bms_ukf.loads import Load
from bms_ukf.plant import open_plant

HEADER = "time_s,current_A,voltage_V,temperature_C,soc_ref"  # positive = charge
DRIVE = [{"rest_s": 60}, {"cycle": "wltc_3b"}]
CHARGE = [{"rest_s": 60}, {"current_A": -2.5, "duration_s": 1200}]


def record(segments: list[dict[str, Any]], soc: float, ambient_degC: float = 25.0) -> np.ndarray:
    """Rows of HEADER at 1 Hz, from sensors with some noise."""
    fmu = resources.find("lgm50_spme", "plants", ".fmu")
    rows = []
    with open_plant(fmu, parameters={"soc_initial": soc}, ambient_degC=ambient_degC) as plant:
        for k, current_A in enumerate(Load(segments=segments).profile(1.0).current_A.tolist(), start=1):
            state = plant.step(current_A, 10**9)
            rows.append((k, -current_A, state.voltage_V, state.temperature_degC, state.soc))
    found = np.array(rows)
    found[:, 1:3] += np.random.default_rng(1).standard_normal((len(found), 2)) * [0.01, 0.001]
    return found


def write(path: Path, rows: np.ndarray, header: str = HEADER) -> Path:
    np.savetxt(path, rows, fmt="%.7g", delimiter=",", header=header, comments="")
    return path
