"""The sensor specification: what a bound means to the filter, where it is stated, and how an impossible one ends."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from drives import CELL
from kernel_record import Record

from bms_ukf import ConfigError, Estimator, SensorSpec, Tuning, service, toml
from bms_ukf.cli.group import cli
from bms_ukf.config import Config, Setup
from bms_ukf.cosim import run
from bms_ukf.dbc import Matrix
from bms_ukf.hil.unit import write_config
from bms_ukf.kernel import layout as k
from bms_ukf.kernel.params import MOVED, R0_PER_K, params
from bms_ukf.scenario import Scenario
from bms_ukf.signal_scale import resolutions
from bms_ukf.signals import SignalMap, bind

EXAMPLES = Path(__file__).resolve().parents[1] / "models" / "configs"
MINIMAL = 'format = 1\ncell = "lgm50_chen2020"\n[bus]\ninterface = "socketcan"\nchannel = "vcan0"\n'
SIGNALS = """
[signals]
dbc = ["vehicle.dbc"]
current = "BatteryStatus.Current"
current_positive = "charge"
cell_voltage = ["CellStatus.Voltage"]
temperature = ["CellStatus.Temperature"]
"""
SCENARIO = """
format = 1
name = "x"
[plant]
fmu = "lgm50_spme"
[load]
segments = [{ current_A = 1.0, duration_s = 20 }]
[estimator]
cell = "lgm50_chen2020"
"""

EXACT = SensorSpec(voltage_offset_V=0.0, voltage_gain=0.0, temperature_K=0.0, skew_s=0.0)


@pytest.fixture
def config(tmp_path):
    """Write a CONFIG beside a vehicle's DBC, and load it."""
    (tmp_path / "vehicle.dbc").write_bytes((EXAMPLES / "example.dbc").read_bytes())

    def load(text: str) -> Setup:
        (tmp_path / "can.toml").write_text(text, encoding="utf-8")
        return Setup.load(tmp_path / "can.toml")

    return load


def header(**tuning: object):
    return params(CELL, Tuning(**tuning))


def test_a_bound_is_1_96_sigma_in_the_header_of_the_kernel():
    spec = SensorSpec(
        voltage_offset_V=0.0196, voltage_gain=0.0, current_offset_A=0.392, temperature_K=3.92, skew_s=0.49
    )
    p, exact = header(sensor_spec=spec), header(sensor_spec=EXACT)
    assert p[k.P_BIAS_SIGMA] == pytest.approx(0.2)
    assert p[k.P_SLOW_VAR] - exact[k.P_SLOW_VAR] == pytest.approx(0.01**2)
    assert p[k.P_R0_VAR] - exact[k.P_R0_VAR] == pytest.approx((R0_PER_K * 2.0) ** 2)
    assert p[k.P_FAST_REL] == pytest.approx(math.hypot(exact[k.P_FAST_REL], 0.25))


def test_soc_walks_by_the_gain_of_the_sensor_and_the_doubt_of_the_capacity():
    charge = 3600 * CELL.cell.capacity_Ah
    both = header(sensor_spec=SensorSpec(current_gain=0.0098), capacity_doubt=0.03)
    assert both[k.P_SOC_WALK_GAIN] == pytest.approx((0.005**2 + 0.03**2) * MOVED / charge)
    assert header(capacity_doubt=0.0)[k.P_SOC_WALK_GAIN] == pytest.approx((0.005 / 1.96) ** 2 * MOVED / charge)


def test_the_default_offset_is_a_fiftieth_of_the_capacity_an_hour():
    for current_bias in (True, False):
        offset_A = header(current_bias=current_bias)[k.P_BIAS_SIGMA]
        assert offset_A == pytest.approx(CELL.cell.capacity_Ah / 50 / 1.96)


def test_an_offset_lets_soc_walk_unless_it_is_a_state():
    """Redrawn every H seconds, it moves SoC by sigma H each time: a variance of sigma^2 H a second."""
    offset = SensorSpec(current_offset_A=0.392)
    without = header(sensor_spec=offset, current_bias=False, current_error_horizon_s=1800.0)
    charge = 3600 * CELL.cell.capacity_Ah
    assert without[k.P_SOC_WALK_OFFSET] == pytest.approx((0.2 / charge) ** 2 * 1800)
    assert header(sensor_spec=offset)[k.P_SOC_WALK_OFFSET] == 0


@pytest.mark.parametrize("current_bias", [True, False])
def test_what_an_offset_drops_on_all_resistances_is_a_slow_error_of_the_voltage(current_bias):
    """Also at rest, and also where the offset is a state: no voltage tells that state."""
    variances = []
    for offset_A in (0.392, 1e-6):
        spec = SensorSpec(current_offset_A=offset_A)
        record = Record(CELL, Tuning(sensor_spec=spec, current_bias=current_bias, initial_soc=0.5))
        record.tick(0.0, 0.0, float(CELL.ocv_V(0.5, 25.0)), 25.0)
        n = len(record.x)
        record["parts"], record.x, record.root = 0.0, [0.5] + [0.0] * (n - 1), 1e-6 * np.eye(n)
        record.tick(4.0, 0.0, math.nan, 25.0)
        variances.append(record.P[3, 3])
    at = record.dynamics(0.5, 25.0)
    drop_V = 0.2 * (at["r0_ohm"] + at["r1_ohm"] + at["r2_ohm"])
    renewed = -math.expm1(-2 * 4.0 / record.params[k.P_SLOW_TAU])
    assert variances[0] - variances[1] == pytest.approx(renewed * drop_V**2, rel=1e-6)


def test_offset_and_gain_of_the_voltage_add_as_independent_errors_at_the_nominal_voltage():
    nominal_V = float(CELL.ocv_V(0.5, 25.0))
    both = header(sensor_spec=SensorSpec(voltage_offset_V=0.005, voltage_gain=0.002))[k.P_SLOW_VAR]
    exact = header(sensor_spec=EXACT)[k.P_SLOW_VAR]
    assert both - exact == pytest.approx((0.005**2 + (0.002 * nominal_V) ** 2) / 1.96**2)


def test_rounding_is_a_uniform_error_of_one_step():
    """The variance of a uniform distribution of width w is w^2 / 12."""
    coarse = SensorSpec(voltage_resolution_V=0.012, temperature_resolution_K=2.4, temperature_K=0.0)
    p, fine = header(sensor_spec=coarse), header()
    assert p[k.P_VAR_VOLTAGE] - fine[k.P_VAR_VOLTAGE] == pytest.approx(0.012**2 / 12)
    exact = header(sensor_spec=EXACT)
    assert p[k.P_R0_VAR] - exact[k.P_R0_VAR] == pytest.approx((R0_PER_K * 2.4) ** 2 / 12)


def test_a_lasting_error_of_the_voltage_is_not_white_noise():
    large = header(sensor_spec=SensorSpec(voltage_offset_V=0.1))
    assert large[k.P_VAR_VOLTAGE] == header()[k.P_VAR_VOLTAGE]
    assert header(voltage_noise_V=0.01)[k.P_VAR_VOLTAGE] > header()[k.P_VAR_VOLTAGE]


def test_the_daemon_takes_the_resolution_from_the_scale_in_the_dbc(config):
    spec = config(MINIMAL + SIGNALS).estimator().tuning.sensor_spec
    assert (spec.current_resolution_A, spec.voltage_resolution_V, spec.temperature_resolution_K) == (0.05, 0.001, 1.0)
    own = config(MINIMAL).estimator().tuning.sensor_spec
    assert own.voltage_resolution_V == pytest.approx(0.0005), "of our own bms.dbc"


def test_a_resolution_that_is_stated_overrules_the_dbc(config):
    spec = config(MINIMAL + SIGNALS + "[sensor_spec]\nvoltage_resolution_V = 0.005\n").estimator().tuning.sensor_spec
    assert (spec.voltage_resolution_V, spec.current_resolution_A) == (0.005, 0.05)
    assert config(MINIMAL + SIGNALS + "[sensor_spec]\nvoltage_resolution_V = 0\n").tuning.sensor_spec == (
        SensorSpec(voltage_resolution_V=0.0, current_resolution_A=0.05, temperature_resolution_K=1.0)
    )


def test_the_resolution_is_that_of_one_cell_of_a_string_in_parallel(config):
    text = MINIMAL + SIGNALS.replace('cell_voltage = ["CellStatus.Voltage"]', 'pack_voltage = "BatteryStatus.Voltage"')
    spec = config(text + "series_cells = 96\nparallel_cells = 4\n").estimator().tuning.sensor_spec
    assert spec.voltage_resolution_V == pytest.approx(0.01 / 96)
    assert spec.current_resolution_A == pytest.approx(0.05 / 4)


def test_a_float_signal_has_no_resolution_and_of_several_the_coarsest_counts(tmp_path):
    (tmp_path / "f.dbc").write_text(
        'VERSION ""\nBU_: A\nBO_ 1 F: 8 A\n'
        ' SG_ I : 0|32@1- (0.5,0) [0|0] "A" A\n SG_ T : 32|8@1+ (1,-40) [0|0] "degC" A\n'
        'BO_ 2 V: 8 A\n SG_ U1 : 0|32@1- (1,0) [0|0] "V" A\n SG_ U2 : 32|16@1+ (1,0) [0|0] "mV" A\n'
        ' SG_ U3 : 48|16@1+ (5,0) [0|0] "mV" A\nSIG_VALTYPE_ 1 I : 1;\nSIG_VALTYPE_ 2 U1 : 1;\n'
    )
    roles = SignalMap("F.I", "charge", [f"V.U{n}" for n in (1, 2, 3)], temperature=["F.T"])
    found = resolutions(bind(roles, Matrix([tmp_path / "f.dbc"]), 3, "f"))
    assert found == {
        "current_resolution_A": 0.0,
        "voltage_resolution_V": pytest.approx(0.005),
        "temperature_resolution_K": 1.0,
    }


def test_config_has_one_specification_and_it_reaches_the_estimator(config):
    for table in ("[sensor_spec]", "[estimator.sensor_spec]"):
        tuning = config(MINIMAL + f"{table}\ncurrent_gain = 0.01\n").estimator().tuning
        assert tuning.sensor_spec.current_gain == 0.01
    with pytest.raises(ConfigError, match=r"can\.toml: estimator: expected no sensor_spec in it beside the table"):
        config(MINIMAL + "[sensor_spec]\nskew_s = 0.1\n[estimator.sensor_spec]\nskew_s = 0.2\n")


def test_the_daemon_of_a_scenario_has_the_specification_of_the_scenario(tmp_path):
    text = SCENARIO + "[estimator.tuning.sensor_spec]\ncurrent_gain = 0.01\n[estimator.tuning]\ngate_sigmas = 4.0\n"
    scenario = toml.validate(tomllib.loads(text), Scenario, "s.toml")
    path = write_config(tmp_path, scenario, tmp_path / "s.toml", "virtual", "spec")
    tuning = Setup.load(path).tuning
    assert (tuning.sensor_spec.current_gain, tuning.gate_sigmas) == (0.01, 4.0)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("voltage_offset_V = -0.005", "sensor_spec.voltage_offset_V is -0.005; expected greater than or equal to 0"),
        ("voltage_offset_V = nan", "sensor_spec.voltage_offset_V is nan; expected a finite number"),
        ("voltage_offset_V = inf", "sensor_spec.voltage_offset_V is inf; expected a finite number"),
        (
            "voltage_offset_V = 5.0",
            "sensor_spec.voltage_offset_V is 5.0; expected at most 1.7 V, the cell's voltage span",
        ),
        ("voltage_gain = 1.0", "sensor_spec.voltage_gain is 1.0; expected less than 1"),
        ("voltage_resolution_V = 2.0", "sensor_spec.voltage_resolution_V is 2.0; expected at most 1.7 V"),
        ("current_offset_A = 0", "sensor_spec.current_offset_A is 0; expected greater than 0"),
        (
            "current_offset_A = 1e3",
            "sensor_spec.current_offset_A is 1000.0; expected at most 15 A, the cell's current",
        ),
        ("current_resolution_A = 1e3", "sensor_spec.current_resolution_A is 1000.0; expected at most 15 A"),
        ("current_gain = 2.0", "sensor_spec.current_gain is 2.0; expected less than 1"),
        ("temperature_K = 101", "sensor_spec.temperature_K is 101; expected less than or equal to 100"),
        ("temperature_resolution_K = 101", "sensor_spec.temperature_resolution_K is 101; expected less than or equal"),
        ("skew_s = 6.0", "sensor_spec.skew_s is 6.0; expected at most 5 s, the shorter of current_timeout_s and volt"),
        ("skew_s = '0.2'", "sensor_spec.skew_s is '0.2'; expected a valid number"),
        ("curent_gain = 0.1", "sensor_spec.curent_gain is 0.1; expected no such key (did you mean current_gain?)"),
    ],
)
def test_a_specification_that_cannot_be_is_one_line(config, tmp_path, line, told):
    with pytest.raises(ConfigError) as refused:
        config(f"{MINIMAL}[sensor_spec]\n{line}\n")
    assert str(refused.value).startswith(f"{tmp_path / 'can.toml'}: {told}")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        (
            "current_offset_sigma_A = 0.05",
            "current_offset_sigma_A is 0.05; expected no such key: sensor_spec.current_of",
        ),
        ("current_gain_sigma = 0.01", "current_gain_sigma is 0.01; expected no such key: sensor_spec.current_gain, a"),
        (
            "voltage_sensor_sigma_V = 0.002",
            "voltage_sensor_sigma_V is 0.002; expected no such key: voltage_noise_V, one",
        ),
        (
            "soc_sigma_invalid = 0.35",
            "soc_sigma_invalid is 0.35; expected no such key: invalid_half_width, a half-width",
        ),
        ("capacity_doubt = 0.6", "capacity_doubt is 0.6; expected less than or equal to 0.5"),
    ],
)
def test_the_keys_of_before_are_refused_with_those_in_their_place(config, tmp_path, line, told):
    with pytest.raises(ConfigError) as refused:
        config(f"{MINIMAL}[estimator]\n{line}\n")
    assert str(refused.value).startswith(f"{tmp_path / 'can.toml'}: estimator.{told}")
    with pytest.raises(ConfigError, match=r"s\.toml: estimator\.tuning\."):
        toml.validate(tomllib.loads(f"{SCENARIO}[estimator.tuning]\n{line}\n"), Scenario, "s.toml")


def test_an_impossible_specification_of_a_scenario_names_the_scenario(tmp_path):
    text = SCENARIO + "[estimator.tuning.sensor_spec]\ncurrent_offset_A = 1e3\n"
    path = tmp_path / "s.toml"
    path.write_text(text)
    told = r"s\.toml: estimator\.tuning\.sensor_spec\.current_offset_A is 1000\.0; expected at most"
    with pytest.raises(ConfigError, match=told):
        run(toml.load(path, Scenario), path)
    with pytest.raises(ConfigError, match=told):
        write_config(tmp_path, toml.load(path, Scenario), path, "virtual", "spec")


def test_an_impossible_specification_in_python_is_refused_by_the_estimator():
    with pytest.raises(ConfigError, match=r"^tuning: sensor_spec\.skew_s is 2\.0; expected at most 1 s"):
        Estimator(CELL, tuning=Tuning(current_timeout_s=1.0, sensor_spec=SensorSpec(skew_s=2.0)))


def test_exports_and_replays_take_the_specification_of_a_config_and_name_it_if_it_is_wrong(tmp_path):
    path = tmp_path / "can.toml"
    path.write_text(f"{MINIMAL}[sensor_spec]\ncurrent_offset_A = 1e3\n")
    (tmp_path / "r.csv").write_text("time_s,current_A,voltage_V,temperature_C\n0,1,3.7,25\n1,1,3.7,25\n")
    for arguments in (
        ["export", "firmware", "lgm50_chen2020", "--target", "host", "--out", str(tmp_path / "f")],
        ["export", "fmu", "lgm50_chen2020", "--out", str(tmp_path / "f.fmu")],
        ["replay", str(tmp_path / "r.csv"), "--cell", "lgm50_chen2020", "--current-positive", "discharge"],
    ):
        told = r"can\.toml: sensor_spec\.current_offset_A is 1000\.0; expected at most"
        with pytest.raises(ConfigError, match=told):
            cli.main([*arguments, "--config", str(path)], standalone_mode=False)
    path.write_text(f"{MINIMAL}[sensor_spec]\ncurrent_gain = 0.02\n")
    assert toml.load(path, Config).tuning(CELL, path) == Tuning(sensor_spec=SensorSpec(current_gain=0.02))


def test_check_explains_the_specification(config):
    told = service.explain(config(MINIMAL + SIGNALS + "[sensor_spec]\nvoltage_resolution_V = 0\n").source)
    assert (
        "sensors, 95 % bounds: voltage ± 5 mV ± 0.1 %, current ± 0.103 A ± 0.5 %, temperature ± 2 K, current and "
        "voltage measured within 0.2 s\n"
        "sensors, resolution: current 0.05 A, voltage exact, temperature 1 K; voltage noise 2 mV (one sigma)\n"
        "capacity of the cell file ± 9.8 % (95 % bound)\n"
    ) in told
