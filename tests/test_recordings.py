"""Reading cycler files: names, units and signs, and what is wrong with them."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from bms_ukf.errors import ConfigError
from bms_ukf.recordings import Recording, Selection, estimate_voltage_lag_s, read, require_sign


def write(path: Path, header: str, rows: list[str]) -> Path:
    text = "\n".join([header, *rows]) + "\n"
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("header", "current", "voltage", "time"),
    [
        ("time_s,current_A,voltage_V,temperature_C", 1.0, 1.0, 1.0),
        ("Test Time / s,Current / A,Voltage / V,Surface Temperature / degC", 1.0, 1.0, 1.0),
        ("test_time_second,current_ampere,voltage_volt,surface_temperature_celsius", 1.0, 1.0, 1.0),
        ("Time [min],Current(mA),Voltage [mV],Temperature (K)", 1e-3, 1e-3, 60.0),
    ],
)
def test_any_spelling_and_unit_gives_the_same_columns(
    tmp_path: Path, header: str, current: float, voltage: float, time: float
) -> None:
    offset = 273.15 if "(K)" in header else 0.0
    rows = [f"{k / time},{-2 / current},{3.7 / voltage},{20 + offset}" for k in range(4)]
    found = read(write(tmp_path / "a.csv.gz", header, rows), current_positive="charge")
    np.testing.assert_allclose(found.time_s, range(4))
    np.testing.assert_allclose(found.current_A, 2.0)
    np.testing.assert_allclose(found.voltage_V, 3.7)
    np.testing.assert_allclose(found.temperature_degC, 20.0)
    assert not found.warnings


def test_the_surface_temperature_is_taken_before_the_chamber(tmp_path: Path) -> None:
    header = "time_s,current_A,voltage_V,Ambient Temperature / degC,Surface Temperature / degC"
    path = write(tmp_path / "a.csv", header, [f"{k},1,3.7,10,12" for k in range(4)])
    np.testing.assert_allclose(read(path, current_positive="discharge").temperature_degC, 12.0)


def test_parquet_reads_as_csv_does(tmp_path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    columns = {"time_s": [0, 1, 2], "current_mA": [1000, 2000, 3000], "voltage_V": [3.7, 3.6, 3.5]}
    parquet.write_table(pa.table(columns), tmp_path / "a.parquet")
    found = read(tmp_path / "a.parquet", current_positive="discharge", temperature_degC=25.0)
    np.testing.assert_allclose(found.current_A, [1, 2, 3])


@pytest.mark.parametrize(("hold", "expected"), [("preceding", [2, 4]), ("following", [1, 2]), ("trapezoid", [1.5, 3])])
def test_a_current_is_the_mean_over_the_interval_before_its_row(
    tmp_path: Path, hold: str, expected: list[float]
) -> None:
    path = write(tmp_path / "a.csv", "time_s,current_A,voltage_V", ["0,1,3.7", "1,2,3.7", "3,4,3.7"])
    found = read(path, current_positive="discharge", current_hold=hold, temperature_degC=25.0)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.current_A[1:], expected)
    np.testing.assert_allclose(found.drawn_Ah[-1] * 3600, expected[0] + 2 * expected[1])


def test_thinning_keeps_the_charge() -> None:
    rng = np.random.default_rng(0)
    time_s = np.cumsum(rng.uniform(0.05, 0.2, 500))
    current_A = rng.normal(size=500)
    drawn = np.cumsum(current_A * np.diff(time_s, prepend=time_s[0])) / 3600
    whole = Recording("a", time_s, current_A, np.full(500, 3.7), np.full(500, 25.0), drawn)
    thin = whole.rows(np.arange(0, 500, 7))
    charge_As = np.sum(thin.current_A[1:] * np.diff(thin.time_s))
    assert charge_As == pytest.approx(3600 * (thin.drawn_Ah[-1] - thin.drawn_Ah[0]), rel=1e-9)


def test_holes_and_repeats_are_left_out_and_named(tmp_path: Path) -> None:
    rows = [f"{k},1,3.7,25" for k in range(200)]
    rows[50] = "50,,3.7,25"
    rows.insert(81, "80,1,3.7,25")
    rows[120] = f"{rows[120].split(',')[0]},1,3.7,"
    found = read(write(tmp_path / "a.csv", "time_s,current_A,voltage_V,temperature_C", rows), current_positive="charge")
    assert found.time_s.size == 199
    assert np.isfinite(found.temperature_degC).all()
    named = ["1 rows without time", "temperature missing in 1 rows", "1 rows at the time of another"]
    assert all(text in warning for text, warning in zip(named, found.warnings, strict=True))


@pytest.mark.parametrize(
    ("rows", "named"),
    [
        (["0,1,3.7", "2,1,3.7", "1,1,3.7", "3,1,3.7"], "row 3 is 1"),
        (["0,1,3.7", "1,x,3.7", "2,1,3.7"], "current_A, row 2"),
        (["0,1,3.7", "1,,3.7", "2,,3.7", "3,1,3.7"], "2 of 4"),
        (["0,1,3.7", "1,1", "2,1,3.7"], "row 2"),
        (["0,1,3.7"], "at least 3"),
        ([], "at least 3"),
    ],
)
def test_what_cannot_be_mended_is_one_line(tmp_path: Path, rows: list[str], named: str) -> None:
    path = write(tmp_path / "a.csv", "time_s,current_A,voltage_V", rows)
    with pytest.raises(ConfigError) as error:
        read(path, current_positive="charge", temperature_degC=25.0)
    assert named in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_column_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="voltage_V"):
        read(write(tmp_path / "a.csv", "time_s,current_A", ["0,1"]), current_positive="charge")


def test_nothing_is_integrated_over_a_gap_under_current(tmp_path: Path) -> None:
    rows = [f"{k},1,3.7" for k in range(100)] + [f"{k},1,3.5" for k in range(9000, 9100)]
    path = write(tmp_path / "a.csv", "time_s,current_A,voltage_V", rows)
    found = read(path, current_positive="discharge", temperature_degC=25.0)
    assert found.time_s[-1] == 99
    assert "gap" in found.warnings[0]


def test_a_gap_at_rest_is_a_rest(tmp_path: Path) -> None:
    rows = [*[f"{k},1,3.7" for k in range(100)], *[f"{k},0,3.8" for k in (100, 9000)], "9001,1,3.7"]
    path = write(tmp_path / "a.csv", "time_s,current_A,voltage_V", rows)
    assert read(path, current_positive="discharge", temperature_degC=25.0).time_s[-1] == 9001


def drive(lag_s: float = 0.0) -> Recording:
    """A random current at 10 Hz and 30 mOhm; the voltage late by `lag_s`."""
    rng = np.random.default_rng(1)
    time_s = np.arange(0, 600, 0.1)
    current_A = np.repeat(rng.normal(1, 3, 600), 10) + rng.normal(0, 0.5, 6000).cumsum() * 0.05
    voltage_V = 3.7 - 0.03 * np.interp(time_s - lag_s, time_s, current_A) + rng.normal(0, 1e-3, 6000)
    return Recording("drive", time_s, current_A, voltage_V, np.full(6000, 25.0), np.cumsum(current_A * 0.1) / 3600)


def test_a_wrong_sign_is_named_and_a_right_one_passes() -> None:
    recording = drive()
    require_sign(recording, "discharge")
    recording.current_A, recording.drawn_Ah = -recording.current_A, -recording.drawn_Ah
    with pytest.raises(ConfigError, match="current_positive is 'charge'; expected 'discharge'"):
        require_sign(recording, "charge")


def test_a_slow_test_shows_its_sign_by_its_trend() -> None:
    drawn_Ah = np.linspace(0, 3, 1000)
    columns = (drawn_Ah * 72000, np.full(1000, 0.05), 4.2 - 0.4 * drawn_Ah, np.full(1000, 25.0), drawn_Ah)
    right = Recording("slow", *columns)
    require_sign(right, "discharge")
    right.voltage_V = right.voltage_V[::-1]
    with pytest.raises(ConfigError, match="rises with the charge drawn"):
        require_sign(right, "discharge")


@pytest.mark.parametrize("lag_s", [0.0, 0.1, 0.23])
def test_the_lag_of_the_voltage_is_found_and_removed(lag_s: float) -> None:
    late = drive(lag_s)
    assert estimate_voltage_lag_s(late) == pytest.approx(lag_s, abs=0.06)
    mended, right = late.with_voltage_lag(lag_s), drive()
    assert np.std((mended.voltage_V - right.voltage_V)[10:-10]) < 0.02


def test_a_lag_is_not_guessed_from_slow_rows() -> None:
    recording = drive(0.3)
    assert estimate_voltage_lag_s(recording.rows(np.arange(0, 6000, 10))) == 0.0


OWN_NAMES = "T_C,cell,ProgTime,Spannung,Strom,Log1"


def own_rows(*cells: str) -> list[str]:
    return [f"{T},{cell},{k},{3.7 + 0.1 * T},-1,{T + 1}" for T in (0, 25) for cell in cells for k in range(4)]


NAMED = {"time_s": "ProgTime", "current_A": "Strom", "voltage_V": "Spannung", "temperature_degC": "Log1"}


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet"])
def test_named_columns_and_chosen_rows_are_read(tmp_path: Path, suffix: str) -> None:
    rows = own_rows("Cell1", "Cell2")
    if suffix == ".parquet":
        import pyarrow as pa
        from pyarrow import csv as pa_csv
        from pyarrow import parquet

        path = tmp_path / "a.parquet"
        text = "\n".join([OWN_NAMES, *rows])
        parquet.write_table(pa_csv.read_csv(pa.BufferReader(text.encode())), path)
    else:
        path = write(tmp_path / f"a{suffix}", OWN_NAMES, rows)
    selection = Selection(NAMED, {"T_C": 25.0, "cell": ["Cell2", "Cell3"]})
    found = read(path, current_positive="charge", selection=selection)
    np.testing.assert_allclose(found.time_s, range(4))
    np.testing.assert_allclose(found.voltage_V, 6.2)
    np.testing.assert_allclose(found.temperature_degC, 26.0)
    assert found.name == "a T_C=25 cell=Cell2|Cell3"


@pytest.mark.parametrize(
    ("columns", "where", "named"),
    [
        (
            {**NAMED, "current_A": "Current"},
            {},
            "columns.current_A is 'Current'; expected one of the file's columns: T_C",
        ),
        (NAMED, {"Cell": "Cell1"}, "where.Cell"),
        (NAMED, {"cell": "Cell7"}, "where.cell is 'Cell7'; expected a value of that column: Cell1, Cell2"),
        (NAMED, {"T_C": 25.0, "cell": 7.0}, "where.cell"),
    ],
)
def test_a_column_or_value_that_is_not_there_is_named_with_those_that_are(
    tmp_path: Path, columns: dict[str, str], where: dict[str, float | str], named: str
) -> None:
    path = write(tmp_path / "a.csv", OWN_NAMES, own_rows("Cell1", "Cell2"))
    with pytest.raises(ConfigError) as error:
        read(path, current_positive="charge", selection=Selection(columns, where))
    assert named in str(error.value)


def test_a_unit_in_a_named_header_counts(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "Prog [min],Strom (mA),U", [f"{k},2000,3.7" for k in range(4)])
    columns = {"time_s": "Prog [min]", "current_A": "Strom (mA)", "voltage_V": "U"}
    found = read(path, current_positive="discharge", temperature_degC=25.0, selection=Selection(columns))
    np.testing.assert_allclose(found.time_s, [0, 60, 120, 180])
    np.testing.assert_allclose(found.current_A, 2.0)


def test_rows_without_temperature_are_counted_and_never_zero(tmp_path: Path) -> None:
    rows = [f"{k},1,3.7,{'' if k == 1 else 20 + k}" for k in range(4)]
    found = read(write(tmp_path / "a.csv", "time_s,current_A,voltage_V,temperature_C", rows), current_positive="charge")
    np.testing.assert_allclose(found.temperature_degC, [20, 21, 22, 23])
    assert "temperature missing in 1 rows of 4" in found.warnings[0]


def test_of_rows_at_one_time_the_new_step_is_kept_and_after_a_long_interval_the_old_one(tmp_path: Path) -> None:
    """Cyclers log the change of a step twice, the first time with the old current and the new voltage."""
    rows = ["0,0,4.0", "0.5,0,3.9", "0.5,2,3.9", "1,2,3.9", "61,2,3.8", "61,0,3.85", "62,0,3.9"]
    path = write(tmp_path / "a.csv", "time_s,current_A,voltage_V", rows)
    found = read(path, current_positive="discharge", temperature_degC=25.0)
    np.testing.assert_allclose(found.time_s, [0, 0.5, 1, 61, 62])
    np.testing.assert_allclose(found.current_A, [0, 2, 2, 2, 0])


def test_after_a_gap_a_recording_starts_anew_only_where_it_is_asked_to(tmp_path: Path) -> None:
    rows = [f"{t},{i},{v}" for t, i, v in [(0, 0, 4.0), (1, 2, 3.9), (2, 2, 3.9), (5000, 0, 3.7), (5001, 2, 3.6)]]
    path = write(tmp_path / "a.csv", "time_s,current_A,voltage_V", rows)
    cut = read(path, current_positive="discharge", temperature_degC=25.0)
    assert cut.time_s[-1] == 2
    assert "cut at 2 s" in cut.warnings[0]
    whole = read(path, current_positive="discharge", temperature_degC=25.0, restarts=True)
    np.testing.assert_array_equal(whole.after_gap, [False, False, False, True, False])
    np.testing.assert_allclose(whole.drawn_Ah * 3600, [0, 2, 4, 4, 6])


def test_extra_records_at_the_edge_of_a_step_are_left_out_and_regular_fast_ones_kept(tmp_path: Path) -> None:
    rows = ["0,0,4.0", "0.1,0,4.0", "0.12,0,3.9", "0.22,2,3.9", "0.32,2,3.9", "0.33,0,3.9", "0.43,0,4.0", "0.53,0,4.0"]
    path = write(tmp_path / "a.csv", "time_s,current_A,voltage_V", rows)
    found = read(path, current_positive="discharge", temperature_degC=25.0)
    np.testing.assert_allclose(found.time_s, [0, 0.1, 0.22, 0.32, 0.43, 0.53])
    assert "2 rows at the edge of a step" in found.warnings[0]
    fast = write(tmp_path / "b.csv", "time_s,current_A,voltage_V", [f"{0.01 * k},1,3.7" for k in range(50)])
    assert read(fast, current_positive="discharge", temperature_degC=25.0).time_s.size == 50
