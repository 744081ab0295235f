"""How soon a failed current sensor is named, and how often a right one is: the campaign's situations, by the hour.

    PYTHONPATH=tests/reference python -m sensor_failures [--seeds 96] [--first 0] [--class NAME ...]

The situations are those of `bms-ukf campaign`: plants that are not the model, seeded. Only the watch of the sensor is
run, so that hundreds of hours take minutes; SoC, which chooses the row of the tables, is off by 5 %.
"""

# ruff: noqa: T201 - it prints its table

from __future__ import annotations

import argparse
import logging
import math
from collections import defaultdict
from typing import NamedTuple

import numpy as np

from bms_ukf.campaign import classes
from bms_ukf.campaign.situation import Situation
from bms_ukf.cell import CellParams
from bms_ukf.failed import CurrentSensor
from bms_ukf.records import Fault, Sample

SOC_ERROR = 0.05
FAILS = "current_fails"
RIGHT = ("start_in_drive", "start_under_load", "start_under_charge", "start_after_minutes", "gaps", "rests", "charges")
RIGHT += ("sensor_error_alone", "sensor_errors_together", "age", "sampling", "packs", "temperatures")


class Seen(NamedTuple):
    """What was said of a sensor over one situation."""

    hours: float
    suspected_s: float  # from so many s on; NaN: never
    named_s: float
    began_s: float  # when, as it was said, it began to be wrong
    fault: Fault


def watch(situation: Situation, until_first: bool = True) -> Seen:
    """Show a sensor's samples to its judge."""
    cell = CellParams.load(situation.cell)
    cells = situation.cells
    sensor = CurrentSensor(cell, cells)
    suspected_s = named_s = began_s = math.nan
    fault = Fault.NONE
    t_ns = np.rint(situation.t_s * 1e9).astype(np.int64).tolist()
    voltage_V = list(situation.voltage_V) if cells > 1 else situation.voltage_V[:, 0].tolist()
    charged = np.clip(situation.soc.mean(axis=1) + SOC_ERROR, 0.0, 1.0).tolist()
    rows = zip(t_ns, situation.current_A.tolist(), voltage_V, situation.temperature_degC.tolist(), charged, strict=True)
    silent = situation.silent.tolist()
    for k, (now_ns, current_A, volts, degC, soc) in enumerate(rows):
        if silent[k]:
            continue
        sensor.see(Sample(now_ns, current_A, volts, degC), soc)
        if math.isnan(suspected_s) and (sensor.suspected or sensor.fault):
            suspected_s = now_ns * 1e-9
        if sensor.fault and not fault:
            fault, named_s, began_s = sensor.fault, now_ns * 1e-9, sensor.since_ns * 1e-9
            if until_first:
                break
    return Seen(float(situation.t_s[-1] - situation.t_s[0]) / 3600, suspected_s, named_s, began_s, fault)


def under_load_s(situation: Situation, from_s: float, to_s: float) -> float:
    """How long a current flowed."""
    loaded_s = np.where(situation.loaded, np.diff(situation.t_s, prepend=0.0), 0.0)
    return float(loaded_s[(situation.t_s > from_s) & (situation.t_s <= to_s)].sum())


def failures(seeds: range) -> None:
    rows = defaultdict(list)
    for seed in seeds:
        situation = classes.situation(FAILS, seed)
        failure = situation.failure
        assert failure is not None
        seen = watch(situation)
        kind = situation.words.split("current ")[1].split(" from ")[0]
        when = "in the run" if failure.at_s > 0 else "from the first sample"
        if failure.within_s == 600.0:
            when = "constant load"
        took_s = under_load_s(situation, failure.at_s, seen.named_s) if seen.fault else math.inf
        late_s = seen.began_s - failure.at_s
        if seen.fault and seen.named_s < failure.at_s:
            kind, when = "named before it failed", ""
        left_s = under_load_s(situation, failure.at_s, math.inf)
        rows[kind, when].append((took_s, late_s, seed, left_s, seen.fault.name, situation.plant))
    print(f"{'kind':18} {'fails':22} runs missed median_s worst_s began_late_s")
    for (kind, when), found in sorted(rows.items()):
        times = sorted(row[0] for row in found if math.isfinite(row[0]))
        missed = [(row[2], round(row[3]), row[5]) for row in found if not math.isfinite(row[0]) and row[3] > 120.0]
        late = max((row[1] for row in found if math.isfinite(row[0])), default=math.nan)
        middle, worst = (times[len(times) // 2], times[-1]) if times else (math.nan, math.nan)
        slow = max(found, key=lambda row: row[0] if math.isfinite(row[0]) else -1)
        print(f"{kind:18} {when:22} {len(found):4} {len(missed):6} {middle:8.0f} {worst:7.0f} {late:6.0f}", end="  ")
        print(f"slowest: seed {slow[2]} {slow[5]}; missed (seed, s under load): {missed}", flush=True)


def right(names: list[str], seeds: range) -> None:
    total = accused = 0.0
    print("class                    hours named suspected which")
    for name in names:
        hours, suspected, which = 0.0, 0, []
        for seed in seeds:
            situation = classes.situation(name, seed)
            seen = watch(situation, until_first=False)
            hours += seen.hours
            suspected += math.isfinite(seen.suspected_s)
            if seen.fault:
                which.append(f"{seed}: {seen.fault.name} at {seen.named_s:.0f} s ({situation.words})")
        total, accused = total + hours, accused + len(which)
        print(f"{name:24} {hours:5.0f} {len(which):5} {suspected:9}  {'; '.join(which)}", flush=True)
    print(f"{'all':24} {total:5.0f} {accused:5.0f}")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--seeds", type=int, default=96)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--class", dest="names", nargs="*", default=[FAILS, *RIGHT])
    given = options.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    logging.disable(logging.ERROR)
    if FAILS in given.names:
        failures(seeds)
    others = [name for name in given.names if name != FAILS]
    if others:
        right(others, range(given.first, given.first + max(1, given.seeds // 4)))


if __name__ == "__main__":
    main()
