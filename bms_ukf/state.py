"""What outlives the process: the estimator's belief and its cells' health, stored while it runs, taken up at a start.

Both are of one moment and one content of a slot: magic, length of the belief (uint32 little-endian), belief, health. A
belief alone is stored as it is.
"""

from __future__ import annotations

import logging
import math
import struct
import threading
from pathlib import Path

from bms_ukf import slots
from bms_ukf.estimator import Estimator
from bms_ukf.pack import Health
from bms_ukf.records import Stored
from bms_ukf.seldom import Seldom
from bms_ukf.slots import Slot

log = logging.getLogger(__name__)

_HEAD = struct.Struct("<8sI")
_MAGIC = b"BMSSTAT1"
CLOSE_S = 0.7  # how long the last write may take: whoever stops the daemon waits for it


def content(estimator: Estimator, health: Health | None = None) -> bytes:
    """What is to be stored of them."""
    belief = estimator.snapshot()
    return belief if health is None else _HEAD.pack(_MAGIC, len(belief)) + belief + health.snapshot()


def resume(
    estimator: Estimator, path: Path, now_ns: int, t_ns: int, max_age_s: float, health: Health | None = None
) -> tuple[Stored, str]:
    """Give `estimator` the belief stored in `path`, aged to the wall time `now_ns`; its own time is `t_ns` then.

    Returns what became of it and a line that says so. What is refused leaves the estimator as it was. `health` has what
    was stored of it if it is that of these cells, whatever became of the belief: a capacity learnt over months does not
    go stale. That it is refused is a line in the log.
    """
    try:
        found = slots.read(path)
    except FileNotFoundError:
        return Stored.NONE, f"{path}: nothing stored yet"
    except OSError as error:
        return Stored.UNREADABLE, f"{path}: not readable ({error.strerror})"
    if not found:
        return Stored.CORRUPT, f"{path}: damaged, or no state file"
    slot, aged = _parts(found[0])
    stored, line = _wake(estimator, slot, now_ns, t_ns, max_age_s)
    if health is not None:
        reason = _age(health, aged, max(now_ns - slot.wall_ns, 0) * 1e-9, t_ns, whole=stored is Stored.USED)
        if reason is not None:
            told = {"file": path, "reason": reason}
            log.warning("state: %(file)s: the health stored is not used: %(reason)s", told)
    return stored, f"{path}: {line}"


def _parts(slot: Slot) -> tuple[Slot, bytes | None]:
    """The slot with the belief alone, and the health if there is one."""
    if not slot.content.startswith(_MAGIC) or len(slot.content) < _HEAD.size:
        return slot, None
    end = _HEAD.size + _HEAD.unpack_from(slot.content)[1]
    return slot._replace(content=slot.content[_HEAD.size : end]), slot.content[end:]


def _age(health: Health, stored: bytes | None, off_s: float, t_ns: int, *, whole: bool) -> str | None:
    """Give `health` what was stored; the belief beside it was used if it is `whole`. Returns why not, if not."""
    reason = None
    try:
        if stored is not None:
            health.restore(stored)
    except ValueError as error:
        stored, reason = None, str(error)
    if stored is None:
        health.adopt()
        return reason
    health.slept(off_s, t_ns)
    if not whole:
        health.lose()
    return None


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
