"""What every expectation has: words for what it wants, and a judgement."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Self

from pydantic import Field, model_validator

from bms_ukf import toml
from bms_ukf.expectations.record import Record

NonNegative = Annotated[float, Field(ge=0)]
Soc = Annotated[float, Field(gt=0, le=1)]


@dataclass(slots=True, frozen=True)
class Verdict:
    """One expectation held against one run."""

    wanted: str
    found: str
    passed: bool


class Expectation(toml.Section):
    """One `[[expect]]` table."""

    kind: str

    @abstractmethod
    def wanted(self) -> str:
        """In words."""

    @abstractmethod
    def judge(self, record: Record) -> tuple[bool, str]:
        """Whether the run was so, and what was found."""

    def refers_to(self) -> str | None:
        """The name of the fault it is about."""
        return None

    def verdict(self, record: Record) -> Verdict:
        passed, found = self.judge(record)
        return Verdict(f"{self.kind}: {self.wanted()}", found, passed)


class Windowed(Expectation):
    """Of rows between two times; the default is the whole run."""

    from_s: NonNegative = 0.0
    to_s: NonNegative | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError("to_s after from_s")
        return self

    @property
    def window(self) -> tuple[float, float]:
        return self.from_s, math.inf if self.to_s is None else self.to_s

    def where(self) -> str:
        end = "the end" if self.to_s is None else f"{self.to_s:g} s"
        return f"from {self.from_s:g} s to {end}"


def pct(soc: float) -> str:
    return f"{100 * soc:.2f} %"
