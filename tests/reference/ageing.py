"""Five full-range days of cells that have aged, and what the estimator finds of it: `python -m ageing` for the table.

The plant is physics-based, its capacity and a resistance in series are changed, and nobody tells the estimator. A day
is a drive of WLTC from 95 to 10 %, a rest, a charge at C/2 and a rest. Sensors have noise, steps and an offset.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf import CellParams, Estimator, resources
from bms_ukf.loads import Load
from bms_ukf.pack import Health
from bms_ukf.plant import open_plant

Array = NDArray[np.float64]
CELL = CellParams.load("lgm50_chen2020")
R0_OHM = float(CELL.dynamics_at(0.5, 25.0)["r0_ohm"])
DRIVE_A = Load(segments=[{"cycle": "wltc_3b"}])
REST = 2700
FULL, EMPTY = 0.95, 0.1


class Plant(NamedTuple):
    """Multiples of the fresh plant's. What has less capacity by itself has as much more resistance."""

    capacity: float = 1.0
    added: float = 0.0  # resistance in series, of the cell file's r0

    @property
    def resistance(self) -> float:
        return 1 / self.capacity + self.added


PLANTS = {
    "fresh": Plant(),
    "capacity -10 %": Plant(capacity=0.9),
    "resistance +30 %": Plant(added=0.3),
    "both": Plant(0.9, 0.3),
}


def lived(aged: Plant, days: int = 5, rate_hz: int = 1) -> Array:
    """True time, current, voltage and temperature, a row a sample: `rate_hz` while it drives, else 1 Hz."""
    rows: list[tuple[float, ...]] = []
    drive_A = DRIVE_A.profile(1 / rate_hz).current_A.tolist()
    parameters = {
        "soc_initial": FULL,
        "capacity_factor": aged.capacity,
        "resistance_ohm": aged.added * R0_OHM,
    }
    with open_plant(resources.find("lgm50_spme", "plants", ".fmu"), parameters=parameters, ambient_degC=25.0) as plant:

        def go(current_A: float, step_s: float) -> float:
            state = plant.step(current_A, round(1e9 * step_s))
            rows.append((state.t_ns, current_A, float(state.voltage_V), float(state.temperature_degC)))
            return float(state.soc)

        def rest() -> float:
            return [go(0.0, 1.0) for _ in range(REST)][-1]

        soc = rest()
        for _ in range(days):
            while soc > EMPTY:
                for current_A in drive_A:
                    soc = go(current_A, 1 / rate_hz)
                    if soc <= EMPTY:
                        break
            soc = rest()
            while soc < FULL and rows[-1][2] < CELL.cell.voltage_limits_V[1]:
                soc = go(-CELL.cell.capacity_Ah / 2, 1.0)
            soc = rest()
    return np.array(rows)


def found(true: Array, offset_A: float = 0.05, seed: int = 1) -> Health:
    """What is told of it by sensors with noise, steps and an offset of the current."""
    noise = np.random.default_rng(seed).standard_normal((len(true), 3)) * [0.02, 0.002, 0.2]
    t_ns, current, voltage, temperature = true.T
    health = Health(Estimator(CELL))
    health.replay(
        t_ns.astype(np.int64),
        current + offset_A + noise[:, 0],
        np.round(voltage + noise[:, 1], 3),
        np.round(2 * (temperature + noise[:, 2])) / 2,
    )
    return health


def main() -> None:
    for rate_hz in (1, 10):
        for name, aged in PLANTS.items():
            true = lived(aged, rate_hz=rate_hz)
            for offset_A in (0.0, 0.05, -0.1):
                health = found(true, offset_A)
                capacity, resistance = health.told_capacity[0], health.told_resistance[0]
                print(  # noqa: T201 - a table
                    f"{rate_hz:2} Hz  {name:17} offset {offset_A:+.2f} A  {health.segments[0]} segments  "
                    f"capacity {capacity:.3f} ± {health.capacity_sigma[0]:.3f} ({capacity / aged.capacity - 1:+.1%})  "
                    f"r0 {resistance:.2f} ± {health.resistance_sigma[0]:.2f} ({resistance / aged.resistance - 1:+.1%})",
                    flush=True,
                )


if __name__ == "__main__":
    main()
