"""Writes the page of a campaign: a row for each class beside its goals, then the worst run of each as a plot.

Importing this does not import matplotlib; writing a report does. The worst runs are run once more, which gives the same
sets: a campaign keeps figures only.
"""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path
from typing import Any

from bms_ukf.campaign import classes
from bms_ukf.campaign.run import run
from bms_ukf.campaign.view import COLUMNS, WORDS, misses
from bms_ukf.report.page import machine, write_page


def write_report(target: Path, summary: dict[str, Any]) -> Path:
    """Write the page `target` if it ends in .html, else `report.html` in the folder `target`; returns the page's path.

    `summary` is that of `campaign.command.summary`. Raises ConfigError if the place cannot be written.
    """
    found = summary["classes"]
    met = sum(not figures["missed"] for figures in found.values())
    seeds = summary["first_seed"], summary["first_seed"] + summary["runs_per_class"] - 1
    return write_page(
        target,
        "campaign.html.j2",
        [],
        title=f"{met} of {len(found)} classes meet their goals",
        heads=list(COLUMNS),
        rows=[_row(name, figures) for name, figures in found.items()],
        average=_row("average", {"runs": "", "worst_seed": None} | summary["average"]),
        misses=misses(summary),
        worst=[_worst(name, figures, summary["plants"]) for name, figures in found.items()],
        provenance=[
            ("Runs", f"{summary['runs_per_class']} of each class, seeds {seeds[0]} to {seeds[1]}"),
            ("Plants", ", ".join(summary["plants"])),
            ("Goals", "with the allowance for chance of a quick campaign" if summary["quick"] else "without allowance"),
            *machine(),
        ],
    )


def _row(name: str, figures: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": name,
        "runs": figures["runs"],
        "missed": bool(figures["missed"]),
        "cells": [_cell(figures, key, form) for key, form in COLUMNS.values()],
    }


def _cell(figures: dict[str, Any], key: str, form: str) -> dict[str, Any]:
    value, goal = figures.get(key), figures["goals"].get(key)
    limit = None if goal is None else f"≥ {goal['at_least']:g}" if "at_least" in goal else f"≤ {goal['at_most']:g}"
    return {
        "text": "–" if value is None else form.format(value),
        "goal": limit or "",
        "missed": key in figures["missed"],
    }


def _worst(name: str, figures: dict[str, Any], plants: list[str]) -> dict[str, Any]:
    from bms_ukf.report.campaign_plots import render  # matplotlib takes half a second that a run without one need not

    seed = figures["worst_seed"]
    (mine,) = (each for each in figures["each"] if each["seed"] == seed)
    situation = classes.situation(name, seed, plants)
    shown = ("inside_pct", "beyond_pct", "ok_pct", "half_width_pct", "rmse_pct")
    facts = [f"{WORDS[key]}: {mine[key]:.1f}" for key in shown if mine[key] is not None]
    if situation.failure is not None:
        facts.append("not named" if mine["named_s"] is None else f"named after {mine['named_s']:.0f} s under load")
    return {
        "name": name,
        "missed": bool(figures["missed"]),
        "draw": mine["draw"],
        "command": " ".join(["bms-ukf campaign --class", name, "--seed", str(seed), *_options(plants)]),
        "figure": b64encode(render(situation, run(situation))).decode(),
        "facts": "; ".join(facts),
    }


def _options(plants: list[str]) -> list[str]:
    """Return what the command needs to draw from these plants; nothing if they are all."""
    return [] if plants == list(classes.plants()) else [f"--plant {plant}" for plant in plants]
