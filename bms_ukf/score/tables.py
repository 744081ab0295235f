"""A score as tables of text, for the terminal and for the page."""

from __future__ import annotations

from typing import Any, NamedTuple

from bms_ukf import honesty
from bms_ukf.score import cases

SHOWN = {"srukf": "bms-ukf", "ekf": "EKF", "coulomb": "coulomb"}
NONE = "–"
HALF_WIDTH_AT_MOST = 3.0  # times the RMSE: a wider interval is honest, and says little


class Table(NamedTuple):
    title: str
    header: list[str]
    rows: list[list[str]]


def every(summary: dict[str, Any]) -> list[Table]:
    """The tables of a score, the most condensed first."""
    return [groups(summary), temperatures(summary), recordings(summary), variants(summary)]


def groups(summary: dict[str, Any]) -> Table:
    """RMSE of every group for every estimator, and ours in detail."""
    estimators, weights = summary["estimators"], summary["weights"]
    total = [f"{estimator['weighted_rmse_pct']:.2f}" for estimator in estimators.values()]
    rows = [["weighted", "1.00", *total, NONE, NONE, NONE, NONE]]
    for name in _ours(summary)["groups"]:
        weight = f"{weights[name]:.2f}" if name in weights else "apart"
        rows.append([name, weight, *_compared(summary, "groups", name)])
    fitted = [estimator["fitted"] for estimator in estimators.values()]
    if fitted[0] is not None:
        rows.append(
            ["fitted, nominal", "apart", *(_number(found["rmse_pct"]) for found in fitted), *_detail(fitted[0])]
        )
    return Table("RMSE by group, % SoC", ["group", "weight", *_names(summary), *_DETAIL], rows)


def temperatures(summary: dict[str, Any]) -> Table:
    """The same by temperature, nominal."""
    rows = [[f"{degree} °C", *_compared(summary, "temperatures", degree)] for degree in _ours(summary)["temperatures"]]
    return Table("RMSE by temperature, nominal, % SoC", ["temperature", *_names(summary), *_DETAIL], rows)


def recordings(summary: dict[str, Any]) -> Table:
    """The same by recording, nominal; recordings that were fitted are marked."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for outcome in summary["outcomes"]:
        if outcome["kind"] == cases.NOMINAL:
            label = outcome["recording"] + (" (fitted)" if outcome["use"] == "fit" else "")
            found.setdefault(label, {})[outcome["estimator"]] = outcome["figures"]
    rows = [
        [label, *(_number(figures["rmse_pct"]) for figures in by.values()), *_detail(next(iter(by.values())))]
        for label, by in found.items()
    ]
    return Table("RMSE by recording, nominal, % SoC", ["recording", *_names(summary), *_DETAIL], rows)


def variants(summary: dict[str, Any]) -> Table:
    """RMSE of every estimator for each temperature and case, and how honest and how sharp our interval is."""
    estimators, rates = summary["estimators"], summary["offsets_c_rate"]
    rows = []
    for found in zip(*(estimator["variants"] for estimator in estimators.values()), strict=True):
        ours, case = found[0], found[0]["case"]
        kind, _, value = case.partition(" ")
        rate = f" ({rates[value.removesuffix(' A')]:+.2f} C)" if kind == cases.OFFSET else ""
        rows.append(
            [
                f"{ours['temperature_degC']:g} °C, {case}{rate}",
                *(_number(other["rmse_pct"]) for other in found),
                f"{100 * ours['coverage95']:.1f} %" + ("" if _is_honest(ours) else " !"),
                _number(ours["half_width_pct"]) + ("" if _is_sharp(ours) else " !"),
            ]
        )
    header = ["temperature, case", *_names(summary), "inside", "half-width"]
    return Table("RMSE, share inside the 95 % interval and its median half-width, % SoC", header, rows)


def _is_honest(figures: dict[str, Any]) -> bool:
    return bool(figures["coverage95"] >= honesty.INSIDE_AT_LEAST)


def _is_sharp(figures: dict[str, Any]) -> bool:
    return bool(figures["half_width_pct"] <= HALF_WIDTH_AT_MOST * figures["rmse_pct"])


def runs(summary: dict[str, Any], estimator: str) -> Table:
    """Every run of one estimator: recordings down, cases across. Start-up counts from 600 s on."""
    found: dict[str, dict[str, float | None]] = {}
    for outcome in summary["outcomes"]:
        if outcome["estimator"] == estimator and outcome["use"] == "validate":
            figures = outcome["figures"]
            figures = figures["after_600s"] if outcome["kind"] == cases.STARTUP else figures
            found.setdefault(outcome["recording"], {})[outcome["case"]] = figures["rmse_pct"]
    names = list(dict.fromkeys(name for by in found.values() for name in by))
    order = (cases.NOMINAL, cases.OFFSET, cases.INITIAL, cases.STARTUP)
    names.sort(key=lambda name: order.index(name.split()[0]))
    rows = [[recording, *(_number(by.get(name)) for name in names)] for recording, by in found.items()]
    return Table(f"Every run of {SHOWN[estimator]}: RMSE, % SoC", ["recording", *names], rows)


def notes(summary: dict[str, Any]) -> list[str]:
    """What there is to know beside the tables."""
    offsets = ", ".join(f"{offset} A is {rate:+.3f} C" for offset, rate in summary["offsets_c_rate"].items())
    groups, step_s = _ours(summary)["variants"], summary["step_s"]
    return [
        f"Of {len(groups)} groups of temperature and case {sum(map(_is_honest, groups))} have at least"
        f" {100 * honesty.INSIDE_AT_LEAST:g} % inside, and {sum(map(_is_sharp, groups))} a median half-width of at most"
        f" {HALF_WIDTH_AT_MOST:g} times the RMSE. The others are marked with an exclamation mark.",
        f"Rows: {'as recorded' if step_s is None else f'one each {step_s:g} s'}."
        f" Capacity: {'learned on the way' if summary['health'] else 'that of the cell file'}.",
        f"Offsets: {offsets}.",
        f"Not filled: {', '.join(summary['missing'])}.",
        "Where the reference was counted from the same current, coulomb counting is right until an error is added.",
    ]


_DETAIL = ["MAE", "max", "in band", "settled"]


def _ours(summary: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = next(iter(summary["estimators"].values()))
    return found


def _names(summary: dict[str, Any]) -> list[str]:
    return [SHOWN[name] for name in summary["estimators"]]


def _compared(summary: dict[str, Any], section: str, name: str) -> list[str]:
    found = [estimator[section][name] for estimator in summary["estimators"].values()]
    return [*(_number(figures["rmse_pct"]) for figures in found), *_detail(found[0])]


def _detail(figures: dict[str, Any]) -> list[str]:
    covered, settled = figures["coverage95"], figures["settled_s"]
    return [
        _number(figures["mae_pct"]),
        _number(figures["max_pct"]),
        NONE if covered is None else f"{100 * covered:.0f} %",
        "never" if settled is None else f"{settled:.0f} s",
    ]


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.2f}"
