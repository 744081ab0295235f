"""OCV tables, starts from a rest, and how well a result is known: parts of the identification with known answers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bms_ukf import toml
from bms_ukf.errors import ConfigError
from bms_ukf.identify import effective, ocv, ocv_table, rests
from bms_ukf.manifest import MeasuredTest
from bms_ukf.recordings import Recording

Array = NDArray[np.float64]


def listed(**more: object) -> MeasuredTest:
    return toml.validate({"role": "ocv_table", "file": "ocv.csv", "temperature_degC": 25.0} | more, MeasuredTest, "m")


def curve_V(soc: Array) -> Array:
    return 3.4 + 0.7 * soc - 0.4 * np.exp(-25 * soc)


def save(folder: Path, header: str, rows: list[str]) -> Path:
    (folder / "ocv.csv").write_text("\n".join([header, *rows]))
    return folder / "m.toml"


def test_a_table_of_soc_and_voltage_is_an_ocv(tmp_path: Path) -> None:
    soc = np.linspace(0, 1, 101)
    rows = [f"{100 * s:.6f},{v:.6f},{0.02 * s:.6f}" for s, v in zip(soc, curve_V(soc), strict=True)]
    columns = {"voltage_V": "U_mean", "hysteresis_V": "half"}
    curve, warnings = ocv_table.load(save(tmp_path, "SoC [%],U_mean,half", rows), listed(columns=columns))
    np.testing.assert_allclose(curve.voltage_V, curve_V(ocv.SOC), atol=2e-3)
    assert curve.half_width_V is not None
    np.testing.assert_allclose(curve.half_width_V, 0.02 * ocv.SOC, atol=1e-4)
    assert not warnings


def test_holes_of_a_table_are_counted_and_named(tmp_path: Path) -> None:
    soc = np.linspace(0.1, 1, 91)
    rows = [f"{s:.3f},{'' if 0.4 < s < 0.6 else f'{curve_V(s):.5f}'}" for s in soc]
    curve, warnings = ocv_table.load(save(tmp_path, "soc,voltage_V", rows), listed())
    assert "19 of 91 rows without a number" in warnings[0]
    assert "covers SoC 0.10 to 1.00 only" in warnings[1]
    assert "nothing between SoC 0.40 and 0.60" in warnings[2]
    inside = ocv.SOC > 0.12
    np.testing.assert_allclose(curve.voltage_V[inside], curve_V(ocv.SOC)[inside], atol=5e-3)


@pytest.mark.parametrize(
    ("scale", "sign", "named"), [(100.0, 1.0, "percent, with % in the header"), (1.0, -1.0, "rises with SoC")]
)
def test_a_table_that_is_no_ocv_is_refused(tmp_path: Path, scale: float, sign: float, named: str) -> None:
    rows = [f"{scale * s},{3.7 + sign * 0.5 * (s - 0.5)}" for s in np.linspace(0, 1, 21)]
    with pytest.raises(ConfigError, match=named):
        ocv_table.load(save(tmp_path, "soc,voltage_V", rows), listed())


@pytest.mark.parametrize(("fall_mV", "refused"), [(1.0, False), (10.0, False), (120.0, True)])
def test_a_table_that_falls_somewhere_is_named_or_refused(tmp_path: Path, fall_mV: float, refused: bool) -> None:
    soc = np.linspace(0, 1, 51)
    voltage_V = 3.3 + 0.5 * np.maximum(soc - 0.5, 0.0)
    voltage_V[20] -= 1e-3 * fall_mV
    path = save(tmp_path, "soc,voltage_V", [f"{s},{v}" for s, v in zip(soc, voltage_V, strict=True)])
    if refused:
        with pytest.raises(ConfigError, match=r"120 mV lower at SoC 0\.4"):
            ocv_table.load(path, listed())
        return
    _, warnings = ocv_table.load(path, listed())
    assert any("10 mV lower at SoC 0.4" in warning for warning in warnings) == (fall_mV == 10.0)


@pytest.mark.parametrize(
    ("half_V", "named"), [((0.02, 0.02), None), ((-0.01, 0.03), "below 0 in 23"), ((-0.02, 0.01), "!")]
)
def test_a_negative_hysteresis_is_named_or_refused(
    tmp_path: Path, half_V: tuple[float, float], named: str | None
) -> None:
    soc = np.linspace(0, 1, 101)
    halves = half_V[0] + (half_V[1] - half_V[0]) * soc
    rows = [f"{s},{v},{h}" for s, v, h in zip(soc, curve_V(soc), halves, strict=True)]
    path = save(tmp_path, "soc,voltage_V,half", rows)
    test = listed(columns={"hysteresis_V": "half"})
    if named == "!":
        with pytest.raises(ConfigError, match="charge branch minus discharge branch"):
            ocv_table.load(path, test)
        return
    curve, warnings = ocv_table.load(path, test)
    assert curve.half_width_V is not None
    assert curve.half_width_V.min() >= 0
    assert [named in warning for warning in warnings] == [True] if named else not warnings


def test_a_bpx_file_gives_an_ocv(tmp_path: Path) -> None:
    limits = {"Minimum stoichiometry": 0.0, "Maximum stoichiometry": 1.0}
    electrodes = {
        "Negative electrode": {**limits, "OCP [V]": "0.2 - 0.1 * x"},
        "Positive electrode": {**limits, "OCP [V]": "4.2 - 0.6 * x"},
    }
    (tmp_path / "cell.json").write_text(json.dumps({"Parameterisation": electrodes}))
    curve, _ = ocv_table.load(tmp_path / "m.toml", listed(file="cell.json"))
    np.testing.assert_allclose(curve.voltage_V, 3.4 + 0.7 * ocv.SOC, atol=1e-6)


def slow(half_width_V: float | None = None, sigma_V: float = 1e-4) -> ocv.Slow:
    half = None if half_width_V is None else np.full(ocv.SOC.size, half_width_V)
    curve = ocv.Curve(25.0, curve_V(ocv.SOC), np.full(ocv.SOC.size, sigma_V), half, 0.0, ("table",))
    return ocv.Slow(4.0, [curve])


def stretches(*starts: float) -> Recording:
    """Two minutes of C/2 from each SoC, hours apart, and nothing that tells the SoC but the rest before."""
    parts = []
    for k, start in enumerate(starts):
        current_A = np.concatenate([[0.0], np.full(120, 2.0)])
        soc = start - np.cumsum(current_A) / 3600 / 4.0
        parts.append((9000.0 * k + np.arange(121.0), current_A, curve_V(soc) - 0.03 * current_A))
    time_s, current_A, voltage_V = (np.concatenate(column) for column in zip(*parts, strict=True))
    drawn_Ah = np.cumsum(current_A) / 3600
    return Recording("pulses", time_s, current_A, voltage_V, np.full(time_s.size, 25.0), drawn_Ah)


def test_every_stretch_counts_from_the_rest_it_starts_with() -> None:
    test = listed(role="pulse", initial_soc="rest")
    soc, warnings = rests.counted_soc(stretches(0.9, 0.6, 0.25), test, slow(), 1.0)
    np.testing.assert_allclose(soc[[0, 121, 242]], [0.9, 0.6, 0.25], atol=1e-3)
    np.testing.assert_allclose(soc[[120, 241, 362]], np.array([0.9, 0.6, 0.25]) - 240 / 3600 / 4, atol=1e-3)
    assert not warnings


def test_a_rest_on_a_plateau_says_how_little_it_tells() -> None:
    flat = slow()
    flat.curves[0].voltage_V = 3.3 + 0.05 * ocv.SOC
    soc, sigma = rests.at_rest(np.array([3.325]), flat)
    assert soc[0] == pytest.approx(0.5)
    assert sigma[0] == pytest.approx(ocv.REST_ERROR_V / 0.05, rel=0.01)
    _, warnings = rests.counted_soc(stretches(0.5), listed(role="pulse", initial_soc="rest"), slow(0.05), 1.0)
    assert "known to ±7 %" in warnings[0]


def test_a_start_under_load_is_no_rest() -> None:
    recording = stretches(0.9)
    recording.current_A[0] = 2.0
    with pytest.raises(ConfigError, match="a rest"):
        rests.counted_soc(recording, listed(role="pulse", initial_soc="rest"), slow(), 1.0)


def test_an_ocv_test_cannot_start_from_the_ocv_it_gives() -> None:
    with pytest.raises(ConfigError, match="as a number"):
        listed(role="ocv", initial_soc="rest")


def test_correlated_residuals_are_worth_what_a_mean_of_them_is() -> None:
    """An AR(1) process of coefficient a is worth n (1 - a) / (1 + a) independent rows; a bias, one."""
    rng = np.random.default_rng(11)
    n, a = 40_000, 0.9
    white = rng.normal(size=n)
    correlated = np.zeros(n)
    for k in range(1, n):
        correlated[k] = a * correlated[k - 1] + white[k]
    assert effective.rows(white) == pytest.approx(n, rel=0.15)
    assert effective.rows(correlated) == pytest.approx(n * (1 - a) / (1 + a), rel=0.3)
    assert effective.rows(np.ones(1000)) < 5


def test_the_error_of_an_ocv_is_within_a_factor_of_three_that_of_repeated_measurements() -> None:
    """Of errors that neighbouring rows share: what is as wide as the curve's knots, no fit can tell from the curve."""
    rng = np.random.default_rng(12)
    soc = np.linspace(0, 1, 1500)
    found, sigmas = [], []
    for _ in range(30):
        shared = np.interp(soc, np.linspace(0, 1, 301), rng.normal(0, 2e-3, 301))
        curve, sigma_V = ocv.rising(soc, curve_V(soc) + shared + rng.normal(0, 2e-4, soc.size))
        found.append(curve)
        sigmas.append(sigma_V)
    inside = (ocv.SOC > 0.1) & (ocv.SOC < 0.9)
    spread = np.median(np.std(found, axis=0)[inside])
    assert spread / 3 < np.median(np.mean(sigmas, axis=0)[inside]) < 3 * spread


def test_stated_errors_are_those_of_repeated_fits_when_one_test_has_a_larger_correlated_misfit() -> None:
    """Two unknowns: one seen by both tests, one by the second alone, whose errors last twenty rows."""
    rng = np.random.default_rng(13)
    n, prior = 400, np.zeros((1, 2))
    jacobians = [np.column_stack([np.ones(n), np.zeros(n)]), np.column_stack([np.ones(n), np.linspace(-1, 1, n)])]
    found, stated = [], []
    for _ in range(200):
        data = [rng.normal(0, 1.5, n), np.repeat(rng.normal(0, 6.0, n // 20), 20)]
        x = np.linalg.lstsq(np.vstack(jacobians), np.concatenate(data), rcond=None)[0]
        residuals = [jacobian @ x - seen for jacobian, seen in zip(jacobians, data, strict=True)]
        found.append(x)
        stated.append(effective.standard_errors(jacobians, residuals, prior))
    np.testing.assert_allclose(np.median(stated, axis=0) / np.std(found, axis=0), 1.0, atol=0.35)
