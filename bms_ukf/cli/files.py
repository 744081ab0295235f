"""What commands do with the files they are given."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from bms_ukf.errors import ConfigError

PATH = click.Path(path_type=Path)


def writable(_context: click.Context, _parameter: click.Parameter, path: Path | None) -> Path | None:
    """Refuse a file in a folder that is not there before the work is done, not after."""
    if path is not None and (path.is_dir() or not path.parent.is_dir()):
        raise ConfigError(path, expected="a file to be written, in a folder that exists")
    return path


def write_json(path: Path, data: dict[str, Any]) -> None:
    write(path, json.dumps(data, indent=2) + "\n")


def write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(path, expected=f"a file that can be written ({error.strerror})") from None
