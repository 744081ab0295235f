"""How far the voltage's changes, block by block, are what the current's changes explain by the cell file.

    y = change of the voltage, u = fall of the voltage by `response` under the measured current
    y = -(a0 u_before + a1 u + a2 u_after) + error,   error ~ N(0, sigma^2 + bits^2 + (rho U)^2)

The three taps are learnt in the run, by least squares over the last MEMORY blocks in which the current moved: their sum
is the cell's own resistance as a multiple of the cell file's (age, cold, a core warmer than the surface), and how it is
shared among them is the skew between the two channels, the mean of a current against the instant of a voltage. On the
recordings of two cell types (1 Hz and 10 Hz, -15 to 45 degC, and those resampled to 1, 2 and 10 s) the sum stayed
within 0.75 and 1.5 over whole drives, where one tap alone went from 0.1 to 1.2. sigma (noise) and rho (error relative
to U, the largest u nearby) are learnt as well; the bits of both channels are the smallest changes seen.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from bms_ukf.failed.blocks import Block

MEMORY = 150.0  # informative blocks
LATER = 10  # informative blocks that a block waits before it is learnt from, lest a failure be taken for the cell
FIRM = 5.0  # the cell file's own answer weighs as many of them
SIGMA_V, SIGMA_MIN_V, SIGMA_MAX_V = 0.003, 0.0005, 0.005  # of a change, at first and at the least and most
RHO, RHO_MIN, RHO_MAX = 0.5, 0.2, 1.0
SIZES = 30.0  # informative blocks that rho is the mean of
TELLS = 4.0  # times sigma: a smaller u is no information
BIT_MAX_V = 0.02  # a resolution coarser than this is no cell's
STILL = 1.2  # times the noise
NEAR = 3  # blocks before a step that a change of the current is still felt in
MADE_UP = 0.35  # of an error may be left for the block beside it to have made it up
RELAXES = 1.2  # times the last block's change: a relaxation does less
DELAY = 2  # blocks by which a step is judged late, as the one after it is looked at, too


class Step(NamedTuple):
    """A change of the voltage between two blocks, judged."""

    t_ns: int  # the end of its block
    dt_s: float
    y_V: float  # measured
    p_V: float  # predicted from the current
    double_V: float  # and from twice the current
    s_V: float  # one sigma of the difference
    noise_V: float  # and of that, what is there at rest
    left_V: float  # what is left of it unexplained, if neither the block before nor the one after makes it up
    tells: bool  # the current moved enough to be compared by
    still: bool  # it moved so little, for some time, that noise is all there is to expect


class _Change(NamedTuple):
    t_ns: int
    dt_s: float
    y_V: float
    u_V: float
    double_V: float  # u, if the current were twice what is measured
    ohmic_V: float  # of u, what r0 makes of a change of the current


_Row = tuple[float, float, float]


class Steps:
    """Takes the changes of voltage, and what the cell file makes of the current's, and gives what they are worth."""

    def __init__(self) -> None:
        self.taps = [0.0, 1.0, 0.0]
        self.informed = 0.0  # blocks that the taps rest upon, up to MEMORY
        self._sigma_V, self._rho2 = SIGMA_V, RHO * RHO
        self._bit_V = self._bit_of_current_V = math.inf
        self._xx, self._xy = [0.0] * 6, [0.0] * 3  # of the least squares; xx by rows from the diagonal on
        self._last: deque[_Change] = deque(maxlen=2 * NEAR + 1)
        self._errors: deque[float] = deque(maxlen=3)
        self._to_learn: deque[tuple[_Row, float, float]] = deque()

    @property
    def gain(self) -> float:
        """The cell's resistance as a multiple of the cell file's, as the steps show it."""
        return sum(self.taps)

    def interrupt(self) -> None:
        """What comes next does not follow what came."""
        self._last.clear()
        self._errors.clear()

    def take(self, block: Block, y_V: float, u_V: float, double_V: float, ohmic_V: float) -> Step | None:
        """The step of DELAY blocks ago, once there is one with a block before and after it."""
        if 0.0 < abs(y_V) < self._bit_V:
            self._bit_V = abs(y_V)
        if 0.0 < abs(ohmic_V) < self._bit_of_current_V:
            self._bit_of_current_V = abs(ohmic_V)
        last = self._last
        last.append(_Change(block.t_ns, block.dt_s, y_V, u_V, double_V, ohmic_V))
        if len(last) < 3:
            return None
        x, y_V = (last[-3].u_V, last[-2].u_V, last[-1].u_V), last[-2].y_V
        a = self.taps
        self._errors.append(y_V + a[0] * x[0] + a[1] * x[1] + a[2] * x[2])
        if len(self._errors) < 3 or len(last) < 4:
            return None
        step = last[-3]
        y_V = step.y_V
        errors = self._errors
        error, before, after = errors[-2], errors[-3], errors[-1]
        excited_V = max(abs(change.u_V) for change in last)
        noise2 = self._sigma_V * self._sigma_V
        for bit_V in (self._bit_V, self._bit_of_current_V):
            noise2 += bit_V * bit_V if bit_V < BIT_MAX_V else 0.0
        moved_V = max(abs(last[k].ohmic_V) for k in (-4, -3, -2))
        noise_V = math.sqrt(noise2)
        tells = moved_V > TELLS * noise_V and moved_V > 0.3 * excited_V
        s_V = math.sqrt(noise2 + self._rho2 * excited_V * excited_V)
        if tells:  # learnt of every step, failed or not: what the current no longer explains becomes less of a surprise
            share = min(error * error / (excited_V * excited_V), 1.0)
            self._rho2 = min(max(self._rho2 + (share - self._rho2) / SIZES, RHO_MIN**2), RHO_MAX**2)
        double_V = -(a[0] * last[-4].double_V + a[1] * step.double_V + a[2] * last[-2].double_V)
        return Step(
            step.t_ns,
            step.dt_s,
            y_V,
            y_V - error,
            double_V,
            s_V,
            noise_V,
            _left(error, before, after),
            tells,
            s_V < STILL * noise_V,
        )

    def learn(self, step: Step) -> None:
        """Let taps and sigmas follow the last step that `take` gave, once LATER more have come without a doubt."""
        change = [change.u_V for change in self._last]
        excited_V = max(abs(u_V) for u_V in change)
        if step.tells:
            self._to_learn.append(((change[-4], change[-3], change[-2]), step.y_V, excited_V))
            if len(self._to_learn) > LATER:
                self._learn(*self._to_learn.popleft())
        elif excited_V < self._sigma_V:
            # Towards the median of |error|, which is 0.67 sigma: no outlier weighs more than another.
            self._sigma_V *= 1.01 if abs(step.y_V - step.p_V) > 0.67 * self._sigma_V else 0.99
            self._sigma_V = min(max(self._sigma_V, SIGMA_MIN_V), SIGMA_MAX_V)

    def doubt(self) -> None:
        """Learn nothing of the steps that have waited."""
        self._to_learn.clear()

    def _learn(self, x: _Row, y_V: float, excited_V: float) -> None:
        p_V = -sum(a * u_V for a, u_V in zip(self.taps, x, strict=True))
        error = y_V - p_V
        weight = 1.0 / (self._sigma_V * self._sigma_V + (RHO_MIN * excited_V) ** 2)
        most_V = 3.0 * math.hypot(self._sigma_V, RHO * excited_V)
        y_V = p_V + min(max(error, -most_V), most_V)  # an outlier pulls no more than others
        kept, k = 1.0 - 1.0 / MEMORY, 0
        for j in range(3):
            self._xy[j] = kept * self._xy[j] - weight * y_V * x[j]
            for i in range(j, 3):
                self._xx[k] = kept * self._xx[k] + weight * x[j] * x[i]
                k += 1
        self.informed = kept * self.informed + 1.0
        xx, xy = self._xx, self._xy
        ridge = FIRM * (xx[0] + xx[3] + xx[5]) / (3.0 * self.informed)
        self.taps = _solve(
            (xx[0] + ridge, xx[1], xx[2], xx[3] + ridge, xx[4], xx[5] + ridge), (xy[0], xy[1] + ridge, xy[2])
        )


def _solve(xx: tuple[float, float, float, float, float, float], xy: _Row) -> list[float]:
    """A symmetric positive definite system of three, by its adjoint: a library takes longer to be called."""
    a, b, c, d, e, f = xx
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    per = 1.0 / (a * A + b * B + c * C)
    x, y, z = xy
    return [per * (A * x + B * y + C * z), per * (B * x + D * y + E * z), per * (C * x + E * y + F * z)]


def _left(error: float, before: float, after: float) -> float:
    """Of an error, what the block before or after does not make up, and what no relaxation begun earlier goes on by.

    A spike goes and comes back, and a skew between the channels shows as two errors that cancel. What relaxes loses
    speed, so it changes less from block to block.
    """
    left = min(error + before, error + after, key=abs)
    if abs(left) < MADE_UP * abs(error):
        return left if left * error > 0 else 0.0
    going_on = max(0.0, math.copysign(before, before * error))
    return math.copysign(max(abs(error) - RELAXES * going_on, 0.0), error)
