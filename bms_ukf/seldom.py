"""A log line that may come with every frame, written seldom."""

from __future__ import annotations

import logging
import time

INTERVAL_S = 10.0


class Seldom:
    """Writes at most `burst` of its lines in INTERVAL_S, and with the next one the number of those left out."""

    def __init__(self, log: logging.Logger, burst: int = 1) -> None:
        self._log, self._burst, self._written = log, burst, 0
        self._until_s, self._left_out = 0.0, 0

    def warning(self, text: str, **values: object) -> None:
        """`text` names its values, as in "%(error)s"."""
        now_s = time.monotonic()
        if now_s >= self._until_s:
            self._until_s, self._written = now_s + INTERVAL_S, 0
        if self._written == self._burst:
            self._left_out += 1
            return
        left_out = self._left_out
        more = f" ({left_out} more since the last such line)" if left_out else ""
        arguments = [values] if values else []  # `logging` formats with a mapping only if it is not empty
        self._log.warning(f"{text}{more}", *arguments, extra={"event": text, "left_out": left_out})
        self._left_out = 0
        self._written += 1
