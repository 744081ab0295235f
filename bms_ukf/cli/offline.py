"""Commands that work on files: cells, measured tests, recordings."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from bms_ukf.cli.files import PATH, writable, write, write_json
from bms_ukf.cli.group import cli
from bms_ukf.errors import BmsError, ConfigError


@cli.command()
@click.argument("cell")
@click.option("--soc", default=0.5, show_default=True, help="Mean SoC of the belief, 0..1.")
@click.option("--sigma", default=0.1, show_default=True, help="Its standard deviation.")
@click.option("--temperature", default=25.0, show_default=True, help="Of the cell, degC.")
@click.option("--json", "json_path", type=PATH, callback=writable, help="Write the figures here.")
def diagnose(cell: str, soc: float, sigma: float, temperature: float, json_path: Path | None) -> None:
    """Tell whether a UKF is worth it for a CELL at an uncertainty of its SoC."""
    from bms_ukf import diagnose, diagnose_view
    from bms_ukf.cell import CellParams

    found = diagnose.diagnose(CellParams.load(cell), soc, sigma, temperature)
    diagnose_view.show(found)
    if json_path is not None:
        write_json(json_path, found)


@cli.command("identify")
@click.argument("manifest", type=PATH)
@click.option("--out", type=PATH, required=True, callback=writable, help="Write the cell file here.")
@click.option("--report", type=PATH, help="Write a page with plots here, or plots and page into this folder.")
def identify_(manifest: Path, out: Path, report: Path | None) -> None:
    """Make a cell file from the measured tests a MANIFEST lists."""
    from rich.console import Console
    from rich.table import Table

    from bms_ukf import identify
    from bms_ukf.report.identify import error_rows, write_report

    console = Console(stderr=True)
    with console.status("identify") as status:
        found = identify.run(manifest, status.update)
    write(out, found.text)
    table = Table("test", "use", "RMSE", "bias", "temperature", title="voltage error, open loop, 10 to 90 % SoC")
    for row in error_rows(found):
        table.add_row(*row)
    console.print(table)
    for warning in found.warnings:
        console.print(f"warning: {warning}", style="yellow", highlight=False)
    if report is not None:
        write_report(report, found)


@cli.command("replay")
@click.argument("inputs", type=PATH, nargs=-1, required=True)
@click.option("--cell", help="A cell file, or the name of a shipped one.  [CAN logs: default as in CONFIG]")
@click.option(
    "--config", type=PATH, help="CONFIG.toml: how CAN logs are read; for others its [estimator] and [sensor_spec]."
)
@click.option("--current-positive", type=click.Choice(["charge", "discharge"]), help="Sign; required but for CAN logs.")
@click.option("--initial-soc", type=click.FloatRange(0, 1), help="Default: from the first voltage.")
@click.option("--initial-sigma", type=click.FloatRange(0, 0.5, min_open=True), help="Its standard deviation.")
@click.option("--current-offset", "current_offset_A", default=0.0, help="Add to the current, A; positive = discharge.")
@click.option("--current-gain", default=1.0, help="Multiply the current by it.")
@click.option("--voltage-offset", "voltage_offset_V", default=0.0, help="Add to the voltage, V.")
@click.option("--resample", "resample_s", type=click.FloatRange(0, min_open=True), help="Rows so far apart, s.")
@click.option("--voltage-lag", "voltage_lag_s", default=0.0, help="How far the voltage lags the current, s.")
@click.option("--temperature", "temperature_degC", type=float, help="For a recording without one, degC.")
@click.option("--soc-ref-sigma", type=click.FloatRange(0, 0.5), default=0.0, help="Of the file's own reference.")
@click.option("--estimator", type=click.Choice(["srukf", "ekf", "coulomb"]), default="srukf", show_default=True)
@click.option("--health/--no-health", default=True, help="Tell capacity from use, and count SoC by it.  [--health]")
@click.option("--force", is_flag=True, help="Run recordings whose numbers do not fit the cell, too.")
@click.option("--out", type=PATH, help="Write the estimates here, as CSV.")
@click.option("--json", "json_path", type=PATH, help="Write the summary here.")
@click.option("--report", type=PATH, help="Write a page with plots here.")
@click.option("--diff", metavar="CELL2", help="Run another cell file, too, and compare.")
@click.option("--format", "form", type=click.Choice(["csv", "parquet"]), help="Of --out.  [csv; a cluster: parquet]")
@click.option("--jobs", type=click.IntRange(1), help="Recordings run at a time.  [default: as many as cores]")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster that is to run them.")
def replay_(
    inputs: tuple[Path, ...],
    cell: str | None,
    config: Path | None,
    out: Path | None,
    json_path: Path | None,
    report: Path | None,
    diff: str | None,
    form: str | None,
    jobs: int | None,
    scheduler: str | None,
    **options: Any,
) -> None:
    """Re-run the estimator over recordings, CSV, Parquet or CAN logs: files, or folders of them.

    With several, --out, --json and --report name folders. Results in Parquet that are there already are kept.
    """
    from bms_ukf.replay import command

    means = command.Means(jobs, scheduler, (form or ("csv" if scheduler is None else "parquet")) == "parquet")
    mistakes = command.replay(inputs, cell, config, command.Places(out, json_path, report), diff, means, options)
    for mistake in mistakes:
        click.echo(f"bms-ukf: {mistake}", err=True)
    if mistakes:
        sys.exit(2)


@cli.command("score")
@click.argument("manifest", type=PATH)
@click.option("--cell", help="A cell file, or the name of a shipped one; required but for --leave-one-out.")
@click.option(
    "--leave-one-out",
    is_flag=True,
    help="For each drive and charge file, identify a cell from the manifest without it, and score it with that cell.",
)
@click.option("--estimator", "estimators", multiple=True, type=click.Choice(["srukf", "ekf", "coulomb"]), help="[all]")
@click.option("--resample", "resample_s", type=click.FloatRange(0, min_open=True), help="Rows so far apart, s.  [1]")
@click.option("--native", is_flag=True, help="Rows as recorded, instead of --resample.")
@click.option("--health/--no-health", default=True, help="Tell capacity from use, and count SoC by it.  [--health]")
@click.option("--force", is_flag=True, help="Run recordings whose numbers do not fit the cell, too.")
@click.option("--gate", "gates", multiple=True, metavar="NAME=LIMIT", help="Exit 1 above it: weighted_rmse_pct=2.5")
@click.option("--json", "json_path", type=PATH, callback=writable, help="Write all figures here.")
@click.option("--report", type=PATH, help="Write a page with plots here, or plots and page into this folder.")
def score_(
    manifest: Path,
    cell: str | None,
    leave_one_out: bool,
    estimators: tuple[str, ...],
    resample_s: float | None,
    native: bool,
    health: bool,
    force: bool,
    gates: tuple[str, ...],
    json_path: Path | None,
    report: Path | None,
) -> None:
    """Score the estimator over the tests of a MANIFEST that were not fitted, as the blind SoC benchmark does."""
    from rich.console import Console

    from bms_ukf import score
    from bms_ukf.cell import CellParams
    from bms_ukf.offline.estimators import ESTIMATORS
    from bms_ukf.report.score import write_report
    from bms_ukf.score import Grid, gate, leaveoneout, view
    from bms_ukf.score.recorded import STEP_S

    limits = [gate.parse(text) for text in gates]
    if native and resample_s is not None:
        raise ConfigError("--native", expected="no --resample beside it")
    if (cell is None) != leave_one_out:
        raise ConfigError("--cell", value=cell, expected="either --cell or --leave-one-out")
    grid = Grid(estimators or tuple(ESTIMATORS), None if native else resample_s or STEP_S, health, force)
    with Console(stderr=True).status("score") as status:
        if cell is None:
            found = leaveoneout.score(manifest, grid, progress=status.update)
        else:
            found = score.score(manifest, CellParams.load(cell), grid, progress=status.update)
    view.show(found.summary, Console())
    if json_path is not None:
        write_json(json_path, found.summary)
    if report is not None:
        write_report(report, found)
    verdicts = [verdict for name, limit in limits if (verdict := gate.verdict(found.summary, name, limit))]
    if verdicts:
        raise BmsError("; ".join(verdicts))


@cli.command("import")
@click.argument("sources", type=PATH, nargs=-1, required=True)
@click.option("--out", type=PATH, required=True, callback=writable, help="Write the cell file here.")
@click.option("--capacity", type=click.FloatRange(0, 2000, min_open=True), required=True, help="Of the cell, Ah.")
@click.option("--voltage-limits", type=(float, float), help="Lower and upper, V.  [default: OCV at SoC 0 and 1]")
@click.option("--name", help="Of the cell.  [default: that of the file to write]")
@click.option("--chemistry", default="unknown", show_default=True)
def import_(
    sources: tuple[Path, ...],
    out: Path,
    capacity: float,
    voltage_limits: tuple[float, float] | None,
    name: str | None,
    chemistry: str,
) -> None:
    """Make a cell file of published ECM tables: CSV files as PyBaMM reads them, or a folder of them."""
    from bms_ukf import ecm_tables

    text = ecm_tables.import_cell(
        sources, name=name or out.stem, chemistry=chemistry, capacity_Ah=capacity, voltage_limits_V=voltage_limits
    )
    write(out, text)
    click.echo(f"{out}: its [noise] is assumed, not measured", err=True)
