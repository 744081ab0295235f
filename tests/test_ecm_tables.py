"""Cell files from published ECM tables: known numbers come back, what is missing is named, and the result runs."""

from __future__ import annotations

import itertools
import re
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf import CellParams, Estimator, Sample
from bms_ukf.cli import main
from bms_ukf.ecm_tables import import_cell
from bms_ukf.errors import ConfigError

TEMPERATURES, CURRENTS_A, SOC = (0.0, 25.0), (-40.0, -20.0, 0.0, 20.0, 40.0), (0.0, 0.5, 1.0)


def r0_ohm(temperature: float, current_A: float, soc: float) -> float:
    """2 mOhm at 25 degC, a tenth more on charge, with a knee of 15 A; more in the cold and at the ends."""
    x = max(abs(current_A), 1e-9) / 15.0
    return 2e-3 * (1.1 if current_A < 0 else 1.0) * (2 - temperature / 25) * (1 + (soc - 0.5) ** 2) * np.arcsinh(x) / x


def grid(path: Path, title: str, value: Callable[[float, float, float], float]) -> None:
    rows = [f"{T},{i},{s},{float(value(T, i, s))!r}" for T, i, s in itertools.product(TEMPERATURES, CURRENTS_A, SOC)]
    path.write_text("\n".join([f"Temperature [degC],Current [A],SoC,{title}", *rows]))


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    return written(tmp_path / "ecm")


def written(folder: Path) -> Path:
    folder.mkdir()
    grid(folder / "r0.csv", "R0 [Ohm]", r0_ohm)
    grid(folder / "slow_r.csv", "R1 [Ohm]", lambda T, i, s: 1e-3)
    grid(folder / "slow_c.csv", "C1 [F]", lambda T, i, s: 3e5)
    grid(folder / "fast_r.csv", "R2 [Ohm]", lambda T, i, s: 5e-4)
    grid(folder / "fast_c.csv", "C2 [F]", lambda T, i, s: 2e4)
    (folder / "ocv.csv").write_text("# SoC,OCV [V]\n-0.05,2.9\n0.0,3.0\n0.5,3.7\n1.0,4.2\n1.05,4.3\n")
    dudt = [f"{v},{T},{1e-4 * (v - 3.5)}" for v in (3.0, 4.2) for T in (0.0, 50.0)]
    (folder / "dudt.csv").write_text("\n".join(["OCV [V],Temperature [degC],dUdT [V/K]", *dudt]))
    return folder


def imported(tables: Path, tmp_path: Path) -> CellParams:
    (tmp_path / "cell.toml").write_text(import_cell([tables], name="x", chemistry="NMC", capacity_Ah=20.0))
    return CellParams.load(tmp_path / "cell.toml")


def test_the_numbers_of_the_tables_come_back(tables: Path, tmp_path: Path) -> None:
    cell = imported(tables, tmp_path)
    at = {key: float(value) for key, value in cell.dynamics_at(0.5, 25.0).items()}
    assert at["r0_ohm"] == pytest.approx(2e-3, rel=0.01)
    assert at["r0_charge_ohm"] == pytest.approx(2.2e-3, rel=0.01)
    assert at["r0_knee_A"] == pytest.approx(15.0, rel=0.1)
    assert (at["r1_ohm"], at["tau1_s"]) == (pytest.approx(5e-4), pytest.approx(10.0))  # the faster first
    assert (at["r2_ohm"], at["tau2_s"]) == (pytest.approx(1e-3), pytest.approx(300.0))
    assert float(cell.ocv_V(0.5, 25.0)) == pytest.approx(3.7)
    assert float(cell.ocv_V(0.5, 5.0)) == pytest.approx(3.7 - 20 * 1e-4 * 0.2, abs=1e-6)
    assert cell.cell.voltage_limits_V == [3.0, 4.2]


def test_the_file_says_that_its_noise_is_assumed_and_what_it_was_made_of(tables: Path, tmp_path: Path) -> None:
    cell = imported(tables, tmp_path)
    assert "assumed" in cell.provenance["noise"]
    assert "assumed" in cell.provenance["voltage_limits"]
    assert set(cell.provenance["sha256"]) == {path.name for path in tables.iterdir()}
    assert cell.provenance["rel_deviation_from_tables"]["r0_ohm"] < 0.01


def test_a_resistance_that_rises_with_current_gets_no_knee_but_its_mean(tables: Path, tmp_path: Path) -> None:
    grid(tables / "r0.csv", "R0 [Ohm]", lambda T, i, s: 1e-3 * (1 + abs(i) / 100))
    cell = imported(tables, tmp_path)
    assert cell.dynamics.r0_knee_A is None
    assert cell.dynamics.r0_ohm[0][0] == pytest.approx(1.3e-3)


def test_the_estimator_runs_on_it(tables: Path, tmp_path: Path) -> None:
    estimator = Estimator(imported(tables, tmp_path))
    for k in range(60):
        estimate = estimator.step(Sample(t_ns=k * 10**9, current_A=0.0, voltage_V=3.7, temperature_degC=25.0))
    assert estimate.soc == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("file", "old", "new", "named"),
    [
        ("slow_c.csv", "C1 [F]", "C7 [F]", "C1"),
        ("r0.csv", "R0 [Ohm]", "R0 [mOhm]", "header"),
        ("r0.csv", "\n25.0,40.0,1.0", "\n25.0,40.0,0.9", "one row for each combination"),
        ("slow_r.csv", "25.0,", "30.0,", "the same temperatures"),
        ("ocv.csv", "\n0.0,3.0\n", "\n0.0,x\n", "numbers"),
        ("ocv.csv", "\n0.5,3.7", "\n0.5,2.7", "ocv.voltage_V"),
        ("fast_r.csv", "R2 [Ohm]", "R1 [Ohm]", "each quantity once"),
        ("dudt.csv", "Temperature [degC]", "Temperature [K]", "Temperature [K]"),
    ],
)
def test_a_mistake_is_one_line_that_names_it(tables: Path, file: str, old: str, new: str, named: str) -> None:
    text = (tables / file).read_text()
    assert old in text
    (tables / file).write_text(text.replace(old, new))
    with pytest.raises(ConfigError) as error:
        import_cell([tables], name="x", chemistry="NMC", capacity_Ah=20.0)
    assert named in str(error.value)
    assert "\n" not in str(error.value)


GRIDS = ("r0.csv", "slow_r.csv", "slow_c.csv", "fast_r.csv", "fast_c.csv")


def rescaled(folder: Path, files: Sequence[str], title: str, factor: float, offset: float = 0.0) -> None:
    """The same tables as someone would write them who took a column's unit for another."""
    for file in files:
        header, *rows = (folder / file).read_text().splitlines()
        column = [name.strip("# ") for name in header.split(",")].index(title)
        cells = [row.split(",") for row in rows]
        for row in cells:
            row[column] = repr(factor * float(row[column]) + offset)
        (folder / file).write_text("\n".join([header, *map(",".join, cells)]))


@pytest.mark.parametrize(
    ("files", "title", "factor", "offset", "named"),
    [
        (["r0.csv"], "R0 [Ohm]", 1e3, 0.0, "expected 7.5e-05 to 0.4 Ohm for 20 Ah (--capacity): is it in mOhm?"),
        (["r0.csv"], "R0 [Ohm]", 1e6, 0.0, "expected 1e-09 to 1000 in every row"),
        (["r0.csv"], "R0 [Ohm]", 1e-3, 0.0, "is it in kOhm"),
        (["r0.csv"], "R0 [Ohm]", -1.0, 0.0, "r0.csv: R0 [Ohm] is -"),
        (["r0.csv"], "R0 [Ohm]", 0.0, 0.0, "r0.csv: R0 [Ohm] is 0.0"),
        (["slow_r.csv"], "R1 [Ohm]", 1e3, 0.0, "slow_r.csv: R1 [Ohm] is 1.0"),
        (["slow_r.csv"], "R1 [Ohm]", -1.0, 0.0, "slow_r.csv: R1 [Ohm] is -0.001"),
        (["fast_c.csv"], "C2 [F]", -1.0, 0.0, "fast_c.csv: C2 [F] is -20000.0"),
        (GRIDS, "Current [A]", 1e3, 0.0, "Current [A] is 40000.0"),
        (GRIDS, "Temperature [degC]", 1.0, 273.15, "Temperature [degC] is 273.15; expected degC: is it in K"),
        (GRIDS, "SoC", 100.0, 0.0, "SoC is 100.0; expected fractions of 1: is it in percent"),
        (["ocv.csv"], "SoC", 100.0, 0.0, "ocv.csv: SoC is 105.0; expected fractions of 1: is it in percent"),
        (["ocv.csv"], "OCV [V]", 1e3, 0.0, "ocv.csv: OCV [V] is 3700.0; expected 1 to 5 V: is it in mV"),
        (["ocv.csv"], "OCV [V]", 0.0, 3.7, "a voltage that rises with SoC"),
        (["dudt.csv"], "OCV [V]", 1e3, 0.0, "dudt.csv: OCV [V] is 3600.0"),
    ],
)  # fmt: skip
def test_a_wrong_unit_or_sign_is_named_with_its_evidence(
    tables: Path, files: Sequence[str], title: str, factor: float, offset: float, named: str
) -> None:
    rescaled(tables, files, title, factor, offset)
    with pytest.raises(ConfigError) as error:
        import_cell([tables], name="x", chemistry="NMC", capacity_Ah=20.0)
    assert named in str(error.value)
    assert "nan" not in str(error.value)


def test_a_capacity_in_milliampere_hours_shows_in_the_resistance(tables: Path) -> None:
    rescaled(tables, ["r0.csv"], "R0 [Ohm]", 25.0)
    with pytest.raises(ConfigError, match=r"R0 \[Ohm\] .* for 1900 Ah \(--capacity\)"):
        import_cell([tables], name="x", chemistry="NMC", capacity_Ah=1900.0)


@pytest.mark.parametrize("file", [*GRIDS, "ocv.csv", "dudt.csv"])
@pytest.mark.parametrize("kept", [[-1], [0, -1], [0, 0, -1], []])
@pytest.mark.parametrize("rows", [0, 1, 2, None])
def test_a_table_of_few_columns_or_rows_is_imported_or_one_line(
    tables: Path, file: str, kept: list[int], rows: int | None
) -> None:
    lines = (tables / file).read_text().splitlines()
    cells = [line.split(",") for line in lines[: None if rows is None else rows + 1]]
    (tables / file).write_text("\n".join(",".join(row[k] for k in kept) for row in cells))
    imported_or_one_line(tables)


@given(
    file=st.sampled_from([*GRIDS, "ocv.csv", "dudt.csv"]),
    row=st.integers(0, 12),
    column=st.integers(0, 3),
    cell=st.sampled_from(["", "nan", "inf", "-1", "0", "1e300", "1e-300", "x", "1,5", ";", '"1"', "True", "\x00"]),
)
def test_a_cell_of_a_table_that_holds_anything_is_imported_or_one_line(
    file: str, row: int, column: int, cell: str
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        tables = written(Path(folder) / "ecm")
        lines = (tables / file).read_text().splitlines()
        cells = lines[row % len(lines)].split(",")
        cells[column % len(cells)] = cell
        lines[row % len(lines)] = ",".join(cells)
        (tables / file).write_text("\n".join(lines))
        imported_or_one_line(tables)


def imported_or_one_line(tables: Path) -> None:
    """Warnings are errors, so an intermediate NaN fails, too."""
    try:
        text = import_cell([tables], name="x", chemistry="NMC", capacity_Ah=20.0)
    except ConfigError as error:
        line = str(error)
        assert "\n" not in line
        assert not re.search(r"\bnan\b", line.replace("'nan'", ""))
    else:
        assert not re.search(r"\b(nan|inf)\b", text)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('{"Parameterisation": {}}', "ocv_table"),
        ('{"R0": [0.001], "Capacity": 5}', "as CSV, no JSON"),
        ("[" * 100_000, "as CSV, no JSON"),
        ("no json", "as CSV, no JSON"),
    ],
)
def test_json_is_refused_by_what_it_is(tmp_path: Path, text: str, named: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ConfigError, match=named):
        import_cell([tmp_path / "a.json"], name="x", chemistry="NMC", capacity_Ah=20.0)


def test_the_command_writes_the_cell_and_refuses_bpx(
    tables: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "made.toml"
    monkeypatch.setattr("sys.argv", ["bms-ukf", "import", str(tables), "--out", str(out), "--capacity", "20"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 0
    assert CellParams.load(out).cell.name == "made"
    bpx = tmp_path / "a.json"
    bpx.write_text('{"Parameterisation": {}}')
    monkeypatch.setattr("sys.argv", ["bms-ukf", "import", str(bpx), "--out", str(out), "--capacity", "20"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "ocv_table" in capsys.readouterr().err.splitlines()[-1]


def test_pybamm_s_example_imports_within_two_percent(tmp_path: Path, third_party: Path) -> None:
    folder = third_party / "parameters" / "pybamm_ecm_example"
    text = import_cell([folder], name="x", chemistry="?", capacity_Ah=100.0, voltage_limits_V=(3.2, 4.2))
    (tmp_path / "cell.toml").write_text(text)
    cell = CellParams.load(tmp_path / "cell.toml")
    assert max(cell.provenance["rel_deviation_from_tables"].values()) < 0.02
    assert float(cell.dynamics_at(0.5, 25.0)["tau1_s"]) == pytest.approx(30.0, rel=1e-3)
