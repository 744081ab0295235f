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

    summary = simulate.simulate("demo", report=report, judged=True)
    sys.exit(0 if simulate.passed(summary) else 1)


@cli.command()
@click.argument("config", type=PATH)
@click.option("--check", is_flag=True, help="Explain the configuration and exit.")
def run(config: Path, check: bool) -> None:
    """Estimate SoC on a CAN interface, as a daemon."""
    from bms_ukf import service

    if check:
        click.echo(service.explain(config))
    else:
        service.serve(config)


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
    if summary["plant_failure"]:
        raise PlantError(summary["plant_failure"])


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
