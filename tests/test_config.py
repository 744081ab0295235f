"""The CONFIG format: its example is whole and works, and a mistake in one is one line that names it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from e2e.crc import calculate_crc8_h2f
from pydantic import BaseModel

from bms_ukf import ConfigError, Fault, SensorSpec, Tuning, resources, roles, service, toml
from bms_ukf.bus import SafeBus
from bms_ukf.clock import LockstepClock
from bms_ukf.config import Bus, Config, Lags, Metrics, PackUse, Recorder, Setup, Signals, State
from bms_ukf.daemon import Daemon
from bms_ukf.e2e_settings import Crc, E2e

EXAMPLE = Path(__file__).resolve().parents[1] / "models" / "configs" / "example.toml"
MINIMAL = """
format = 1
cell = "lgm50_chen2020"
[bus]
interface = "socketcan"
channel = "vcan0"
"""
SIGNALS = """
[signals]
dbc = ["vehicle.dbc"]
current = "BatteryStatus.Current"
current_positive = "charge"
cell_voltage = ["CellStatus.Voltage"]
temperature = ["CellStatus.Temperature"]
"""


E2E = "[signals.e2e.CellStatus]\n"


@pytest.fixture
def config(tmp_path):
    """Writes a CONFIG, beside a vehicle's DBC, and loads all it names."""
    (tmp_path / "vehicle.dbc").write_bytes((EXAMPLE.parent / "example.dbc").read_bytes())

    def load(text: str) -> Setup:
        path = tmp_path / "can.toml"
        path.write_text(text, encoding="utf-8")
        return Setup.load(path)

    return load


def test_the_example_works_with_the_dbc_beside_it():
    setup = Setup.load(EXAMPLE)
    assert setup.warnings == []
    battery = cantools.database.load_file(EXAMPLE.parent / "example.dbc").get_message_by_name("BatteryStatus")
    data = battery.encode({"Current": 12.5, "Voltage": 3.7})
    sample = setup.decoder.decode(battery.frame_id, False, data, 7)
    assert sample is not None
    assert (sample.t_ns, sample.current_A) == (7, -12.5), "positive is charge there, and discharge here"


@pytest.mark.parametrize(
    "model", [Config, Bus, Signals, PackUse, Lags, E2e, Crc, Metrics, Recorder, State, SensorSpec, Tuning]
)
def test_the_example_shows_every_key(model: type[BaseModel]):
    text = EXAMPLE.read_text(encoding="utf-8")
    shown = set(re.findall(r"(?:^(?:# )?\[?|[.{,] ?)(\w+)(?=[.\]]| = )", text, flags=re.MULTILINE))
    assert set(model.model_fields) <= shown


def test_what_the_example_comments_out_is_valid_where_it_may_stand():
    text = EXAMPLE.read_text(encoding="utf-8")
    for line, instead_of in (
        ('pack_voltage = "BatteryStatus.Voltage"', "cell_voltage"),
        ("capacity_scale = 35.0", ""),
        ("resistance_scale = 0.03", ""),
        ('unit = { "BatteryStatus.Current" = "A" }', ""),
    ):
        changed = text.replace(f"# {line}", line)
        assert changed != text
        if instead_of:
            changed = re.sub(rf"^{instead_of} = .*$", "", changed, flags=re.MULTILINE)
        Setup(toml.validate(tomllib.loads(changed), Config, EXAMPLE), EXAMPLE)


def test_the_strings_that_the_example_comments_out_are_valid_there():
    text = EXAMPLE.read_text(encoding="utf-8")
    of_each = "# string_of = [1, 1, 2, 2] "
    assert of_each in text
    text = text.replace(of_each, "string_of = [1, 1, 2, 2] ").replace("\ncells = 1 ", "\ncells = 4 ")
    text = text.replace('"BatteryStatus.Current" ', '["BatteryStatus.Current", "BatteryStatus.Voltage"] ', 1)
    text = text.replace(
        '["CellStatus.Voltage"] ',
        '["CellStatus.Voltage", "CellStatus.Voltage", "CellStatus.Voltage", "CellStatus.Voltage"] ',
    )
    text = text.replace("# unit = { ", 'unit = { "BatteryStatus.Voltage" = "A", ', 1)
    setup = Setup(toml.validate(tomllib.loads(text), Config, EXAMPLE), EXAMPLE)
    assert setup.wiring.strings == 2


def test_the_balancing_that_the_example_comments_out_is_valid_there():
    text = EXAMPLE.read_text(encoding="utf-8")
    for line in ('balancing = ["CellStatus.Balancing"]', "bleed_A = 0.1"):
        assert f"\n# {line} " in text
        text = text.replace(f"\n# {line} ", f"\n{line} ")
    setup = Setup(toml.validate(tomllib.loads(text), Config, EXAMPLE), EXAMPLE)
    assert "  balancing: CellStatus.Balancing (0x201, 0..0.1 A taken from a cell, CRC or counter checked)" in (
        roles.explained(setup.decoder.bound, setup.config.signals)
    )


def test_a_bleed_without_a_flag_that_switches_it_is_refused(config):
    for text in (MINIMAL, MINIMAL + SIGNALS):
        with pytest.raises(ConfigError, match=r"pack\.bleed_A is 0\.1; expected it with signals\.balancing"):
            config(text + "[pack]\nbleed_A = 0.1\n")


def cell_status(counter: int, voltage_V: float = 3.7, relay: int = 2) -> bytes:
    """A frame of the example's CellStatus, protected by an independent implementation of its CRC."""
    body = round(voltage_V * 1000).to_bytes(2, "big") + bytes([65, counter << 4 | relay])
    return body + bytes([calculate_crc8_h2f(bytes([0x2A]) + body)])


def test_the_example_refuses_a_frame_with_a_wrong_crc_or_counter_and_reads_a_right_one():
    decoder = Setup.load(EXAMPLE).decoder
    good = cell_status(counter=3)
    assert decoder.decode(0x201, False, good[:-1] + bytes([good[-1] ^ 1]), 0) is None
    sample = decoder.decode(0x201, False, good, 1)
    assert sample is not None
    assert (sample.voltage_V, sample.temperature_degC) == (3.7, 25.0)
    assert decoder.decode(0x201, False, good, 2) is None
    assert (decoder.counters.crc, decoder.counters.counter, decoder.counters.accepted) == (1, 1, 1)


def test_what_the_example_sets_in_the_estimator_and_of_the_sensors_is_the_default():
    example = toml.load(EXAMPLE, Config)
    assert (example.estimator, example.sensor_spec) == (Tuning(), SensorSpec())


def test_the_shortest_config_expects_the_projects_own_messages(config):
    setup = config(MINIMAL)
    assert (0x120, False) in setup.decoder.ids()
    assert setup.cell.cell.name == "lgm50_chen2020"


def test_files_are_looked_for_beside_the_config(config, tmp_path, monkeypatch, cell):
    (tmp_path / "my_cell.toml").write_bytes(resources.find("lgm50_chen2020", "cells", ".toml").read_bytes())
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    setup = config(MINIMAL.replace("lgm50_chen2020", "my_cell.toml") + SIGNALS)
    assert setup.cell == cell
    assert sorted(setup.decoder.ids()) == [(0x200, False), (0x201, False)]


def test_a_signal_without_a_unit_is_a_warning_and_not_a_guess_kept_quiet(config, tmp_path):
    text = (tmp_path / "vehicle.dbc").read_text().replace('[-1600|1600] "A"', '[-1600|1600] ""')
    (tmp_path / "vehicle.dbc").write_text(text)
    (warning,) = config(MINIMAL + SIGNALS).warnings
    assert warning.startswith("BatteryStatus.Current has no unit in the DBC: taken as A")


def test_a_cell_of_the_same_family_is_scaled(config):
    setup = config("capacity_scale = 35.0\n" + MINIMAL + SIGNALS)
    assert setup.cell.cell.capacity_Ah == pytest.approx(35 * 5.1532)
    assert "180.362 Ah, 35 times the size" in service.explain(setup.source)


def test_check_tells_what_every_role_is_read_from():
    lines = service.explain(EXAMPLE).splitlines()
    assert [line.strip().split(":")[0] for line in lines[3:]] == [
        "current",
        "voltage",
        "temperature",
        "contactor",
        "sensors, 95 % bounds",
        "sensors, resolution",
        "capacity of the cell file ± 9.8 % (95 % bound)",
        "pack",
        "capacity and resistance of each cell told from its use, kept with the state",
        f"state stored in {EXAMPLE.parent / 'bms-ukf.state'} every 10 s",
        f"on a fault the last 120 s to {EXAMPLE.parent / 'flights'}",
    ]
    assert "BatteryStatus.Current (0x200, -1638.35..1638.4 A, 0.05 a bit, positive on the bus is charge" in lines[3]
    assert "plausible -800 to 800, no CRC, no counter" in lines[3]
    assert "CRC or counter checked" in lines[4]
    assert "no value is 255" in lines[5]
    assert "CellStatus.MainRelay (0x201, open is Open" in lines[6]


def test_check_of_many_cells_names_the_first_and_the_last(config):
    told = service.explain(config("cells = 96\n" + MINIMAL).source)
    assert "voltage 1: CellVoltages.Cell1 (0x121, page 0" in told
    assert "… 94 more …\n  voltage 96: CellVoltages.Cell96" in told


def test_a_dbc_that_is_not_strictly_valid_is_read_with_a_warning(config, tmp_path):
    overlong = 'BO_ 514 Other: 1 Vehicle\n SG_ A : 0|16@1+ (1,0) [0|1] "" Bms\n'
    (tmp_path / "odd.dbc").write_text(f"{(tmp_path / 'vehicle.dbc').read_text()}\n{overlong}")
    setup = config(MINIMAL + SIGNALS.replace("vehicle.dbc", "odd.dbc"))
    (warning,) = setup.warnings
    assert "odd.dbc" in warning


@pytest.mark.parametrize(
    ("text", "key", "told"),
    [
        (MINIMAL.replace("channel", "chanel"), "bus.chanel", "did you mean channel?"),
        (MINIMAL.replace("format = 1", "format = 2"), "format", "1"),
        (MINIMAL.replace("format = 1", ""), "format", "missing"),
        (MINIMAL.replace('"vcan0"', "0"), "bus.channel", "string"),
        ("silence_s = 0\n" + MINIMAL, "silence_s", "greater than 0"),
        ("cells = 2000\n" + MINIMAL, "cells", "400"),
        (MINIMAL + "[estimator]\ninitial_soc = 50\n", "estimator.initial_soc", "less than or equal to 1"),
        (MINIMAL + "[estimator]\ngate_sigma = 5\n", "estimator.gate_sigma", "did you mean gate_sigmas?"),
        (MINIMAL + SIGNALS + 'pack_voltage = "BatteryStatus.Voltage"\n', "signals", "either cell_voltage or pack_volt"),
        (MINIMAL + SIGNALS.replace("CellStatus.V", "CellStatus.U"), "signals.cell_voltage", "CellStatus.Voltage"),
        (MINIMAL + SIGNALS.replace("BatteryStatus", "BateryStatus"), "signals.current", "BatteryStatus"),
        (MINIMAL + SIGNALS.replace('"charge"', '"in"'), "signals.current_positive", "'charge' or 'discharge'"),
        ("cells = 2\n" + MINIMAL + SIGNALS, "signals.cell_voltage", "each of 2 cells"),
        (MINIMAL + SIGNALS + 'contactor = "CellStatus.MainRelay"\n', "signals", "contactor_open together"),
        ("capacity_scale = 0.0\n" + MINIMAL, "capacity_scale", "0.001"),
        (MINIMAL + SIGNALS + 'unit = { "CellStatus.Voltage" = "mV" }\n', "signals.voltage", "2.5 to 4.2 V"),
        (MINIMAL + SIGNALS + 'unit = { "CellStatus.Voltage" = "kV" }\n', "signals.voltage", "in bits below 0.1"),
        (MINIMAL + SIGNALS + 'unit = { "CellStatus.Temperature" = "K" }\n', "signals.temperature", "20 to 30 degC"),
        (MINIMAL + SIGNALS + 'unit = { "BatteryStatus.Current" = "kA" }\n', "signals.current", "capacity_scale"),
        (MINIMAL + SIGNALS + "lag_s = { voltage = -1.0 }\n", "signals.lag_s.voltage", "greater than or equal to 0"),
        (MINIMAL + SIGNALS + E2E, "signals.e2e.CellStatus", "either profile, or crc, counter or both"),
        (MINIMAL + SIGNALS + E2E + 'profile = "P03"\n', "signals.e2e.CellStatus.profile", "'P01'"),
        (MINIMAL + SIGNALS + E2E + 'profile = "P02"\n', "signals.e2e.CellStatus.data_id", "16 bytes"),
        (MINIMAL + SIGNALS + E2E + 'counter = "Count"\n', "signals.e2e.CellStatus.counter", "CellStatus.Counter"),
        (
            MINIMAL + SIGNALS + E2E + 'counter = "Counter"\ncounter_values = 17\n',
            "signals.e2e.CellStatus.c",
            "at most 16",
        ),
        (
            MINIMAL + SIGNALS + E2E + 'counter = "Counter"\nmax_delta = 16\n',
            "signals.e2e.CellStatus.max_de",
            "below 16",
        ),
        (
            MINIMAL + SIGNALS + E2E + "crc = { polynomial = 7, byte = 5 }\n",
            "signals.e2e.CellStatus.crc",
            "within the 5",
        ),
        (MINIMAL + SIGNALS + E2E + "crc = { polynomial = 256, byte = 4 }\n", "signals.e2e.CellStatus.crc", "8 bits"),
    ],
)
def test_a_mistake_is_one_line_naming_file_key_and_what_was_expected(config, tmp_path, text, key, told):
    with pytest.raises(ConfigError) as refused:
        config(text)
    line = str(refused.value)
    assert line.startswith(f"{tmp_path / 'can.toml'}: {key}")
    assert told in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (MINIMAL.replace("lgm50_chen2020", "lgm51"), "lgm51: expected a file, or one of the shipped cells: "),
        (MINIMAL + SIGNALS.replace("vehicle.dbc", "no.dbc"), "no.dbc: expected a readable DBC file"),
        (MINIMAL + SIGNALS.replace("vehicle.dbc", "can.toml"), "can.toml: expected a readable DBC file"),
        ("format = \n", "can.toml: expected TOML"),
    ],
)
def test_a_file_that_is_missing_or_unreadable_is_named(config, text, told):
    with pytest.raises(ConfigError) as refused:
        config(text)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_missing_config_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nothing\.toml: expected a readable TOML file"):
        Setup.load(tmp_path / "nothing.toml")


def fd_dbc(cells: int, per_frame: int = 30) -> str:
    """Frames of 64 bytes: cells of 16 bits each, big-endian as many makers have them; current and two temperatures."""
    lines = ['VERSION ""', "BU_: Bms", "BO_ 16 Pack: 8 Bms"]
    lines += [' SG_ Current : 0|32@1- (0.001,0) [0|0] "A" Bms', ' SG_ Inlet : 32|8@1+ (1,-40) [0|0] "degC" Bms']
    lines += [' SG_ Outlet : 40|8@1+ (1,-40) [0|0] "degC" Bms']
    for frame in range(-(-cells // per_frame)):
        lines.append(f"BO_ {32 + frame} Cells{frame + 1}: 64 Bms")
        for k in range(per_frame):
            lines.append(f' SG_ Cell{frame * per_frame + k + 1} : {16 * k + 7}|16@0+ (0.0001,0) [0|0] "V" Bms')
    lines += ['BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","StandardCAN_FD","ExtendedCAN_FD";']
    lines += ['BA_DEF_DEF_ "VFrameFormat" "StandardCAN";']
    lines += [f'BA_ "VFrameFormat" BO_ {32 + frame} 2;' for frame in range(-(-cells // per_frame))]
    return "\n".join(lines) + "\n"


def fd_config(cells: int, pack: str) -> str:
    voltages = ", ".join(f'"Cells{k // 30 + 1}.Cell{k + 1}"' for k in range(cells))
    return (
        MINIMAL.replace("[bus]", f"cells = {cells}\n[bus]")
        + f"""fd = true
[signals]
dbc = ["fd.dbc"]
current = "Pack.Current"
current_positive = "discharge"
cell_voltage = [{voltages}]
temperature = ["Pack.Inlet", "Pack.Outlet"]
[pack]
{pack}
"""
    )


def test_a_pack_of_400_cells_in_fd_frames_is_read_and_published(config, tmp_path):
    """Thirty cells a frame, half of them by one temperature sensor and half by the other."""
    cells = 400
    (tmp_path / "fd.dbc").write_text(fd_dbc(cells))
    setup = config(fd_config(cells, f"sensor_of = {[1] * 200 + [2] * 200}"))
    matrix = cantools.database.load_file(tmp_path / "fd.dbc")
    estimator, sent = setup.estimator(), can.Bus("fd-frames", interface="virtual")
    bus = SafeBus(lambda: can.Bus("fd-frames", interface="virtual"))
    clock = LockstepClock()
    pack = setup.pack_output(estimator)
    daemon = Daemon(bus, estimator, setup.intake(), clock=clock, pace=setup.pace, fd=setup.config.bus.fd, pack=pack)
    volts = np.round(np.linspace(3.6, 3.9, cells), 4)
    for k in range(1, 4):
        clock.set(k * 10**9)
        head = matrix.encode_message("Pack", {"Current": 10.0, "Inlet": 20, "Outlet": 30})
        sent.send(can.Message(arbitration_id=16, data=head, is_extended_id=False, timestamp=float(k)))
        for frame in range(14):
            message = matrix.get_message_by_name(f"Cells{frame + 1}")
            assert message.is_fd
            signals = {s.name: volts[int(s.name[4:]) - 1] if int(s.name[4:]) <= cells else 0 for s in message.signals}
            data = message.encode(signals, strict=False)
            sent.send(
                can.Message(
                    arbitration_id=32 + frame, data=data, is_extended_id=False, is_fd=True, dlc=64, timestamp=float(k)
                )
            )
        while daemon.poll(0.0):
            pass
    assert setup.decoder.counters.accepted == 45
    assert daemon.published == 3
    estimate = daemon.estimate
    assert estimate.faults is Fault.UNCERTAIN, "three seconds after a start without an initial SoC"
    np.testing.assert_allclose(estimate.voltage_pred_V + estimate.innovation_V, volts, atol=1e-9)
    assert estimate.r0_ohm[:200].min() > 1.1 * estimate.r0_ohm[200:].max(), "20 degC at the inlet, 30 at the outlet"
    assert estimate.soc[-1] > estimate.soc[0] + 0.1
    shown = {m.arbitration_id for m in iter(lambda: sent.recv(0.0), None)}
    assert {0x220, 0x223, 0x226, 0x227, 0x228, 0x229, 0x22A, 0x22B} <= shown
    bus.close()
    sent.shutdown()


def test_fd_frames_are_not_read_where_fd_is_not_set(config, tmp_path):
    (tmp_path / "fd.dbc").write_text(fd_dbc(30))
    setup = config(fd_config(30, f"sensor_of = {[1] * 29 + [2]}"))
    assert setup.decoder.decode(32, False, bytes(64), 0, classic=False) is None
    assert setup.decoder.counters.not_data == 1
    sample = setup.decoder.decode(32, False, bytes([0x90, 0x88] * 32), 0)
    assert np.allclose(sample.voltage_V, 3.7)


@pytest.mark.parametrize(
    ("pack", "told"),
    [
        ("sensor_of = [1, 2]", "pack.sensor_of: expected the number of a sensor for each of 30 cells, not of 2"),
        (f"sensor_of = {[1] * 30}", "pack.sensor_of is 1; expected sensors 1 to 2"),
        (f"sensor_of = {[3] * 30}", "pack.sensor_of is 3; expected sensors 1 to 2"),
        ("", "one for each of 30 cells (pack.sensor_of allows any number)"),
        ("pulse_s = 0.0", "pack.pulse_s is 0.0; expected greater than 0"),
    ],
)
def test_a_pack_that_is_wired_wrongly_is_one_line(config, tmp_path, pack, told):
    (tmp_path / "fd.dbc").write_text(fd_dbc(30))
    with pytest.raises(ConfigError) as caught:
        config(fd_config(30, pack))
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)
