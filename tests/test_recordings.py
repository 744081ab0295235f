"""Reading cycler files: names, units and signs, and what is wrong with them."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from bms_ukf.errors import ConfigError
from bms_ukf.recordings import Recording, estimate_voltage_lag_s, read, require_sign


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
    assert [word for warning in found.warnings for word in ("without", "before") if word in warning] == [
        "without",
        "before",
    ]


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
