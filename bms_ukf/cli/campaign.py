"""The command that tests the estimator's promise."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from bms_ukf.cli.files import PATH, writable, write_json
from bms_ukf.cli.group import cli


@cli.command("campaign")
@click.option("--quick", is_flag=True, help="12 runs of each class in place of 60, with an allowance for chance.")
@click.option("--class", "name", metavar="NAME", help="One class of situations, or one family of them.  [default: all]")
@click.option("--seed", type=int, help="One run of each class: the one of this seed.")
@click.option("--first-seed", type=int, default=0, show_default=True, help="Seed of the first run of each class.")
@click.option("--runs", type=click.IntRange(1), help="Runs of each class.  [default: 60, quick 12]")
@click.option("--plant", "plants", multiple=True, help="Cut from traces of this plant; may be given again.  [all]")
@click.option("--jobs", type=click.IntRange(1), help="Runs at a time.  [default: as many as cores]")
@click.option("--report", type=PATH, callback=writable, help="Write a page here, with each class's worst run.")
@click.option("--json", "json_path", type=PATH, callback=writable, help="Write all figures here.")
def campaign_(
    quick: bool,
    name: str | None,
    seed: int | None,
    first_seed: int,
    runs: int | None,
    plants: tuple[str, ...],
    jobs: int | None,
    report: Path | None,
    json_path: Path | None,
) -> None:
    """Test the published interval in randomised situations; exit 1 if a class misses its goals."""
    from rich.console import Console

    from bms_ukf.campaign import command, view

    wanted = command.plan(name, seed, quick, first_seed, runs, plants)
    with view.progress(Console(stderr=True), len(wanted.tasks)) as watch:
        found = command.campaign(wanted, jobs, watch)
    summary = command.summary(wanted, found)
    view.show(summary, view.console())
    if json_path is not None:
        write_json(json_path, summary)
    if report is not None:
        from bms_ukf.report.campaign import write_report

        click.echo(f"report: {write_report(report, summary)}")
    sys.exit(0 if summary["passed"] else 1)
