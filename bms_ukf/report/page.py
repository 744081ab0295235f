"""Puts a report where it was asked for: one page that needs no other, or a page and its plots in a folder."""

from __future__ import annotations

import platform
from base64 import b64encode
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import jinja2

from bms_ukf.errors import ConfigError


class Named(Protocol):
    @property
    def name(self) -> str: ...


def write_page(target: Path, template: str, plots: Sequence[tuple[Named, bytes]], **values: Any) -> Path:
    """Write the page `target` if it ends in .html, else `report.html` and the plots as PNG into the folder `target`.

    `template` is a file beside this one; it is given `plots`, with the PNG in base64, and `values`. Returns the page's
    path. Raises ConfigError if the place cannot be written.
    """
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    encoded = [(plot, b64encode(png).decode()) for plot, png in plots]
    text = environment.get_template(template).render(plots=encoded, **values)
    page = target if target.suffix == ".html" else target / "report.html"
    try:
        if page != target:
            target.mkdir(parents=True, exist_ok=True)
            for plot, png in plots:
                (target / f"{plot.name}.png").write_bytes(png)
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(target, expected=f"a place that can be written ({error.strerror})") from None
    return page


def machine() -> list[tuple[str, str]]:
    """What the numbers of a page depend on beside its data, to end its provenance with."""
    return [("Versions", _versions()), ("Machine", f"{platform.system()} {platform.machine()}")]


def _versions() -> str:
    """Of this package and what its numbers depend on."""
    installed = []
    for name in ("bms-ukf", "numpy", "numba"):
        try:
            installed.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            installed.append(f"{name} (not installed as a package)")
    return ", ".join([*installed, f"Python {platform.python_version()}"])
