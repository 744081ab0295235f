"""What can go wrong at the edges. The numerics below raise nothing: they return fault bits (`records.Fault`)."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, Literal

PlantFailure = Literal["hang", "crash", "nan", "refused", "memory"]


class BmsError(Exception):
    """Any error this package raises on purpose; its text is one line, fit for a terminal."""


class ConfigError(BmsError):
    """A file, key or argument the user gave is wrong. The command line turns it into one line and exit code 2.

    `source` is the file (or the option) at fault, `key` the dotted key in it, `value` what stood there and `expected`
    what would have been right; `key` and `value` are left out where there are none.
    """

    def __init__(
        self, source: str | Path, *, expected: str, key: str | None = None, value: object | None = None
    ) -> None:
        self.source, self.key, self.value, self.expected = str(source), key, value, expected
        place = f"{source}: {key}" if key else f"{source}"
        found = ":" if value is None else f" is {_short(value)};"
        super().__init__(" ".join(f"{place}{found} expected {expected}".split()))

    def __reduce__(self) -> tuple[Any, ...]:
        """An error of a process of a pool is pickled, which by itself would give back `args` alone."""
        again = partial(type(self), expected=self.expected, key=self.key, value=self.value)
        return again, (self.source,)


class PlantError(BmsError):
    """A plant that could be described failed while starting or running.

    `kind` tells how: the FMU gave no answer in time ("hang"), its process ended ("crash"), an output is not finite
    ("nan"), it returned an error ("refused"), or it took more memory than it may ("memory").
    """

    def __init__(self, text: str, kind: PlantFailure) -> None:
        self.kind = kind
        super().__init__(" ".join(text.split()))

    def __reduce__(self) -> tuple[Any, ...]:
        return PlantError, (str(self), self.kind)


def _short(value: object, limit: int = 60) -> str:
    text = repr(value)
    return text if len(text) <= limit else f"{text[: limit - 1]}…"
