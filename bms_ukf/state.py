"""What outlives the process: the estimator's belief, stored while it runs and taken up at the next start."""

from __future__ import annotations

import logging
import math
import threading
from pathlib import Path

from bms_ukf import slots
from bms_ukf.estimator import Estimator
from bms_ukf.records import Stored
from bms_ukf.seldom import Seldom
from bms_ukf.slots import Slot

log = logging.getLogger(__name__)

CLOSE_S = 0.7  # how long the last write may take: whoever stops the daemon waits for it


def resume(estimator: Estimator, path: Path, now_ns: int, t_ns: int, max_age_s: float) -> tuple[Stored, str]:
    """Give `estimator` the belief stored in `path`, aged to the wall time `now_ns`; its own time is `t_ns` then.

    Returns what became of it and a line that says so. What is refused leaves the estimator as it was.
    """
    try:
        found = slots.read(path)
    except FileNotFoundError:
        return Stored.NONE, f"{path}: nothing stored yet"
    except OSError as error:
        return Stored.UNREADABLE, f"{path}: not readable ({error.strerror})"
    if not found:
        return Stored.CORRUPT, f"{path}: damaged, or no state file"
    stored, line = _wake(estimator, found[0], now_ns, t_ns, max_age_s)
    return stored, f"{path}: {line}"


def _wake(estimator: Estimator, slot: Slot, now_ns: int, t_ns: int, max_age_s: float) -> tuple[Stored, str]:
    off_s = (now_ns - slot.wall_ns) * 1e-9
    if off_s < 0:
        return Stored.FUTURE, f"stored {-off_s:.0f} s in the future: the wall clock was set back"
    if off_s > max_age_s:
        return Stored.STALE, f"stored {off_s:.0f} s ago, more than state.max_age_s = {max_age_s:g}"
    try:
        estimator.restore(slot.content)
    except ValueError as error:
        return Stored.FOREIGN, str(error)
    estimator.sleep(off_s, t_ns)
    estimator.bleed_A = math.nan  # what is bled now, the frames to come will say
    return Stored.USED, f"as stored {off_s:.0f} s ago"


class Keeper:
    """Writes beliefs to a file in a thread of its own: a medium may take seconds, and frames do not wait.

    Of beliefs that come faster than they can be written, the newest is. A write that fails is logged, and the next one
    tried as if nothing had been.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._next: Slot | None = None
        self._closing = False
        self._told = threading.Condition()
        self._not_written = Seldom(log)
        self._thread = threading.Thread(target=self._write_all, name="state", daemon=True)
        self._thread.start()

    def keep(self, belief: bytes, wall_ns: int) -> None:
        """Have this one written soon."""
        with self._told:
            self._next = Slot(wall_ns, belief)
            self._told.notify()

    def close(self) -> bool:
        """Write what is left; False if that takes longer than CLOSE_S."""
        with self._told:
            self._closing = True
            self._told.notify()
        self._thread.join(CLOSE_S)
        return not self._thread.is_alive()

    def _write_all(self) -> None:
        before = self._stored()
        while True:
            with self._told:
                while self._next is None and not self._closing:
                    self._told.wait()
                slot, self._next = self._next, None
            if slot is None:
                return
            try:
                slots.write(self.path, slot, before)
                before = slot
            except OSError as error:
                self._not_written.warning(
                    "state: %(file)s: not stored (%(error)s)", file=self.path, error=error.strerror
                )

    def _stored(self) -> Slot | None:
        try:
            return next(iter(slots.read(self.path)), None)
        except OSError:
            return None
