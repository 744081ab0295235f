from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf import honesty, metrics
from bms_ukf.metrics import judge

NAN = math.nan
FIGURES = ["rmse_pct", "mae_pct", "max_pct", "bias_pct", "coverage95", "settled_s"]


def score(t_s: object, soc: object, sigma: object, soc_ref: object, soc_ref_sigma: float = 0.0) -> dict:
    """Figures of an estimate whose interval is that of a Gaussian."""
    interval = honesty.bounds(np.asarray(soc, float), np.asarray(sigma, float))
    return metrics.score(t_s, soc, interval, soc_ref, soc_ref_sigma)


def constant_error(error: float, *, n: int = 1201, sigma: float = 0.01) -> dict:
    reference = np.linspace(0.9, 0.2, n)
    return score(np.arange(n), reference + error, np.full(n, sigma), reference)


def test_a_constant_error_is_all_four_errors_with_its_sign_as_bias() -> None:
    result = constant_error(-0.015)
    assert [result[key] for key in ("rmse_pct", "mae_pct", "max_pct")] == pytest.approx([1.5] * 3)
    assert result["bias_pct"] == pytest.approx(-1.5)
    assert result["settled_s"] == 0


def test_known_answer_of_two_rows() -> None:
    result = score([0, 1], [0.53, 0.46], [0.02, 0.02], [0.5, 0.5])
    assert result["rmse_pct"] == pytest.approx(math.sqrt((9 + 16) / 2))
    assert result["mae_pct"] == pytest.approx(3.5)
    assert result["max_pct"] == pytest.approx(4.0)
    assert result["bias_pct"] == pytest.approx(-0.5)
    assert result["coverage95"] == 0.5  # 1.96 * 2 % = 3.92 % holds the first only
    assert result["settled_s"] is None


def test_the_references_own_sigma_widens_the_band() -> None:
    rows = ([0.0], [0.55], [0.02], [0.5])
    assert score(*rows)["coverage95"] == 0
    assert score(*rows, soc_ref_sigma=0.02)["coverage95"] == 1  # 1.96 * (2 % + 2 %) = 7.84 %


def test_the_window_starts_at_600_s_and_not_at_row_600() -> None:
    t_s = np.arange(0, 1200, 10.0) + 50  # the clock does not start at zero
    error = np.where(t_s - 50 < 600, 0.2, 0.001)
    result = score(t_s, 0.5 + error, np.full(t_s.size, 0.01), np.full(t_s.size, 0.5))
    assert result["n_scored"] == 120
    assert result["after_600s"]["n_scored"] == 60
    assert result["max_pct"] == pytest.approx(20)
    assert result["after_600s"]["max_pct"] == pytest.approx(0.1)
    assert result["settled_s"] == result["after_600s"]["settled_s"] == 600


def test_settled_counts_the_last_excursion_only() -> None:
    error = np.array([0.1, 0.0, 0.0, 0.03, 0.01, 0.01])
    assert score(np.arange(6) * 2.0, 0.5 + error, np.full(6, 0.01), np.full(6, 0.5))["settled_s"] == 8


@pytest.mark.parametrize(("last", "settled_s"), [(0.021, None), (0.019, 0.0), (NAN, None)])
def test_settled_is_none_when_the_last_row_is_outside_or_unavailable(last: float, settled_s: float | None) -> None:
    result = score([0, 1, 2], [0.5, 0.5, 0.5 + last], [0.01] * 3, [0.5] * 3)
    assert result["settled_s"] == settled_s


@pytest.mark.parametrize(("soc", "sigma"), [(NAN, 0.01), (0.5, NAN)])
def test_rows_that_are_not_available_are_counted_and_not_scored(soc: float, sigma: float) -> None:
    result = score([0, 1, 2], [soc, 0.51, 0.51], [sigma, 0.01, 0.01], [0.5] * 3)
    assert (result["n_scored"], result["n_unavailable"]) == (2, 1)
    assert result["rmse_pct"] == pytest.approx(1.0)
    assert result["settled_s"] == 1  # it cannot have settled while it said nothing


def test_rows_without_a_reference_are_left_out() -> None:
    result = score([0, 1, 2], [0.9, 0.5, NAN], [0.01] * 3, [NAN, 0.5, NAN])
    assert (result["n_scored"], result["n_unavailable"]) == (1, 0)
    assert result["max_pct"] == 0


@pytest.mark.parametrize("rows", [([], [], [], []), ([0.0], [NAN], [NAN], [0.5]), ([0.0], [0.5], [0.1], [NAN])])
def test_nothing_to_score_gives_none_and_fails_every_goal(rows: tuple[list[float], ...]) -> None:
    result = score(*rows)
    assert all(result[key] is None and result["after_600s"][key] is None for key in FIGURES)
    assert [check.passed for check in judge(result)] == [False]


@pytest.mark.parametrize(("end_s", "goals"), [(599.0, 1), (600.0, 2)])
def test_a_run_that_ends_before_600_s_is_not_judged_by_what_comes_after(end_s: float, goals: int) -> None:
    checks = judge(score([0.0, end_s], [0.5, 0.5], [0.01, 0.01], [0.5, 0.5]))
    assert [check.passed for check in checks] == [True] * goals


def test_an_estimate_lost_before_600_s_fails_both_goals() -> None:
    checks = judge(score([0.0, 600.0], [NAN, NAN], [NAN, NAN], [0.5, 0.5]))
    assert [check.passed for check in checks] == [False, False]


@pytest.mark.parametrize(
    ("error", "sigma", "passed"),
    [
        (0.009, 0.01, [True, True]),
        (0.011, 0.01, [False, True]),
        (0.009, 0.001, [True, False]),
        (0.0, 0.0, [True, True]),
    ],
)
def test_goals_are_rmse_within_1_pct_and_an_honest_band(error: float, sigma: float, passed: list[bool]) -> None:
    assert [check.passed for check in judge(constant_error(error, sigma=sigma))] == passed


ERRORS = st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=200)


@given(ERRORS)
def test_errors_are_ordered_and_bounded(errors: list[float]) -> None:
    n = len(errors)
    result = score(np.arange(n) * 10.0, 0.5 + np.array(errors), np.full(n, 0.05), np.full(n, 0.5))
    tolerance = 1e-9
    assert abs(result["bias_pct"]) <= result["mae_pct"] + tolerance
    assert result["mae_pct"] <= result["rmse_pct"] + tolerance
    assert result["rmse_pct"] <= result["max_pct"] + tolerance
    assert 0 <= result["coverage95"] <= 1
    assert result["n_scored"] == n


@given(ERRORS)
def test_from_settled_on_every_error_is_within_2_pct(errors: list[float]) -> None:
    n = len(errors)
    soc = 0.5 + np.array(errors)
    t_s = np.arange(n) * 10.0
    settled_s = score(t_s, soc, np.full(n, 0.05), np.full(n, 0.5))["settled_s"]
    within = np.abs(100 * (soc - 0.5)) <= 2
    if settled_s is None:
        assert not within[-1]
    else:
        assert within[t_s >= settled_s].all()
        assert settled_s == 0 or not within[t_s < settled_s][-1]


@given(ERRORS)
def test_mirrored_errors_change_only_the_sign_of_the_bias(errors: list[float]) -> None:
    n = len(errors)
    up, down = (
        score(np.arange(n), 0.5 + sign * np.array(errors), np.full(n, 0.05), np.full(n, 0.5)) for sign in (1, -1)
    )
    assert down["bias_pct"] == pytest.approx(-up["bias_pct"], abs=1e-9)
    assert down["rmse_pct"] == pytest.approx(up["rmse_pct"], abs=1e-9)


@given(st.integers(0, 2**31))
def test_a_matched_sigma_covers_95_pct(seed: int) -> None:
    n = 2000
    error = np.random.default_rng(seed).normal(0, 0.01, n)
    coverage = score(np.arange(n), 0.5 + error, np.full(n, 0.01), np.full(n, 0.5))["coverage95"]
    assert coverage == pytest.approx(0.95, abs=0.03)  # six standard errors
