"""Faults of sensors: what was measured is changed before it is sent."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Annotated, Literal, Self

import numpy as np
from numpy.random import Generator
from pydantic import Field, model_validator

from bms_ukf.faults.base import Injection, Positive, generators
from bms_ukf.records import NAN, PerCell, Sample

Effect = Callable[[float, float], float]  # what was measured, and seconds since the fault began


class SensorFault(Injection):
    """`signal` is measured wrong; values are in its unit."""

    signal: Literal["current_A", "voltage_V", "temperature_degC"]
    cell: Annotated[int, Field(ge=1)] | None = None  # of a voltage or temperature; None: all

    @model_validator(mode="after")
    def _current_is_one(self) -> Self:
        if self.signal == "current_A" and self.cell is not None:
            raise ValueError("no cell: one current flows through all")
        return self

    @abstractmethod
    def effect(self, dice: Generator) -> Effect:
        """What it makes of a measured value."""


class Offset(SensorFault):
    """Reads `offset` too much."""

    kind: Literal["offset"]
    offset: float

    def effect(self, dice: Generator) -> Effect:
        return lambda value, _: value + self.offset


class Scale(SensorFault):
    """Reads `factor` times what it should."""

    kind: Literal["scale"]
    factor: float

    def effect(self, dice: Generator) -> Effect:
        return lambda value, _: value * self.factor


class Drift(SensorFault):
    """An offset that grows by `per_hour`."""

    kind: Literal["drift"]
    per_hour: float

    def effect(self, dice: Generator) -> Effect:
        return lambda value, since_s: value + self.per_hour * since_s / 3600.0


class Stuck(SensorFault):
    """Repeats the value it read when the fault began, or `value`."""

    kind: Literal["stuck"]
    value: float | None = None

    def effect(self, dice: Generator) -> Effect:
        held = self.value

        def hold(value: float, _: float) -> float:
            nonlocal held
            held = value if held is None else held
            return held

        return hold


class Spike(SensorFault):
    """One reading is off by `height`, at the start and then every `every_s`; None: at the start only."""

    kind: Literal["spike"]
    height: float
    every_s: Positive | None = None

    @property
    def end_s(self) -> float:
        return self.at_s if self.every_s is None else super().end_s

    def effect(self, dice: Generator) -> Effect:
        due_s = 0.0

        def strike(value: float, since_s: float) -> float:
            nonlocal due_s
            if since_s < due_s:
                return value
            due_s = np.inf if self.every_s is None else due_s + self.every_s
            return value + self.height

        return strike


class OpenWire(SensorFault):
    """Nothing is measured, and the sender knows it: not available."""

    kind: Literal["open_wire"]

    def effect(self, dice: Generator) -> Effect:
        return lambda _value, _: NAN


AnyFault = Offset | Scale | Drift | Stuck | Spike | OpenWire


class SensorFaults:
    """All of a scenario, in the order of its file."""

    def __init__(self, faults: Sequence[Injection], seed: int, cells: int) -> None:
        """Of `faults` those of sensors are taken."""
        self._cells = cells
        own = [fault for fault in faults if isinstance(fault, SensorFault)]
        self._effects = [
            (fault, [fault.effect(dice) for _ in range(cells)])
            for fault, dice in zip(own, generators(seed, own), strict=True)
        ]

    def spoil(self, sample: Sample) -> Sample:
        """Change a sample, in place, as the faults active at its time do; the same sample."""
        for fault, effects in self._effects:
            if fault.active(sample.t_ns):
                since_s = fault.since_s(sample.t_ns)
                setattr(sample, fault.signal, self._spoilt(getattr(sample, fault.signal), fault, effects, since_s))
        return sample

    @staticmethod
    def _spoilt(values: PerCell, fault: SensorFault, effects: Sequence[Effect], since_s: float) -> PerCell:
        if isinstance(values, float):
            return effects[0](values, since_s)
        wrong = values.copy()
        for k in range(len(wrong)) if fault.cell is None else (fault.cell - 1,):
            wrong[k] = effects[k](float(values[k]), since_s)
        return wrong
