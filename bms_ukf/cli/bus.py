"""Commands that talk on a bus, a real one or a virtual."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from bms_ukf.cli.files import PATH, writable, write, write_json
from bms_ukf.cli.group import cli
from bms_ukf.errors import PlantError


@cli.command()
@click.option("--report", type=PATH, default=Path("demo-report"), show_default=True, help="Folder for plots and page.")
def demo(report: Path) -> None:
    """Drive a physics-based cell over a virtual CAN bus and watch its SoC come back."""
    from bms_ukf import simulate

    sys.exit(0 if simulate.passed(simulate.simulate("demo", report=report, judged=True)) else 1)


@cli.command()
@click.argument("config", type=PATH)
@click.option("--check", is_flag=True, help="Explain the configuration and exit.")
@click.option("--log-frames", type=PATH, callback=writable, help="Write all frames here: .log, .asc, .blf, .trc, .mf4")
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
@click.option("--out", type=PATH, callback=writable, help="Write the configuration here, and not to the terminal.")
def init(dbc: tuple[Path, ...], out: Path | None) -> None:
    """Propose a configuration for a vehicle's own DBC files."""
    from bms_ukf import skeleton

    text, gaps = skeleton.propose(dbc, out)
    if out is None:
        click.echo(text, nl=False)
    else:
        write(out, text)
    for gap in gaps:
        click.echo(f"fill in {gap}", err=True)


@cli.command()
@click.argument("scenario", required=False)
@click.option("--inspect", "fmu", type=PATH, help="Print the variables of an FMU and a scenario for it, and exit.")
@click.option("--json", "json_path", type=PATH, callback=writable, help="Write the summary here.")
@click.option("--out", type=PATH, callback=writable, help="Write the trace here, as CSV.")
@click.option("--report", type=PATH, callback=writable, help="Write a page here, with its plots inside.")
def cosim(
    scenario: str | None, fmu: Path | None, json_path: Path | None, out: Path | None, report: Path | None
) -> None:
    """Run a SCENARIO: a plant FMU, a load, sensors, a bus and the estimator."""
    if fmu is not None:
        from bms_ukf.plant import inspection

        click.echo(inspection.describe(fmu))
        return
    if scenario is None:
        raise click.UsageError("SCENARIO or --inspect PLANT.fmu is missing")
    from bms_ukf import simulate

    summary = simulate.simulate(scenario, out=out, report=report)
    if json_path is not None:
        write_json(json_path, summary)
    if failure := summary["plant_failure"]:
        raise PlantError(failure, "refused")


@cli.command("hil")
@click.argument("scenarios", nargs=-1, required=True)
@click.option("--interface", help="direct, virtual, or one of python-can's.  [default: as in each SCENARIO]")
@click.option("--channel", help="Of the interface.  [default: as in each SCENARIO]")
@click.option("--junit", type=PATH, callback=writable, help="Write the verdicts here, for CI.")
@click.option("--json", "json_path", type=PATH, callback=writable, help="Write all figures here.")
@click.option("--report", type=PATH, callback=writable, help="Write a page here: the fault matrix, plots, verdicts.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Scenarios at a time.")
def hil_(
    scenarios: tuple[str, ...],
    interface: str | None,
    channel: str | None,
    junit: Path | None,
    json_path: Path | None,
    report: Path | None,
    jobs: int,
) -> None:
    """Run SCENARIOS (files or folders) with faults against the daemon, and judge them; exit 1 if one fails."""
    from bms_ukf.hil import command

    results = command.hil(scenarios, command.Place(interface, channel), jobs, junit)
    if report is not None:
        from bms_ukf.report.hil import write_report

        click.echo(f"report: {write_report(report, results)}")
    if json_path is not None:
        write_json(json_path, {"scenarios": [result.summary() for result in results]})
    sys.exit(1 if any(result.outcome == "failed" for result in results) else 0)
