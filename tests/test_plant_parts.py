"""Plants of several FMUs: who gets what from whom, in which unit, when, and what happens when one of them fails."""

from __future__ import annotations

import pytest
from c_fmu import Var, build

from bms_ukf import toml
from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.plant import PlantTable, open_plant

SECOND = 1_000_000_000
CELL = (
    Var("i", "input", "A", "0"),
    Var("T_in", "input", "K", "298.15"),
    Var("v", "output", "V"),
    Var("heat", "output", "W"),
    Var("T_used", "output", "K"),
)
HOUSING = (Var("Q", "input", "kW", "0"), Var("T", "output", "degC"), Var("steps", "output"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    build(folder / "cell.fmu", CELL, "v = 4 - 0.1 * i; heat = 100 * i; T_used = T_in; return 0;", "v = 4; heat = 0;")
    build(folder / "housing.fmu", HOUSING, "steps += 1; T += 1000 * Q * h / 100; return 0;", "T = 20;", fmi=3)
    return folder


def table(**keys):
    part = [{"name": "cell", "fmu": "cell.fmu"}, {"name": "housing", "fmu": "housing.fmu"}]
    connect = [{"from": "cell.heat", "to": "housing.Q"}, {"from": "housing.T", "to": "cell.T_in"}]
    variables = {
        "current_A": "cell.i", "voltage_V": "cell.v", "temperature_degC": "cell.T_used", "soc": "", "ambient_degC": "",
    }  # fmt: skip
    data = {"part": part, "connect": connect, "variables": variables} | keys
    return toml.validate(data, PlantTable, "plant")


def temperatures(folder, **keys):
    with open_plant(table(**keys), folder) as plant:
        return [float(plant.step(1.0, SECOND).temperature_degC) for _ in range(4)]


def test_each_part_sees_what_the_others_had_at_the_beginning_of_the_step(folder):
    # Heat of 100 W from the first step on reaches the housing in the second, which warms by 1 K, and the cell then.
    assert temperatures(folder) == pytest.approx([20.0, 20.0, 21.0, 22.0])


def test_the_order_in_which_parts_are_listed_does_not_matter(folder):
    part = [{"name": "housing", "fmu": "housing.fmu"}, {"name": "cell", "fmu": "cell.fmu"}]
    assert temperatures(folder, part=part) == temperatures(folder)


def test_parts_exchange_as_often_as_the_plants_step_says(folder):
    assert temperatures(folder, step_s=0.25)[-1] == pytest.approx(23.5)


def test_a_connection_may_have_a_gain_and_an_offset(folder):
    connect = [
        {"from": "cell.heat", "to": "housing.Q", "gain": -2.0},
        {"from": "housing.T", "to": "cell.T_in", "offset": 5.0},
    ]
    assert temperatures(folder, connect=connect) == pytest.approx([25.0, 25.0, 23.0, 21.0])


def test_a_part_may_step_more_slowly_than_the_others(folder):
    part = [{"name": "cell", "fmu": "cell.fmu"}, {"name": "housing", "fmu": "housing.fmu", "step_s": 2.0}]
    # The first two seconds carry the heat of one, 100 W, in the mean 50 W.
    assert temperatures(folder, part=part) == pytest.approx([20.0, 20.0, 21.0, 21.0])


def test_a_part_may_drive_the_plant(folder, tmp_path):
    build(tmp_path / "load.fmu", (Var("I", "output", "mA"),), "I = 2000; return 0;", "I = 2000;")
    build(tmp_path / "cell.fmu", CELL[:3], "v = 4 - 0.1 * i; return 0;", "v = 4;")
    data = {
        "part": [{"name": "load", "fmu": "load.fmu"}, {"name": "cell", "fmu": "cell.fmu"}],
        "connect": [{"from": "load.I", "to": "cell.i"}],
        "variables": {
            "current_A": "cell.i",
            "voltage_V": "cell.v",
            "temperature_degC": "",
            "soc": "",
            "ambient_degC": "cell.T_in",
        },
    }
    with open_plant(toml.validate(data, PlantTable, "plant"), tmp_path) as plant:
        assert plant.input is None
        state = plant.step(0.0, SECOND)
        assert (state.current_A, state.voltage_V) == (2.0, pytest.approx(3.8))
        assert state.temperature_degC == pytest.approx(25.0)


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        (
            {"variables": {"current_A": "i"}},
            "variables.current_A is 'i'; expected part.variable, with a part among cell",
        ),
        (
            {"variables": {"current_A": "cell.I"}},
            "variables.current_A is 'I'; expected a variable of the FMU, such as i",
        ),
        ({"connect": [{"from": "cell.heat", "to": "cell.v"}]}, "connect[0].to is 'cell.v'; expected an input"),
        ({"connect": [{"from": "cell.v", "to": "housing.Q"}]}, "expected a unit that V can be converted to"),
        ({"connect": [{"from": "cell.v", "too": "housing.Q"}]}, "connect.0.too"),
        ({"part": [{"name": "a", "fmu": "b.fmu"}] * 2}, "a name of its own for each [[plant.part]], not a, a"),
        ({"fmu": "cell.fmu"}, "either fmu, or [[plant.part]]"),
        ({"step_s": 0.3}, ""),
    ],
)
def test_a_table_that_means_nothing_is_one_line(folder, keys, line):
    with pytest.raises(ConfigError) as caught, open_plant(table(**keys), folder) as plant:
        plant.step(1.0, SECOND)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_part_that_fails_is_named_and_the_plant_is_over(folder, tmp_path):
    bad = build(tmp_path / "bad.fmu", HOUSING, "if (t > 1.5) abort(); return 0;", "T = 20;")
    part = [{"name": "cell", "fmu": "cell.fmu"}, {"name": "housing", "fmu": str(bad)}]
    with open_plant(table(part=part), folder) as plant:
        plant.step(1.0, SECOND)
        plant.step(1.0, SECOND)
        with pytest.raises(PlantError, match=r"bad\.fmu: at t = 2 s: .*SIGABRT"):
            plant.step(1.0, SECOND)
        with pytest.raises(PlantError) as caught:
            plant.step(1.0, SECOND)
        assert caught.value.kind == "crash"
        assert plant.state.t_ns == 2 * SECOND
