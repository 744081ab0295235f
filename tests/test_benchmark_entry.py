"""The entry of the blind benchmark: the estimator sample by sample, in a folder that needs nothing of this checkout."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import measured
import numpy as np
import pytest

from bms_ukf import CellParams, Estimator
from bms_ukf.benchmark_entry import STEP_INSTRUCTIONS, Model, package


@pytest.fixture(scope="module")
def X() -> np.ndarray:
    """Rows of the benchmark: current (positive = charge), voltage, temperature."""
    return measured.record(measured.DRIVE, 0.9)[:900, 1:4]


def test_the_entry_is_the_estimator_sample_by_sample(cell: CellParams, X: np.ndarray) -> None:
    model, z, found = Model("lgm50_chen2020"), None, []
    for row in X:
        soc, z = model(row, z)
        found.append(soc)
    t_ns = np.arange(len(X)) * 10**9
    np.testing.assert_array_equal(found, Estimator(cell).replay(t_ns, -X[:, 0], X[:, 1], X[:, 2])["soc"])


def test_two_recordings_at_a_time_do_not_disturb_each_other(X: np.ndarray) -> None:
    model = Model("lgm50_chen2020")
    alone = model(X[1], model(X[0])[1])[0]
    _, z = model(X[0])
    _, other = model(X[500])
    model(X[501], other)
    assert model(X[1], z)[0] == alone


def test_before_the_first_estimate_it_says_a_number(X: np.ndarray) -> None:
    assert Model("lgm50_chen2020")([0.0, float("nan"), 25.0])[0] == 1.0


def test_the_folder_runs_on_its_own(bms_ukf, tmp_path: Path, X: np.ndarray) -> None:
    ended = bms_ukf("export", "benchmark", "lgm50_chen2020", "--out", tmp_path / "entry")
    assert ended.code == 0
    assert ended.out.strip().endswith("Model.py")
    readme = (tmp_path / "entry" / "README.md").read_text()
    assert "lgm50_chen2020" in readme
    for count in STEP_INSTRUCTIONS.values():
        assert f"| {count:,} |".replace(",", " ") in readme
    code = (
        "import json, sys, bms_ukf; from Model import Model\n"
        "z = None\n"
        "for row in json.load(sys.stdin): soc, z = Model(row, z)\n"
        "print(json.dumps([soc, bms_ukf.__file__]))"
    )
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    command = [sys.executable, "-c", code]
    ran = subprocess.run(
        command,
        cwd=tmp_path / "entry",
        env=environment | {"NUMBA_DISABLE_JIT": "1"},  # plain Python: compiling for a few samples would take longer
        input=json.dumps(X[:20].tolist()),
        capture_output=True,
        text=True,
        check=True,
    )
    soc, home = json.loads(ran.stdout)
    model, z = Model("lgm50_chen2020"), None
    for row in X[:20]:
        expected, z = model(row, z)
    assert soc == pytest.approx(expected, abs=1e-9)
    assert Path(home).is_relative_to((tmp_path / "entry").resolve())


def test_a_place_that_cannot_be_written_is_one_line(bms_ukf, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    assert (
        "file/entry: expected a folder"
        in bms_ukf("export", "benchmark", "lgm50_chen2020", "--out", tmp_path / "file" / "entry").line
    )
    assert package("lgm50_chen2020", tmp_path / "a" / "b").is_file()
