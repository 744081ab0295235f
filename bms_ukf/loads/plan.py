"""A load table made ready to run: files read, neighbours joined, and each part able to say its steps one by one."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from bms_ukf.loads.profile import Piecewise
from bms_ukf.loads.segments import Cccv, Limits, Quantity, Schedule, Segment
from bms_ukf.loads.terminal import Terminal
from bms_ukf.loads.vehicle import Vehicle

Steps = Iterator[tuple[Quantity, float]]
SOFT_START = 0.1  # of the current of a CC-CV charge: its first step, if nothing is known of the cell yet


class Plan(Protocol):
    """Anything that asks for something step by step. `terminal` is brought up to date before every step."""

    @property
    def quantities(self) -> set[Quantity]:
        """What it may ask for."""

    def steps_at_most(self, step_s: float) -> int: ...

    def steps(self, step_s: float, terminal: Terminal) -> Steps: ...


@dataclass(frozen=True, slots=True)
class Sequel:
    """Parts one after the other, all of them `repeat` times."""

    parts: Sequence[Plan]
    repeat: int

    @property
    def quantities(self) -> set[Quantity]:
        return set().union(*(part.quantities for part in self.parts))

    def steps_at_most(self, step_s: float) -> int:
        return self.repeat * sum(part.steps_at_most(step_s) for part in self.parts)

    def steps(self, step_s: float, terminal: Terminal) -> Steps:
        for _ in range(self.repeat):
            for part in self.parts:
                yield from part.steps(step_s, terminal)


@dataclass(frozen=True, slots=True)
class Until:
    """A part that ends early once a limit is reached; if it is from the start, there is no step at all."""

    limits: Limits
    part: Plan

    @property
    def quantities(self) -> set[Quantity]:
        return self.part.quantities

    def steps_at_most(self, step_s: float) -> int:
        return self.part.steps_at_most(step_s)

    def steps(self, step_s: float, terminal: Terminal) -> Steps:
        steps = self.part.steps(step_s, terminal)
        while not terminal.reached(self.limits):
            step = next(steps, None)
            if step is None:
                return
            yield step


@dataclass(frozen=True, slots=True)
class Hold:
    """Constant current, then constant voltage."""

    settings: Cccv

    @property
    def quantities(self) -> set[Quantity]:
        return {"current_A"}

    def steps_at_most(self, step_s: float) -> int:
        return math.ceil(self.settings.max_duration_s / step_s - 1e-6)

    def steps(self, step_s: float, terminal: Terminal) -> Steps:
        sign, constant_A = math.copysign(1.0, self.settings.cccv_A), abs(self.settings.cccv_A)
        for _ in range(self.steps_at_most(step_s)):
            largest_A = constant_A if terminal.resistance_ohm else SOFT_START * constant_A
            holding_A = sign * terminal.holding(self.settings.voltage_V, highest=sign < 0)
            if holding_A <= min(self.settings.cutoff_A, largest_A):
                return
            yield "current_A", sign * min(holding_A, largest_A)


def plan(segments: Sequence[Segment], repeat: int, vehicle: Vehicle, relative_to: Path | None) -> Plan:
    """Reads the files that the segments name. Neighbours that need not know the plant become one Piecewise.

    Raises ConfigError for a file that is missing or malformed.
    """
    parts: list[Plan] = []
    for segment in segments:
        part: Plan
        if isinstance(segment, Schedule):
            part = plan(segment.schedule, segment.repeat, vehicle, relative_to)
        elif isinstance(segment, Cccv):
            part = Hold(segment)
        else:
            part = Piecewise(segment.quantity, *segment.intervals(vehicle, relative_to), segment.repeat)
        if segment.limited:
            part = Until(segment, part)
        last = parts[-1] if parts else None
        if isinstance(part, Piecewise) and isinstance(last, Piecewise) and part.quantity == last.quantity:
            parts[-1] = last.then(part)
        else:
            parts.append(part)
    if len(parts) == 1 and isinstance(parts[0], Piecewise):
        return parts[0].repeated(repeat)
    return Sequel(parts, repeat)
