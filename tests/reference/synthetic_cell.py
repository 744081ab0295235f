"""A cell that exists only for the tests, as its TOML file would say it: fresh data at every call, to be spoilt."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from bms_ukf import CellParams, toml

CellData = dict[str, Any]


def nonlinear() -> CellData:
    """5 Ah. OCV: steep when empty, flat (0.1 V per unit of SoC) around 40 %, a shoulder at 75 %; slow when cold."""
    soc = np.linspace(0, 1, 101)
    ocv = 3.0 + 0.45 * (1 - np.exp(-20 * soc)) + 0.08 * soc + 0.55 / (1 + np.exp(-(soc - 0.75) / 0.07))
    temperatures = [-10.0, 25.0, 45.0]
    knots = np.array([0.0, 0.1, 0.3, 0.6, 1.0])
    rows = [-10.0, 10.0, 25.0, 45.0]
    slow = [float(np.exp(2500 * (1 / (T + 273.15) - 1 / 298.15))) for T in rows]
    empty = 1 + 0.8 * np.exp(-8 * knots)

    def table(at_knots: Any, activation: float = 1.0) -> list[list[float]]:
        return [(at_knots * factor**activation).tolist() for factor in slow]

    return {
        "format": 1,
        "cell": {
            "name": "synthetic",
            "chemistry": "none",
            "capacity_Ah": 5.0,
            "coulombic_efficiency": 0.99,
            "voltage_limits_V": [2.9, 4.2],
            "current_limits_A": [-5.0, 10.0],
            "temperature_limits_degC": [-10.0, 45.0],
        },
        "ocv": {
            "temperature_degC": temperatures,
            "soc": soc.tolist(),
            "voltage_V": [(ocv + 2e-4 * (T - 25) * (soc - 0.5)).tolist() for T in temperatures],
        },
        "dynamics": {
            "soc": knots.tolist(),
            "temperature_degC": rows,
            "r0_ohm": table(0.025 * empty),
            "r0_knee_A": table(8.0 + 4.0 * knots, -0.8),
            "r1_ohm": table(0.012 * empty),
            "tau1_s": table(15.0 * (1 + 0.2 * knots), 0.3),
            "r2_ohm": table(0.015 * (1 + 2 * (knots - 0.5) ** 2)),
            "tau2_s": table(400.0 * (1 + 0.1 * knots), 0.3),
        },
        "noise": {
            "voltage_sigma_V": 0.004,
            "r0_rel_sigma": 0.1,
            "v_rc1_sigma_V": 0.003,
            "v_rc2_sigma_V": 0.004,
            "rc_rel_sigma": 0.1,
        },
    }


def with_coefficient() -> CellData:
    """The same cell with one OCV row and a temperature coefficient in place of the rows."""
    data = nonlinear()
    ocv = data["ocv"]
    ocv["temperature_degC"], ocv["voltage_V"] = [25.0], [ocv["voltage_V"][1]]
    ocv["docv_dT_V_per_K"] = [2e-4 * (soc - 0.5) for soc in ocv["soc"]]
    return data


def plateau() -> CellData:
    """2 Ah, like LFP: 30 mV from 15 to 95 %, in two steps, and hysteresis as wide as that."""
    data = nonlinear()
    soc = np.linspace(0, 1, 101)
    step = 1 / (1 + np.exp(-(soc - 0.65) / 0.03))
    ocv = 2.9 + 0.35 * (1 - np.exp(-18 * soc)) + 0.012 * soc + 0.018 * step + 0.1 * np.exp((soc - 1) / 0.012)
    data["cell"] |= {"capacity_Ah": 2.0, "voltage_limits_V": [2.5, 3.6]}
    data["ocv"] = {"temperature_degC": [25.0], "soc": soc.tolist(), "voltage_V": [ocv.tolist()]}
    data["hysteresis"] = {
        "soc": [0.0, 1.0],
        "temperature_degC": [0.0, 25.0],
        "max_V": [[0.03, 0.02], [0.015, 0.01]],
        "rate": 60.0,
    }
    data["noise"]["hysteresis_sigma_V"] = 0.003
    return data


def linear() -> CellData:
    """OCV a straight line from 3 V to 4 V, resistances constant: the filter's system is linear."""
    data = nonlinear()
    data["ocv"] = {"temperature_degC": [25.0], "soc": [0.0, 1.0], "voltage_V": [[3.0, 4.0]]}
    constants = {"r0_ohm": 0.02, "r1_ohm": 0.012, "tau1_s": 15.0, "r2_ohm": 0.015, "tau2_s": 400.0}
    tables = {key: [[value, value]] for key, value in constants.items()}
    data["dynamics"] = {"soc": [0.0, 1.0], "temperature_degC": [25.0], **tables}
    return data


def cell_of(data: CellData) -> CellParams:
    return toml.validate(data, CellParams, "cell.toml")


def as_toml(data: CellData) -> str:
    """JSON's scalars and arrays are TOML's, but for NaN and infinity."""

    def text(item: Any) -> str:
        return json.dumps(item).replace("NaN", "nan").replace("Infinity", "inf")

    lines = [f"{key} = {text(item)}" for key, item in data.items() if not isinstance(item, dict)]
    for section, items in data.items():
        if isinstance(items, dict):
            lines += [f"[{section}]", *(f"{key} = {text(item)}" for key, item in items.items())]
    return "\n".join(lines)
