"""A log line that may come with every frame, written seldom."""

from __future__ import annotations

import logging
import time

INTERVAL_S = 10.0


class Seldom:
    """Writes the first of its lines at once, then at most one in INTERVAL_S with the number of those left out."""

    def __init__(self, log: logging.Logger) -> None:
        self._log, self._next_s, self._left_out = log, 0.0, 0

    def warning(self, text: str, **values: object) -> None:
        """`text` names its values, as in "%(error)s"."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            self._left_out += 1
            return
        left_out = self._left_out
        more = f" ({left_out} more since the last such line)" if left_out else ""
        arguments = [values] if values else []  # `logging` formats with a mapping only if it is not empty
        self._log.warning(f"{text}{more}", *arguments, extra={"event": text, "left_out": left_out})
        self._next_s, self._left_out = now_s + INTERVAL_S, 0
