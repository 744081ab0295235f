"""Commands that package the estimator for use elsewhere."""

from __future__ import annotations

from pathlib import Path

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
