"""`bms-ukf score`: the cases it makes of a recording, the weights, the gate, and the command from manifest to page."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import measured
import numpy as np
import pytest

from bms_ukf import CellParams, identify
from bms_ukf import score as score_package
from bms_ukf.manifest import MeasuredTest
from bms_ukf.offline.signals import Signals, Told
from bms_ukf.score import Grid, cases, leaveoneout, tables, weights
from bms_ukf.score.recorded import Recorded
from bms_ukf.score.weights import Outcome

MANIFEST = """
format = 1
cell = "lgm50_chen2020"
chemistry = "NMC"
current_positive = "charge"
voltage_limits_V = [2.5, 4.2]
"""
TEST = """
[[test]]
role = "{role}"
file = "{file}"
temperature_degC = {temperature}
use = "{use}"
"""


def manifest(folder: Path, *tests: str) -> Path:
    path = folder / "m.toml"
    path.write_text(MANIFEST + "".join(tests))
    return path


def listed(file: str, role: str = "drive", use: str = "validate", temperature: float = 25.0, more: str = "") -> str:
    return TEST.format(role=role, file=file, use=use, temperature=temperature) + more


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two drives and a charge of the plant."""
    folder = tmp_path_factory.mktemp("measured")
    measured.write(folder / "warm.csv", measured.record(measured.DRIVE, 0.92))
    measured.write(folder / "cold.csv", measured.record(measured.DRIVE, 0.62, 0.0))
    measured.write(folder / "charge.csv", measured.record(measured.CHARGE, 0.3))
    return folder


@pytest.fixture(scope="module")
def whole(data: Path) -> Path:
    return manifest(
        data,
        listed("warm.csv", more="soc_ref_sigma = 0.01\n"),
        listed("cold.csv", temperature=0.0, more='group = "mixed"\n'),
        listed("charge.csv", role="charge"),
        listed("cold.csv", use="fit", temperature=0.0),
    )


# --- the cases ------------------------------------------------------------------------------------------------------


def made(rows: int = 2000, role: str = "drive", step_s: float = 1.0) -> Recorded:
    """From 95 % to 45 %, with a standstill every 50 s at 1 Hz."""
    time_s = step_s * np.arange(float(rows))
    current_A = np.where(time_s % 50 < 5, 0.0, 5.0)
    test = MeasuredTest(role=role, file="made.csv", temperature_degC=25.0)
    signals = Signals(time_s, current_A, np.linspace(4.1, 3.6, rows), np.full(rows, 25.0))
    return Recorded(test, "made", signals, np.linspace(0.95, 0.45, rows), np.ones(rows, bool))


def by_name(recorded: Recorded) -> dict[str, cases.Case]:
    return {case.name: case for case in cases.of(recorded, 0.3)}


def test_a_drive_makes_every_case_it_can_fill() -> None:
    offsets = ["offset -0.3 A", "offset -0.1 A", "offset +0.1 A", "offset +0.3 A"]
    startups = ["startup 0.9", "startup 0.6", "startup 0.3"]
    assert sorted(by_name(made())) == sorted(["nominal", *offsets, *startups, "initial 0.9", "initial 0.6"])
    assert sorted(by_name(made(role="charge"))) == sorted(["nominal", *offsets])


def test_a_cut_that_leaves_hardly_a_row_to_count_is_no_case() -> None:
    recorded = made()
    short = Recorded(recorded.test, "made", recorded.signals, recorded.soc_ref, np.arange(2000) < 1600)
    assert "initial 0.6" not in by_name(short)
    assert "initial 0.9" in by_name(short)


def test_an_offset_is_added_to_the_current_in_the_projects_own_sign() -> None:
    found = by_name(made())
    added_A = found["offset -0.3 A"].signals.current_A - found["nominal"].signals.current_A
    assert added_A == pytest.approx(-0.3)


@pytest.mark.parametrize("step_s", [1.0, 0.5, 7.0])
def test_a_wrong_start_is_cut_at_its_soc_after_an_hour_at_rest_that_does_not_count(step_s: float) -> None:
    recorded = made(4000, step_s=step_s)
    case = by_name(recorded)["initial 0.6"]
    assert case.told.soc == 1.0
    before, rows = case.padded, case.soc_ref.size - case.padded
    assert case.soc_ref[before] <= 0.6 < recorded.soc_ref[-rows - 1]
    for padded, column in zip(
        (case.signals.voltage_V, case.signals.current_A, case.soc_ref),
        (recorded.signals.voltage_V, recorded.signals.current_A, recorded.soc_ref),
        strict=True,
    ):
        np.testing.assert_array_equal(padded[before:], column[-rows:])
    np.testing.assert_array_equal(case.signals.current_A[:before], 0.0)
    np.testing.assert_array_equal(case.signals.voltage_V[:before], recorded.signals.voltage_V[-rows])
    assert np.isnan(case.soc_ref[:before]).all()
    assert case.signals.time_s[before] - case.signals.time_s[0] == pytest.approx(3600, abs=step_s)
    np.testing.assert_allclose(np.diff(case.signals.time_s), step_s)


def test_a_startup_is_told_wrong_over_the_whole_recording() -> None:
    case = by_name(made())["startup 0.3"]
    assert (case.told.soc, case.soc_ref.size) == (0.3, 2000)


# --- weights --------------------------------------------------------------------------------------------------------


def outcome(kind: str, rmse_pct: float | None, temperature: float = 25.0, value: float = 0.0, **more: str) -> Outcome:
    names = ("mae_pct", "max_pct", "coverage95", "settled_s", "half_width_pct")
    kept = dict.fromkeys(names, 1.0 if rmse_pct is not None else None)
    figures = {"rmse_pct": rmse_pct, **kept}
    fields = {"role": "drive", "group": "standard", "use": "validate"} | more
    late = figures | {"rmse_pct": 7.0}
    return Outcome(
        "srukf", "r", temperature_degC=temperature, kind=kind, value=value, case=kind,
        figures=figures | {"after_600s": late}, **fields,
    )  # fmt: skip


def test_every_outcome_counts_in_its_groups_and_fitted_ones_in_none() -> None:
    found = weights.grouped(
        [
            outcome("nominal", 1.0),
            outcome("nominal", 2.0, group="mixed"),
            outcome("nominal", 3.0, role="charge"),
            outcome("nominal", 50.0, use="fit"),
            outcome("offset", 4.0, value=-0.3),
            outcome("offset", 5.0, value=0.1),
            outcome("initial", 6.0, value=0.6),
            outcome("startup", 8.0, value=0.6),
        ]
    )
    rmse = {name: weights.figures(name, outcomes)["rmse_pct"] for name, outcomes in found.items()}
    assert rmse == {
        "standard cycles": 1.0,
        "mixed cycles": 2.0,
        "charging": 3.0,
        "temperatures": 1.5,
        "nominal": 2.0,
        "current offset": 4.0,
        "current offset 0.1 A": 5.0,
        "initial SoC": 6.0,
        "start-up after 600 s": 7.0,
    }


def test_a_temperature_counts_once_however_many_drives_it_has() -> None:
    outcomes = [outcome("nominal", 1.0), outcome("nominal", 3.0), outcome("nominal", 8.0, temperature=0.0)]
    assert weights.figures("temperatures", outcomes)["rmse_pct"] == 5.0
    assert weights.figures("standard cycles", outcomes)["rmse_pct"] == 4.0


def test_the_three_cuts_weigh_three_two_and_one_however_many_drives_reach_each() -> None:
    runs = [outcome("initial", 1.0, value=0.9), outcome("initial", 3.0, value=0.9), outcome("initial", 6.0, value=0.6)]
    assert weights.figures("initial SoC", [*runs, outcome("initial", 12.0, value=0.3)])["rmse_pct"] == pytest.approx(
        (3 * 2 + 2 * 6 + 1 * 12) / 6
    )
    assert weights.figures("initial SoC", runs)["rmse_pct"] == pytest.approx((3 * 2 + 2 * 6) / 5)


def test_variants_are_by_temperature_and_case_without_what_was_fitted() -> None:
    found = weights.variants(
        [
            outcome("startup", 2.0, value=0.3),
            outcome("nominal", 1.0, temperature=0.0),
            outcome("offset", 4.0, value=0.3),
            outcome("nominal", 1.0),
            outcome("nominal", 5.0, use="fit"),
            outcome("nominal", 3.0),
        ]
    )
    assert [(*variant, len(runs)) for variant, runs in found.items()] == [
        (25.0, "nominal", 2),
        (25.0, "offset", 1),
        (25.0, "startup", 1),
        (0.0, "nominal", 1),
    ]
    assert weights.figures("", found[weights.Variant(25.0, "startup")])["rmse_pct"] == 7.0  # from 600 s on


def test_a_group_is_marked_where_its_interval_misses_or_says_little() -> None:
    def variant(coverage95: float, half_width_pct: float) -> dict:
        figures = {"rmse_pct": 1.0, "coverage95": coverage95, "half_width_pct": half_width_pct}
        return {"temperature_degC": 25.0, "case": "offset +0.3 A", **figures}

    found = [variant(0.93, 3.0), variant(0.929, 3.0), variant(0.93, 3.01)]
    estimators = {"srukf": {"variants": found}}
    summary = {"estimators": estimators, "offsets_c_rate": {"+0.3": 0.1}, "step_s": 1.0, "health": True, "missing": []}
    table = tables.variants(summary)
    assert [row[-2:] for row in table.rows] == [["93.0 %", "3.00"], ["92.9 % !", "3.00"], ["93.0 %", "3.01 !"]]
    assert table.rows[0][0] == "25 °C, offset +0.3 A (+0.10 C)"
    assert "2 have at least 93 % inside, and 2 a median" in tables.notes(summary)[0]


def test_an_estimator_that_says_nothing_is_wrong_by_everything() -> None:
    assert weights.figures("nominal", [outcome("nominal", None)])["rmse_pct"] == 100.0
    assert weights.figures("nominal", [outcome("nominal", None)])["settled_s"] is None


def test_weights_are_the_benchmarks_and_what_is_there_sums_to_one() -> None:
    assert sum(weights.WEIGHTS.values()) == pytest.approx(1.0)
    shares = weights.normalised(["charging", "current offset", "nominal", "payloads"])
    assert shares == pytest.approx({"charging": 0.25, "current offset": 0.25, "payloads": 0.5})


# --- the command ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scored(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, str]:
    """The JSON and the page of a score."""
    from click.testing import CliRunner

    from bms_ukf import cli

    out = tmp_path_factory.mktemp("out")
    arguments = ["score", whole, "--cell", "lgm50_chen2020", "--json", out / "s.json", "--report", out / "s.html"]
    result = CliRunner().invoke(cli.cli, list(map(str, arguments)), catch_exceptions=False)
    assert result.exit_code == 0
    assert "weighted" in result.output
    return json.loads((out / "s.json").read_text()), (out / "s.html").read_text()


def test_the_groups_are_those_the_recordings_fill_and_the_others_are_named(scored: tuple[dict, str]) -> None:
    summary, _ = scored
    filled = ["charging", "standard cycles", "mixed cycles", "initial SoC", "current offset", "temperatures"]
    assert summary["weights"] == pytest.approx(dict.fromkeys(filled, 1 / 6))
    assert {"withheld cell", "open cells", "payloads"} < set(summary["missing"])
    assert "initial SoC 0.3 (warm, cold)" in summary["missing"]
    assert summary["offsets_c_rate"]["+0.1"] == pytest.approx(0.02, rel=0.05)


def test_the_weighted_score_is_the_weighted_sum_of_the_groups(scored: tuple[dict, str]) -> None:
    summary, _ = scored
    assert list(summary["estimators"]) == ["srukf", "ekf", "coulomb"]
    for estimator in summary["estimators"].values():
        expected = np.mean([estimator["groups"][name]["rmse_pct"] for name in summary["weights"]])
        assert estimator["weighted_rmse_pct"] == pytest.approx(expected)
        assert estimator["fitted"]["rmse_pct"] == estimator["temperatures"]["0"]["rmse_pct"]


def test_coulomb_counting_shows_what_each_case_does_to_a_counter(scored: tuple[dict, str]) -> None:
    """It is off by what it was told wrong, and by the charge of an offset: known answers for the whole way."""
    summary, _ = scored
    runs = {
        (outcome["recording"], outcome["case"]): outcome["figures"]
        for outcome in summary["outcomes"]
        if outcome["estimator"] == "coulomb" and outcome["use"] == "validate"
    }
    assert runs["warm", "nominal"]["max_pct"] < 0.5
    assert runs["warm", "startup 0.6"]["bias_pct"] == pytest.approx(-32, abs=0.5)
    assert runs["warm", "initial 0.9"]["bias_pct"] == pytest.approx(10, abs=2.0)
    duration_h = 1.8 * 1000 / 3600
    expected_pct = 100 * 0.3 * duration_h / summary["capacity_Ah"]
    assert runs["warm", "offset -0.3 A"]["max_pct"] == pytest.approx(expected_pct, abs=0.6)
    assert runs["warm", "offset -0.3 A"]["bias_pct"] > 0 > runs["warm", "offset +0.3 A"]["bias_pct"]


def test_every_temperature_and_case_has_the_share_inside_and_the_median_half_width(scored: tuple[dict, str]) -> None:
    summary, page = scored
    ours = {(found["temperature_degC"], found["case"]): found for found in summary["estimators"]["srukf"]["variants"]}
    runs = [o["figures"] for o in summary["outcomes"] if o["estimator"] == "srukf" and o["use"] == "validate"]
    assert sum(found["recordings"] for found in ours.values()) == len(runs)
    nominal = [run for run in summary["outcomes"] if run["estimator"] == "srukf" and run["case"] == "nominal"]
    cold = next(run["figures"] for run in nominal if run["temperature_degC"] == 0.0 and run["use"] == "validate")
    for key in ("rmse_pct", "coverage95", "half_width_pct"):
        assert ours[0.0, "nominal"][key] == cold[key]
    assert "0 °C, offset -0.3 A (-0.06 C)" in page


@pytest.mark.parametrize(("options", "rows"), [([], 1800), (["--resample", "10"], 180), (["--native"], 3599)])
def test_the_rate_is_once_a_second_or_as_asked_or_as_recorded(
    data: Path, bms_ukf, options: list[str], rows: int
) -> None:
    fast = np.loadtxt(data / "warm.csv", delimiter=",", skiprows=1)
    halves = np.arange(fast[0, 0], fast[-1, 0] + 0.1, 0.5)
    columns = [np.interp(halves, fast[:, 0], column) for column in fast.T[1:]]
    measured.write(data / "fast.csv", np.column_stack([halves, *columns]))
    path = manifest(data, listed("fast.csv"))
    given = ["score", path, "--cell", "lgm50_chen2020", "--estimator", "coulomb", "--json", data / "r.json", *options]
    assert bms_ukf(*given).code == 0
    summary = json.loads((data / "r.json").read_text())
    assert list(summary["estimators"]) == ["coulomb"]
    nominal = next(found for found in summary["outcomes"] if found["case"] == "nominal")
    assert nominal["figures"]["n_scored"] == pytest.approx(rows, rel=0.05)
    assert nominal["figures"]["rmse_pct"] < 0.5
    cut = next(found for found in summary["outcomes"] if found["case"] == "initial 0.9")
    assert cut["figures"]["max_pct"] == pytest.approx(10, abs=1.5)


def test_ours_learns_the_capacity_on_the_way_unless_it_must_not(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hours of use decide what is learned: here it matters only which of the two was asked to run."""
    asked = []

    def stand_in(name: str):
        def run(signals: Signals, _told: Told | None) -> dict:
            asked.append(name)
            column = np.full(signals.time_s.size, 0.5)
            return {"soc": column, "soc_low": column - 0.1, "soc_high": column + 0.1}

        return run

    monkeypatch.setattr(
        score_package, "followed", lambda cell, tuning, signals, told: (stand_in("health")(signals, told), None)
    )
    monkeypatch.setattr(score_package, "prepare", lambda name, cell, tuning: stand_in("no health"))
    path = manifest(data, listed("charge.csv", role="charge"))
    for health, expected in ((True, "health"), (False, "no health")):
        asked.clear()
        found = score_package.score(path, CellParams.load("lgm50_chen2020"), Grid(("srukf",), health=health))
        assert set(asked) == {expected}
        assert found.summary["health"] is health


def test_ours_finds_the_start_that_coulomb_counting_cannot(scored: tuple[dict, str]) -> None:
    groups = {name: estimator["groups"] for name, estimator in scored[0]["estimators"].items()}
    assert (
        groups["srukf"]["start-up after 600 s"]["rmse_pct"] < 3 < groups["coulomb"]["start-up after 600 s"]["rmse_pct"]
    )


def test_the_page_holds_tables_and_plots_and_refers_to_nothing_outside(scored: tuple[dict, str]) -> None:
    _, page = scored
    assert page.count("data:image/png;base64,") == 2 + 3
    for word in ("weighted", "coulomb", "payloads", "offset +0.3 A", "warm", "(fitted)"):
        assert word in page, word
    assert not re.search(r"https?:|url\(|@import|<script|<link", re.sub(r"base64,[^\"]+", "", page))


def test_a_part_of_a_file_is_estimated_from_its_start_and_counted_where_it_lies(data: Path, bms_ukf) -> None:
    halves = [listed("warm.csv", more=f"part = [{a}, {b}]\n") for a, b in ((0.0, 0.5), (0.5, 1.0))]
    path = manifest(data, *halves, listed("cold.csv"))
    assert bms_ukf("score", path, "--cell", "lgm50_chen2020", "--json", data / "p.json").code == 0
    summary = json.loads((data / "p.json").read_text())
    coulomb = [found for found in summary["outcomes"] if found["estimator"] == "coulomb"]
    offset = {found["recording"]: found["figures"] for found in coulomb if found["case"] == "offset +0.3 A"}
    first, second = offset["warm 0-50 %"], offset["warm 50-100 %"]
    assert first["n_scored"] == pytest.approx(second["n_scored"], abs=2)
    assert not [found for found in coulomb if found["figures"]["n_scored"] == 0]
    # The counter's error grows from the file's start: over the second half it is three times that of the first.
    assert second["bias_pct"] == pytest.approx(3 * first["bias_pct"], rel=0.15)


def test_files_of_one_name_in_two_folders_are_told_apart(data: Path, bms_ukf) -> None:
    for folder, source in (("25", "warm.csv"), ("0", "cold.csv")):
        (data / folder).mkdir()
        (data / folder / "drive.csv").write_bytes((data / source).read_bytes())
    path = manifest(data, listed("25/drive.csv"), listed("0/drive.csv", temperature=0.0))
    assert bms_ukf("score", path, "--cell", "lgm50_chen2020", "--json", data / "f.json").code == 0
    summary = json.loads((data / "f.json").read_text())
    assert {found["recording"] for found in summary["outcomes"]} == {"25/drive.csv", "0/drive.csv"}


@pytest.mark.parametrize(("gate", "code"), [("weighted_rmse_pct=99", 0), ("weighted_rmse_pct=0.001", 1)])
def test_a_gate_decides_the_exit_code(bms_ukf, data: Path, gate: str, code: int) -> None:
    path = manifest(data, listed("charge.csv", role="charge"))
    ended = bms_ukf("score", path, "--cell", "lgm50_chen2020", "--gate", gate)
    assert ended.code == code
    assert ("above its gate of 0.001" in ended.err) == (code == 1)


@pytest.mark.parametrize(
    ("tests", "more", "told"),
    [
        ([listed("warm.csv", use="fit")], [], 'with use = "validate"'),
        ([listed("none.csv")], [], "test.file is 'none.csv'; expected a file in"),
        ([listed("bare.csv")], [], "bare.csv: soc_ref: expected this column"),
        ([listed("warm.csv", more='current_positive = "discharge"\n')], [], "current_positive is 'discharge'"),
        ([listed("warm.csv", more='group = "odd"\n')], [], "test.0.group"),
        (
            [listed("charge.csv", role="charge")],
            ["--gate", "rmse=1"],
            "--gate: rmse: expected one of weighted_rmse_pct",
        ),
        (
            [listed("charge.csv", role="charge")],
            ["--gate", "weighted_rmse_pct"],
            "expected weighted_rmse_pct=X with a limit",
        ),
        ([listed("charge.csv", role="charge")], ["--cell", "nothing"], "one of the shipped cells"),
        ([listed("warm.csv")], ["--native", "--resample", "2"], "--native: expected no --resample"),
        ([listed("warm.csv")], ["--leave-one-out"], "either --cell or --leave-one-out"),
    ],
)
def test_a_mistake_is_one_line(bms_ukf, data: Path, tests: list[str], more: list[str], told: str) -> None:
    rows = np.loadtxt(data / "warm.csv", delimiter=",", skiprows=1)[:, :4]
    measured.write(data / "bare.csv", rows, "time_s,current_A,voltage_V,temperature_C")
    line = bms_ukf("score", manifest(data, *tests), "--cell", "lgm50_chen2020", *more).line
    assert told in line


# --- leave one out --------------------------------------------------------------------------------------------------


def test_each_file_is_scored_whole_with_a_cell_identified_without_it(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The identification takes minutes and has its own tests: a stand-in records the tests that it is given."""
    given: list[tuple[set[str], set[str]]] = []

    def identified(path: Path, progress, tests) -> SimpleNamespace:
        progress("fitting")
        uses = {use: {Path(test.file).name for test in tests if test.use == use} for use in ("fit", "validate")}
        given.append((uses["fit"], uses["validate"]))
        return SimpleNamespace(cell=CellParams.load("lgm50_chen2020"))

    monkeypatch.setattr(identify, "run", identified)
    path = manifest(
        data,
        listed("warm.csv", use="fit", more="part = [0.0, 0.5]\n"),
        listed("warm.csv", more="part = [0.5, 1.0]\n"),
        listed("cold.csv", use="fit", temperature=0.0),
        listed("charge.csv", role="charge"),
    )
    said: list[str] = []
    found = leaveoneout.score(path, Grid(("coulomb",)), progress=said.append)
    assert given == [
        ({"cold.csv"}, {"charge.csv"}),
        ({"warm.csv"}, {"warm.csv", "charge.csv"}),
        ({"warm.csv", "cold.csv"}, {"warm.csv"}),
    ]
    nominal = {run["recording"]: run for run in found.summary["outcomes"] if run["case"] == "nominal"}
    assert set(nominal) == {"warm", "cold", "charge"}
    assert all(run["use"] == "validate" for run in nominal.values())
    assert nominal["warm"]["figures"]["n_scored"] > 1700
    assert said[0] == "file 1 of 3, without warm.csv: fitting"
    assert "file 3 of 3, without charge.csv: scoring charge: nominal" in said


def test_what_the_other_tests_lack_is_named_with_the_file_that_was_left_out(data: Path, bms_ukf) -> None:
    path = manifest(data, listed("warm.csv"), listed("charge.csv", role="charge", use="fit"))
    line = bms_ukf("score", path, "--leave-one-out").line
    assert "m.toml" in line
    assert "without warm.csv" in line
