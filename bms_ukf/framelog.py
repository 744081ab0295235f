"""Every frame received and sent, in a file: `bms-ukf run --log-frames`. `bms-ukf replay` runs such files again."""

from __future__ import annotations

import logging
import time
from pathlib import Path

import can

from bms_ukf.errors import ConfigError

log = logging.getLogger(__name__)

FORMATS = (".log", ".asc", ".blf", ".trc", ".mf4")
FLUSH_S = 1.0


class FrameLog:
    """Writes until the medium fails, which is logged and ends it: a daemon does not stop because of its log."""

    def __init__(self, path: Path) -> None:
        """The ending of `path` is the format. ConfigError if it is none, or the file cannot be written."""
        if path.suffix.lower() not in FORMATS:
            raise ConfigError(
                "--log-frames", value=str(path), expected=f"a file name that ends in {', '.join(FORMATS)}"
            )
        self._path, self._flush_at_s = path, 0.0
        try:
            self._writer: can.io.generic.MessageWriter | None = can.Logger(path)
        except (ImportError, NotImplementedError):
            raise ConfigError("--log-frames", expected="asammdf, for .mf4 (pip install 'bms-ukf[mf4]')") from None
        except OSError as error:
            raise ConfigError(path, expected=f"a file that can be written ({error.strerror})") from None

    def received(self, message: can.Message) -> None:
        self._write(message)

    def sent(self, message: can.Message) -> None:
        """Stamped with the wall clock, as received frames are."""
        stamped = can.Message(
            time.time(), message.arbitration_id, message.is_extended_id, data=message.data, is_rx=False
        )
        self._write(stamped)

    def close(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.stop()
            except OSError as error:
                log.warning(
                    "frame log: %(file)s: not complete (%(error)s)", {"file": self._path, "error": error.strerror}
                )

    def _write(self, message: can.Message) -> None:
        if self._writer is None:
            return
        try:
            self._writer.on_message_received(message)
            now_s = time.monotonic()
            if now_s >= self._flush_at_s:
                self._flush_at_s = now_s + FLUSH_S
                file = getattr(self._writer, "file", None)
                if file is not None:
                    file.flush()
        except OSError as error:
            log.warning("frame log: %(file)s: ended (%(error)s)", {"file": self._path, "error": error.strerror})
            self.close()
