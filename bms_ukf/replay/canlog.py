"""A CAN log through the daemon as `bms-ukf run` has it: one row for every set of frames it would have published.

Of a pack a row holds what its frames do: mean SoC, largest sigma, prediction and NIS of the cell that fits worst, `soh`
of the one with the least capacity. Its summary has the keys of `rerun`, with `steps_per_s` of the samples taken, and

| key | meaning |
|---|---|
| `samples` | that the estimator took |
| `frames` | what became of the received ones; see `frames.Counters` |
| `real_time_factor` | time of the log over that of the replay, reading included |
"""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bms_ukf.cell import CellParams
from bms_ukf.config import Setup
from bms_ukf.core import Core
from bms_ukf.errors import ConfigError
from bms_ukf.pack import Health
from bms_ukf.records import NAN, Detail, Estimate, Sample, largest_known
from bms_ukf.replay.ageing import ageing
from bms_ukf.replay.logs import LogClock, frames
from bms_ukf.replay.rows import Rows
from bms_ukf.shown import SOC_FIELDS
from bms_ukf.trace import Trace

LEAST_NS = 1_000_000  # a wait of no time would never end


def rerun(path: Path, config: Path, cell: CellParams | None = None) -> tuple[Trace, dict[str, Any]]:
    """Every set that would have been published, and the summary. `cell` takes the place of the configuration's."""
    setup = Setup.load(config, cell)
    estimator = setup.estimator()
    health = setup.health(estimator)
    core, clock, told = Core(estimator, setup.intake(), setup.pace, health), LogClock(), _Published(health)
    core.witness = told
    begin_s = time.perf_counter()
    log = frames(path, setup.decoder.ids(), fd=setup.config.bus.fd)
    for stamp_s, arbitration_id, is_extended_id, data, classic in log:
        while (silence_ns := clock.due(stamp_s) - clock.now()) > LEAST_NS:
            patience_ns = max(core.patience_ns(clock.now()), LEAST_NS)
            if silence_ns <= patience_ns:
                break
            clock.wait(patience_ns)
            core.idle(clock.now())
        core.hear(arbitration_id, is_extended_id, data, clock.at(stamp_s), classic=classic)
    took_s = time.perf_counter() - begin_s
    if not told.samples:
        expected = (
            f"frames of {', '.join(sorted({b.message.name for b in setup.decoder.bound}))}, as {config} maps them"
        )
        raise ConfigError(path, expected=expected)
    trace = told.rows.trace()
    final = {name: float(trace[name][-1]) if len(trace) else NAN for name in SOC_FIELDS}
    final_known = {name: value if np.isfinite(value) else None for name, value in final.items()}
    duration_s = clock.now() * 1e-9
    summary = {
        "recording": path.name,
        "cell": setup.cell.cell.name,
        "estimator": "srukf",
        "n": len(trace),
        "duration_s": duration_s,
        "steps_per_s": told.samples / took_s,
        "final_soc": final_known["soc"],
        "soc_sigma_final": final_known["soc_sigma"],
        "soc_low_final": final_known["soc_low"],
        "soc_high_final": final_known["soc_high"],
        "warnings": [*setup.warnings, *_warnings(setup, clock)],
        "samples": told.samples,
        "frames": asdict(setup.decoder.counters),
        "real_time_factor": duration_s / took_s,
    }
    return trace, summary | ageing(health)


def _warnings(setup: Setup, clock: LogClock) -> list[str]:
    found = []
    if setup.decoder.counters.refused:
        found.append(f"{setup.decoder.counters.refused} frames were refused for length, CRC or counter")
    if clock.steps:
        found.append(f"the clock that stamped the frames was set back {clock.steps} times")
    return found


class _Published:
    """A row for every set of frames."""

    def __init__(self, health: Health | None) -> None:
        self.rows, self.samples, self._health = Rows(), 0, health

    def stepped(self, sample: Sample, _: Estimate) -> None:
        self.samples += 1
        self.rows.measured(sample)

    def coasted(self, t_ns: int, _: Estimate) -> None:
        """A prediction is a row only if it is published."""

    def published(self, t_ns: int, estimate: Estimate, _: Detail) -> None:
        soh = NAN if self._health is None else -largest_known(-self._health.told_capacity)
        self.rows.add(t_ns, estimate, soh)
