"""Identifies lgm50_chen2020.toml: a cycler's programme on the plant FMU, then least squares. Takes about a minute.

    python models/cells/make_lgm50_chen2020.py

Only what a cycler measures is used: current, voltage and temperature, from a full cell at rest. README.md tells what
each test is for. The date in [provenance] is the only thing that differs between two runs.
"""

from __future__ import annotations

import datetime
import hashlib
import itertools
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from ecm_fit import Array, Recording, Tables, fit
from residual_noise import estimate_noise
from scipy.interpolate import PchipInterpolator

from bms_ukf import resources
from bms_ukf.loads import Vehicle, read_series
from bms_ukf.plant import open_plant

HERE = Path(__file__).parent
PLANT = HERE.parent / "plants" / "lgm50_spme.fmu"
LOWER_V, UPPER_V = 2.5, 4.2
TEMPERATURES_DEGC = [-10.0, 0.0, 10.0, 25.0, 40.0]
OCV_SOC = np.unique(np.round(np.concatenate([np.linspace(0, 0.1, 41), np.linspace(0.1, 1, 91)]), 4))
DYNAMICS_SOC = np.array([0, 0.025, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1])


class Cycler:
    """Applies currents to a full, rested cell in a chamber, and records what it sees."""

    def __init__(self, ambient_degC: float) -> None:
        self.ambient_degC = ambient_degC
        self.plant = open_plant(PLANT, parameters={"soc_initial": 1.0}, ambient_degC=ambient_degC)
        self.rows: list[tuple[float, float, float, float]] = []

    def apply(self, currents_A: Iterable[float], step_s: float = 1.0, upper_V: float = UPPER_V) -> bool:
        """Applies one current per step; False if a voltage limit ended it."""
        for current_A in currents_A:
            state = self.plant.step(current_A, round(step_s * 1e9))
            self.rows.append((step_s, current_A, state.voltage_V, state.temperature_degC))
            if (current_A > 0 and state.voltage_V < LOWER_V) or (current_A < 0 and state.voltage_V > upper_V):
                return False
        return True

    def hold(self, current_A: float, duration_s: float, step_s: float = 1.0) -> bool:
        return self.apply(itertools.repeat(current_A, round(duration_s / step_s)), step_s)

    def until_limit(self, current_A: float, step_s: float) -> None:
        self.apply(itertools.repeat(current_A), step_s)

    def charge_Ah(self) -> Array:
        """Charge drawn up to each row."""
        step_s, current_A = np.array(self.rows).T[:2]
        return np.cumsum(step_s * current_A) / 3600

    def recording(self, capacity_Ah: float) -> Recording:
        step_s, current_A, voltage_V, temperature_degC = np.array(self.rows).T
        soc = 1 - self.charge_Ah() / capacity_Ah
        return Recording(self.ambient_degC, step_s, current_A, voltage_V, temperature_degC, soc)


def slow_test() -> tuple[float, Array]:
    """Capacity, Ah, and open-circuit voltage at `OCV_SOC`, V: full to empty and back at C/50 and 25 degC.

    The currents after C/50 empty the cell to its lower limit at rest. The mean of both directions is the open-circuit
    voltage; at SoC 0 and 1 it is the voltage limits, which is what empty and full mean.
    """
    cycler = Cycler(25.0)
    for current_A in (0.1, 0.01, 0.001):
        cycler.until_limit(current_A, 60.0)
    capacity_Ah = float(cycler.charge_Ah()[-1])
    turn = len(cycler.rows)
    cycler.until_limit(-0.1, 60.0)
    record = cycler.recording(capacity_Ah)
    discharge = np.interp(OCV_SOC, record.soc[turn - 1 :: -1], record.voltage_V[turn - 1 :: -1])
    charge = np.interp(OCV_SOC, record.soc[turn:], record.voltage_V[turn:])
    ocv_V = (discharge + charge) / 2
    ocv_V[[0, -1]] = LOWER_V, UPPER_V
    return capacity_Ah, ocv_V


def pulse_test(ambient_degC: float, capacity_Ah: float) -> Recording:
    """Rests and 10 s pulses of C/2 and 1 C, both ways, at falling SoC down to the lower limit."""
    cycler = Cycler(ambient_degC)
    levels = np.concatenate([np.arange(0.95, 0.22, -0.05), np.arange(0.2, 0.02, -0.025)])
    for move in -np.diff(levels, prepend=1.0) * capacity_Ah * 3600 / 2.5:
        going = cycler.hold(2.5, move, move / 10) and cycler.hold(0.0, 1200.0, 20.0)
        for current_A in (5.0, -2.5, 2.5, -5.0):
            going = going and cycler.hold(current_A, 10.0) and cycler.hold(0.0, 60.0, 2.0)
        if not going:
            break
    return cycler.recording(capacity_Ah)


def training_drive(ambient_degC: float, capacity_Ah: float) -> Recording:
    """Random current with the memory of a car's (8 s), in stretches of 1 to 5 minutes of differing mean and spread."""
    rng = np.random.default_rng(20)
    cycler = Cycler(ambient_degC)
    cycler.hold(2.5, 600.0)
    going = True
    while going:
        mean_A, spread_A = rng.choice([0.0, 1.0, 2.0, 3.5], p=[0.2, 0.3, 0.3, 0.2]), rng.uniform(0.0, 4.0)
        noise = itertools.accumulate(rng.normal(size=rng.integers(60, 300)), lambda y, x: 0.88 * y + 0.48 * x)
        going = cycler.apply(np.clip(mean_A + spread_A * np.array(list(noise)), -5, 12), upper_V=4.35)
    return cycler.recording(capacity_Ah)


def validation_drive(ambient_degC: float, capacity_Ah: float) -> Recording:
    """UDDS, US06 and HWFET in a small electric car with rests between, over and over; never fitted."""
    car = Vehicle(cells_parallel=18)
    traces = [read_series(resources.find(name, "loads", ".csv"), "speed_mps") for name in ("udds", "us06", "hwfet")]
    round_A = np.concatenate([np.append(car.cell_current_A(*trace), np.zeros(300)) for trace in traces])
    cycler = Cycler(ambient_degC)
    cycler.hold(2.5, 600.0)
    cycler.apply(itertools.cycle(round_A), upper_V=4.35)
    return cycler.recording(capacity_Ah)


def identify() -> dict[str, dict[str, Any]]:
    """The whole programme; returns the sections of the cell file."""
    capacity_Ah, ocv_V = slow_test()
    ocv = PchipInterpolator(OCV_SOC, ocv_V)
    tests = [test(T, capacity_Ah) for T in TEMPERATURES_DEGC for test in (pulse_test, training_drive)]
    knots = (3, len(TEMPERATURES_DEGC), len(DYNAMICS_SOC))
    start = Tables(
        DYNAMICS_SOC, np.array(TEMPERATURES_DEGC), np.full(knots, 0.01), np.full(knots[1], 3.0), np.array([15.0, 300.0])
    )
    tables = fit(tests, ocv, start, keep=5, roughness_mV=30.0)
    validation = [validation_drive(T, capacity_Ah) for T in TEMPERATURES_DEGC]
    noise = estimate_noise(validation, tables, ocv)
    tau = [np.full(knots[1:], tau) for tau in tables.tau_s]
    return {
        "cell": {
            "name": "lgm50_chen2020",
            "chemistry": "NMC811 / graphite-SiOx",
            "capacity_Ah": round(capacity_Ah, 4),
            "coulombic_efficiency": 1.0,
            "voltage_limits_V": [LOWER_V, UPPER_V],
            "current_limits_A": [-7.5, 15.0],
            "temperature_limits_degC": [-10.0, 45.0],
        },
        "ocv": {"temperature_degC": [25.0], "soc": OCV_SOC, "voltage_V": ocv_V.round(5)[None, :]},
        "dynamics": {
            "soc": DYNAMICS_SOC,
            "temperature_degC": TEMPERATURES_DEGC,
            "r0_ohm": tables.r_ohm[0].round(5),
            "r0_knee_A": np.broadcast_to(tables.knee_A[:, None], knots[1:]).round(2),
            "r1_ohm": tables.r_ohm[1].round(5),
            "tau1_s": tau[0].round(1),
            "r2_ohm": tables.r_ohm[2].round(5),
            "tau2_s": tau[1].round(1),
        },
        "noise": noise._asdict(),
        "provenance": {
            "made_by": "models/cells/make_lgm50_chen2020.py",
            "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
            "source": "plant FMU lgm50_spme: PyBaMM SPMe with the parameter set Chen2020",
            "plant_sha256": hashlib.sha256(PLANT.read_bytes()).hexdigest(),
        },
        "provenance.fit_rmse_mV": _rmse(tests[1::2], tables, ocv),
        "provenance.validation_rmse_mV": _rmse(validation, tables, ocv),
    }


def _rmse(records: list[Recording], tables: Tables, ocv: Callable[[Array], Array]) -> dict[str, float]:
    """Root mean square voltage error of drives between 10 % and 90 % SoC, mV, by ambient temperature."""
    result = {}
    for record in records:
        error = (tables.simulate(record, ocv) - record.voltage_V)[(record.soc > 0.1) & (record.soc < 0.9)]
        result[f"{record.ambient_degC:g}"] = round(1e3 * float(np.sqrt(np.mean(error**2))), 2)
    return result


def to_toml(sections: dict[str, dict[str, Any]]) -> str:
    """The text of a cell file."""
    lines = ["format = 1"]
    for section, values in sections.items():
        lines.append(f"\n[{section}]")
        lines += [f"{key if key.isidentifier() else _value(key)} = {_value(value)}" for key, value in values.items()]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if np.ndim(value) == 0:
        return repr(float(value))
    if np.ndim(value) == 1:
        return f"[{', '.join(map(_value, value))}]"
    return "[\n" + "".join(f"    {_value(row)},\n" for row in value) + "]"


def main() -> None:
    sections = identify()
    (HERE / "lgm50_chen2020.toml").write_text(to_toml(sections))
    for title in ("noise", "provenance.fit_rmse_mV", "provenance.validation_rmse_mV"):
        sys.stdout.write(f"{title}: {sections[title]}\n")


if __name__ == "__main__":
    main()
