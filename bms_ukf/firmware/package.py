"""Writes the folder of an exported estimator: object file, header, example, CMake snippet, size report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from numpy.typing import NDArray

from bms_ukf import __version__
from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.firmware.compile import compiled
from bms_ukf.firmware.report import Cost, cost
from bms_ukf.firmware.targets import TARGETS
from bms_ukf.kernel import layout
from bms_ukf.kernel.embedded import size
from bms_ukf.kernel.params import BITS, COMPACT, FULL, Precision, form_of, params, state_names
from bms_ukf.kernel.step import FAULT_MASK, STATUS_SHIFT
from bms_ukf.records import Fault, Status
from bms_ukf.tuning import Tuning

TABLES = {"full": FULL, "compact": COMPACT}
HELD_DIGITS = 1e-6  # relative: what float32 makes of a number may differ by 6e-8 from it

RESULTS = {
    "SOC": "0 .. 1; NAN while initialising or invalid",
    "SOC_SIGMA": "(SOC_HIGH - SOC_LOW) / 3.92; NAN where SOC is",
    "VOLTAGE_PRED": "V, predicted before the voltage was used; NAN here and below: none was compared",
    "INNOVATION": "V, measured minus predicted",
    "INNOVATION_VAR": "V^2",
    "NIS": "innovation^2 / its variance: 1 on average while the model is right",
    "AGE": "s since a voltage was last used",
    "BIAS": "A, what the current sensor shows too much, positive = discharge; NAN: not estimated",
    "R0": "ohm, ohmic resistance in the direction of the current, as tracked",
    "CODE": "status and faults of this cell alone, as bms_ukf_step returns those of all",
    "SOC_LOW": "0 .. 1, the 2.5 % quantile of SoC; NAN where SOC is",
    "SOC_HIGH": "0 .. 1, the 97.5 % quantile",
}
STATUSES = {
    Status.INITIALISING: "not every signal has been seen yet: no SoC",
    Status.OK: "no fault: the truth lies between SOC_LOW and SOC_HIGH with a probability of 95 %",
    Status.DEGRADED: "a SoC with its bounds, but a fault is set",
    Status.INVALID: "half of the interval is above {tuning.invalid_half_width:g}: no SoC",
}
FAULTS = {  # those that the kernel can report; `tuning` is that of the export
    Fault.CURRENT_MISSING: "none for longer than {tuning.current_timeout_s:g} s: no charge is counted",
    Fault.VOLTAGE_MISSING: "none for longer than {tuning.voltage_timeout_s:g} s",
    Fault.TEMPERATURE_MISSING: "none for longer than {tuning.temperature_timeout_s:g} s: the last one is held",
    Fault.CURRENT_IMPLAUSIBLE: "ignored",
    Fault.VOLTAGE_IMPLAUSIBLE: "ignored",
    Fault.TEMPERATURE_IMPLAUSIBLE: "ignored",
    Fault.INNOVATION_REJECTED: "the voltage was too far from its prediction, not used",
    Fault.TIME_REVERSED: "older than the sample before it: refused whole",
    Fault.NUMERIC: "a step gave a value that is not finite: refused whole, the state is kept",
    Fault.OUT_OF_TABLE: "SoC or temperature beyond the cell's tables: extrapolated",
    Fault.UNCERTAIN: "half of SOC_HIGH - SOC_LOW is above {tuning.ok_half_width:g}",
}


def export(
    cell: CellParams,
    out: Path,
    target: str,
    precision: Precision = "f32",
    cells: int = 1,
    tuning: Tuning | None = None,
    tables: str = "full",
) -> Cost:
    """Write the estimator of `cells` cells into the folder `out`, made if it is not there; returns what it costs.

    `target` is one of `TARGETS`. ConfigError if the precision cannot hold the cell, or the folder cannot be written.
    """
    tuning, bits, machine = tuning or Tuning(), BITS[precision], TARGETS[target]
    form, numbers = form_of(cell, tuning, 1, bits, part_lanes=1), params(cell, tuning, bits, TABLES[tables])
    _require_held(numbers, params(cell, tuning, 64, TABLES[tables]), cell, precision)
    made = compiled(form, cells, numbers, machine)
    costs = cost(made, form, cells, bits, machine)
    written: dict[str, Any] = {
        "cell": cell.cell.name,
        "cells": cells,
        "target": target,
        "abi": machine.abi_text,
        "gcc": machine.gcc,
        "version": __version__,
        "states": [*state_names(cell), *(["current_bias_A"] if form.bias else [])],
        "real": "double" if bits == 64 else "float",
        "state": size(form, cells),
        "work": made.work,
        "state_bytes": size(form, cells) * bits // 8,
        "work_bytes": made.work * bits // 8,
        "stack": costs.stack if costs.stack is not None else "an unknown number of",
        "undefined": costs.undefined,
        "current_timeout_s": tuning.current_timeout_s,
        "current_min": numbers[layout.P_CURRENT_MIN],
        "current_max": numbers[layout.P_CURRENT_MAX],
        "voltage_min": numbers[layout.P_VOLTAGE_MIN],
        "voltage_max": numbers[layout.P_VOLTAGE_MAX],
        "voltage_V": float(cell.ocv_V(0.5, 25.0)),
        "temperature_min": numbers[layout.P_TEMPERATURE_MIN],
        "temperature_max": numbers[layout.P_TEMPERATURE_MAX],
        "results": [(name, getattr(layout, f"OUT_{name}"), text) for name, text in RESULTS.items()],
        "statuses": [(status.name, int(status), text.format(tuning=tuning)) for status, text in STATUSES.items()],
        "faults": [(fault.name, int(fault), text.format(tuning=tuning)) for fault, text in FAULTS.items()],
        "status_shift": STATUS_SHIFT,
        "fault_mask": FAULT_MASK,
        "costs": costs,
        "precision": precision,
        "tables": tables,
    }
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,  # C and CMake
    )
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "bms_ukf.o").write_bytes(made.object)
        for name in ("bms_ukf.h", "main.c", "bms_ukf.cmake", "size.txt"):
            text = environment.get_template(f"{name}.j2").render(written)
            (out / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(out, expected=f"a folder that can be written ({error.strerror})") from None
    return costs


def _require_held(numbers: NDArray[Any], exact: NDArray[np.float64], cell: CellParams, precision: Precision) -> None:
    """Every number in the target's type is what it is in float64, to that type's digits."""
    known = np.isfinite(exact)
    off = np.abs(numbers[known].astype(float) - exact[known]) > HELD_DIGITS * np.abs(exact[known])
    if off.any():
        value = float(exact[known][int(np.argmax(off))])
        expected = f"numbers that {precision} can hold: its range ends at 3.4e38 and 1.2e-38 (--precision f64)"
        raise ConfigError(f"cell {cell.cell.name}", key="a number of its tables", value=value, expected=expected)
