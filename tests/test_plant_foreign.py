"""FMUs by others' tools, driven by the scenario that inspecting them prints: PythonFMU, PythonFMU3, and a container."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from c_fmu import Var, build

from bms_ukf.plant import open_plant

SECOND = 1_000_000_000
PYTHON_FMU = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Cell(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.current, self.u, self.charge, self.full = 0.0, 3.5, 50.0, 5.0
        self.register_variable(Real("current", causality=Fmi2Causality.input))
        self.register_variable(Real("u", causality=Fmi2Causality.output))
        self.register_variable(Real("charge", causality=Fmi2Causality.output))
        self.register_variable(Real("full", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))

    def do_step(self, t, h):
        print("a word on every step")
        self.charge -= 100 * self.current * h / 3600 / self.full
        self.u = 3 + self.charge / 100 - 0.05 * self.current
        return True
"""
PYTHON_FMU3 = """
from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3Variability, Float64

class Cell(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.i, self.v, self.soc = 0.0, 0.0, 3.5, 0.5
        continuous = Fmi3Variability.continuous
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, variability=continuous))
        self.register_variable(Float64("i", causality=Fmi3Causality.input, variability=continuous, start=0.0))
        self.register_variable(Float64("v", causality=Fmi3Causality.output, variability=continuous))
        self.register_variable(Float64("soc", causality=Fmi3Causality.output, variability=continuous))

    def do_step(self, t, h):
        self.soc -= self.i * h / 3600 / 5
        self.v = 3 + self.soc - 0.05 * self.i
        return True
"""


def made_by(module: str, source: str, folder: Path) -> Path:
    pytest.importorskip(module, reason=f"no {module}: its FMUs are not tried")
    (folder / "cell.py").write_text(source)
    subprocess.run(
        [sys.executable, "-m", module, "build", "-f", "cell.py"], cwd=folder, check=True, capture_output=True
    )
    return folder / "Cell.fmu"


@pytest.mark.parametrize(("module", "source"), [("pythonfmu", PYTHON_FMU), ("pythonfmu3", PYTHON_FMU3)])
def test_an_fmu_in_python_runs_from_what_inspection_prints_of_it(bms_ukf, tmp_path, module, source):
    fmu = made_by(module, source, tmp_path)
    shown = bms_ukf("cosim", "--inspect", fmu)
    assert shown.code == 0, shown.err
    (tmp_path / "cell.toml").write_text(shown.out)
    assert bms_ukf("cosim", tmp_path / "cell.toml", "--json", tmp_path / "r.json").code == 0
    summary = json.loads((tmp_path / "r.json").read_text())
    assert summary["n_scored"] == 600
    assert summary["plant_failure"] is None


def test_a_container_of_two_fmus_is_a_plant(tmp_path):
    pytest.importorskip("fmu_manipulation_toolbox", reason="no fmu-manipulation-toolbox: no container is tried")
    cell = (Var("i", "input", "A", "0"), Var("T_in", "input", "K", "298.15"), Var("v", "output", "V"))
    build(
        tmp_path / "cell.fmu",
        (*cell, Var("heat", "output", "W")),
        "v = 4 - 0.1 * i; heat = 100 * i; return 0;",
        "v = 4;",
    )
    build(
        tmp_path / "housing.fmu",
        (Var("Q", "input", "W", "0"), Var("T", "output", "K")),
        "T += Q * h / 100; return 0;",
        "T = 293.15;",
    )
    (tmp_path / "pack.csv").write_text(
        "rule;from_fmu;from_port;to_fmu;to_port\nFMU;cell.fmu;;;\nFMU;housing.fmu;;;\nINPUT;;i;cell.fmu;i\n"
        "OUTPUT;cell.fmu;v;;v\nOUTPUT;housing.fmu;T;;T\nLINK;cell.fmu;heat;housing.fmu;Q\nLINK;housing.fmu;T;cell.fmu;T_in\n"
    )
    command = "from fmu_manipulation_toolbox.cli.fmucontainer import fmucontainer; fmucontainer()"
    for fmi in "2", "3":
        arguments = ["-container", "pack.csv:0.1", "-fmi", fmi, "-fmu-directory", tmp_path]
        made = subprocess.run(
            [sys.executable, "-c", command, *arguments], cwd=tmp_path, check=False, capture_output=True, text=True
        )
        assert made.returncode == 0, made.stderr
        names = {"current_A": "i", "voltage_V": "v", "temperature_degC": {"name": "T", "unit": "K"}}
        with open_plant(tmp_path / "pack.fmu", variables=names | {"soc": "", "ambient_degC": ""}) as plant:
            for _ in range(10):
                state = plant.step(1.0, SECOND)
        assert state.voltage_V == pytest.approx(3.9)
        assert state.temperature_degC == pytest.approx(29.9, abs=0.2)
