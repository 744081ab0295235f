"""The group every command of `bms-ukf` joins."""

from __future__ import annotations

import click

from bms_ukf import __version__


@click.group(context_settings={"help_option_names": ["-h", "--help"]}, invoke_without_command=True)
@click.version_option(__version__, prog_name="bms-ukf")
@click.pass_context
def cli(context: click.Context) -> None:
    """Battery state of charge on a CAN bus."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())
