"""What the voltage does under a current that says it does not move: a load that the sensor does not see.

Beyond what is left of noise, resolution and relaxation (`steps`), a step of SIGMAS is a load that was not seen: by
chance one in 5e8. Cells do not do it: three such steps within 120 s were seen once, in pulse tests resampled to 2 s. So
STEPS of them within WINDOW_S name the sensor; one does if the sensor failed within the last hour. Under a constant load
there is only one: it does if the voltage goes on as under a load, by LASTS_S; so does a step of the current that the
voltage does not follow.

Smaller loads add up: while the current stands still, Page's cumulative sum of the log likelihood ratio of a spread
twice the noise names the sensor at ALARM, which Gaussian noise reaches by chance in e^ALARM steps.

Where it ends: a load whose steps on r0 are less than about 1.5 times the noise of the voltage is not seen, nor is a
failure while the true current is what the sensor shows. Of one cell, a voltage that jumps and goes on like a loaded one
is the same thing to see, and is called the current's; of several cells most have to do so.
"""

from __future__ import annotations

import math
from collections import deque

from bms_ukf.failed.steps import Step

SIGMAS = 6.0
ALARM, MOST = 20.0, 3.0  # the likelihood ratio, and how many sigmas a step counts for at most
UNMOVED = 0.25  # of the voltage's step, what the current explains of it at most, for it to be one that was not seen
STEPS = 4
WINDOW_S, WINDOW_STEPS = 120.0, 18.0  # the longer of the two
LASTS_S, LASTS_STEPS = 40.0, 8.0
CALM = 3  # steps before a single one, in which nothing as large happened
GOES_ON = 1.15  # times its first step: r1 and r2 add half of r0 and more within a minute
FOLLOWS = 0.4  # of what is predicted: a voltage that does less does not follow


class Unseen:
    """`since_ns` is when the first of what names the sensor happened; None while nothing does."""

    def __init__(self) -> None:
        self.probation_ns: int | None = None  # until when
        self.reset()

    def reset(self) -> None:
        self.since_ns: int | None = None
        self._seen: deque[int] = deque()
        self._before: deque[Step] = deque(maxlen=CALM)
        self._one: _Lasting | None = None
        self._sum, self._began_ns = 0.0, 0

    @property
    def pending(self) -> bool:
        """A load may not have been seen."""
        return self._one is not None or len(self._seen) > 2 or self._sum > 0.6 * ALARM

    @property
    def seen(self) -> bool:
        """One of what may be several."""
        return bool(self._seen) or self._one is not None

    def is_on_probation(self, t_ns: int) -> bool:
        return self.probation_ns is not None and t_ns < self.probation_ns

    def interrupt(self) -> None:
        """What comes next does not follow what came."""
        self._before.clear()
        self._one = None

    def take(self, step: Step) -> None:
        unseen = is_unseen(step)
        if unseen:
            self._seen.append(step.t_ns)
        window_ns = 1e9 * max(WINDOW_S, WINDOW_STEPS * step.dt_s)
        while self._seen and step.t_ns - self._seen[0] > window_ns:
            self._seen.popleft()
        if len(self._seen) >= (1 if self.is_on_probation(step.t_ns) else STEPS):
            self.since_ns = self._seen[0]
        if step.still:
            self._add(step)
        if self._one is not None:
            self._one = self._one.take(step)
        elif len(self._before) == CALM and (unseen or _is_not_followed(step)) and _is_lone(step, self._before):
            self._one = _Lasting(step, self._before)
        if self._one is not None and self._one.failed:
            self.since_ns = self._one.t_ns
        self._before.append(step)

    def _add(self, step: Step) -> None:
        sigmas = min(abs(step.left_V) / step.s_V, MOST)
        total = max(0.0, self._sum + 0.375 * sigmas * sigmas - math.log(2.0))
        if self._sum == 0.0 < total:
            self._began_ns = step.t_ns
        self._sum = total
        if total >= ALARM:
            self.since_ns = self._began_ns


def is_unseen(step: Step) -> bool:
    return abs(step.left_V) > SIGMAS * step.s_V and abs(step.p_V) < UNMOVED * abs(step.y_V)


class _Lasting:
    """One step that either channel did alone, and what both did since; counted from each step shortly before it, too,

    so that what only comes late or early is not taken for something that does not come.
    """

    def __init__(self, step: Step, before: deque[Step]) -> None:
        self.t_ns, self.failed = step.t_ns, False
        self._first, self._moved = step, abs(step.p_V) > abs(step.y_V)
        self._y_V, self._p_V = [step.y_V], [step.p_V]
        for earlier in reversed(before):
            self._y_V.append(self._y_V[-1] + earlier.y_V)
            self._p_V.append(self._p_V[-1] + earlier.p_V)
        self._steps = 0
        self._level_V = self._y_V[:]  # of y, without its noise

    def take(self, step: Step) -> _Lasting | None:
        """None where it is over: the current moves again, or the other channel has followed."""
        self._steps += 1
        self._y_V = [y_V + step.y_V for y_V in self._y_V]
        self._p_V = [p_V + step.p_V for p_V in self._p_V]
        self._level_V = [was + 0.2 * (now - was) for was, now in zip(self._level_V, self._y_V, strict=True)]
        first, large_V = self._first, SIGMAS * step.noise_V
        if self._steps > 2 and abs(step.p_V) > max(large_V, 0.3 * abs(first.p_V)):
            return None
        if self._steps > 7 and not all(map(self._is_apart, self._level_V, self._p_V)):
            return None
        if step.t_ns - self.t_ns >= 1e9 * max(LASTS_S, LASTS_STEPS * step.dt_s):
            self.failed = self._moved or abs(self._level_V[0]) > GOES_ON * abs(first.y_V) + 2.0 * step.noise_V
            return self if self.failed else None
        return self

    def _is_apart(self, y_V: float, p_V: float) -> bool:
        if self._moved:
            return p_V / self._first.p_V > 0.5 and y_V / p_V < FOLLOWS
        return (y_V - p_V) / self._first.left_V > 0.5


def _is_not_followed(step: Step) -> bool:
    return abs(step.p_V) > 6.0 * step.noise_V and abs(step.y_V) < 0.25 * abs(step.p_V)


def _is_lone(step: Step, before: deque[Step]) -> bool:
    most_V = 0.3 * max(abs(step.y_V), abs(step.p_V))
    return all(abs(earlier.y_V) < most_V and abs(earlier.p_V) < most_V for earlier in before)
