"""The wheel alone, installed elsewhere, does the whole job from an empty folder: nothing is read from the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

FIND_DATA = """
from pathlib import Path
import bms_ukf
from bms_ukf import resources

data = Path(bms_ukf.__file__).parent / "data"
found = [
    resources.default_dbc(),
    resources.find("lgm50_chen2020", "cells", ".toml"),
    resources.find("lgm50_spme", "plants", ".fmu"),
]
assert all(path.is_file() and data in path.parents for path in found), found
print(bms_ukf.__file__)
"""


def run(command: list[str | Path], folder: Path) -> str:
    """What the command printed; fails with its errors if it did not end well."""
    outside = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(command, cwd=folder, env=outside, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder], ROOT)
    (wheel,) = folder.iterdir()
    return wheel


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs' folder of a fresh environment with the wheel, and the libraries of this environment.

    A folder named in a .pth file is searched, but .pth files in it are not read: an editable install is not found.
    """
    home = tmp_path_factory.mktemp("elsewhere") / "venv"
    venv.create(home, symlinks=True)
    library = sysconfig.get_path("purelib", "venv", {"base": str(home)})
    (Path(library) / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    install = ["install", "--quiet", "--no-deps", "--no-index", "--ignore-installed", wheel]
    run([sys.executable, "-m", "pip", "--python", home / "bin" / "python", *install], home)
    return home / "bin"


def test_the_wheel_is_pure_python_and_carries_the_data(wheel):
    assert wheel.name.endswith("-py3-none-any.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {
        "bms_ukf/py.typed",
        "bms_ukf/data/can/bms.dbc",
        "bms_ukf/data/cells/lgm50_chen2020.toml",
        "bms_ukf/data/plants/lgm50_spme.fmu",
        "bms_ukf/data/campaign/lgm50_spme.xz",
        "bms_ukf/fmumaker/c/fmi3.c",
        "bms_ukf/fmumaker/c/plant.c",
    } <= names
    assert {name for name in names if name.startswith("bms_ukf/data/loads/")}
    assert {name for name in names if name.startswith("bms_ukf/data/scenarios/")}
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert not {name for name in names if name.endswith((".so", ".pyc")) or name.startswith(("tests/", "can/"))}


def test_the_installed_wheel_finds_its_own_data(installed, tmp_path):
    file = run([installed / "python", "-c", FIND_DATA], tmp_path).strip()
    assert installed.parent in Path(file).parents


def test_the_demo_runs_from_the_wheel_in_an_empty_folder(installed, tmp_path):
    assert "RMSE" in run([installed / "bms-ukf", "demo", "--report", tmp_path / "report"], tmp_path)
    assert list((tmp_path / "report").glob("*.html"))
    assert [path.name for path in tmp_path.iterdir()] == ["report"]
