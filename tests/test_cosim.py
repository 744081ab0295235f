"""Co-simulation: the same scenario straight into the estimator and over a bus, again and again, and its summary."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from c_fmu import Var, build

from bms_ukf import ConfigError, Fault, cosim, metrics, toml
from bms_ukf.scenario import Scenario
from bms_ukf.trace import Trace

# What a bit of the DBC is worth, per column of a trace.
BITS = {
    "soc": 0.0025e-2,
    "soc_sigma": 0.0025e-2,
    "voltage_pred_V": 0.0002,
    "innovation_V": 0.0001,
    "nis": 0.01,
}
NIS_LARGEST = 163.81
SUMMARY_KEYS = {
    "n",
    "duration_s",
    "realtime_factor",
    "final_soc",
    "soc_sigma_final",
    "rmse_pct",
    "mae_pct",
    "max_pct",
    "bias_pct",
    "coverage95",
    "settled_s",
    "after_600s",
}

SENSORS = {
    "seed": 3,
    "current": {"noise_A": 0.02, "offset_A": 0.05, "resolution_A": 0.001},
    "voltage": {"noise_V": 0.002, "resolution_V": 0.0005},
    "temperature": {"noise_degC": 0.05, "resolution_degC": 0.01},
}
_channels = (f"test-cosim-{k}" for k in itertools.count())


def scenario(interface: str = "direct", **tables: Any) -> Scenario:
    """A drive whose sensors resolve what the DBC does: then both ways give the estimator the same numbers."""
    data: dict[str, Any] = {
        "format": 1,
        "name": "test",
        "plant": {"fmu": "lgm50_spme", "parameters": {"soc_initial": 0.8}, "ambient_degC": 20.0},
        "load": {"segments": [{"rest_s": 20.0}, {"cycle": "us06"}, {"current_A": -2.0, "duration_s": 200.0}]},
        "sensors": SENSORS,
        "bus": {"interface": interface, "channel": next(_channels)},
        "estimator": {"cell": "lgm50_chen2020", "tuning": {"initial_soc": 0.6, "initial_soc_sigma": 0.2}},
    }
    return toml.validate(data | tables, Scenario, "test")


def run(interface: str = "direct", **tables: Any) -> tuple[Trace, dict[str, Any]]:
    return cosim.run(scenario(interface, **tables), Path("test"))


@pytest.fixture(scope="module")
def at_one_temperature():
    """A drive both ways, whose sensor of temperature is too coarse to show that the cell warms up."""
    sensors = {**SENSORS, "temperature": {"noise_degC": 0.0, "resolution_degC": 25.0}}
    return run("direct", sensors=sensors)[0], run("virtual", sensors=sensors)[0]


@pytest.fixture(scope="module")
def direct():
    return run("direct")


@pytest.fixture(scope="module")
def virtual():
    return run("virtual")


def test_direct_and_over_the_bus_agree_within_dbc_quantisation_row_by_row(at_one_temperature):
    straight, bus = at_one_temperature
    assert len(straight) == len(bus) > 800
    assert np.array_equal(straight.t_ns, bus.t_ns)
    assert np.array_equal(straight.status, bus.status)
    assert np.array_equal(straight.faults, bus.faults)
    for column, bit in BITS.items():
        a, b = straight[column], bus[column]
        if column == "nis":
            a = np.minimum(a, NIS_LARGEST)
        assert np.array_equal(np.isnan(a), np.isnan(b)), column
        assert np.nanmax(np.abs(a - b)) < 0.5001 * bit, column


def test_a_temperature_that_comes_after_its_current_moves_soc_by_little(direct, virtual):
    """Of frames that arrive one by one the current moves the state on, before the new temperature is known."""
    straight, bus = direct[0], virtual[0]
    away = np.abs(straight["soc"] - bus["soc"]) - BITS["soc"] / 2
    assert 0 < np.nanmax(away) < 0.1 * np.nanmin(straight["soc_sigma"])


def test_the_bus_carried_every_frame(virtual):
    trace, summary = virtual
    assert (summary["frames_in"], summary["frames_out"]) == (3 * len(trace), 6 * len(trace))
    assert not np.any(trace.faults & (Fault.E2E | Fault.BUS))


@pytest.mark.parametrize("interface", ["direct", "virtual"])
def test_the_same_seed_gives_the_same_trace_to_the_bit(request, interface, tmp_path):
    first, again = request.getfixturevalue(interface)[0], run(interface)[0]
    first.write_csv(tmp_path / "first.csv")
    again.write_csv(tmp_path / "again.csv")
    assert (tmp_path / "first.csv").read_bytes() == (tmp_path / "again.csv").read_bytes()


def test_another_seed_gives_another_trace(direct):
    other, _ = run(sensors={"seed": 4, "voltage": {"noise_V": 0.002}})
    assert not np.array_equal(direct[0]["voltage_V"], other["voltage_V"])
    assert np.array_equal(direct[0]["voltage_true_V"], other["voltage_true_V"])


def test_the_trace_holds_what_the_plant_did_what_was_measured_and_what_was_made_of_it(direct):
    trace, _ = direct
    # The plant's SoC is the charge drawn from it; its capacity is the cell file's within identification.
    drawn = np.cumsum(trace["current_true_A"]) / 3600 / 5.15
    assert np.allclose(trace["soc_ref"], 0.8 - drawn, atol=2e-3)
    assert np.mean(trace["current_A"] - trace["current_true_A"]) == pytest.approx(0.05, abs=0.005)
    assert np.std(trace["voltage_V"] - trace["voltage_true_V"]) == pytest.approx(0.002, rel=0.15)
    assert trace["soc"][-1] == pytest.approx(trace["soc_ref"][-1], abs=0.03)


def test_the_summary_has_the_keys_scripts_read_and_is_json(virtual):
    trace, summary = virtual
    assert summary.keys() >= SUMMARY_KEYS
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert summary["n"] == len(trace)
    assert summary["duration_s"] == pytest.approx(len(trace) * 1.0)
    assert summary["final_soc"] == trace["soc"][-1]
    error_pct = 100 * (trace["soc"] - trace["soc_ref"])
    assert summary["rmse_pct"] == pytest.approx(math.sqrt(np.mean(error_pct**2)))
    assert {check.name for check in metrics.judge(summary)}


def test_a_plant_that_does_not_know_its_soc_is_followed_without_a_score():
    short = {"segments": [{"current_A": 1.0, "duration_s": 30.0}]}
    trace, summary = run(load=short, plant={"fmu": "lgm50_spme", "variables": {"soc": ""}})
    assert np.isnan(trace["soc_ref"]).all()
    assert summary["rmse_pct"] is None
    assert summary["final_soc"] == pytest.approx(0.5, abs=0.2)


def test_a_summary_without_an_estimate_at_the_end_is_json_too():
    short = {"segments": [{"current_A": 1.0, "duration_s": 30.0}]}
    hidden = {"cell": "lgm50_chen2020", "tuning": {"invalid_half_width": 1e-6}}
    _, summary = run(load=short, estimator=hidden)
    assert json.loads(json.dumps(summary, allow_nan=False))["final_soc"] is None
    assert summary["soc_sigma_final"] is None
    assert (summary["n_scored"], summary["n_unavailable"]) == (0, 30)


def test_the_interval_crosses_the_bus_with_every_soc(virtual):
    trace, summary = virtual
    low, high = trace.interval
    known = np.isfinite(trace["soc"])
    assert (np.isfinite(low) & np.isfinite(high) == known).all()
    assert ((low <= trace["soc"]) & (trace["soc"] <= high))[known].all()
    bit = 0.0025e-2
    assert np.abs((high - low) / 3.92 - trace["soc_sigma"])[known].max() < bit
    assert (summary["soc_low_final"], summary["soc_high_final"]) == (low[-1], high[-1])


def test_every_step_is_shown_to_the_one_who_watches():
    seen = []
    trace, _ = cosim.run(
        scenario("virtual", load={"segments": [{"rest_s": 5.0}]}),
        Path("test"),
        lambda progress: seen.append((progress.step, progress.steps, progress.frames_in, progress.frames_out)),
    )
    assert seen == [(k, 5, 3 * k, 6 * k) for k in range(1, 6)]
    assert len(trace) == 5


@pytest.mark.parametrize(
    ("tables", "told"),
    [
        ({"plant": {"fmu": "nothing"}}, "nothing: expected a file, or one of the shipped plants: "),
        ({"plant": {"fmu": "lgm50_spme", "variables": {"voltage_V": "voltage"}}}, "voltage_V"),
        ({"plant": {"fmu": "lgm50_spme", "parameters": {"soc_initial": 2.0}}}, "parameters.soc_initial"),
        ({"estimator": {"cell": "nothing"}}, "shipped cells"),
        ({"bus": {"interface": "nonsense", "channel": "x"}}, "bus.interface is 'nonsense'"),
        ({"load": {"segments": [{"cycle": "nothing"}]}}, "shipped loads"),
    ],
)
def test_what_a_scenario_names_and_is_not_there_is_told_in_one_line(tables, told):
    with pytest.raises(ConfigError) as refused:
        run(**tables)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_plant_that_runs_empty_leaves_the_trace_so_far_and_says_why():
    trace, summary = run(load={"segments": [{"current_A": 25.0, "duration_s": 3600.0}]})
    assert 0 < len(trace) < 3600
    assert "outside the model's range" in summary["plant_failure"]
    assert summary["n"] == len(trace)


def test_a_step_longer_than_a_current_is_held_is_refused():
    with pytest.raises(ConfigError, match=r"step_s of at most estimator\.tuning\.current_timeout_s"):
        scenario(step_s=10.0)


def test_a_load_that_looks_at_the_plant_drives_to_a_limit_charges_and_ends():
    segments = [
        {"current_A": 5.0, "duration_s": 7200.0, "until_below_V": 3.55},
        {"cccv_A": -5.0, "voltage_V": 3.9, "cutoff_A": 2.5},
    ]
    trace, summary = run(load={"segments": segments})
    voltage_V, current_A = trace["voltage_true_V"], trace["current_true_A"]
    turned = int(np.argmax(current_A < 0))
    assert voltage_V[turned - 1] <= 3.55 < voltage_V[turned - 2]
    assert 3.9 <= voltage_V.max() < 3.903  # after a reversal the voltage rises by 2 mV a step
    assert current_A[-1] == pytest.approx(-2.5, abs=0.02)
    assert summary["plant_failure"] is None


def test_a_load_that_is_over_before_its_first_step_is_refused():
    with pytest.raises(ConfigError, match="at least one step before its limits are reached"):
        run(load={"segments": [{"rest_s": 10.0, "until_above_V": 3.0}]})


OTHERWISE_DRIVEN = {
    "power_W": ("P", "W", "0", "i = P / 3.7; v = 3.7 - 0.02 * i; return 0;", "v = 3.7;"),
    "voltage_V": ("u", "V", "3.7", "i = (3.7 - u) / 0.02; v = u; return 0;", "v = 3.7;"),
}


@pytest.mark.parametrize("role", OTHERWISE_DRIVEN)
def test_a_load_in_amperes_drives_a_plant_that_takes_watts_or_volts(tmp_path, role):
    name, unit, start, step, begin = OTHERWISE_DRIVEN[role]
    variables = (Var(name, "input", unit, start), Var("v", "output", "V"), Var("i", "output", "A"))
    fmu = build(tmp_path / "plant.fmu", variables, step, begin)
    names = {"current_A": "i", "voltage_V": "v", "temperature_degC": "", "soc": "", "ambient_degC": ""}
    load = {"segments": [{"current_A": 2.0, "duration_s": 60.0}]}
    trace, _ = run(load=load, plant={"fmu": str(fmu), "variables": names | {role: name}})
    assert trace["current_true_A"][5:] == pytest.approx(np.full(55, 2.0), rel=0.02)
