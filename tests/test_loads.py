from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pydantic import ValidationError

from bms_ukf import resources
from bms_ukf.errors import ConfigError
from bms_ukf.loads import Load, Vehicle, read_series

# Duration in s, distance in km and top speed in km/h as the procedures state them (EPA in miles: 7.45, 8.01, 10.26).
PROCEDURES = {
    "udds": (1369, 11.99, 91.2),
    "us06": (600, 12.89, 129.2),
    "hwfet": (765, 16.51, 96.4),
    "wltc_3b": (1800, 23.27, 131.3),
}


def load(*segments: dict[str, object], **options: object) -> Load:
    return Load.model_validate({"segments": list(segments), **options})


@pytest.fixture
def csv_file(tmp_path: Path):
    def write(text: str | bytes) -> Path:
        path = tmp_path / "load.csv"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return write


@pytest.mark.parametrize("name", PROCEDURES)
def test_shipped_cycle_is_the_procedure(name: str) -> None:
    duration_s, distance_km, top_kmh = PROCEDURES[name]
    time_s, speed_mps = read_series(resources.find(name, "loads", ".csv"), "speed_mps")
    assert np.array_equal(time_s, np.arange(duration_s + 1))
    assert np.trapezoid(speed_mps, time_s) / 1000 == pytest.approx(distance_km, abs=0.006)
    assert speed_mps.max() * 3.6 == pytest.approx(top_kmh, abs=0.06)
    assert speed_mps[0] == speed_mps[-1] == 0


def test_every_shipped_cycle_is_checked_here() -> None:
    assert resources.names("loads", ".csv") == sorted(PROCEDURES)


def test_steady_speed_draws_the_road_load_of_the_equation() -> None:
    vehicle = Vehicle()
    current_A = vehicle.cell_current_A(np.array([0.0, 1.0]), np.array([20.0, 20.0]))
    force_N = 0.010 * 1400 * 9.80665 + 0.5 * 1.2 * 0.69 * 20**2
    assert current_A[0] == pytest.approx((force_N * 20 / 0.88 + 500) / (96 * 14 * 3.63))


def test_standstill_draws_the_auxiliaries_only() -> None:
    vehicle = Vehicle(auxiliary_power_W=484.0, cells_series=100, cells_parallel=10, cell_voltage_nominal_V=4.0)
    assert vehicle.cell_current_A(np.arange(3.0), np.zeros(3)) == pytest.approx([0.121, 0.121])


def test_braking_recovers_kinetic_energy_times_regen_efficiency() -> None:
    vehicle = Vehicle(
        drag_area_m2=0, rolling_resistance=0, auxiliary_power_W=0, mass_factor=1, mass_kg=1000, regen_efficiency=0.5
    )
    current_A = vehicle.cell_current_A(np.array([0.0, 2.0]), np.array([10.0, 6.0]))
    assert current_A[0] * 96 * 14 * 3.63 == pytest.approx(-0.5 * 0.5 * 1000 * (100 - 36) / 2)


def test_friction_brakes_take_what_exceeds_the_regen_limit() -> None:
    vehicle = Vehicle(regen_power_max_W=10e3, regen_efficiency=0.8, auxiliary_power_W=0)
    current_A = vehicle.cell_current_A(np.array([0.0, 1.0]), np.array([30.0, 20.0]))
    assert current_A[0] * 96 * 14 * 3.63 == pytest.approx(-8e3)


def test_mean_power_does_not_depend_on_how_finely_a_ramp_is_sampled() -> None:
    fine_s = np.linspace(0, 10, 1001)
    coarse_s = np.array([0.0, 10.0])
    fine_A = Vehicle().cell_current_A(fine_s, 2 * fine_s)
    coarse_A = Vehicle().cell_current_A(coarse_s, 2 * coarse_s)
    assert coarse_A[0] == pytest.approx(fine_A.mean(), rel=1e-9)


def test_segments_follow_each_other_and_repeat() -> None:
    profile = load({"current_A": 2.0, "duration_s": 2}, {"rest_s": 1}, repeat=2).profile(1.0)
    assert profile.t_ns.tolist() == [10**9 * k for k in range(1, 7)]
    assert profile.current_A == pytest.approx([2, 2, 0, 2, 2, 0])


def test_a_step_across_segments_carries_their_mean_current() -> None:
    profile = load({"current_A": 3.0, "duration_s": 1}, {"rest_s": 1}).profile(2.0)
    assert profile.current_A == pytest.approx([1.5])


@given(
    durations_s=st.lists(st.floats(0.1, 1000), min_size=1, max_size=6),
    currents_A=st.lists(st.floats(-20, 20), min_size=6, max_size=6),
    step_s=st.sampled_from([0.01, 0.1, 0.25, 1.0]),
)
def test_no_charge_is_lost_on_the_grid(durations_s: list[float], currents_A: list[float], step_s: float) -> None:
    segments = [{"current_A": i, "duration_s": d} for d, i in zip(durations_s, currents_A, strict=False)]
    assume(sum(durations_s) >= step_s)
    profile = load(*segments).profile(step_s)
    given_Ah = sum(d * i for d, i in zip(durations_s, currents_A, strict=False)) / 3600
    assert abs(profile.charge_Ah - given_Ah) <= 20 * step_s / 3600 + 1e-9  # the part of a step at the end
    assert profile.t_ns[-1] <= sum(durations_s) * 1e9 + 1e-3 * step_s * 1e9
    assert np.all(np.diff(profile.t_ns) == round(step_s * 1e9))


def test_a_drive_cycle_has_one_row_per_second_and_repeats_exactly() -> None:
    once = load({"cycle": "udds"}).profile(1.0)
    twice = load({"cycle": "udds", "repeat": 2}).profile(1.0)
    assert once.t_ns.size == 1369
    assert twice.current_A == pytest.approx(np.tile(once.current_A, 2), abs=1e-9)


def test_a_city_car_needs_a_plausible_amount_of_energy() -> None:
    charge_Ah = load({"cycle": "wltc_3b"}).profile(1.0).charge_Ah
    assert 0.11 < charge_Ah / 5.0 < 0.15  # of a 5 Ah cell, for 23.27 km
    energy_kWh_per_100km = charge_Ah * 96 * 14 * 3.63 / 1000 / 23.27 * 100
    assert 11 < energy_kWh_per_100km < 16


@pytest.mark.parametrize(
    ("options", "expected_A"),
    [
        ({}, [2, 3]),
        ({"current_hold": "following"}, [1, 2]),
        ({"current_hold": "trapezoid"}, [1.5, 2.5]),
        ({"current_positive": "charge"}, [-2, -3]),
        ({"repeat": 2}, [2, 3, 2, 3]),
    ],
)
def test_recorded_current_lands_in_the_right_interval_with_the_right_sign(csv_file, options, expected_A) -> None:
    path = csv_file("time_s,current_A,remark\n5,1,a\n6,2,b\n7,3,c\n")
    assert load({"csv": str(path), **options}).profile(1.0).current_A == pytest.approx(expected_A)


def test_files_are_found_beside_the_scenario(csv_file, tmp_path: Path) -> None:
    csv_file("time_s,speed_mps\n0,0\n1,0\n")
    profile = load({"cycle": "load.csv"}).profile(1.0, relative_to=tmp_path)
    assert profile.current_A == pytest.approx([500 / (96 * 14 * 3.63)])


@pytest.mark.parametrize(
    ("text", "key", "value", "expected"),
    [
        ("time_s,current_mA\n0,1\n1,1\n", "current_A", "time_s,current_mA", "a header row with the columns"),
        ("", "time_s", "", "a header row with the columns"),
        ("time_s,current_A\n0,1\n", None, "1 rows", "at least two rows"),
        ("time_s,current_A\n0,1\n1,x\n", "current_A, row 2", "x", "a finite number"),
        ("time_s,current_A\n0,1\n1,\n", "current_A, row 2", "", "a finite number"),
        ("time_s,current_A\n0,1\n1\n", "current_A, row 2", None, "a finite number"),
        ("time_s,current_A\n0,1\n1,nan\n", "current_A, row 2", "nan", "a finite number"),
        ("time_s,current_A\n0,1\n2,1\n2,1\n", "time_s, row 3", 2.0, "a time after that of the row before, 2"),
        (b"\xff\xfe\x00\x01", None, None, "a text file"),
    ],
)
def test_a_bad_csv_is_named_with_column_and_row(csv_file, text, key, value, expected) -> None:
    path = csv_file(text)
    with pytest.raises(ConfigError) as caught:
        load({"csv": str(path)}).profile(1.0)
    assert (caught.value.source, caught.value.key, caught.value.value) == (str(path), key, value)
    assert caught.value.expected.startswith(expected)
    assert "\n" not in str(caught.value)


def test_negative_speed_is_refused(csv_file) -> None:
    path = csv_file("time_s,speed_mps\n0,0\n1,-3\n")
    with pytest.raises(ConfigError, match="at least 0") as caught:
        load({"cycle": str(path)}).profile(1.0)
    assert (caught.value.key, caught.value.value) == ("speed_mps, row 2", -3.0)


def test_an_unknown_cycle_names_the_shipped_ones() -> None:
    with pytest.raises(ConfigError, match="hwfet, udds, us06, wltc_3b"):
        load({"cycle": "wltp"}).profile(1.0)


@pytest.mark.parametrize("step_s", [0.0, -1.0, 11.0])
def test_a_step_that_does_not_fit_is_refused(step_s: float) -> None:
    with pytest.raises(ConfigError, match="step_s"):
        load({"rest_s": 10}).profile(step_s)


@pytest.mark.parametrize(
    ("segment", "named"),
    [
        ({}, "one of cycle, csv, current_A, power_W, rest_s, cccv_A, schedule, voltage_V"),
        ({"cycle": "udds", "rest_s": 3}, "one of cycle, csv, current_A, power_W, rest_s, cccv_A, schedule, voltage_V"),
        ({"current_A": 1.0}, "duration_s"),
        ({"cycle": "udds", "repeats": 3}, "repeats"),
        ({"rest_s": -1}, "rest_s"),
        ({"current_A": float("nan"), "duration_s": 1}, "current_A"),
    ],
)
def test_a_wrong_segment_is_refused_by_name(segment: dict[str, object], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        load(segment)
