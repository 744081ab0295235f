"""The `bms-ukf` command: reads arguments, calls one function, turns errors into one line and an exit code.

0 fine · 1 the work ran and its verdict is bad · 2 wrong usage, configuration or input · 130 interrupted
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, NoReturn

import click

from bms_ukf import __version__
from bms_ukf.errors import BmsError, ConfigError, PlantError

PATH = click.Path(path_type=Path)


def _writable(_context: click.Context, _parameter: click.Parameter, path: Path | None) -> Path | None:
    """Refuse a file in a folder that is not there before the work is done, not after."""
    if path is not None and (path.is_dir() or not path.parent.is_dir()):
        raise ConfigError(path, expected="a file to be written, in a folder that exists")
    return path


@click.group(context_settings={"help_option_names": ["-h", "--help"]}, invoke_without_command=True)
@click.version_option(__version__, prog_name="bms-ukf")
@click.pass_context
def cli(context: click.Context) -> None:
    """Battery state of charge on a CAN bus."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@cli.command()
@click.option("--report", type=PATH, default=Path("demo-report"), show_default=True, help="Folder for plots and page.")
def demo(report: Path) -> None:
    """Drive a physics-based cell over a virtual CAN bus and watch its SoC come back."""
    from bms_ukf import simulate

    sys.exit(0 if simulate.passed(simulate.simulate("demo", report=report, judged=True)) else 1)


@cli.command()
@click.argument("config", type=PATH)
@click.option("--check", is_flag=True, help="Explain the configuration and exit.")
@click.option("--log-frames", type=PATH, callback=_writable, help="Write all frames here: .log, .asc, .blf, .trc, .mf4")
def run(config: Path, check: bool, log_frames: Path | None) -> None:
    """Estimate SoC on a CAN interface, as a daemon."""
    from bms_ukf import service

    if check:
        click.echo(service.explain(config))
    else:
        service.serve(config, log_frames)


@cli.command("monitor")
@click.argument("config", type=PATH, required=False)
@click.option("--interface", help="Of python-can.  [default: as in CONFIG]")
@click.option("--channel", help="Of the interface.  [default: as in CONFIG]")
@click.option("--seconds", type=click.FloatRange(0, min_open=True), help="End after so long.  [default: never]")
def monitor_(config: Path | None, interface: str | None, channel: str | None, seconds: float | None) -> None:
    """Show what the daemon publishes, live; with a CONFIG also what the vehicle sends."""
    from bms_ukf.monitor import command

    command.monitor(config, interface, channel, seconds)


@cli.command()
@click.argument("dbc", type=PATH, nargs=-1, required=True)
@click.option("--out", type=PATH, callback=_writable, help="Write the configuration here, and not to the terminal.")
def init(dbc: tuple[Path, ...], out: Path | None) -> None:
    """Propose a configuration for a vehicle's own DBC files."""
    from bms_ukf import skeleton

    text, gaps = skeleton.propose(dbc, out)
    if out is None:
        click.echo(text, nl=False)
    else:
        _write(out, text)
    for gap in gaps:
        click.echo(f"fill in {gap}", err=True)


@cli.command()
@click.argument("scenario", required=False)
@click.option("--inspect", "fmu", type=PATH, help="Print the variables of an FMU and a scenario for it, and exit.")
@click.option("--json", "json_path", type=PATH, callback=_writable, help="Write the summary here.")
@click.option("--out", type=PATH, callback=_writable, help="Write the trace here, as CSV.")
@click.option("--report", type=PATH, callback=_writable, help="Write a page here, with its plots inside.")
def cosim(
    scenario: str | None, fmu: Path | None, json_path: Path | None, out: Path | None, report: Path | None
) -> None:
    """Run a SCENARIO: a plant FMU, a load, sensors, a bus and the estimator."""
    if fmu is not None:
        from bms_ukf import inspection

        click.echo(inspection.describe(fmu))
        return
    if scenario is None:
        raise click.UsageError("SCENARIO or --inspect PLANT.fmu is missing")
    from bms_ukf import simulate

    summary = simulate.simulate(scenario, out=out, report=report)
    if json_path is not None:
        _write_json(json_path, summary)
    if failure := summary["plant_failure"]:
        raise PlantError(failure)


@cli.command()
@click.argument("cell")
@click.option("--soc", default=0.5, show_default=True, help="Mean SoC of the belief, 0..1.")
@click.option("--sigma", default=0.1, show_default=True, help="Its standard deviation.")
@click.option("--temperature", default=25.0, show_default=True, help="Of the cell, degC.")
@click.option("--json", "json_path", type=PATH, callback=_writable, help="Write the figures here.")
def diagnose(cell: str, soc: float, sigma: float, temperature: float, json_path: Path | None) -> None:
    """Tell whether a UKF is worth it for a CELL at an uncertainty of its SoC."""
    from bms_ukf import diagnose, diagnose_view
    from bms_ukf.cell import CellParams

    found = diagnose.diagnose(CellParams.load(cell), soc, sigma, temperature)
    diagnose_view.show(found)
    if json_path is not None:
        _write_json(json_path, found)


@cli.command("identify")
@click.argument("manifest", type=PATH)
@click.option("--out", type=PATH, required=True, callback=_writable, help="Write the cell file here.")
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
    _write(out, found.text)
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
@click.option("--config", type=PATH, help="CONFIG.toml: how CAN logs are read; for others its [estimator] section.")
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
@click.option("--out", type=PATH, help="Write the estimates here, as CSV.")
@click.option("--json", "json_path", type=PATH, help="Write the summary here.")
@click.option("--report", type=PATH, help="Write a page with plots here.")
@click.option("--diff", metavar="CELL2", help="Run another cell file, too, and compare.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Recordings run at a time.")
def replay_(
    inputs: tuple[Path, ...],
    cell: str | None,
    config: Path | None,
    out: Path | None,
    json_path: Path | None,
    report: Path | None,
    diff: str | None,
    jobs: int,
    **options: Any,
) -> None:
    """Re-run the estimator over recordings, CSV, Parquet or CAN logs: files, or folders of them.

    With several, --out, --json and --report name folders.
    """
    from bms_ukf.replay import command

    mistakes = command.replay(inputs, cell, config, command.Places(out, json_path, report), diff, jobs, options)
    for mistake in mistakes:
        click.echo(f"bms-ukf: {mistake}", err=True)
    if mistakes:
        sys.exit(2)


@cli.command("score")
@click.argument("manifest", type=PATH)
@click.option("--cell", required=True, help="A cell file, or the name of a shipped one.")
@click.option("--gate", "gates", multiple=True, metavar="NAME=LIMIT", help="Exit 1 above it: weighted_rmse_pct=2.5")
@click.option("--json", "json_path", type=PATH, callback=_writable, help="Write all figures here.")
@click.option("--report", type=PATH, help="Write a page with plots here, or plots and page into this folder.")
def score_(manifest: Path, cell: str, gates: tuple[str, ...], json_path: Path | None, report: Path | None) -> None:
    """Score the estimator over the tests of a MANIFEST that were not fitted, as the blind SoC benchmark does."""
    from rich.console import Console

    from bms_ukf import score
    from bms_ukf.cell import CellParams
    from bms_ukf.report.score import write_report
    from bms_ukf.score import gate, view

    limits = [gate.parse(text) for text in gates]
    loaded = CellParams.load(cell)
    with Console(stderr=True).status("score") as status:
        found = score.score(manifest, loaded, progress=status.update)
    view.show(found.summary, Console())
    if json_path is not None:
        _write_json(json_path, found.summary)
    if report is not None:
        write_report(report, found)
    verdicts = [verdict for name, limit in limits if (verdict := gate.verdict(found.summary, name, limit))]
    if verdicts:
        raise BmsError("; ".join(verdicts))


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


@cli.command("import")
@click.argument("sources", type=PATH, nargs=-1, required=True)
@click.option("--out", type=PATH, required=True, callback=_writable, help="Write the cell file here.")
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
    _write(out, text)
    click.echo(f"{out}: its [noise] is assumed, not measured", err=True)


def _write_json(path: Path, data: dict[str, Any]) -> None:
    _write(path, json.dumps(data, indent=2) + "\n")


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(path, expected=f"a file that can be written ({error.strerror})") from None


def main() -> NoReturn:
    """Run the command line and exit."""
    try:
        cli.main(standalone_mode=False)
    except click.exceptions.Abort:
        sys.exit(130)
    except KeyboardInterrupt:
        sys.exit(130)
    except click.ClickException as error:
        _fail(error.format_message(), 2)
    except ConfigError as error:
        _fail(str(error), 2)
    except BmsError as error:
        _fail(str(error), 1)
    sys.exit(0)


def _fail(text: str, code: int) -> NoReturn:
    click.echo(f"bms-ukf: {' '.join(text.split())}", err=True)
    sys.exit(code)
