"""Where the package's data lie: inside the installed wheel, or in the checkout's top-level folders."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from bms_ukf.errors import ConfigError

_PACKAGED = Path(__file__).parent / "data"
_CHECKOUT = Path(__file__).parent.parent
_FOLDERS = {
    "can": _CHECKOUT / "can",
    "cells": _CHECKOUT / "models" / "cells",
    "plants": _CHECKOUT / "models" / "plants",
    "scenarios": _CHECKOUT / "models" / "scenarios",
    "loads": _CHECKOUT / "models" / "loads",
    "campaign": _CHECKOUT / "models" / "campaign",
}


def folder(kind: str) -> Path:
    """The folder of one kind of data: `can`, `cells`, `plants`, `scenarios`, `loads` or `campaign`."""
    packaged = _PACKAGED / kind
    return packaged if packaged.is_dir() else _FOLDERS[kind]


def names(kind: str, suffix: str) -> list[str]:
    """The shipped names of a kind, sorted, without their suffix."""
    return sorted(path.stem for path in folder(kind).glob(f"*{suffix}"))


def find(given: str | Path, kind: str, suffix: str, *, relative_to: Path | None = None) -> Path:
    """The file meant by `given`: a path (from `relative_to`, else from the working folder) or a shipped name.

    Raises ConfigError naming the shipped names when there is no such file.
    """
    with suppress(OSError, RuntimeError):  # a name too long for the file system; a home of nobody
        path = Path(given).expanduser()
        if relative_to is not None and not path.is_absolute() and (relative_to / path).is_file():
            return relative_to / path
        if path.is_file():
            return path
        shipped = folder(kind) / f"{given}{suffix}"
        if path.name == str(given) and shipped.is_file():
            return shipped
    raise ConfigError(given, expected=f"a file, or one of the shipped {kind}: {', '.join(names(kind, suffix))}")


def default_dbc() -> Path:
    """The project's own CAN matrix."""
    return folder("can") / "bms.dbc"
