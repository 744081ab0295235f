"""Rows beyond the tested temperatures: Arrhenius from what the tests know, and less sure the farther."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bms_ukf.identify import beyond, ocv
from bms_ukf.identify.dynamics import Model
from bms_ukf.identify.ocv_rows import OcvRows
from bms_ukf.identify.simulate import KNEE, R0, R0_CHARGE, R1
from bms_ukf.identify.tables import SOC, Structure, Unknowns

Array = NDArray[np.float64]


def model_of(temperature_degC: list[float], activation_K: float, rel_sigma: float = 0.01) -> Model:
    """A model whose resistances follow one activation, known to `rel_sigma`."""
    tested = np.array(temperature_degC)
    unknowns = Unknowns(Structure(2), tested, 3.0, np.full(SOC.size, 0.7), None, both_branches=False)
    wanted = np.repeat((activation_K * (1 / (tested + 273.15) - 1 / 298.15))[:, None], SOC.size, axis=1)
    tables = unknowns.tables(unknowns.start)
    for channel in (R0, R0_CHARGE, R1, R1 + 2):
        tables[channel] = np.log(0.02) + wanted
    tables[KNEE] = np.log(4.0) - wanted
    tables[[R1 + 1, R1 + 3]] = np.log([[[10.0]], [[300.0]]])
    x = unknowns.start.copy()
    x[: unknowns.n_tables] = np.linalg.lstsq(unknowns.to_tables, (tables - unknowns.offset).ravel(), rcond=None)[0]
    rows = OcvRows([3.0 + ocv.SOC for _ in tested])
    return Model(unknowns, rows, 3.0, x, np.full(x.size, rel_sigma))


def slow(temperature_degC: list[float]) -> ocv.Slow:
    curve_V, sigma_V = 3.0 + ocv.SOC, np.full(ocv.SOC.size, 1e-3)
    return ocv.Slow(3.0, [ocv.Curve(T, curve_V, sigma_V, None, 0.1, ("discharge",)) for T in temperature_degC])


@settings(max_examples=12, deadline=None)
@given(
    coldest=st.integers(-35, 20),
    steps=st.lists(st.integers(10, 30), min_size=1, max_size=4),
    activation_K=st.floats(500.0, 7000.0),
)
def test_known_tables_go_on_by_their_own_activation_to_where_cells_are_used(
    coldest: int, steps: list[int], activation_K: float
) -> None:
    tested = [float(coldest)]
    for step in steps:
        tested.append(tested[-1] + step)
    model = model_of(tested, activation_K, rel_sigma=1e-4)
    rows = beyond.Extended(model)
    assert set(tested) <= set(rows.temperature_degC)
    assert rows.temperature_degC[0] < beyond.COLD_DEGC + beyond.LEAST_K + 1
    assert rows.temperature_degC[-1] > beyond.HOT_DEGC - beyond.LEAST_K - 1
    expected = np.log(0.02) + activation_K * (1 / (rows.temperature_degC + 273.15) - 1 / 298.15)
    for channel in (R0, R0_CHARGE, R1, R1 + 2):
        np.testing.assert_allclose(
            rows.tables[channel], np.minimum(expected, np.log(9.0))[:, None] + 0 * SOC, atol=0.02
        )
    product = rows.tables[R0] + rows.tables[KNEE]
    np.testing.assert_allclose(product[rows.tables[R0] < 2.1], np.log(0.08), atol=0.02)
    tau = rows.tables[[R1 + 1, R1 + 3]]
    np.testing.assert_allclose(tau, np.log([[[10.0]], [[300.0]]]) + 0 * tau, atol=1e-9)
    kept = ~rows.added
    np.testing.assert_allclose(rows.tables[:, kept], model.unknowns.tables(model.x), atol=1e-12)


def test_what_the_tests_hardly_saw_is_carried_on_by_what_cells_have_in_common() -> None:
    doubtful = beyond.Extended(model_of([0.0, 25.0], 6500.0, rel_sigma=2.0))
    assert doubtful.activation_K[0] == pytest.approx(3000.0, abs=300)


@pytest.mark.parametrize("relative", [0.0, 0.2])
def test_the_interval_grows_with_the_distance_from_the_tests(relative: float) -> None:
    noise = {"voltage_sigma_V": 0.2, "r0_rel_sigma": relative, "rc_rel_sigma": 0.0, "soc": [0.0, 1.0]}
    scales = []
    for coldest in (-20.0, -10.0, 0.0, 10.0):
        tested = [coldest, 25.0]
        rows = beyond.Extended(model_of(tested, 3000.0))
        given = noise | {"temperature_degC": tested, "error_scale": np.array([[1.0, 1.2], [1.0, 1.0]])}
        found = rows.noise(given)
        assert found["temperature_degC"] == [-30.0, coldest, 25.0, 60.0]
        np.testing.assert_array_equal(found["error_scale"][1:3], given["error_scale"])
        assert found["error_scale"][0][1] > 1.2
        assert found["error_scale"][0][0] <= beyond.MOST_GROWTH
        stated = rows.provenance(slow(tested))["provenance.rel_sigma"]["r0_ohm"]
        assert stated[0] > 2 * stated[1]
        scales.append(found["error_scale"][0][0])
        assert rows.provenance(slow(tested))["provenance.arrhenius"]["temperature_degC"].tolist() == [-30.0, 60.0]
    assert np.all(np.diff(scales) > 0)


def test_tests_that_reach_far_enough_are_left_alone() -> None:
    rows = beyond.Extended(model_of([-30.0, 25.0, 60.0], 3000.0))
    assert not rows.added.any()
    assert "provenance.arrhenius" not in rows.provenance(slow([25.0]))
    noise = {"r0_rel_sigma": 0.1, "rc_rel_sigma": 0.1, "temperature_degC": [25.0], "error_scale": np.ones((1, 2))}
    assert rows.noise(noise) is noise
