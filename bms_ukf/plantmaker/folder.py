"""The folder of a plant, from which its FMU is built: table of variables, equations in C, and a page about it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bms_ukf.plantmaker import codegen
from bms_ukf.plantmaker.models import Cell

LARGEST_C_RATE = 10.0
AT_K, AT_SOC = 298.15, 0.5  # where a cell's resistance is taken
WEAK_CAPACITY, WEAK_RESISTANCE, WEAK_SOC = -0.10, 0.30, -0.05  # shares of its own, and SoC


@dataclass(frozen=True)
class Spread:
    """How the cells of a string differ.

    Standard deviations, drawn from `seed` by a generator for each quantity; on top of them the ambient temperature
    rises evenly from the first cell to the last, and one cell is weak.
    """

    capacity: float = 0.0  # of the capacity
    resistance: float = 0.0  # of the cell's own at 25 degC and half charge, in series with it
    soc: float = 0.0
    seed: int = 0
    gradient_K: float = 0.0  # of the ambient temperature, from the first cell to the last
    weak: int | None = None  # the cell, counted from 1, that WEAK_CAPACITY, WEAK_RESISTANCE and WEAK_SOC are added to

    def draw(self, name: str, sigma: float, cells: int) -> list[float]:
        """`sigma` times normal numbers, one a cell, cut at three sigmas."""
        drawn = np.random.default_rng([self.seed, *name.encode()]).standard_normal(cells)
        return _rounded(sigma * drawn.clip(-3, 3))

    def values(self, name: str, sigma: float, weakness: float, cells: int) -> list[float]:
        """What is drawn, with `weakness` added to the weak cell's."""
        found = self.draw(name, sigma, cells)
        if self.weak is not None:
            found[self.weak - 1] += weakness
        return _rounded(found)

    def ambient_offsets_K(self, cells: int) -> list[float]:
        return _rounded(np.linspace(0.0, self.gradient_K, cells))


def _rounded(values: ArrayLike) -> list[float]:
    return [round(float(value), 7) + 0.0 for value in np.asarray(values)]  # + 0.0: no minus zero


def resistance_ohm(cell: Cell) -> float:
    """Of a cell at rest to a current of 1 C: what the voltage falls by at once."""
    made = codegen.functions(cell)
    state = made.initial([0.0, AT_K, AT_SOC])
    rest_V, loaded_V = (float(made.outputs(state, [i, AT_K, AT_SOC])[0]) for i in (0.0, cell.nominal_Ah))
    return (rest_V - loaded_V) / cell.nominal_Ah


def write(
    cell: Cell,
    folder: Path,
    *,
    name: str,
    description: str,
    reference: str,
    series: int | None = None,
    spread: Spread | None = None,
    parallel: int = 1,
    soc_initial: float = 0.5,
) -> None:
    """Writes cell.c, cell.h and fmu.toml into `folder`. `series` cells give arrays; None: one cell, and scalars.

    A cell of the plant is `parallel` of the model's, equal and in parallel.
    """
    codegen.write(cell, folder)
    spread, cells = spread or Spread(), series or 1
    own_ohm = resistance_ohm(cell) / parallel if spread.resistance or spread.weak else 0.0
    shares = spread.values("capacity", spread.capacity, WEAK_CAPACITY, cells)
    capacity = _rounded([parallel * (1 + value) for value in shares])
    extra_ohm = spread.values("resistance", spread.resistance * own_ohm, WEAK_RESISTANCE * own_ohm, cells)
    offsets = spread.values("soc", spread.soc, WEAK_SOC, cells)
    largest_A = LARGEST_C_RATE * cell.nominal_Ah * parallel
    low_V, high_V = cell.voltage_limits_V

    def start(values: list[float]) -> str:
        return str(values) if series else str(values[0])

    array = f"\nelements = {series}" if series else ""
    of_cells = '"capacity_factor", "resistance_ohm", "soc_offset", "ambient_offset_K"'
    ambient = '"ambient_degC", "ambient_offset_K"'
    (folder / "fmu.toml").write_text(f'''# Written by bms_ukf.plantmaker; bms_ukf/fmumaker/table.py explains it.

[model]
name = "{name}"
description = "{description}"
version = "1"
reference = "{reference}"
step_s = 1.0
stop_s = 3600.0
sources = ["plant.c", "cell.c", "rkc.c"]
headers = ["state.h", "cell.h", "rkc.h"]

[units]
A = {{ A = 1 }}
V = {{ kg = 1, m = 2, s = -3, A = -1 }}
ohm = {{ kg = 1, m = 2, s = -3, A = -2 }}
degC = {{ K = 1, offset = 273.15 }}
K = {{ K = 1 }}
1 = {{}}

[[variable]]
name = "current_A"
causality = "input"
unit = "A"
start = 0.0
min = {-largest_A}
max = {largest_A}
description = "cell current, positive on discharge; held over a communication step"

[[variable]]
name = "ambient_degC"
causality = "input"
unit = "degC"
start = 25.0
min = -40.0
max = 80.0
description = "ambient temperature; the cell starts at it"

[[variable]]
name = "voltage_V"
causality = "output"
unit = "V"{array}
description = "terminal voltage"
feedthrough = ["current_A", "capacity_factor", "resistance_ohm"]
at_start = ["current_A", "ambient_degC", "soc_initial", {of_cells}]

[[variable]]
name = "temperature_degC"
causality = "output"
unit = "degC"{array}
description = "cell temperature ({cell.thermal})"
feedthrough = [{ambient if cell.thermal == "isothermal" else ""}]
at_start = [{ambient}]

[[variable]]
name = "soc"
causality = "output"
unit = "1"{array}
description = "charge above empty over capacity, between {low_V:g} V and {high_V:g} V at rest and 25 degC; not clamped"
feedthrough = []
at_start = ["soc_initial", "soc_offset"]

[[variable]]
name = "soc_initial"
causality = "parameter"
unit = "1"
start = {soc_initial}
min = 0.0
max = 1.0
description = "state of charge at the start, the cell at rest"

[[variable]]
name = "soc_offset"
causality = "parameter"
unit = "1"{array}
start = {start(offsets)}
min = -1.0
max = 1.0
description = "added to soc_initial"

[[variable]]
name = "capacity_factor"
causality = "parameter"
unit = "1"{array}
start = {start(capacity)}
min = 0.05
max = 20.0
description = "capacity over that of the parameter set, {cell.capacity_Ah:.4f} Ah; resistance scales with its inverse"

[[variable]]
name = "resistance_ohm"
causality = "parameter"
unit = "ohm"{array}
start = {start(extra_ohm)}
min = -1.0
max = 10.0
description = "in series with the cell, besides its own; makes no heat"

[[variable]]
name = "ambient_offset_K"
causality = "parameter"
unit = "K"{array}
start = {start(spread.ambient_offsets_K(cells))}
min = -50.0
max = 50.0
description = "added to ambient_degC"
''')


def page(cell: Cell, command: str) -> str:
    """README.md of a made plant."""
    low_V, high_V = cell.voltage_limits_V
    widened = f", without the hysteresis of {cell.hysteresis_V:g} V to either side" if cell.hysteresis_V else ""
    return f"""# {cell.model} with the parameter set {cell.parameter_set}

PyBaMM's `{cell.model}`, thermal model `{cell.thermal}`, parameter set `{cell.parameter_set}`, made into C by

    {command}

{cell.capacity_Ah:.4f} Ah lie between {low_V:g} V and {high_V:g} V at rest and 25 degC{widened}.
The cell starts at rest, at the ambient temperature. A step after which the model does not hold
({cell.out_of_range}) is refused whole: the cells stay at the start of the step.
modelDescription.xml has the variables.

The equations are integrated by the second-order Runge-Kutta-Chebyshev method with error control (rkc.c): 1e-5 a step.
"""
