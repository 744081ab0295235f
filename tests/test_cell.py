"""A cell file that cannot be true is refused in one line that names file, key, value and what was expected."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import synthetic_cell
from synthetic_cell import as_toml, nonlinear

from bms_ukf import CellParams, ConfigError


def refusal(tmp_path: Path, text: str) -> str:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        CellParams.load(path)
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(f"{path}: ")
    assert " expected " in line
    return line


def changed(path: str, value: object) -> str:
    """The synthetic cell with the item at a dotted path, `ocv.voltage_V.0.3`, replaced; None deletes it."""
    data = nonlinear()
    *parents, last = (int(part) if part.isdigit() else part for part in path.split("."))
    place = data
    for part in parents:
        place = place[part]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return as_toml(data)


@pytest.mark.parametrize("data", [nonlinear(), synthetic_cell.with_coefficient(), synthetic_cell.linear()])
def test_a_good_file_is_read_as_it_stands(tmp_path, data):
    path = tmp_path / "good.toml"
    path.write_text(as_toml(data), encoding="utf-8")
    cell = CellParams.load(path)
    assert cell.model_dump(exclude_none=True, exclude={"provenance"}) == data
    assert cell == CellParams.load(str(path))


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        # A key that does not exist, with the one that was meant.
        ("cell.capacity_ah", 5.0, ["cell.capacity_ah is 5.0", "did you mean capacity_Ah?"]),
        ("dynamics.r0_ohms", [[0.1]], ["dynamics.r0_ohms", "did you mean r0_ohm?"]),
        ("humidity", 1, ["humidity is 1", "no such key", "known: format, cell"]),
        ("noise.zzz", 1.0, ["noise.zzz is 1.0", "voltage_sigma_V"]),
        # A key that is missing.
        ("cell.capacity_Ah", None, ["cell.capacity_Ah", "missing"]),
        ("noise", None, ["noise", "missing"]),
        ("format", None, ["format", "missing"]),
        # Another version of the layout, or another type.
        ("format", 2, ["format is 2", "1"]),
        ("cell.capacity_Ah", "5", ["cell.capacity_Ah is '5'", "number"]),
        ("ocv.soc", 0.5, ["ocv.soc is 0.5", "list"]),
        # Units: mAh, mV, mohm, ms, percent.
        ("cell.capacity_Ah", 5000.0, ["cell.capacity_Ah is 5000.0", "2000"]),
        ("cell.voltage_limits_V", [2900.0, 4200.0], ["cell.voltage_limits_V.0 is 2900.0", "6"]),
        ("ocv.voltage_V.0", [10.0 * k for k in range(300, 401)], ["ocv.voltage_V in volts"]),
        ("dynamics.r0_ohm.1", [25.0, 24.0, 23.0, 22.0, 21.0], ["dynamics.r0_ohm", "between 0 and 10", "25"]),
        ("dynamics.tau1_s.0.0", 0.001, ["dynamics.tau1_s", "0.001"]),
        ("dynamics.soc", [0.0, 10.0, 30.0, 60.0, 100.0], ["dynamics.soc", "fractions"]),
        ("noise.voltage_sigma_V", 4.0, ["noise.voltage_sigma_V is 4.0", "0.5"]),
        ("cell.temperature_limits_degC", [263.0, 318.0], ["cell.temperature_limits_degC.0 is 263.0", "120"]),
        # Not a number, and signs.
        ("ocv.voltage_V.0.3", float("nan"), ["ocv.voltage_V.0.3 is nan", "finite"]),
        ("cell.capacity_Ah", float("inf"), ["cell.capacity_Ah is inf"]),
        ("dynamics.r2_ohm.0.0", -0.01, ["dynamics.r2_ohm", "-0.01"]),
        ("cell.current_limits_A", [5.0, 10.0], ["current_limits_A", "charge < 0"]),
        ("cell.coulombic_efficiency", 99.0, ["cell.coulombic_efficiency is 99.0", "1"]),
        # Order and shape.
        ("ocv.voltage_V.1.40", 2.0, ["ocv.voltage_V strictly increasing with SoC", "entry 40 is 2"]),
        ("ocv.soc.5", 0.5, ["ocv.soc strictly increasing"]),
        ("ocv.temperature_degC", [25.0, -10.0, 45.0], ["ocv.temperature_degC strictly increasing"]),
        ("ocv.temperature_degC", [25.0, 45.0], ["ocv.voltage_V as 2 rows", "of 101 numbers"]),
        ("ocv.voltage_V.2", [3.0, 4.0], ["ocv.voltage_V as 3 rows", "of 101 numbers"]),
        ("dynamics.r1_ohm.3", [0.01], ["dynamics.r1_ohm as 4 rows", "of 5 numbers"]),
        ("dynamics.soc", [0.0, 0.1, 0.3, 0.6, 0.9], ["dynamics.soc", "cover 0..1"]),
        ("cell.voltage_limits_V", [4.2, 2.9], ["voltage_limits_V as [lower, upper]"]),
        ("cell.voltage_limits_V", [2.9], ["cell.voltage_limits_V", "at least 2"]),
        ("dynamics.tau1_s.3", [500.0] * 5, ["tau1_s below dynamics.tau2_s"]),
        ("ocv.docv_dT_V_per_K", [0.0] * 101, ["docv_dT_V_per_K only with a single"]),
        # A table of where the model errs, in part.
        ("noise.error_scale", [[1.0, 2.0]], ["noise.soc, temperature_degC and error_scale together or not at all"]),
        ("noise.soc", [0.0, 1.0], ["noise.soc, temperature_degC and error_scale together or not at all"]),
        # Consistent in itself, not with the rest.
        ("cell.voltage_limits_V", [1.0, 2.0], ["ocv.voltage_V near cell.voltage_limits_V"]),
    ],
)
def test_a_mistake_is_named(tmp_path, path, value, says):
    line = refusal(tmp_path, changed(path, value))
    assert [text for text in says if text not in line] == [], line


def test_a_temperature_coefficient_that_turns_the_ocv_over_is_refused(tmp_path):
    data = synthetic_cell.with_coefficient()
    data["ocv"]["docv_dT_V_per_K"] = [9e-3 * (1 - soc) for soc in data["ocv"]["soc"]]
    line = refusal(tmp_path, as_toml(data))
    assert "strictly increasing with SoC at 45 degC, after docv_dT_V_per_K" in line


def test_the_number_of_further_mistakes_is_told(tmp_path):
    data = nonlinear()
    data["cell"]["capacity_Ah"] = -1.0
    data["noise"]["r0_rel_sigma"] = -1.0
    assert "(and 1 more)" in refusal(tmp_path, as_toml(data))


@pytest.mark.parametrize("text", ["format = ", "[cell\n", "a = 1\na = 2\n", "\x00"])
def test_what_is_not_toml_is_refused_with_its_place(tmp_path, text):
    line = refusal(tmp_path, text)
    assert "expected TOML (" in line
    assert re.search(r"line \d|at end of document", line)


def test_a_file_that_is_not_text_is_refused(tmp_path):
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"binary\.toml: expected a readable TOML file \([^\n]*\)$"):
        CellParams.load(path)


def test_an_unknown_cell_lists_those_there_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("bms_ukf.resources.folder", lambda kind: tmp_path)
    for name in ("one", "two"):
        (tmp_path / f"{name}.toml").write_text(as_toml(nonlinear()), encoding="utf-8")
    for missing in ("thre", "no/such/file.toml", "one.tom"):
        with pytest.raises(ConfigError) as caught:
            CellParams.load(missing)
        assert str(caught.value) == f"{missing}: expected a file, or one of the shipped cells: one, two"
    assert CellParams.load("one").cell.name == "synthetic"


def test_a_cell_does_not_change_once_loaded():
    cell = synthetic_cell.cell_of(nonlinear())
    with pytest.raises(ValueError, match="frozen"):
        cell.cell.capacity_Ah = 6.0
