"""A diagnosis on the terminal, in 80 columns."""

from __future__ import annotations

from typing import Any

from rich.console import Console, Group
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from bms_ukf.diagnose import MAX_OUTSIDE
from bms_ukf.view import WIDTH


def show(found: dict[str, Any], console: Console | None = None) -> None:
    """Print what `diagnose.diagnose` found."""
    console = console or Console()
    title = (
        f"{found['cell']} · SoC {_pct(found['soc'])} ± {_pct(found['soc_sigma'])} · {found['temperature_degC']:.4g} °C"
    )
    style = "green" if found["verdict"]["worth_it"] else "yellow"
    console.print(Text(title, style="bold"), soft_wrap=True)
    for heading, body in (
        ("Terminal voltage: bias of its mean, and its sigma, mV", _bias(found)),
        ("Sigma points of the filter", _points(found)),
        (
            f"Slope of the OCV, and the sigma of SoC that {found['voltage_error_mV']:.2f} mV means",
            _observability(found),
        ),
    ):
        console.print()
        console.print(heading, style="bold", highlight=False)
        console.print(Padding(body, (0, 0, 0, 2)), width=WIDTH)
    console.print(f"\nOne step of the estimator: {found['step_us']:.2g} µs on this machine", highlight=False)
    verdict = Text(found["verdict"]["text"])
    console.print(Panel(verdict, title="is a UKF worth it here?", border_style=style, width=WIDTH, padding=(0, 2)))


def _bias(found: dict[str, Any]) -> Group:
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="dim")
    table.add_column("belief")
    for name in ("± SoC", "true σ", "EKF bias", "σ", "UKF bias", "σ", "outside"):
        table.add_column(name, justify="right")
    table.add_column("update", no_wrap=True)
    for row in found["bias"]:
        estimates = (row["tangent_line"], row["ukf"])
        table.add_row(
            row["size"],
            _pct(row["soc_sigma"]),
            _mV(row["true"]["std_mV"]),
            *(text for one in estimates for text in (_mV(one["bias_mV"], "+"), _mV(one["std_mV"]))),
            f"{100 * row['outside']:.1f} %",
            row["update"].removeprefix("sigma "),
        )
    outside = max(row["outside"] for row in found["bias"])
    notes = [f"One voltage at rest is good for {found['voltage_error_mV']:.2f} mV (sensor and model, one sigma)."]
    if outside > MAX_OUTSIDE:
        notes.append("Outside 0..1 the curve goes on with its edge slope, as no cell does.")
    if any(row["update"] == "components" for row in found["bias"]):
        notes.append("A wide belief is a sum of narrow Gaussians over SoC, each with sigma points of its own.")
    return Group(table, *(Text(note, style="dim") for note in notes))


def _points(found: dict[str, Any]) -> Group:
    points, sound = found["sigma_points"], found["positive_definite"]
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    voltages = [name for name in points if name.startswith("v_")]
    for name in ("SoC", *(name.removesuffix("_V") for name in voltages), "mean weight", "covariance weight"):
        table.add_column(name, justify="right")
    columns = (points[name] for name in ("soc", *voltages, "w_mean", "w_cov"))
    for soc, *volts, w_mean, w_cov in zip(*columns, strict=True):
        shown = (f"{1e3 * v:+.2f} mV" if v else "0" for v in volts)
        table.add_row(_pct(soc), *shown, f"{w_mean:.4g}", f"{w_cov:.4g}")
    word = "cannot lose" if sound["guaranteed"] else "may lose"
    notes = (
        f"alpha {points['alpha']:g}, beta {points['beta']:g}, kappa {points['kappa']:g}. The covariance {word} its "
        f"positive definiteness: the innovation variance less what the states explain is r + e²(beta + alpha²(n + "
        f"kappa − 1)) = {sound['least_mV2']:.3g} mV² here, never below the measurement's r = {sound['r_mV2']:.3g} mV²."
    )
    return Group(table, Text(notes, style="dim"))


def _observability(found: dict[str, Any]) -> Table:
    table = Table(box=None, padding=(0, 1, 0, 0), show_header=False)
    rows = found["observability"]
    slopes = [row["docv_dsoc_mV_per_pct"] for row in rows]
    sigmas = [row["soc_sigma"] for row in rows]
    table.add_row(Text("SoC, %", style="dim"), *(f"{100 * row['soc']:.0f}" for row in rows))
    table.add_row(Text("mV per %", style="dim"), *(f"{slope:{'.3g' if slope >= 10 else '.2f'}}" for slope in slopes))
    table.add_row(Text("sigma, %", style="dim"), *("–" if sigma is None else f"{100 * sigma:.2f}" for sigma in sigmas))
    return table


def _mV(value: float, sign: str = "") -> str:
    return f"{value:{sign}.{0 if abs(value) >= 1000 else 2 if sign else 1}f}"


def _pct(share: float) -> str:
    return f"{100 * share:.3g} %"
