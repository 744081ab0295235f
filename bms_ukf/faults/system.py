"""Faults of the machine the daemon runs on."""

from __future__ import annotations

from typing import Literal

from bms_ukf.faults.base import Injection


class SystemFault(Injection):
    """Something that befalls the daemon's process, its file or its clock. Without `for_s` it is over at once."""

    @property
    def end_s(self) -> float:
        return self.at_s + (self.for_s or 0.0)


class DaemonKilled(SystemFault):
    """SIGKILL, and a start with what was stored after `for_s` (None: with the next step)."""

    kind: Literal["daemon_killed"]


class ColdRestart(SystemFault):
    """As a kill, and what was stored is gone."""

    kind: Literal["cold_restart"]


class StateCorrupted(SystemFault):
    """The state file is damaged, as a start after it will find; a daemon that runs on writes it anew."""

    kind: Literal["state_corrupted"]
    how: Literal["garbage", "truncated", "empty"] = "garbage"
    for_s: None = None


class ClockStep(SystemFault):
    """The wall clock, which stamps frames, is set by `step_s`, and set back after `for_s` (None: never)."""

    kind: Literal["clock_step"]
    step_s: float


AnyFault = DaemonKilled | ColdRestart | StateCorrupted | ClockStep
