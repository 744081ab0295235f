"""Writes the FMU of an estimator: a folder for `fmumaker`, with the kernel's object file for every machine."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import jinja2

from bms_ukf import __version__, firmware
from bms_ukf.cell import CellParams
from bms_ukf.firmware.package import FAULTS, STATUSES
from bms_ukf.fmumaker.build import HERE, MACHINES, build, compiler, require_compiler
from bms_ukf.tuning import Tuning

HOME = Path(__file__).parent

# Name, unit, start value, description. The start values are implausible.
INPUTS = [
    ("voltage_V", "V", 0.0, "terminal voltage at the end of the communication step"),
    ("temperature_degC", "degC", -273.15, "surface temperature at the end of the communication step"),
]
OUTPUTS = [
    ("soc", "1", "charge above empty over capacity, both at 25 degC; NaN while initialising or invalid"),
    ("soc_sigma", "1", "(soc_high - soc_low) / 3.92; NaN where soc is"),
    ("innovation_V", "V", "measured minus predicted voltage; NaN: no voltage was compared"),
    ("voltage_pred_V", "V", "predicted before the voltage was used"),
    ("soc_low", "1", "2.5 % quantile of soc; NaN where soc is"),
    ("soc_high", "1", "97.5 % quantile of soc"),
]


def machines_here() -> list[str]:
    """This machine, and those with a cross compiler here."""
    return [HERE, *(name for name in MACHINES if name != HERE and shutil.which(compiler(name)))]


def export(cell: CellParams, fmu: Path, fmi: int = 2, cells: int = 1, tuning: Tuning | None = None) -> list[str]:
    """Write the float64 estimator of `cells` cells as `fmu`, for FMI 2.0 (`fmi` = 2) or 3.0 (3).

    Returns the machines it runs on, as FMI 3.0 calls them. ConfigError if there is no C compiler, or the file
    cannot be written.
    """
    require_compiler(HERE)  # before half a minute of compiling
    with tempfile.TemporaryDirectory() as folder:
        write(cell, Path(folder), machines_here(), cells, tuning)
        build(Path(folder), fmu, fmi, machines_here())
    return machines_here()


def write(
    cell: CellParams, folder: Path, machines: Sequence[str], cells: int = 1, tuning: Tuning | None = None
) -> None:
    """Write the folder of which `fmumaker.build` makes FMUs of either version, for each of `machines`."""
    values = {
        "cell": cell.cell.name,
        "cells": cells,
        "version": __version__,
        "inputs": INPUTS,
        "outputs": OUTPUTS,
        "statuses": {status: text.format(tuning=tuning or Tuning()) for status, text in STATUSES.items()},
        "faults": {fault: text.format(tuning=tuning or Tuning()) for fault, text in FAULTS.items()},
    }
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HOME),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,  # TOML and Markdown
    )
    for name in ("fmu.toml", "README.md"):
        (folder / name).write_text(environment.get_template(f"{name}.j2").render(values), encoding="utf-8")
    for name in ("model.c", "state.h"):
        shutil.copyfile(HOME / name, folder / name)
    for machine in machines:
        target = machine if machine in MACHINES else "host"
        firmware.export(cell, folder / machine, target, "f64", cells, tuning)
