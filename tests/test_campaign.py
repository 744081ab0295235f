"""The honesty campaign: situations that repeat, figures by definition, goals with an allowance, and its command."""

import json
import pickle

import numpy as np
import pytest

from bms_ukf import Status
from bms_ukf.campaign import classes, command, course, figures, goals, library, run, sensing, traces, view
from bms_ukf.campaign.run import Published
from bms_ukf.campaign.situation import Failure, Situation
from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.manifest import DATA_FOLDER
from bms_ukf.records import Fault


def published(t_s, soc, half_width, truth, status=Status.OK, faults=Fault.NONE):
    """One set for each time, of one cell."""
    columns = [np.broadcast_to(np.asarray(value, dtype=float), (len(t_s),))[:, None] for value in (soc, truth)]
    words = [np.broadcast_to(np.asarray(value, dtype=np.int64), (len(t_s),)) for value in (status, faults)]
    silent = np.zeros(len(t_s), dtype=bool)
    low, high = columns[0] - half_width, columns[0] + half_width
    return Published(np.asarray(t_s, dtype=float), columns[0], low, high, *words, columns[1], silent, 0.0, False, True)


def resting(rows, **more):
    """A situation of one cell that does nothing."""
    t_s, ones = np.arange(1.0, rows + 1), np.ones(rows)
    loaded = more.pop("loaded", np.zeros(rows, dtype=bool))
    return Situation(
        "", "", "", t_s, 0 * ones, 3.7 * ones[:, None], 25 * ones, 0.5 * ones[:, None], loaded, 25.0, **more
    )


def judged(answer, **more):
    return figures.judge("rests", 0, resting(len(answer.t_s), **more), answer)


@pytest.mark.parametrize("name", classes.CLASSES)
def test_a_class_and_a_seed_give_the_same_situation_again(name):
    first, second = classes.situation(name, 3), classes.situation(name, 3)
    assert first.words == second.words
    for array in ("t_s", "current_A", "voltage_V", "temperature_degC", "soc"):
        assert np.array_equal(getattr(first, array), getattr(second, array), equal_nan=True), array


@pytest.mark.parametrize("name", classes.CLASSES)
def test_another_seed_gives_another_situation(name):
    assert classes.situation(name, 0).words != classes.situation(name, 1).words


@pytest.mark.parametrize("name", classes.CLASSES)
def test_a_dozen_seeds_see_every_variant_and_plant(name):
    kind = classes.CLASSES[name]
    for what, values in (("variant", kind.variants), ("plant", traces.plants())):
        assert {classes.in_turn(name, what, seed, values) for seed in range(12)} == set(values)


@pytest.mark.parametrize("name", ["start_in_drive", "gaps", "packs"])
def test_a_run_gives_the_same_sets_again(name):
    first, second = (run.run(classes.situation(name, 0)) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one, other, equal_nan=True)


def test_a_silent_bus_is_answered_by_predictions_that_are_not_ok():
    situation = classes.situation("gaps", 0)
    answer = run.run(situation)
    assert situation.silent.sum() >= 10
    assert answer.silent.any()
    assert not (answer.status[answer.silent] == Status.OK)[3:].any()


def test_a_long_silence_counts_as_some_300_rows():
    t_s = np.arange(2.0, 40_000.0, 2.0)
    silent = published(t_s, 0.5, 0.1, 0.5)._replace(silent=np.ones(t_s.size, dtype=bool))
    assert run.judged(silent).size == pytest.approx(300, abs=3)


def test_sets_of_100_hz_count_once_a_second():
    assert run.judged(published(np.arange(1, 1001) / 100, 0.5, 0.1, 0.5)).size == 10


def test_figures_count_rows_inside_beyond_and_ok():
    answer = published(np.arange(1.0, 11), 0.5, 0.1, [0.5] * 6 + [0.61] * 2 + [0.7] * 2, status=[1] * 9 + [2])
    found = judged(answer)
    assert (found.rows, found.known, found.inside, found.ok, found.beyond) == (10, 10, 6, 9, 1)
    assert found.rmse == pytest.approx(np.sqrt((2 * 0.11**2 + 2 * 0.2**2) / 10))
    together = figures.of_class([found])
    assert together["inside_pct"] == pytest.approx(60)
    assert together["beyond_pct"] == pytest.approx(100 / 9)
    assert together["ok_pct"] == pytest.approx(90)
    assert together["half_width_pct"] == pytest.approx(10)


def test_rows_without_a_soc_are_neither_inside_nor_wrong():
    found = judged(published(np.arange(1.0, 5), [0.5, 0.5, np.nan, np.nan], 0.1, 0.5, status=[1, 1, 3, 3]))
    assert (found.rows, found.known, found.inside, found.ok) == (4, 2, 2, 2)


def test_sharpness_is_not_asked_of_lfp_or_beyond_the_tables():
    answer = published(np.arange(1.0, 5), 0.5, 0.3, 0.5, status=Status.DEGRADED)
    for easier in (answer._replace(flat=True), answer._replace(covered=False)):
        together = figures.of_class([judged(easier)])
        assert together["ok_pct"] is None
        assert together["half_width_pct"] is None
        assert together["inside_pct"] == 100


def test_a_failed_sensor_is_named_after_the_time_under_load():
    faults = [0] * 20 + [int(Fault.CURRENT_SIGN)] * 10
    loaded = np.arange(1, 31) % 2 == 0
    answer = published(np.arange(1.0, 31), 0.5, 0.1, 0.5, faults=faults)
    found = judged(answer, loaded=loaded, failure=Failure("current", 10.0, within_s=5.0))
    assert found.named_s == 5.0  # of the 11 s until the set at 21 s a load flows in 5
    assert found.in_time
    assert not judged(answer, loaded=loaded, failure=Failure("current", 10.0, within_s=4.0)).in_time
    assert judged(answer, loaded=loaded, failure=Failure("voltage", 10.0)).named_s is None


def test_a_fault_bit_from_before_the_failure_names_nothing_else():
    answer = published(np.arange(1.0, 31), 0.5, 0.1, 0.5, faults=int(Fault.INNOVATION_REJECTED))
    assert judged(answer, failure=Failure("current", 10.0)).named_s is None


def test_a_resampled_course_keeps_its_charge():
    whole = course.cut(traces.load("lgm50_spme/drive_25degC"), 9000, 1000)
    charge_As = whole.current_A.sum()
    slow = course.resample(whole, 10.0)
    assert slow.rows == 100
    assert 10.0 * slow.current_A.sum() == pytest.approx(charge_As, rel=1e-9)
    fast = course.resample(whole, 0.01)
    ends_As = 0.5 * abs(whole.current_A[-1]) + abs(whole.current_A[0])
    assert 0.01 * fast.current_A.sum() == pytest.approx(charge_As, abs=ends_As + 0.1)
    assert np.interp(500.0, fast.t_s, fast.voltage_V[:, 0]) == pytest.approx(
        np.interp(500.0, whole.t_s - 1.0, whole.voltage_V[:, 0]), abs=0.01
    )


def test_a_skew_moves_charge_between_rows_and_loses_none():
    whole = course.cut(traces.load("lgm50_spme/drive_25degC"), 9000, 1000)
    exact = {"current_noise_C": 0.0, "current_bit_C": 0.0}
    errors = sensing.Errors(skew_s=0.25, **exact)
    shown = sensing.current(errors, np.random.default_rng(0), whole.t_s, whole.current_A, 5.0)
    expected = 0.75 * whole.current_A[1:] + 0.25 * whole.current_A[:-1]
    assert shown[1:] == pytest.approx(expected)


def test_errors_are_drawn_so_that_95_percent_lie_within_the_specification():
    rng = np.random.default_rng(0)
    drawn = [sensing.draw(rng) for _ in range(2000)]
    bounds = {"voltage_offset_V": 0.005, "voltage_gain": 0.001, "current_offset_C": 0.02, "current_gain": 0.005}
    for name, bound in (bounds | {"temperature_offset_K": 2.0, "skew_s": 0.2}).items():
        share = np.mean([abs(getattr(errors, name)) <= bound for errors in drawn])
        assert share == pytest.approx(0.95, abs=0.02), name


@pytest.mark.parametrize(("trials", "success"), [(12, 0.93), (12, 0.02), (60, 0.5), (216, 0.005)])
def test_the_allowance_is_the_binomial_quantile(trials, success):
    from scipy.stats import binom

    for probability in (0.05, 0.95):
        assert goals.quantile(probability, trials, success) == binom.ppf(probability, trials, success)


def test_a_full_campaign_gets_no_allowance_and_a_quick_one_does():
    inside = goals.Goal("inside_pct", 93.0, at_least=True)
    assert not inside.met(90.0, 60, quick=False)
    assert inside.met(90.0, 12, quick=True)
    assert not inside.met(75.0, 12, quick=True)
    assert inside.met(93.0, 60, quick=False)


def test_every_class_has_goals_and_every_goal_a_figure():
    assert set(goals.SHARPNESS) == set(classes.CLASSES)
    known = figures.of_class([judged(published(np.arange(1.0, 5), 0.5, 0.1, 0.5))])
    assert {goal.figure for name in classes.CLASSES for goal in goals.of(name)} <= set(known)


def test_the_command_writes_the_figures_of_a_run_and_its_exit_code_is_the_verdict(bms_ukf, tmp_path):
    ended = bms_ukf("campaign", "--class", "rests", "--seed", 0, "--jobs", 1, "--json", tmp_path / "c.json")
    summary = json.loads((tmp_path / "c.json").read_text())
    assert ended.code == (0 if summary["passed"] else 1)
    assert list(summary["classes"]) == ["rests"]
    (only,) = summary["classes"]["rests"]["each"]
    assert only["seed"] == 0
    assert only["draw"] == classes.situation("rests", 0).words
    assert only["draw"] in ended.out
    assert "rests" in ended.out


def test_a_missed_goal_is_exit_code_1_and_a_line(bms_ukf, monkeypatch):
    nobody = goals.Sharpness(100.0, 0.0001)
    monkeypatch.setattr(goals, "SHARPNESS", dict(goals.SHARPNESS, rests=nobody))
    ended = bms_ukf("campaign", "--class", "rests", "--seed", 1, "--plant", "lgm50_spme", "--jobs", 1)
    assert ended.code == 1
    assert "rests: median half-width, % SoC" in ended.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--class", "holidays"), "start_after_hours"),
        (("--seed", "-1"), "a seed from 0 to 9999"),
        (("--seed", "10000"), "a seed from 0 to 9999"),
        (("--quick", "--first-seed", "9995"), "a seed from 0 to 9999"),
        (("--seed", "one"), "one"),
        (("--plant", "windmill"), "lgm50_spme"),
    ],
)
def test_a_class_or_seed_that_does_not_exist_is_one_line(bms_ukf, arguments, words):
    assert words in bms_ukf("campaign", *arguments).line


def test_a_family_names_its_classes():
    assert classes.named("sensors") == ["sensor_error_alone", "sensor_errors_together"]
    assert classes.named(None) == list(classes.CLASSES)


def test_the_page_shows_the_worst_run_its_goals_and_how_to_repeat_it(bms_ukf, tmp_path):
    page = tmp_path / "campaign.html"
    bms_ukf("campaign", "--class", "gaps", "--runs", 2, "--jobs", 1, "--report", page, "--json", tmp_path / "c.json")
    worst = json.loads((tmp_path / "c.json").read_text())["classes"]["gaps"]["worst_seed"]
    text = page.read_text("utf-8")
    assert text.count("data:image/png;base64,") == 1
    assert f"bms-ukf campaign --class gaps --seed {worst}" in text
    assert "≥ 93" in text
    assert classes.situation("gaps", worst).words.partition(";")[0] in text


def test_a_limit_that_the_run_cannot_reach_asks_for_nothing():
    answer = published(np.arange(1.0, 31), 0.5, 0.1, 0.5)
    loaded = np.ones(30, dtype=bool)
    assert judged(answer, loaded=loaded, failure=Failure("current", 10.0, within_s=19.0)).within_s == 19.0
    assert judged(answer, loaded=loaded, failure=Failure("current", 10.0, within_s=21.0)).within_s is None


def test_the_doubt_of_a_recording_s_reference_counts():
    answer = published(np.arange(1.0, 5), 0.5, 0.1, 0.615)
    assert judged(answer).inside == 0
    assert judged(answer._replace(ref_sigma=0.01)).inside == 4


@pytest.mark.parametrize("seed", range(8))
def test_a_rest_is_a_rest_and_lasts(seed):
    situation = classes.situation("rests", seed)
    assert not situation.loaded.any()
    assert situation.t_s[-1] >= 1200.0


@pytest.mark.parametrize("seed", range(6))
def test_a_silence_is_one_gap_with_samples_on_both_sides(seed):
    silent = classes.situation("gaps", seed).silent
    assert not silent[0]
    assert not silent[-1]
    assert np.count_nonzero(np.diff(silent.astype(int))) == 2


def test_without_recordings_the_plants_are_those_with_committed_traces(monkeypatch):
    monkeypatch.delenv(DATA_FOLDER, raising=False)
    assert library.plants() == traces.plants()
    assert library.names("lgm50_spme") == traces.names("lgm50_spme")


def test_every_goal_has_words():
    assert {goal.figure for name in classes.CLASSES for goal in goals.of(name)} <= set(view.WORDS)


def test_an_error_in_a_process_of_its_own_comes_back_as_it_was():
    for error in (ConfigError("a.toml", key="b", value=3, expected="less"), PlantError("it hangs", "hang")):
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


def test_classes_that_the_plants_asked_for_cannot_serve_are_left_out(monkeypatch):
    drives_only = [name for name in library.names("mohtat2020") if "/drive_" in name]
    monkeypatch.setattr(library, "names", lambda plant: drives_only)
    found = command.campaign(command.plan("starts", seed=0, plants=("mohtat2020",)), jobs=1)
    assert {run.name for run in found} >= {"start_after_hours", "start_in_drive"}
    with pytest.raises(classes.NoTraceError, match="of mohtat2020"):
        command.campaign(command.plan("charges", seed=0, plants=("mohtat2020",)), jobs=1)
