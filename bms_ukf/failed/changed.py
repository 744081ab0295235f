"""Whether the current has come to mean something else during the run: the other way round, half of it, nothing.

The textbook tool for a change at an unknown time: Page's cumulative sum (Biometrika 41, 1954) of the log likelihood
ratio of what the voltage does if the sensor has failed in each way, against what it does if it is right. For
independent steps of the stated distribution a false alarm comes on average no sooner than after e^alarm steps (Lorden,
Annals of Mathematical Statistics 42, 1971): 5e8 for 20. The steps are neither quite, so the ratio of one is bounded,
the size of the errors is learnt in the run (`steps`), and evidence fades: a failure shows within a minute of driving.
"""

from __future__ import annotations

import math

from bms_ukf.failed.steps import Step
from bms_ukf.records import Fault

DOUBT = 4.0  # from where on nothing more is learnt of the cell
SUSPECTED = 0.7  # of what names it
MOST = 2.5  # of one step, which may have other causes
CLOSE, MOST_CLOSE = 0.15, 5.0  # of one that is what a failure makes of it, to such a share: chance and skew seldom are
FADES_S, FADES_STEPS = 90.0, 20.0  # the longer of the two
# What names each kind. That the voltage has for a while nothing to do with the current is what a skew that changes
# looks like, too: it needs more.
ALARMS = {Fault.CURRENT_SIGN: 22.0, Fault.CURRENT_FAILED: 40.0, Fault.CURRENT_SCALE: 20.0}
SETTLED = 20.0  # informative steps after which a cell's own resistance is known from those of its file
KNEE = 0.15  # SoC below which the resistance doubles by itself


class Changed:
    """Sums the evidence of every step in which the current moved."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self.fault = Fault.NONE
        self.since_ns = 0  # when what `fault` says began
        self._sums = dict.fromkeys(ALARMS, 0.0)
        self._began_ns = dict.fromkeys(ALARMS, 0)

    @property
    def doubted(self) -> bool:
        return max(self._sums.values()) > DOUBT

    @property
    def suspected(self) -> Fault:
        """What is likely, and not yet named."""
        suspected = Fault.NONE
        for kind, alarm in ALARMS.items():
            if self._sums[kind] > SUSPECTED * alarm:
                suspected |= kind
        return suspected

    def take(self, step: Step, informed: float, soc: float) -> None:
        """`informed`: steps that the cell's own resistance is known from."""
        kept = math.exp(-step.dt_s / max(FADES_S, FADES_STEPS * step.dt_s))
        evidence = against(step) if step.tells else None
        for kind, alarm in ALARMS.items():
            total = kept * self._sums[kind]
            if evidence is not None and not (kind is Fault.CURRENT_SCALE and (informed < SETTLED or soc < KNEE)):
                total = max(0.0, total + evidence[kind])
            if self._sums[kind] < MOST <= total:
                self._began_ns[kind] = step.t_ns
            self._sums[kind] = total
            if total >= alarm and self.fault is Fault.NONE:
                self.fault, self.since_ns = kind, self._began_ns[kind]


def against(step: Step) -> dict[Fault, float]:
    """The log likelihood ratio, bounded, of each kind of failure against a current that is right."""
    failed_V = {Fault.CURRENT_SIGN: -step.p_V, Fault.CURRENT_FAILED: 0.0, Fault.CURRENT_SCALE: step.double_V}
    return {kind: _ratio(step, predicted_V) for kind, predicted_V in failed_V.items()}


def _ratio(step: Step, failed_V: float) -> float:
    right, failed = step.y_V - step.p_V, step.y_V - failed_V
    most_V = CLOSE * abs(failed_V) + 2.0 * step.noise_V
    is_close = abs(failed) < most_V and abs(failed_V) > 5.0 * step.noise_V
    most = MOST_CLOSE if is_close else MOST
    return min(max((right * right - failed * failed) / (2.0 * step.s_V * step.s_V), -MOST), most)


def agreement(step: Step) -> float:
    """The log likelihood ratio of the current against the likeliest failure, bounded; 0 where the current stands."""
    return min(-max(against(step).values()), MOST) if step.tells else 0.0
