"""Loads that depend on what the plant does: charging at a constant voltage, powers, limits and schedules of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from bms_ukf import ConfigError
from bms_ukf.loads import Load


class Cell:
    """Open-circuit voltage linear in SoC, a resistance and one RC pair; shape (cells,), all with the same current."""

    def __init__(self, soc=0.5, r0_ohm=0.03, r1_ohm=0.02, tau_s=30.0, capacity_Ah=5.0) -> None:
        self.soc = np.atleast_1d(np.asarray(soc, dtype=float)).copy()
        self.r0_ohm, self.r1_ohm, self.tau_s, self.capacity_Ah = r0_ohm, r1_ohm, tau_s, capacity_Ah
        self.v1 = np.zeros_like(self.soc)
        self.current_A = 0.0

    @property
    def emf(self) -> np.ndarray:
        return 3.0 + 1.2 * self.soc - self.v1

    @property
    def voltage_V(self) -> np.ndarray:
        return self.emf - self.r0_ohm * self.current_A

    def step(self, current_A: float, step_s: float) -> None:
        decay = math.exp(-step_s / self.tau_s)
        self.v1 = self.v1 * decay + self.r1_ohm * current_A * (1 - decay)
        self.soc = self.soc - current_A * step_s / 3600 / self.capacity_Ah
        self.current_A = current_A

    def step_power(self, power_W: float, step_s: float) -> None:
        e, r = self.emf.sum(), self.r0_ohm * self.soc.size
        self.step((e - math.sqrt(e**2 - 4 * r * power_W)) / (2 * r), step_s)

    def step_voltage(self, voltage_V: float, step_s: float) -> None:
        self.step((self.emf.sum() - voltage_V) / (self.r0_ohm * self.soc.size), step_s)


def run(*segments, cell=None, step_s=1.0, plant_input="current_A", **options):
    """Current, highest and lowest voltage and lowest SoC after each step; shape (n, 4)."""
    cell = cell or Cell()
    demand = Load.model_validate({"segments": list(segments), **options}).demand(step_s, plant_input=plant_input)
    advance = {"current_A": cell.step, "power_W": cell.step_power, "voltage_V": cell.step_voltage}[plant_input]
    rows = []
    while (asked := demand.next(cell.voltage_V, cell.soc, cell.current_A)) is not None:
        advance(asked, step_s)
        rows.append([cell.current_A, cell.voltage_V.max(), cell.voltage_V.min(), cell.soc.min()])
    assert len(rows) <= demand.steps_at_most
    return np.array(rows).reshape(-1, 4)


CHARGE = {"cccv_A": -2.5, "voltage_V": 4.1, "cutoff_A": 0.1}


@settings(max_examples=30)
@given(
    durations_s=st.lists(st.floats(0.1, 40), min_size=1, max_size=5),
    step_s=st.sampled_from([0.1, 1.0, 7.0]),
    repeat=st.integers(1, 3),
)
def test_a_load_that_need_not_know_the_plant_is_asked_for_as_its_profile(durations_s, step_s, repeat) -> None:
    segments = [{"current_A": 0.1 * (k + 1), "duration_s": d} for k, d in enumerate(durations_s)]
    load = Load.model_validate({"segments": [*segments, {"rest_s": step_s}], "repeat": repeat})
    profile, demand = load.profile(step_s), load.demand(step_s)
    asked = [demand.next(3.7) for _ in range(profile.t_ns.size)]
    assert asked == pytest.approx(profile.current_A.tolist(), abs=1e-9)
    assert demand.steps_at_most - profile.t_ns.size in (0, 1)


def test_charge_is_constant_current_then_constant_voltage_then_over() -> None:
    current_A, high_V, _, _ = run(CHARGE).T
    held = np.flatnonzero(current_A > -2.5 + 1e-9)[1:]  # without the soft start
    assert current_A[0] == pytest.approx(-0.25)
    assert np.all(current_A[1 : held[0]] == -2.5)
    assert held[0] > 1000
    assert np.all(held == np.arange(held[0], current_A.size))
    assert np.abs(high_V[held] - 4.1).max() < 1e-3
    assert high_V.max() < 4.1 + 1e-3
    assert np.all(np.diff(current_A[held]) > 0)
    assert -0.12 < current_A[-1] < -0.1


@pytest.mark.parametrize("step_s", [0.5, 10.0])
def test_the_voltage_is_held_at_any_step(step_s: float) -> None:
    high_V = run(CHARGE, step_s=step_s)[:, 1]
    assert high_V.max() < 4.1 + 0.002 * max(1.0, step_s)
    assert high_V[-1] == pytest.approx(4.1, abs=2e-3)


class ColdCell(Cell):
    """Its resistance falls with the current, as that of kinetics does: by a half from 0.25 A to 2.5 A."""

    @property
    def voltage_V(self) -> np.ndarray:
        return self.emf - 0.15 * math.asinh(self.current_A)


def test_a_resistance_that_rises_as_the_current_falls_does_not_make_the_voltage_oscillate() -> None:
    current_A, high_V, _, _ = run(CHARGE, cell=ColdCell(), step_s=1.0).T
    held = np.flatnonzero(current_A > -2.5 + 1e-9)[1:]
    assert np.abs(high_V[held] - 4.1).max() < 2e-3
    assert np.all(np.diff(current_A[held[5:]]) > 0)
    assert -0.12 < current_A[-1] < -0.1


def test_a_string_is_charged_until_its_highest_cell_and_discharged_until_its_lowest() -> None:
    spread = [0.5, 0.55, 0.6]
    charged = run(CHARGE, cell=Cell(soc=spread))
    assert charged[:, 1].max() == pytest.approx(4.1, abs=1e-3)
    assert charged[-1, 2] < 4.05
    discharged = run({"cccv_A": 2.5, "voltage_V": 3.2, "cutoff_A": 0.1}, cell=Cell(soc=spread))
    assert discharged[:, 2].min() == pytest.approx(3.2, abs=1e-3)
    assert 0.1 < discharged[-1, 0] < 0.12


def test_a_full_cell_is_not_charged_and_a_charge_takes_no_longer_than_allowed() -> None:
    assert run(CHARGE, cell=Cell(soc=0.95)).size == 0
    assert len(run(CHARGE | {"max_duration_s": 60.0})) == 60


def test_charging_twice_ends_at_the_same_place() -> None:
    once = run(CHARGE)
    twice = run(CHARGE, {"current_A": 5.0, "duration_s": 1200}, CHARGE)
    assert twice[-1, 3] == pytest.approx(once[-1, 3], abs=2e-3)


@pytest.mark.parametrize(
    ("limit", "column", "value"),
    [
        ({"until_below_V": 3.2, "current_A": 2.0}, 2, 3.2),
        ({"until_above_V": 4.0, "current_A": -2.0}, 1, 4.0),
        ({"until_below_soc": 0.3, "current_A": 2.0}, 3, 0.3),
        ({"until_above_soc": 0.6, "current_A": -2.0}, 3, 0.6),
    ],
)
def test_a_segment_ends_with_the_step_that_passes_its_limit(limit, column, value) -> None:
    before, last = run({"duration_s": 86400, **limit})[[-2, -1], column]
    assert min(before, last) <= value <= max(before, last)
    assert value not in (before,)


def test_a_drive_repeats_until_the_cell_is_empty_and_the_schedule_goes_on() -> None:
    drive = {"schedule": [{"cycle": "udds"}, {"rest_s": 300}], "repeat": 1000, "until_below_V": 3.05}
    rows = run(drive, {"rest_s": 600}, CHARGE, repeat=2)
    voltage_V = rows[:, 2]
    days = np.flatnonzero(voltage_V <= 3.05)
    assert days.size == 2  # once in each round, and never further
    assert rows[-1, 3] > 0.8
    rest = rows[days[0] + 1 : days[0] + 601, 0]
    assert np.all(rest == 0)


def test_what_ends_within_a_step_before_a_charge_loses_no_charge() -> None:
    rows = run({"current_A": 2.0, "duration_s": 2.5}, CHARGE | {"max_duration_s": 1.0}, step_s=1.0)
    assert rows[:, 0] == pytest.approx([2.0, 2.0, 1.0, -0.25 if rows[-1, 0] > -1 else -2.5])


@pytest.mark.parametrize("cells", [1, 3])
def test_constant_power_is_that_power_at_the_terminals(cells: int) -> None:
    cell = Cell(soc=[0.8] * cells)
    rows = run({"power_W": 15.0 * cells, "duration_s": 600}, cell=cell)
    power_W = rows[:, 0] * rows[:, 1] * cells
    assert power_W[0] == pytest.approx(15.0 * cells, rel=0.05)  # the resistance is not known yet
    assert power_W[1:] == pytest.approx(np.full(599, 15.0 * cells), rel=2e-3)


def test_a_power_beyond_what_the_cell_has_asks_for_the_most_it_can_give() -> None:
    rows = run({"power_W": 10.0, "duration_s": 10}, {"power_W": 1000.0, "duration_s": 5})
    assert np.isfinite(rows).all()
    assert rows[10, 0] == pytest.approx(3.6 / (2 * 0.03), rel=0.1)


@pytest.mark.parametrize("plant_input", ["power_W", "voltage_V"])
def test_a_plant_of_another_input_is_given_the_same_load(plant_input: str) -> None:
    segments = [{"current_A": 3.0, "duration_s": 300}, {"power_W": 10.0, "duration_s": 300}, CHARGE]
    expected, rows = run(*segments), run(*segments, plant_input=plant_input)
    assert rows[2:300, 0] == pytest.approx(expected[2:300, 0], rel=2e-3)
    assert rows[302:600, 0] == pytest.approx(expected[302:600, 0], rel=2e-3)
    assert rows[-1, 3] == pytest.approx(expected[-1, 3], abs=2e-3)
    assert rows[600:, 1].max() < 4.1 + 2e-3


def test_a_plant_that_takes_power_or_voltage_gets_what_the_load_says_as_it_stands(tmp_path: Path) -> None:
    (tmp_path / "v.csv").write_text("time_s,voltage_V,power_W\n0,3.7,5\n1,3.6,6\n2,3.8,7\n")
    for quantity, expected in (("voltage_V", [3.6, 3.8]), ("power_W", [-6.0, -7.0])):
        table = {"csv": str(tmp_path / "v.csv"), "quantity": quantity, "current_positive": "charge"}
        demand = Load.model_validate({"segments": [table]}).demand(1.0, plant_input=quantity)
        assert [demand.next(3.7, 0.5, 0.0) for _ in range(3)] == pytest.approx([*expected, None])
    held = Load.model_validate({"segments": [{"voltage_V": 4.0, "duration_s": 1.5}]}).demand(
        1.0, plant_input="voltage_V"
    )
    assert [held.next(3.7, 0.5, 0.0) for _ in range(3)] == [4.0, 4.0, None]


def test_a_cycle_as_power_is_its_current_times_the_nominal_voltage() -> None:
    current = Load.model_validate({"segments": [{"cycle": "us06"}]}).profile(1.0).current_A
    demand = Load.model_validate({"segments": [{"cycle": "us06", "quantity": "power_W"}]}).demand(
        1.0, plant_input="power_W"
    )
    assert [demand.next(3.7) for _ in current] == pytest.approx((3.63 * current).tolist())


def test_a_long_load_is_not_held_in_memory() -> None:
    demand = Load.model_validate({"segments": [{"cycle": "udds", "repeat": 10**7, "until_below_V": 3.0}]}).demand(1.0)
    assert demand.steps_at_most == 1369 * 10**7
    assert demand.next(3.7) is not None
    assert demand.next(2.9) is None


@pytest.mark.parametrize(
    ("segment", "named"),
    [
        (CHARGE | {"cutoff_A": 3.0}, "cutoff_A below the current, which is 2.5 A"),
        ({"cccv_A": -2.5, "voltage_V": 4.1}, "cutoff_A"),
        ({"cccv_A": -2.5, "current_A": 1.0}, "a table with one of"),
        ({"schedule": []}, "schedule"),
        ({"schedule": [{"rest_s": 1, "until_V": 3}]}, "until_V"),
        ({"cycle": "udds", "quantity": "voltage_V"}, "quantity"),
    ],
)
def test_a_wrong_segment_is_refused_by_name(segment, named) -> None:
    with pytest.raises(ValidationError, match=named):
        Load.model_validate({"segments": [segment]})


def test_what_the_plant_cannot_take_or_does_not_give_is_told_in_one_line() -> None:
    with pytest.raises(ConfigError, match="no voltage, as the plant takes current_A"):
        Load.model_validate({"segments": [{"schedule": [{"voltage_V": 4.0, "duration_s": 1}]}]}).demand(1.0)
    with pytest.raises(ConfigError, match=r"until_below_soc is 0\.3; .* the plant gives no SoC"):
        Load.model_validate({"segments": [{"rest_s": 1, "until_below_soc": 0.3}]}).demand(1.0).next(3.7)
    demand = Load.model_validate({"segments": [{"rest_s": 5}]}).demand(1.0, plant_input="voltage_V")
    demand.next(3.7)
    with pytest.raises(ConfigError, match="a current output of the plant"):
        demand.next(3.7)
    with pytest.raises(ConfigError, match="currents over time, without limits"):
        Load.model_validate({"segments": [CHARGE]}).profile(1.0)
