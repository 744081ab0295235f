"""Recordings in a wrong unit are refused with the evidence, for cells of any size; right ones are not."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import measured
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError
from bms_ukf.manifest import Manifest
from bms_ukf.measured import load
from bms_ukf.recordings import Recording, require_units, require_voltage

Array = NDArray[np.float64]
LIMITS_V = (2.5, 4.2)


class Cell(NamedTuple):
    """A cell by its capacity and the drop of its resistance at 1C."""

    capacity_Ah: float
    drop_V: float

    def recording(self, rate_per_h: Array, step_s: float, soc: float, *, reference: bool) -> Recording:
        """The cell under a current, in multiples of 1C (positive = discharge)."""
        time_s = step_s * np.arange(rate_per_h.size)
        moved = np.cumsum(rate_per_h) * step_s / 3600
        left = np.clip(soc - moved, 0, 1)
        voltage_V = np.clip(2.9 + 1.25 * left - self.drop_V * rate_per_h, 2.0, 4.6)
        soc_ref = left if reference else None
        current_A = self.capacity_Ah * rate_per_h
        temperature = np.full(time_s.size, 25.0)
        return Recording("made", time_s, current_A, voltage_V, temperature, self.capacity_Ah * moved, soc_ref)

    def drive(self, *, reference: bool) -> Recording:
        """An hour at C/2 on average, 1 Hz, from 90 %."""
        rng = np.random.default_rng(3)
        return self.recording(np.repeat(rng.uniform(-0.5, 1.5, 720), 5), 1.0, 0.9, reference=reference)

    def slow(self, *, reference: bool) -> Recording:
        """From full to empty at C/20, a row a minute."""
        return self.recording(np.full(1160, 0.05), 60.0, 0.98, reference=reference)

    def pulses(self, *, reference: bool) -> Recording:
        """Pulses of 1C with rests, 20 levels of SoC, 10 s apart."""
        level = np.concatenate([np.zeros(30), np.ones(2), np.zeros(4), -np.ones(1), np.full(19, 0.9)])
        return self.recording(np.tile(level, 18), 10.0, 0.95, reference=reference)


KINDS = ("drive", "slow", "pulses")
CELLS = st.builds(Cell, st.floats(0.5, 300.0), st.floats(0.01, 0.3))
MISTAKES = {  # factors of time, current, voltage, SoC
    "mV": (1.0, 1.0, 1e3, 1.0),
    "mA": (1.0, 1e3, 1.0, 1.0),
    "kA": (1.0, 1e-3, 1.0, 1.0),
    "minutes": (1 / 60, 1.0, 1.0, 1.0),
    "hours": (1 / 3600, 1.0, 1.0, 1.0),
    "ms": (1e3, 1.0, 1.0, 1.0),
    "percent": (1.0, 1.0, 1.0, 100.0),
    "a fraction": (1.0, 1.0, 1.0, 0.01),
}
# Without a reference SoC an hour's drive has no second witness of its time.
UNSEEN = {("drive", "minutes"), ("drive", "hours")}


def mistaken(recording: Recording, mistake: str) -> Recording:
    """The recording as it is read if one of its units is another than its header says."""
    time, current, voltage, soc = MISTAKES[mistake]
    return Recording(
        recording.name,
        time * recording.time_s,
        current * recording.current_A,
        voltage * recording.voltage_V,
        recording.temperature_degC,
        time * current * recording.drawn_Ah,
        None if recording.soc_ref is None else soc * recording.soc_ref,
    )


@given(cell=CELLS, kind=st.sampled_from(KINDS), reference=st.booleans())
def test_a_recording_of_the_cell_is_accepted(cell: Cell, kind: str, reference: bool) -> None:
    recording = getattr(cell, kind)(reference=reference)
    require_units(recording, LIMITS_V, cell.capacity_Ah)
    require_units(recording, LIMITS_V, None)
    aged = cell._replace(capacity_Ah=0.7 * cell.capacity_Ah, drop_V=2 * cell.drop_V)
    require_units(getattr(aged, kind)(reference=reference), LIMITS_V, cell.capacity_Ah)


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("kind", KINDS)
@given(cell=CELLS)
def test_a_wrong_unit_is_named_where_the_recording_has_a_reference(kind: str, mistake: str, cell: Cell) -> None:
    line = refused(mistaken(getattr(cell, kind)(reference=True), mistake), cell)
    assert mistake in line


@pytest.mark.parametrize("mistake", [mistake for mistake, factors in MISTAKES.items() if factors[3] == 1.0])
@pytest.mark.parametrize("kind", KINDS)
@given(cell=CELLS)
def test_a_wrong_unit_is_named_without_a_reference_too(kind: str, mistake: str, cell: Cell) -> None:
    recording = mistaken(getattr(cell, kind)(reference=False), mistake)
    if (kind, mistake) in UNSEEN:
        require_units(recording, LIMITS_V, cell.capacity_Ah)
    else:
        assert mistake in refused(recording, cell)


@given(cell=CELLS, kind=st.sampled_from(KINDS), factor=st.sampled_from([60.0, 3600.0, 1e3, 1e-3]))
def test_a_charge_counter_is_a_witness_of_time_and_current(cell: Cell, kind: str, factor: float) -> None:
    recording = getattr(cell, kind)(reference=False)
    recording.time_s = recording.time_s / factor
    line = refused(recording, cell)
    assert any(word in line for word in ("minutes", "hours", "ms", "mA", "kA")), line


@pytest.mark.parametrize(("factor", "named"), [(1e3, "the counter in mAh"), (3600.0, "the counter in As")])
@given(cell=CELLS, kind=st.sampled_from(KINDS))
def test_a_charge_counter_in_another_unit_is_named(factor: float, named: str, cell: Cell, kind: str) -> None:
    recording = getattr(cell, kind)(reference=True)
    recording.drawn_Ah = factor * recording.drawn_Ah
    assert named in refused(recording, cell)


def refused(recording: Recording, cell: Cell) -> str:
    with pytest.raises(ConfigError) as error:
        require_units(recording, LIMITS_V, cell.capacity_Ah)
    line = str(error.value)
    assert "\n" not in line
    assert "…" not in line  # all of the evidence is shown
    assert "nan" not in line
    return line


def test_a_recording_of_another_cell_is_named() -> None:
    recording = Cell(3.0, 0.1).drive(reference=True)
    with pytest.raises(ConfigError, match=r"expected within 2 to 2\.8 V, the cell's limits \(--force runs it\)"):
        require_units(recording, (2.0, 2.8), 3.0, hint=" (--force runs it)")


def test_a_gap_in_which_the_cell_was_charged_is_no_wrong_unit() -> None:
    cell = Cell(5.0, 0.1)
    parts = [cell.recording(np.full(120, 0.05), 1.0, soc, reference=False) for soc in (0.95, 0.5, 0.05)]
    time_s = np.concatenate([part.time_s + 9000.0 * k for k, part in enumerate(parts)])
    current_A, voltage_V = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("current_A", "voltage_V")
    )
    current_A[[120, 240]] = 0.0
    drawn_Ah = np.cumsum(current_A * np.diff(time_s, prepend=time_s[0])) / 3600
    recording = Recording("gaps", time_s, current_A, voltage_V, np.full(time_s.size, 25.0), drawn_Ah)
    require_units(recording, LIMITS_V, 5.0)


MANIFEST = """
format = 1
cell = "made"
chemistry = "NMC"
capacity_Ah = 5.0
current_positive = "charge"
voltage_limits_V = [2.5, 4.2]
[[test]]
role = "drive"
file = "drive.csv"
temperature_degC = 25
use = "validate"
"""


@pytest.mark.parametrize(
    ("mistake", "named"),
    [
        ("mV", "drive: voltage_V is '3658 in the median'; expected 1 to 5 V: is it in mV?"),
        ("mA", "drive: current_A is '7498 at most'; expected 0.025 to 1e+03 A for 5 Ah: is it in mA?"),
        ("minutes", "by soc_ref: is the time in minutes?"),
        ("percent", "drive: soc_ref is '90.05 at most'; expected fractions of 1: is it in percent"),
    ],
)
def test_every_command_that_reads_recordings_names_a_wrong_unit(
    tmp_path: Path, bms_ukf, mistake: str, named: str
) -> None:
    recording = mistaken(Cell(5.0, 0.1).drive(reference=True), mistake)
    columns = (
        recording.time_s,
        -recording.current_A,
        recording.voltage_V,
        recording.temperature_degC,
        recording.soc_ref,
    )
    measured.write(tmp_path / "drive.csv", np.column_stack(columns))
    (tmp_path / "m.toml").write_text(MANIFEST)
    cell = ["--cell", "lgm50_chen2020"]
    replay = ["replay", tmp_path / "drive.csv", *cell, "--current-positive", "charge", "--estimator", "coulomb"]
    score = ["score", tmp_path / "m.toml", *cell, "--estimator", "coulomb"]
    assert bms_ukf(*replay).line.count("(--force runs it)") == 1
    assert named in bms_ukf(*score).line
    assert named in bms_ukf("identify", tmp_path / "m.toml", "--out", tmp_path / "cell.toml").line
    assert bms_ukf(*replay, "--force").code == 0
    assert bms_ukf(*score, "--force").code == 0


def test_the_voltages_of_a_table_have_a_unit_too() -> None:
    require_voltage("ocv.csv", np.array([np.nan, 3.0, 3.7, 4.2]))
    with pytest.raises(
        ConfigError, match=r"ocv\.csv: voltage_V is '3700 in the median'; expected 1 to 5 V: is it in mV"
    ):
        require_voltage("ocv.csv", np.array([3000.0, np.nan, 3700.0, 4200.0]))


@pytest.mark.usefixtures("third_party")
def test_measured_recordings_are_accepted_and_their_wrong_units_named() -> None:
    path = Path(__file__).parents[1] / "models" / "cells" / "manifests" / "panasonic_ncr18650pf.toml"
    tests = Manifest.load(path)
    for test in tests.test:
        recording = load(path, tests, test)
        for mistake, factors in MISTAKES.items():
            if recording.soc_ref is not None or factors[3] == 1.0:
                with pytest.raises(ConfigError, match=mistake):
                    require_units(mistaken(recording, mistake), tests.voltage_limits_V, tests.capacity_Ah)
