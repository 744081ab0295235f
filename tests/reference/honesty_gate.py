"""The ratchet of the quick campaign: goals that are missed today, each with the value that must not get worse.

`PYTHONPATH=tests/reference python -m honesty_gate [CLASS...]` (`make ratchet`: all) runs the quick campaign, on all
committed traces, and writes the file again. With classes it runs those alone, and keeps plants and the other figures.
A goal that is not in the file must be met. When the file is empty, the ratchet has done its work.
"""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bms_ukf.campaign import classes, command, goals, traces, view

GATE = Path(__file__).resolve().parents[1] / "honesty_gate.toml"
HEAD = """\
# Goals that the quick campaign misses today, in the order of its table: no figure may get worse than it is here.
# `make ratchet` measures them again, when the filter has got better or the campaign has changed.
"""
# Slack for small changes and other machines: shares by one run of the class, widths and errors by a factor.
SHARE_PCT, FACTOR = 100 / command.QUICK_RUNS, 1.25


def quick() -> command.Plan:
    """Return the runs of the gate: another plant's traces do not change them, as long as the file does not name it."""
    return command.plan(quick=True, plants=_file()["plants"])


def held() -> dict[str, dict[str, float]]:
    """Return the figures in the file, by class."""
    return {name: figures for name, figures in _file().items() if isinstance(figures, dict)}


def _file() -> dict[str, Any]:
    return tomllib.loads(GATE.read_text(encoding="utf-8"))


def broken(summary: dict[str, Any], gate: dict[str, dict[str, float]]) -> list[str]:
    """Return a line for each goal of a quick campaign that is missed by more than the gate has."""
    lines = []
    for name, found in summary["classes"].items():
        for goal in goals.missed(name, found, summary["quick"]):
            value, before = found[goal.figure], gate.get(name, {}).get(goal.figure)
            if before is None:
                lines.append(f"{name}: {goal.figure} {value:.2f}, goal {goal.words}")
                continue
            slack = SHARE_PCT if goal.share else (FACTOR - 1) * before
            worst = before - slack if goal.at_least else before + slack
            if value < worst if goal.at_least else value > worst:
                lines.append(f"{name}: {goal.figure} {value:.2f}, was {before:.2f} (goal {goal.words})")
    return lines


def missed(summary: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return the figures that a quick campaign misses, by class."""
    return {name: {key: found[key] for key in found["missed"]} for name, found in summary["classes"].items()}


def text(plants: Sequence[str], gate: dict[str, dict[str, float]]) -> str:
    """Return the file that holds a gate."""
    tables = [_table(name, gate[name]) for name in classes.CLASSES if gate.get(name)]
    return "".join([HEAD, f"plants = {json.dumps(list(plants))}\n", *tables])


def _table(name: str, figures: dict[str, float]) -> str:
    return f"\n[{name}]\n" + "".join(f"{key} = {value:.2f}\n" for key, value in figures.items())


def main(names: Sequence[str]) -> int:
    plants, gate = (_file()["plants"], held()) if names else (traces.plants(), {})
    for name in names or [None]:
        wanted = command.plan(name, quick=True, plants=plants)
        with view.progress(view.console(), len(wanted.tasks)) as watch:
            summary = command.summary(wanted, command.campaign(wanted, watch=watch))
        view.show(summary, view.console())
        gate |= missed(summary)
    GATE.write_text(text(plants, gate), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
