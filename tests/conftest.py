"""What several test modules need. What they compare with, or are made of, is in `reference/`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import NamedTuple

import hypothesis
import pytest

from bms_ukf import CellParams, cli
from bms_ukf.manifest import DATA_FOLDER

# A busy machine is not a failure. CI tries the same examples every time; whoever works on the code tries others.
hypothesis.settings.register_profile("bms-ukf", deadline=None, derandomize="CI" in os.environ)
hypothesis.settings.load_profile("bms-ukf")


@pytest.fixture(scope="session")
def cell() -> CellParams:
    return CellParams.load("lgm50_chen2020")


@pytest.fixture(scope="session")
def third_party() -> Path:
    """The folder of measured cells, DBCs and logs that are not ours to ship; without it the test is skipped by name."""
    folder = os.environ.get(DATA_FOLDER)
    if folder is None:
        pytest.skip(f"{DATA_FOLDER} is not set: no third-party data to try this on")
    return Path(folder)


class Ended(NamedTuple):
    code: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """The one line on stderr that a user's mistake may cost."""
        assert self.code == 2
        assert self.err.startswith("bms-ukf: ")
        assert self.err.count("\n") == 1, self.err
        return self.err


@pytest.fixture
def bms_ukf(monkeypatch, capsys):
    """Runs the command in this process."""

    def run(*arguments: str | Path) -> Ended:
        monkeypatch.setattr(sys, "argv", ["bms-ukf", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        code = ended.value.code
        assert isinstance(code, int)
        return Ended(code, *capsys.readouterr())

    return run
