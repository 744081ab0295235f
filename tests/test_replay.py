"""`bms-ukf replay` over cycler recordings: what is written, what each option does, and what is refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import measured
import numpy as np
import pytest

from bms_ukf import CellParams, Estimator

CELL = ["--cell", "lgm50_chen2020", "--current-positive", "charge"]


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    return measured.record(measured.DRIVE, 0.9)


@pytest.fixture
def drive(tmp_path: Path, rows: np.ndarray) -> Path:
    return measured.write(tmp_path / "drive.csv", rows)


@pytest.fixture
def replay(bms_ukf, drive: Path, tmp_path: Path):
    """Runs it over the drive; gives the rows of the CSV and the summary."""

    def run(*more: object) -> tuple[dict[str, np.ndarray], dict]:
        out, summary = tmp_path / "est.csv", tmp_path / "sum.json"
        ended = bms_ukf("replay", drive, *CELL, "--out", out, "--json", summary, *more)
        assert ended.code == 0, ended.err
        with out.open() as file:
            found = list(csv.DictReader(file))
        columns = {name: np.array([row[name] or "nan" for row in found]) for name in found[0]}
        numbers = {name: column.astype(float) for name, column in columns.items() if name not in {"status", "faults"}}
        columns |= numbers
        return columns, json.loads(summary.read_text())

    return run


def test_the_csv_is_the_estimate_at_every_row_of_the_recording(replay, cell: CellParams, rows: np.ndarray) -> None:
    columns, _ = replay()
    written = np.array([[float(f"{value:.7g}") for value in row] for row in rows])
    t_ns = np.round(written[:, 0] * 1e9).astype(np.int64)
    expected = Estimator(cell).replay(t_ns, -written[:, 1], written[:, 2], written[:, 3])
    for name in ("soc", "soc_sigma", "voltage_pred_V", "innovation_V", "nis"):
        np.testing.assert_allclose(columns[name], expected[name], rtol=1e-8, err_msg=name)
    np.testing.assert_allclose(columns["time_s"], written[:, 0])
    np.testing.assert_allclose(columns["soc_ref"], written[:, 4])
    assert set(columns["status"]) == {"ok"}


def test_the_summary_has_every_key_of_the_contract_and_scores_the_csv(replay) -> None:
    columns, summary = replay("--soc-ref-sigma", "0.01")
    error_pct = 100 * (columns["soc"] - columns["soc_ref"])
    assert summary["n"] == len(error_pct)
    assert summary["duration_s"] == columns["time_s"][-1] - columns["time_s"][0]
    assert summary["steps_per_s"] > 1000
    assert summary["final_soc"] == pytest.approx(columns["soc"][-1])
    assert summary["soc_sigma_final"] == pytest.approx(columns["soc_sigma"][-1])
    assert summary["rmse_pct"] == pytest.approx(np.sqrt(np.mean(error_pct**2)), rel=1e-6)
    assert summary["bias_pct"] == pytest.approx(np.mean(error_pct), rel=1e-6)
    band_pct = 196 * np.hypot(columns["soc_sigma"], 0.01)
    assert summary["coverage95"] == pytest.approx(np.mean(np.abs(error_pct) <= band_pct))
    assert {"mae_pct", "max_pct", "settled_s"} < summary.keys() & summary["after_600s"].keys()


def test_errors_of_the_sensors_are_added_in_the_projects_sign_before_the_estimator_sees_them(replay) -> None:
    right, _ = replay()
    wrong, _ = replay("--current-offset", "0.2", "--current-gain", "1.1", "--voltage-offset", "-0.01")
    np.testing.assert_allclose(wrong["current_A"], 1.1 * right["current_A"] + 0.2, atol=1e-8)
    np.testing.assert_allclose(wrong["voltage_V"], right["voltage_V"] - 0.01, atol=1e-8)


def test_what_is_told_of_soc_is_where_the_estimate_starts(replay) -> None:
    told, _ = replay("--initial-soc", "0.6", "--initial-sigma", "0.001")
    assert told["soc"][0] == pytest.approx(0.6, abs=0.01)
    found, summary = replay()
    assert found["soc"][0] == pytest.approx(0.9, abs=0.05)
    assert summary["warnings"] == []


def test_a_recording_that_begins_under_load_is_run_with_a_warning(bms_ukf, tmp_path: Path, rows: np.ndarray) -> None:
    loaded = rows[np.abs(rows[:, 1]).argmax() :]
    path = measured.write(tmp_path / "loaded.csv", loaded)
    ended = bms_ukf("replay", path, *CELL)
    assert ended.code == 0
    assert "does not begin at rest" in " ".join(ended.out.split())


def test_resampled_rows_keep_the_charge(replay) -> None:
    fine, _ = replay()
    coarse, summary = replay("--resample", "10")
    assert np.diff(coarse["time_s"]) == pytest.approx(10.0)
    assert summary["n"] == (len(fine["time_s"]) - 1) // 10 + 1
    last = np.searchsorted(fine["time_s"], coarse["time_s"][-1])
    assert 10 * coarse["current_A"][1:].sum() == pytest.approx(fine["current_A"][1 : last + 1].sum(), abs=1e-4)


@pytest.mark.parametrize("estimator", ["ekf", "coulomb"])
def test_the_other_estimators_run_over_the_same_rows(replay, estimator: str) -> None:
    columns, summary = replay("--estimator", estimator)
    assert summary["estimator"] == estimator
    assert summary["rmse_pct"] < 5
    assert np.isfinite(columns["soc"]).all()


def test_two_cell_files_are_run_over_the_same_recording_and_compared(replay, tmp_path: Path) -> None:
    _, alike = replay("--diff", "lgm50_chen2020")
    assert alike["diff"]["from_first"] == {"mean_pct": 0.0, "rms_pct": 0.0, "max_pct": 0.0}
    page = tmp_path / "r.html"
    _, apart = replay("--diff", "panasonic_ncr18650pf", "--report", page)
    assert apart["diff"]["cell"] == "panasonic_ncr18650pf"
    assert apart["diff"]["from_first"]["max_pct"] > 1
    assert "SoC by lgm50_chen2020 and by panasonic_ncr18650pf" in page.read_text()


def test_the_page_of_a_recording_shows_its_errors_and_no_goals_of_ours(replay, tmp_path: Path) -> None:
    replay("--report", tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    assert "Largest absolute error" in page
    assert "Verdict" not in page
    assert page.count("data:image/png;base64,") == 6


def test_a_folder_is_run_whole_with_results_by_name_and_a_bad_file_stops_nothing(
    bms_ukf, tmp_path: Path, rows: np.ndarray
) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("a.csv", "b.csv.gz"):
        measured.write(folder / name, rows[:300])
    (folder / "bad.csv").write_text("x,y\n1,2\n")
    (folder / "notes.txt").write_text("no recording")
    out, summaries = tmp_path / "out", tmp_path / "made" / "json"
    ended = bms_ukf("replay", folder, *CELL, "--out", out, "--json", summaries, "--jobs", "2")
    assert "bad.csv: time_s is 'x,y'; expected columns" in ended.line
    assert sorted(path.name for path in out.iterdir()) == ["a.csv", "b.csv"]
    assert sorted(path.name for path in summaries.iterdir()) == ["a.json", "b.json"]
    assert (out / "a.csv").read_bytes() == (out / "b.csv").read_bytes()


def test_the_tuning_of_a_configuration_is_used(replay, tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text(
        'format = 1\ncell = "x"\nbus = { interface = "socketcan", channel = "can0" }\n'
        "[estimator]\ninitial_soc = 0.6\ninitial_soc_sigma = 0.001\n"
    )
    assert replay("--config", config)[0]["soc"][0] == pytest.approx(0.6, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["drive.csv", "--cell", "lgm50_chen2020"], "--current-positive"),
        (["drive.csv", "--cell", "lgm50_chen2020", "--current-positive", "discharge"], "the voltage jumps by +"),
        (["drive.csv", *CELL, "--initial-sigma", "0.1"], "--initial-sigma is 0.1; expected --initial-soc beside it"),
        (["nothing.csv", *CELL], "nothing.csv: expected a readable CSV"),
        (["car.log"], "--config: expected the configuration by which car.log is read"),
        ([".", "other/drive.csv", *CELL], "their results would overwrite each other"),
        (["empty", *CELL], "empty: expected a folder with recordings"),
        (["drive.csv", *CELL, "--out", "no/such/est.csv"], "no/such/est.csv: expected a file to be written"),
        (["drive.csv", *CELL, "--diff", "nothing"], "nothing: expected a file, or one of the shipped cells"),
        (["bare.csv", *CELL], "bare.csv: temperature_degC: expected a column, or the temperature of the test"),
    ],
)
def test_a_mistake_is_one_line(bms_ukf, tmp_path, monkeypatch, drive, rows, arguments: list[str], told: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    measured.write(tmp_path / "bare.csv", rows[:, :3], "time_s,current_A,voltage_V")
    if "." in arguments:
        (tmp_path / "other").mkdir()
        (tmp_path / "other" / "drive.csv").write_bytes(drive.read_bytes())
    (tmp_path / "car.log").write_text("")
    assert told in bms_ukf("replay", *arguments).line
