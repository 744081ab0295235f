"""The estimator as an entry of McMaster University's blind SoC benchmark (Kollmeyer et al., ITEC 2022).

The benchmark calls a function once a sample, at 1 Hz, with the state it returned before (None at first):

    soc, z = Model(X, z)        X = [current in A, positive = charge; voltage in V; temperature in degC]

`package` writes a folder with such a `Model.py`, the cell file and this package's source beside it: what remains to be
installed is in its `requirements.txt`. Its `README.md` says how to call it, and what a step costs.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from bms_ukf import resources
from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.estimator import Estimator
from bms_ukf.records import Sample
from bms_ukf.tuning import Tuning

STEP_NS = 1_000_000_000
REQUIREMENTS = "numpy\nnumba>=0.68,<0.69\npydantic>=2.7\n"
# What an estimator needs of this package.
SOURCES = (
    "__init__.py",
    "beliefs.py",
    "benchmark_entry.py",
    "cell.py",
    "errors.py",
    "estimator.py",
    "kernel",
    "pchip.py",
    "percell.py",
    "py.typed",
    "records.py",
    "resources.py",
    "sensor_spec.py",
    "shown.py",
    "toml.py",
    "tuning.py",
    "wiring.py",
)
MODEL = '''"""{name}, by bms-ukf: `soc, z = Model(X, z)` once a second; X: current (+ charge), voltage, temperature."""

from pathlib import Path

from bms_ukf.benchmark_entry import Model as Entry

Model = Entry(Path(__file__).parent / "cell.toml")
'''

# Instructions of a step on a Cortex-M7 in float32; `tests/test_pil.py` holds them against what it measures.
STEP_INSTRUCTIONS = {"usual": 4_200, "wide": 131_000, "first": 650_000}
README = """# {name}, by bms-ukf

    soc, z = Model(X, z)

once a second; X is current in A (positive = charge), voltage in V and temperature in degC; z is None at first. Install
`requirements.txt`; the first call compiles for half a minute.

## Cost of a step

As `bms-ukf export firmware` compiles the same filter for a Cortex-M7 (float32, cell lgm50_chen2020, two RC pairs), in
instructions that QEMU counts over a WLTC drive (`pytest -s tests/test_pil.py` in the source of bms-ukf):

| step | instructions |
|---|---|
| usual: one Gaussian holds the belief | {usual} |
| while the belief is wide (after a start, a gap or refused voltages): 24 Gaussians | {wide} |
| the first voltage, once | {first} |
"""


class Model:
    """The benchmark's entry for one cell file. Several recordings may be run at a time, each with its own state."""

    def __init__(self, cell: str | Path, tuning: Tuning | None = None) -> None:
        self._cell, self._tuning = CellParams.load(cell), tuning

    def __call__(self, X: Sequence[float], z: Estimator | None = None) -> tuple[float, Estimator]:
        """SoC, 0..1, after one more sample, and the state for the next call; a state is used up by the call.

        SoC is 1 until there is an estimate: the benchmark knows no missing value, and starts full.
        """
        current_A, voltage_V, temperature_degC = (float(value) for value in X)
        estimator = Estimator(self._cell, tuning=self._tuning) if z is None else z
        t_ns = 0 if estimator.t_ns is None else estimator.t_ns + STEP_NS
        soc = float(estimator.step(Sample(t_ns, -current_A, voltage_V, temperature_degC)).soc)
        return (soc if soc == soc else 1.0), estimator  # noqa: PLR0124


def package(cell: str, folder: Path) -> Path:
    """Write the entry for a cell into `folder`, made if need be. Returns the path of its `Model.py`.

    Raises ConfigError if the cell or the place is no good.
    """
    source, home = resources.find(cell, "cells", ".toml"), Path(__file__).parent
    name = CellParams.load(source).cell.name
    try:
        target = folder / "bms_ukf"
        target.mkdir(parents=True, exist_ok=True)
        for part in SOURCES:
            if (home / part).is_dir():
                ignored = shutil.ignore_patterns("__pycache__")
                shutil.copytree(home / part, target / part, dirs_exist_ok=True, ignore=ignored)
            else:
                shutil.copyfile(home / part, target / part)
        shutil.copyfile(source, folder / "cell.toml")
        (folder / "requirements.txt").write_text(REQUIREMENTS, encoding="utf-8")
        counts = {step: f"{count:,}".replace(",", " ") for step, count in STEP_INSTRUCTIONS.items()}
        (folder / "README.md").write_text(README.format(name=name, **counts), encoding="utf-8")
        entry = folder / "Model.py"
        entry.write_text(MODEL.format(name=name), encoding="utf-8")
    except OSError as error:
        raise ConfigError(folder, expected=f"a folder that can be written ({error.strerror})") from None
    return entry
