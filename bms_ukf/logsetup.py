"""What the daemon says on stderr: lines for people, or JSON for whoever collects them ([log] of the configuration).

A JSON line has `ts` (UTC), `level`, `source` (the module), `message`, `event` (the message before its values were put
in, the same for all lines of one kind), the values as `fields`, and `left_out`: how many such lines were not written.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Literal

from bms_ukf import toml


class Log(toml.Section):
    """[log]: how the daemon's log is written, and from which level on."""

    format: Literal["text", "json"] = "text"
    level: Literal["debug", "info", "warning", "error"] = "info"


def to_stderr(settings: Log) -> None:
    """Send the log of this process there, in place of where it went before."""
    text = logging.Formatter("%(asctime)s %(levelname)s %(message)s")
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines() if settings.format == "json" else text)
    logging.basicConfig(handlers=[handler], level=settings.level.upper(), force=True)


class JsonLines(logging.Formatter):
    """A line is a JSON object; values that JSON does not know are written as text."""

    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, object] = {
            "ts": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "source": record.name,
            "message": record.getMessage(),
            "event": getattr(record, "event", record.msg),
            "fields": record.args if isinstance(record.args, Mapping) else {},
            "left_out": getattr(record, "left_out", 0),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str, ensure_ascii=False)
