"""Commands that package the estimator for use elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from bms_ukf.cli.files import PATH
from bms_ukf.cli.group import cli


@cli.group()
def export() -> None:
    """Package the estimator for use elsewhere."""


@export.command("benchmark")
@click.argument("cell")
@click.option("--out", type=PATH, required=True, help="Folder to write.")
def export_benchmark(cell: str, out: Path) -> None:
    """Write a CELL's entry for the blind SoC benchmark: a folder with its Model.py."""
    from bms_ukf import benchmark_entry

    click.echo(benchmark_entry.package(cell, out))


@export.command("firmware")
@click.argument("cell")
@click.option("--target", type=click.Choice(["cortex-m4", "cortex-m7", "rv32", "host"]), required=True)
@click.option("--precision", type=click.Choice(["f32", "f64"]), default="f32", show_default=True)
@click.option("--cells", type=click.IntRange(1, 1000), default=1, show_default=True, help="In series, one filter each.")
@click.option(
    "--tables",
    type=click.Choice(["full", "compact"]),
    default="full",
    show_default=True,
    help="compact: a third of the flash, coarser at low charge and in the cold.",
)
@click.option("--config", type=PATH, help="CONFIG.toml: its sections [estimator] and [sensor_spec].")
@click.option("--out", type=PATH, required=True, help="Folder to write.")
def export_firmware(
    cell: str, target: str, precision: Literal["f32", "f64"], cells: int, tables: str, config: Path | None, out: Path
) -> None:
    """Write a CELL's estimator as an object file with a C header, for a microcontroller; no tool chain is needed."""
    from bms_ukf import firmware, toml
    from bms_ukf.cell import CellParams
    from bms_ukf.config import Config

    model = CellParams.load(cell)
    tuning = None if config is None else toml.load(config, Config).tuning(model, config)
    firmware.export(model, out, target, precision, cells, tuning, tables)
    click.echo((out / "size.txt").read_text(encoding="utf-8"), nl=False)


@export.command("fmu")
@click.argument("cell")
@click.option("--fmi", type=click.IntRange(2, 3), default=2, show_default=True, help="Version: 2.0 or 3.0.")
@click.option("--cells", type=click.IntRange(1, 1000), default=1, show_default=True, help="In series, one filter each.")
@click.option("--config", type=PATH, help="CONFIG.toml: its sections [estimator] and [sensor_spec].")
@click.option("--out", type=PATH, required=True, help="The .fmu to write.")
def export_fmu(cell: str, fmi: int, cells: int, config: Path | None, out: Path) -> None:
    """Write a CELL's estimator as a co-simulation FMU without Python; needs a C compiler."""
    from bms_ukf import estimator_fmu, toml
    from bms_ukf.cell import CellParams
    from bms_ukf.config import Config
    from bms_ukf.fmumaker.build import MACHINES, compiler

    model = CellParams.load(cell)
    tuning = None if config is None else toml.load(config, Config).tuning(model, config)
    made = estimator_fmu.export(model, out, fmi, cells, tuning)
    click.echo(f"{out}: {out.stat().st_size} bytes, for {', '.join(made)}")
    for name in MACHINES.keys() - set(made):
        click.echo(f"not for {name}: no {compiler(name)} here")
