"""The MANIFEST format: its example is whole, a mistake in one is one line, and the shipped ones load."""

from __future__ import annotations

from pathlib import Path

import pytest

from bms_ukf import manifest, toml
from bms_ukf.errors import ConfigError
from bms_ukf.manifest import Columns, Manifest, MeasuredTest

MODELS = Path(__file__).resolve().parents[1] / "models"
EXAMPLE = MODELS / "configs" / "manifest.toml"


def test_the_example_has_every_key() -> None:
    loaded = Manifest.load(EXAMPLE)
    used = {key for test in loaded.test for key in test.model_fields_set}
    assert loaded.model_fields_set == set(Manifest.model_fields)
    assert used == set(MeasuredTest.model_fields)
    assert {key for test in loaded.test for key in test.columns.named()} == set(Columns.model_fields)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("role = ", "rolle = ", "did you mean role"),
        ('"pulse"', '"puls"', "test.2.role"),
        ("part = [0.0, 0.5]", "part = [0.5, 0.5]", "part as"),
        ("[2.5, 4.2]", "[4.2, 2.5]", "voltage_limits_V"),
        ("format = 1", "format = 2", "format"),
        ("initial_soc = 0.97", "initial_soc = 97", "initial_soc"),
        ("columns = { soc_ref", "columns = { soc", "soc_ref"),
        ("Step = [3, 4]", "Step = { from = 3 }", "where"),
    ],
)
def test_a_mistake_is_one_line_that_names_it(tmp_path: Path, old: str, new: str, named: str) -> None:
    (tmp_path / "m.toml").write_text(EXAMPLE.read_text().replace(old, new))
    with pytest.raises(ConfigError) as error:
        Manifest.load(tmp_path / "m.toml")
    assert named in str(error.value)
    assert "\n" not in str(error.value)


def test_files_are_found_beside_the_manifest_then_in_the_data_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "data").mkdir()
    for folder in ("here", "data"):
        (tmp_path / folder / "both.csv").touch()
    (tmp_path / "data" / "only.csv").touch()
    source = tmp_path / "here" / "m.toml"
    monkeypatch.delenv(manifest.DATA_FOLDER, raising=False)
    with pytest.raises(ConfigError, match="set BMS_UKF_DATA"):
        manifest.find(source, "only.csv")
    monkeypatch.setenv(manifest.DATA_FOLDER, str(tmp_path / "data"))
    assert manifest.find(source, "only.csv") == tmp_path / "data" / "only.csv"
    assert manifest.find(source, "both.csv") == tmp_path / "here" / "both.csv"


@pytest.mark.parametrize("path", sorted((MODELS / "cells" / "manifests").glob("*.toml")), ids=lambda path: path.stem)
def test_no_shipped_manifest_validates_what_it_fits(path: Path) -> None:
    tests = Manifest.load(path).test
    fitted = [((test.file, test.where), *test.part) for test in tests if test.use == "fit"]
    for test in tests:
        if test.use == "validate":
            overlaps = [
                part
                for part in fitted
                if part[0] == (test.file, test.where) and part[1] < test.part[1] and test.part[0] < part[2]
            ]
            assert not overlaps


def test_defaults_are_those_of_the_contract() -> None:
    data = {"role": "drive", "file": "a.csv", "temperature_degC": 25}
    test = toml.validate(data, MeasuredTest, "test")
    assert (test.use, test.voltage_lag_s, test.current_hold, test.part) == ("fit", 0.0, "preceding", [0.0, 1.0])
