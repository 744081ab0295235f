"""What several test modules need. What they compare with, or are made of, is in `reference/`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import NamedTuple

import hypothesis
import pytest
from daemon_rig import SECOND_NS, Flaky, load_A, rig_of
from model_cell import ModelCell

from bms_ukf import CellParams, Sample, cli
from bms_ukf import core as core_module
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


@pytest.fixture
def samples(cell):
    """Makes the samples of a drive, one a second, in units the DBC can carry."""

    def make(count: int) -> list[Sample]:
        battery = ModelCell(cell, soc=0.8)
        made = []
        for k in range(count):
            voltage_V = battery.step(load_A(k), 1.0)
            made.append(Sample((k + 1) * SECOND_NS, load_A(k), round(voltage_V / 0.0005) * 0.0005, 25.0))
        return made

    return make


@pytest.fixture
def rig(cell, monkeypatch):
    monkeypatch.setattr(core_module, "PATIENCE_NS", 0)
    with rig_of(cell) as rig:
        yield rig


@pytest.fixture
def settled(rig, samples):
    """A rig whose estimator has seen a minute of driving; what it published then is read and gone."""
    for sample in samples(60):
        rig.feed(sample)
    rig.frames()
    return rig


@pytest.fixture
def flaky(settled):
    """The interface of a settled rig's daemon, which the test can break."""
    flaky = Flaky(settled.bus._bus)  # its opener gives the same again
    settled.bus._bus, settled.bus._opener = flaky, lambda: flaky
    yield flaky
    flaky.inner.shutdown()
