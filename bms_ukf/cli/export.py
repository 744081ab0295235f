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
@click.option("--out", type=PATH, required=True, help="Folder to write.")
def export_firmware(
    cell: str, target: str, precision: Literal["f32", "f64"], cells: int, tables: str, out: Path
) -> None:
    """Write a CELL's estimator as an object file with a C header, for a microcontroller; no tool chain is needed."""
    from bms_ukf import firmware
    from bms_ukf.cell import CellParams

    firmware.export(CellParams.load(cell), out, target, precision, cells, tables=tables)
    click.echo((out / "size.txt").read_text(encoding="utf-8"), nl=False)
