"""The unit under test: the daemon of a CONFIG file, with a vehicle's end of its bus."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from bms_ukf import resources
from bms_ukf.cell import CellParams
from bms_ukf.faults.base import Injection
from bms_ukf.frames import Frame
from bms_ukf.scenario import Scenario

STATE = "state"  # the file's name, beside the configuration


class Unit(Protocol):
    """What the runner does with a daemon, wherever it runs. Times are those of the scenario, in ns.

    A context manager: entered, the daemon runs and has taken up what was stored.
    """

    def advance(self, t_ns: int) -> bool:
        """Let time pass until then; False if it was later already."""

    def send(self, frame: Frame) -> None:
        """From the vehicle, now."""

    def answers(self, until_ns: int) -> list[Frame]:
        """What the daemon has sent since the last call; it has until then to do so."""

    def interface(self, *, up: bool) -> None: ...

    def kill(self) -> None:
        """End it as it is, at once."""

    def start(self) -> None:
        """After `kill`, with what is stored."""

    def set_clock(self, offset_s: float) -> None:
        """Set the wall clock to so much more than it would be."""

    @property
    def state(self) -> Path:
        """Where the state file is, or would be."""

    def __enter__(self) -> Unit: ...

    def __exit__(self, *error: object) -> None: ...


def write_config(folder: Path, scenario: Scenario, source: Path, interface: str, channel: str) -> Path:
    """Write the CONFIG.toml of a scenario's daemon into `folder`. ConfigError without its cell, or if that contradicts
    the specification of the sensors.
    """
    daemon = scenario.daemon
    cell = resources.find(scenario.estimator.cell, "cells", ".toml", relative_to=source.parent).resolve()
    values: dict[str, Any] = {"format": 1, "cell": str(cell), "cells": scenario.cells}
    values |= daemon.model_dump(exclude={"state_period_s", "temperature_sensors"})
    values |= {"bus.interface": interface, "bus.channel": channel}
    values |= {"state.file": STATE, "state.period_s": daemon.state_period_s}
    if daemon.temperature_sensors > 1:
        values["pack.sensor_of"] = [sensor + 1 for sensor in daemon.sensor_of(scenario.cells)]
    tuning = scenario.estimator.tuning
    tuning.check(CellParams.load(cell), source, "estimator.tuning.sensor_spec")
    values |= {f"sensor_spec.{name}": value for name, value in tuning.sensor_spec.model_dump(exclude_none=True).items()}
    others = tuning.model_dump(exclude={"sensor_spec"}, exclude_none=True)
    values |= {f"estimator.{name}": value for name, value in others.items()}
    path = folder / "config.toml"
    path.write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items()), encoding="utf-8")
    return path


def corrupt(state: Path, how: str) -> None:
    """Damage a state file, if there is one."""
    if state.exists():
        data = state.read_bytes()
        state.write_bytes({"garbage": bytes(byte ^ 0x5A for byte in data), "truncated": data[:20], "empty": b""}[how])


def obstacle(faults: Sequence[Injection], impossible: dict[str, str]) -> str | None:
    """Why these faults cannot all be had, given what is not possible and why; None: they can."""
    reasons = [f"{fault.kind}: {impossible[fault.kind]}" for fault in faults if fault.kind in impossible]
    return "; ".join(dict.fromkeys(reasons)) or None
