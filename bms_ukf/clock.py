"""When a frame was measured: its stamp, guarded against steps of the wall clock that stamped it."""

from __future__ import annotations

import time
from collections.abc import Callable

TOLERANCE_NS = 500_000_000  # a scheduler may delay a reader; a wall clock that is set moves by more


class StampClock:
    """Integer nanoseconds since the clock was made, never running backwards.

    Stamps are trusted for differences. Where the time since the frame before disagrees with the monotonic clock by more
    than TOLERANCE_NS, the wall clock has been set: the monotonic one is believed, and `steps` counts it. In all, frames
    are kept between the present and TOLERANCE_NS before it: the queue of a reader that was held up is not counted
    twice, and an interface that stamps nothing does not stop time.
    """

    def __init__(self, monotonic_ns: Callable[[], int] | None = None) -> None:
        """`monotonic_ns` is the clock that nobody sets (None: this machine's)."""
        self.steps = 0
        self._stamp_ns: int | None = None
        self._monotonic_ns = monotonic_ns or time.monotonic_ns
        self._start_ns = self._read_ns = self._monotonic_ns()
        self._t_ns = 0

    def at(self, stamp_s: float) -> int:
        """The time of a frame stamped `stamp_s` and received just now."""
        stamp_ns, now_ns = round(stamp_s * 1e9), self._monotonic_ns()
        waited_ns = now_ns - self._read_ns
        passed_ns = waited_ns if self._stamp_ns is None else stamp_ns - self._stamp_ns
        if abs(passed_ns - waited_ns) > TOLERANCE_NS:
            self.steps += 1
            passed_ns = waited_ns
        elapsed_ns = now_ns - self._start_ns
        self._t_ns = max(self._t_ns, elapsed_ns - TOLERANCE_NS, min(self._t_ns + passed_ns, elapsed_ns))
        self._stamp_ns, self._read_ns = stamp_ns, now_ns
        return self._t_ns

    def now(self) -> int:
        """The present, for whoever waits for a time to come; it moves nothing."""
        return self._monotonic_ns() - self._start_ns

    def advance(self) -> int:
        """Go on to the present when there is no frame to tell it. A frame that comes later is not put before it."""
        now_ns = self._monotonic_ns()
        waited_ns = now_ns - self._read_ns
        if self._stamp_ns is not None:
            self._stamp_ns += waited_ns
        self._t_ns += waited_ns
        self._read_ns = now_ns
        return self._t_ns


class LockstepClock:
    """The same in a simulation that sets the time itself: frames are handled at the instant they were sent."""

    steps = 0  # of the wall clock: there is none

    def __init__(self) -> None:
        self._t_ns = 0

    def set(self, t_ns: int) -> None:
        self._t_ns = t_ns

    def at(self, stamp_s: float) -> int:
        return self._t_ns

    def now(self) -> int:
        return self._t_ns

    def advance(self) -> int:
        return self._t_ns
