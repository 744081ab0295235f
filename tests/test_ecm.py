"""The cell model in the kernel: its tables against the cell file, its step against the closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
import synthetic_cell
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_record import Record

from bms_ukf import CellParams, Status, Tuning
from bms_ukf.kernel import layout

NONLINEAR = synthetic_cell.cell_of(synthetic_cell.nonlinear())
WITH_COEFFICIENT = synthetic_cell.cell_of(synthetic_cell.with_coefficient())
LINEAR = synthetic_cell.cell_of(synthetic_cell.linear())
EDGES_DEGC = (-10.0, 45.0)
R1, TAU1, R2, TAU2 = 0.012, 15.0, 0.015, 400.0  # of LINEAR

finely = np.linspace(0, 1, 1501)
currents = st.floats(-50, 100)
steps = st.floats(1e-4, 4.9)  # below the current's timeout: all of it is counted


def started(cell: CellParams, soc: float = 0.5, temperature: float = 25.0) -> Record:
    """A record that has begun at `soc` with relaxed RC voltages, and has no voltage to correct it from here on."""
    record = Record(cell, Tuning(initial_soc=soc, current_bias=False))
    ocv = float(cell.ocv_V(soc, temperature))
    record.tick(0.0, 0.0, ocv, temperature)
    record.x, record["parts"] = [soc, 0.0, 0.0, 0.0, 0.0], 0.0  # one Gaussian, no error of voltage and r0
    return record


@pytest.mark.parametrize("cell", [NONLINEAR, WITH_COEFFICIENT], ids=["rows", "coefficient"])
@pytest.mark.parametrize("temperature", [-10.0, -3.7, 7.0, 25.0, 31.0, 45.0])
def test_the_ocv_table_is_the_cell_files_curve_within_a_tenth_of_a_millivolt(cell, temperature):
    record = Record(cell)
    table = [record.ocv(soc, temperature) for soc in finely]
    assert np.abs(table - cell.ocv_V(finely, temperature)).max() < 1e-4


@pytest.mark.parametrize("soc", [0.0, 0.123, 0.5, 1.0])
def test_ocv_is_held_beyond_the_temperatures_of_the_file_and_linear_between(soc):
    record = Record(NONLINEAR)
    for edge, beyond in zip(EDGES_DEGC, (-40.0, 80.0), strict=True):
        assert record.ocv(soc, beyond) == record.ocv(soc, edge)
    middle = 0.5 * (record.ocv(soc, 25.0) + record.ocv(soc, 45.0))
    assert record.ocv(soc, 35.0) == pytest.approx(middle, abs=1e-6)


@pytest.mark.parametrize("cell", [NONLINEAR, WITH_COEFFICIENT], ids=["rows", "coefficient"])
@pytest.mark.parametrize("temperature", [-40.0, 12.3, 45.0])
def test_ocv_increases_with_soc_everywhere_also_beyond_the_table(cell, temperature):
    record = Record(cell)
    curve = [record.ocv(soc, temperature) for soc in np.linspace(-0.5, 1.5, 4001)]
    assert np.diff(curve).min() > 0


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(1e-5, 0.3), min_size=5, max_size=40))
def test_no_shape_of_an_increasing_ocv_gives_a_table_that_decreases(rises):
    data = synthetic_cell.nonlinear()
    voltages = 3.0 + np.cumsum(rises) / sum(rises)
    data["ocv"] = {
        "temperature_degC": [25.0],
        "soc": np.linspace(0, 1, len(rises)).tolist(),
        "voltage_V": [voltages.tolist()],
    }
    record = Record(synthetic_cell.cell_of(data))
    curve = np.array([record.ocv(soc, 25.0) for soc in np.linspace(-0.1, 1.1, 1201)])
    assert np.diff(curve).min() >= -1e-15  # rounding


def test_ocv_goes_on_straight_with_its_edge_slope():
    record = Record(NONLINEAR)
    for edge, outwards in ((0.0, -1), (1.0, 1)):
        at_edge = record.ocv(edge, 25.0)
        slope = (record.ocv(edge + outwards * 0.1, 25.0) - at_edge) / 0.1
        inside = (at_edge - record.ocv(edge - outwards * 1e-6, 25.0)) / 1e-6
        assert slope == pytest.approx(inside, rel=1e-4)
        assert record.ocv(edge + outwards * 0.4, 25.0) == pytest.approx(at_edge + 0.4 * slope, rel=1e-12)


def test_every_dynamics_channel_is_its_own_table_of_the_cell_file():
    record = Record(NONLINEAR)
    for temperature in (-10.0, 10.0, 25.0, 45.0):
        for soc in NONLINEAR.dynamics.soc:
            expected = {key: float(v) for key, v in NONLINEAR.dynamics_at(soc, temperature).items()}
            # 10 and 25 degC fall between the kernel's rows, which are 5 K apart or less.
            assert record.dynamics(soc, temperature) == pytest.approx(expected, rel=2e-3)


def test_dynamics_are_held_beyond_soc_and_temperature_of_the_tables():
    record = Record(NONLINEAR)
    assert record.dynamics(-0.3, 25.0) == record.dynamics(0.0, 25.0)
    assert record.dynamics(1.3, 25.0) == record.dynamics(1.0, 25.0)
    assert record.dynamics(0.5, -40.0) == record.dynamics(0.5, -10.0)
    assert record.dynamics(0.5, 90.0) == record.dynamics(0.5, 45.0)


def test_resistance_between_temperatures_follows_arrhenius():
    """The synthetic r0 is exactly exp(2500 K / T): log over 1/T loses nothing, linear in T would be off by 5 %."""
    factor = math.exp(2500 * (1 / 273.15 - 1 / 298.15))
    at_0, at_25 = (float(NONLINEAR.dynamics_at(0.3, T)["r0_ohm"]) for T in (0.0, 25.0))
    assert at_0 / at_25 == pytest.approx(factor, rel=1e-12)
    record = Record(NONLINEAR)
    assert record.dynamics(0.3, 0.0)["r0_ohm"] / record.dynamics(0.3, 25.0)["r0_ohm"] == pytest.approx(factor, rel=2e-3)


@settings(deadline=None, max_examples=60)
@given(currents, steps)
def test_a_current_step_charges_the_rc_pairs_as_the_closed_form_says(current, dt):
    record = started(LINEAR)
    record.tick(dt, current)
    expected = [R1 * current * -math.expm1(-dt / TAU1), R2 * current * -math.expm1(-dt / TAU2)]
    assert record.x[1:3] == pytest.approx(expected, rel=1e-9, abs=1e-15)


@settings(deadline=None, max_examples=40)
@given(currents, steps, st.integers(2, 30))
def test_many_short_steps_are_one_long_step(current, dt, n):
    once, often = started(LINEAR), started(LINEAR)
    for record, count in ((once, 1), (often, n)):
        for _ in range(count):
            record.tick(dt / count, current)
    assert often.x == pytest.approx(once.x, rel=1e-11, abs=1e-14)
    once_P, often_P, slow = once.P, often.P, (3, 3)
    # A step takes the part of the slow error that follows the polarisation by that at its end: the largest of a pulse.
    taus = dt / once.params[layout.P_SLOW_TAU] + once.params[layout.P_SLOW_RATE] * abs(current) * dt
    polarised = once.state[layout.H_POLARISED : layout.H_POLARISED + 2].sum()
    follows = -math.expm1(-2 * taus) * (once.params[layout.P_SLOW_REL] * polarised) ** 2
    rounding = 1e-11 * once_P[slow] + 1e-14
    assert -rounding <= once_P[slow] - often_P[slow] <= follows + rounding
    often_P[slow] = once_P[slow]
    np.testing.assert_allclose(often_P, once_P, rtol=1e-6, atol=1e-14)


@settings(deadline=None, max_examples=40)
@given(steps, st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_no_current_keeps_soc_and_lets_the_rc_voltages_decay(dt, v1, v2):
    record = started(NONLINEAR)
    record.x = [record.x[0], v1, v2, 0.0, 0.0]
    tau1, tau2 = (record.dynamics(0.5, 25.0)[key] for key in ("tau1_s", "tau2_s"))
    record.tick(dt, 0.0)
    expected = [0.5, v1 * math.exp(-dt / tau1), v2 * math.exp(-dt / tau2), 0.0, 0.0]
    assert record.x == pytest.approx(expected, rel=1e-12, abs=1e-17)


@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(currents, steps), min_size=1, max_size=60))
def test_soc_falls_by_the_charge_drawn_and_rises_by_what_charging_leaves(drive):
    record = started(NONLINEAR)
    for current, dt in drive:
        record.tick(dt, current)
    charge = math.fsum((0.99 if current < 0 else 1.0) * current * dt for current, dt in drive)
    assert (0.5 - record.x[0]) * 5.0 * 3600 == pytest.approx(charge, rel=1e-11, abs=1e-9)


def test_a_resistance_drop_is_subtracted_on_discharge_and_added_on_charge():
    for current in (4.0, -4.0):
        record = started(NONLINEAR)
        status, _ = record.tick(1e-6, current, 3.6, 25.0)
        assert status is not Status.INITIALISING
        assert record["voltage_pred"] == pytest.approx(
            record.ocv(0.5, 25.0) - record.drop(0.5, 25.0, current), abs=0.02
        )
        assert (record["voltage_pred"] < record.ocv(0.5, 25.0)) == (current > 0)
