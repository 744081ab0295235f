"""Little to identify a cell from: a slow test alone, pulses alone, one pulse test; the result claims no more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lab_tests import cell_of, pulse_load_A, slow_A, write
from numpy.typing import NDArray

from bms_ukf import identify
from bms_ukf.cell import CellParams
from bms_ukf.estimator import Estimator
from bms_ukf.identify import choice
from bms_ukf.identify.choice import gain
from bms_ukf.report.identify import write_report

Array = NDArray[np.float64]


def test_a_slow_test_alone_makes_a_cell_that_says_how_little_it_knows(tmp_path: Path) -> None:
    truth = cell_of("nonlinear")
    found = identify.run(write(tmp_path, truth, [("ocv", 25.0, slow_A(truth), 60.0)]))
    assert any("no test of role 'pulse'" in warning for warning in found.warnings)
    assert found.cell.noise.r0_rel_sigma == pytest.approx(0.5)
    r0 = float(found.cell.dynamics_at(0.5, 25.0)["r0_ohm"])
    assert 0.3 < r0 / float(truth.dynamics_at(0.5, 25.0)["r0_ohm"]) < 3
    assert found.cell.cell.capacity_Ah == pytest.approx(truth.cell.capacity_Ah, rel=0.02)
    assert "no test of role" in write_report(tmp_path / "report.html", found).read_text()
    rest = Estimator(found.cell).replay(*_rest(truth, 0.6))
    assert rest["soc"][-1] == pytest.approx(0.6, abs=0.05)


def _rest(cell: CellParams, soc: float) -> tuple[NDArray[np.int64], Array, Array, Array]:
    rows = 100
    voltage_V = np.full(rows, float(cell.ocv_V(soc, 25.0)))
    return np.arange(rows, dtype=np.int64) * 1_000_000_000, np.zeros(rows), voltage_V, np.full(rows, 25.0)


def test_pulses_alone_from_full_to_empty_make_a_cell_and_its_capacity(tmp_path: Path) -> None:
    truth = cell_of("nonlinear")
    found = identify.run(write(tmp_path, truth, [("pulse", 25.0, pulse_load_A(5.0), 1.0)]))
    said = " ".join(found.warnings)
    assert "no slow test" in said
    assert "drew from full to empty" in said
    assert found.cell.cell.capacity_Ah == pytest.approx(truth.cell.capacity_Ah, rel=0.05)
    soc = np.linspace(0.15, 0.95, 30)
    assert np.abs(found.cell.ocv_V(soc, 25.0) - truth.ocv_V(soc, 25.0)).max() < 0.03


def test_one_pulse_test_of_a_simple_cell_gives_a_simple_cell(tmp_path: Path) -> None:
    """Two linear pairs and a linear r0: no third pair, no core, no hysteresis, and no knee that is not known."""
    truth = cell_of("linear")
    tests = [("ocv", 25.0, slow_A(truth), 60.0), ("pulse", 25.0, pulse_load_A(5.0), 1.0)]
    found = identify.run(write(tmp_path, truth, tests))
    structure = found.model.unknowns.structure
    assert structure.pairs == 2
    assert structure.core is None
    assert not structure.hysteresis
    at = found.cell.dynamics_at(0.5, 25.0)
    assert float(at["r0_ohm"]) == pytest.approx(0.02, rel=0.1)
    assert float(at["r1_ohm"] + at["r2_ohm"]) == pytest.approx(0.027, rel=0.15)
    for values in found.cell.provenance["rel_sigma"].values():
        assert min(values) <= 1.0


@pytest.mark.parametrize("chance", [False, True])
def test_more_structure_is_taken_only_if_most_blocks_gain(chance: bool) -> None:
    """One block in which the new structure happens to fit better is chance; a little in every block is not."""
    old = [np.full(12, 1e-6), np.full(12, 4e-6)]
    new = [blocks.copy() for blocks in old]
    if chance:
        new[0][3] *= 0.2
        new[1][4:6] *= 1.2
    else:
        new = [0.9 * blocks for blocks in old]
    change, error = gain(new, old, [1.0, 1.0])
    assert change < 0
    assert (change < -error) == (not chance)
    assert choice.WORTH_IT > choice.CORE_WORTH_IT
