"""What the estimator knew some time ago, to go back to when it turns out that what it was told since was wrong."""

from __future__ import annotations

from collections import deque

from bms_ukf.estimator import Estimator
from bms_ukf.percell import Kept

EVERY_NS = 10_000_000_000
BACK_NS = 300_000_000_000  # longer than a failure may take to be named by what is seen of it
MARGIN_NS = 10_000_000_000  # by which a failure began before it was first seen


class Rewind:
    """Some thirty copies of the estimator, one every EVERY_NS."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, Kept]] = deque()

    def keep(self, estimator: Estimator, t_ns: int) -> None:
        """Remember the estimator as it is before a sample of `t_ns`, if it is time to."""
        kept = self._kept
        if kept and t_ns < kept[-1][0]:
            kept.clear()  # another clock
        if kept and t_ns - kept[-1][0] < EVERY_NS:
            return
        while kept and t_ns - kept[0][0] > BACK_NS:
            kept.popleft()
        kept.append((t_ns, estimator.keep()))

    def back(self, estimator: Estimator, since_ns: int, t_ns: int) -> None:
        """Forget what came since a failure began at `since_ns`, and let the time up to `t_ns` pass with no current."""
        kept = self._kept
        if not kept:
            return
        while len(kept) > 1 and kept[-1][0] > since_ns - MARGIN_NS:
            kept.pop()
        estimator.go_back(kept[-1][1])
        if estimator.t_ns is not None and estimator.t_ns < t_ns:
            estimator.coast(t_ns)
