"""The `bms-ukf` command: reads arguments, calls one function, turns errors into one line and an exit code.

0 fine · 1 the work ran and its verdict is bad · 2 wrong usage, configuration or input · 130 interrupted
"""

from __future__ import annotations

import sys
from typing import NoReturn

import click

from bms_ukf.cli import bus, campaign, export, offline  # noqa: F401 - their commands join the group
from bms_ukf.cli.group import cli
from bms_ukf.errors import BmsError, ConfigError


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
