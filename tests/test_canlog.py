"""CAN logs through the daemon: what would have been published is what comes out, whatever the format, every time."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import pytest
from model_cell import ModelCell

from bms_ukf import ConfigError, Estimator, Sample, Status
from bms_ukf.config import Setup
from bms_ukf.framelog import FrameLog
from bms_ukf.node import SampleEncoder
from bms_ukf.replay import canlog, logs
from bms_ukf.replay.logs import LogClock, frames

START_S = 1_700_000_000.0
CONFIG = """
format = 1
cell = "lgm50_chen2020"
silence_s = 2.5
bus = { interface = "socketcan", channel = "can0" }
"""
ALL = [(0x120, False), (0x121, False), (0x122, False)]


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "bms.toml").write_text(CONFIG)
    return tmp_path / "bms.toml"


@pytest.fixture
def drive(cell) -> list[Sample]:
    battery = ModelCell(cell, 0.7)
    volts = [battery.step(1.0, 1.0) for _ in range(100)]
    return [Sample(k * 10**9, 1.0, round(v / 0.0005) * 0.0005, 25.0) for k, v in enumerate(volts)]


@pytest.fixture
def logged(tmp_path: Path, drive) -> Callable[..., Path]:
    """Writes a log of a drive, as its name says."""

    def write(name: str = "drive.log", samples: list[Sample] = drive) -> Path:
        encoder, writer = SampleEncoder(), can.Logger(tmp_path / name)
        for sample in samples:
            stamp_s = START_S + sample.t_ns * 1e-9
            writer(can.Message(stamp_s - 1e-3, 0x7FF, False, data=b"other", channel=0))
            for number, extended, data in encoder.encode(sample):
                writer(can.Message(stamp_s, number, extended, data=data, channel=0))
        writer.stop()
        return tmp_path / name

    return write


def test_a_log_gives_what_the_estimator_alone_says_of_its_samples(logged, config, cell, drive):
    trace, summary = canlog.rerun(logged(), config)
    alone = Estimator(cell, tuning=Setup.load(config).tuning)
    known = [alone.step(sample) for sample in drive]
    assert len(trace) == len(drive)
    np.testing.assert_allclose(trace["soc"], [e.soc for e in known], atol=1e-6)
    np.testing.assert_allclose(trace["nis"], [e.nis for e in known], atol=1e-2)
    assert (summary["samples"], summary["frames"]["accepted"]) == (300, 300)
    assert trace.t_s[-1] - trace.t_s[0] == pytest.approx(99.0, abs=1e-5)
    assert trace["current_A"][-1] == 1.0


@pytest.mark.parametrize("name", ["drive.asc", "drive.blf", "drive.trc", "drive.mf4"])
def test_every_format_gives_the_same(logged, config, name):
    first, _ = canlog.rerun(logged(), config)
    other, _ = canlog.rerun(logged(name), config)
    np.testing.assert_allclose(other["soc"], first["soc"], atol=1e-5)
    np.testing.assert_allclose(other.t_s, first.t_s, atol=2e-3)


def test_twice_the_same_log_gives_twice_the_same_bits(logged, config):
    path = logged()
    first, second = canlog.rerun(path, config)[0], canlog.rerun(path, config)[0]
    assert first["soc"].tobytes() == second["soc"].tobytes()
    assert first.t_ns.tobytes() == second.t_ns.tobytes()


def test_silence_in_a_log_is_answered_by_predictions_as_on_a_bus(logged, config, drive):
    trace, _ = canlog.rerun(logged(samples=drive[:50] + drive[80:]), config)
    silent = (trace.t_s > 49.5) & (trace.t_s < 79.5)
    assert 8 <= silent.sum() <= 12
    assert (trace.status[silent][2:] == Status.DEGRADED).all()
    assert trace.status[-1] == Status.OK


def test_a_steady_period_is_kept(logged, config):
    config.write_text(CONFIG.replace("silence_s = 2.5", 'transmit = "periodic"\nperiod_s = 0.5'))
    trace, _ = canlog.rerun(logged(), config)
    assert 195 <= len(trace) <= 200
    assert np.median(np.diff(trace.t_s)) == pytest.approx(0.5, abs=1e-3)


def test_a_clock_set_back_in_a_log_is_told_and_takes_no_time(logged, config, drive):
    path = logged()
    lines = path.read_text().splitlines(keepends=True)
    late = [line.replace("(17000000", "(16999000", 1) for line in lines[200:]]
    path.write_text("".join(lines[:200] + late))
    trace, summary = canlog.rerun(path, config)
    assert summary["warnings"] == ["the clock that stamped the frames was set back 1 times"]
    assert (np.diff(trace.t_ns) >= 0).all()
    assert trace.t_s[-1] == pytest.approx(99.0, abs=2.5)


def test_stamps_a_little_out_of_order_do_not_turn_time_back():
    clock = LogClock()
    times = [clock.at(START_S + s) for s in (0.0, 1.0, 0.9, 1.1)]
    assert times == [0, 10**9, 10**9, 1_100_000_000]
    assert clock.steps == 0


def test_a_log_that_was_cut_off_is_read_to_its_end_and_one_that_is_none_is_refused(logged, tmp_path):
    path = logged()
    text = path.read_text()
    path.write_text(text[:-30])
    assert len(list(frames(path, ALL))) == 299
    cut = text.index("\n", 1000) + 1
    path.write_text(text[:cut] + "nothing\n" + text[cut:])
    with pytest.raises(ConfigError, match="a line of candump -L"):
        list(frames(path, ALL))
    path.write_text(text.replace("122#", "122#x", 1))
    with pytest.raises(ConfigError, match="a line of candump -L"):
        list(frames(path, ALL))


# python-can's reader of .blf leaves a file it cannot read to the garbage collector, which warns.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", ["x.log", "x.asc", "x.blf", "x.trc", "x.mf4"])
def test_a_file_that_is_no_log_is_one_line(tmp_path, config, name):
    (tmp_path / name).write_bytes(b"\x01nothing\n")
    with pytest.raises(ConfigError):
        canlog.rerun(tmp_path / name, config)


def test_extended_remote_and_fd_frames_of_candump_are_told_apart(tmp_path):
    (tmp_path / "x.log").write_text(
        "(1.0) can0 120#11\n(1.1) can0 00000120#22\n(1.2) can0 120#R\n(1.3) can0 120##0AABB\n(1.4) can0 120#\n"
    )
    classic = list(frames(tmp_path / "x.log", [(0x120, False)]))
    assert [(data, told) for *_, data, told in classic] == [
        (b"\x11", True),
        (b"", False),
        (b"\xaa\xbb", False),
        (b"", True),
    ]
    assert [told for *_, told in frames(tmp_path / "x.log", [(0x120, False)], fd=True)] == [True, False, True, True]
    assert list(frames(tmp_path / "x.log", [(0x120, True)])) == [(1.1, 0x120, True, b"\x22", True)]


def test_a_candump_log_is_read_as_python_can_reads_it_whatever_else_is_on_the_bus(tmp_path):
    dice, ids = random.Random(3), [(0x1DB, False), (0x7, False), (0x18FF50E5, True)]
    others = [(0x1DA, False), (0xDB, False), (0x1DB, True), (0x500, False)]
    with can.CanutilsLogWriter(tmp_path / "x.log", channel="vcan0") as writer:
        for k in range(3000):
            number, extended = dice.choice(ids + others)
            data = dice.randbytes(dice.randrange(9))
            writer(can.Message(START_S + k * 1e-3, number, extended, data=data, channel="can12", is_rx=k % 2 == 0))
    theirs = [
        (m.timestamp, m.arbitration_id, m.is_extended_id, bytes(m.data), True)
        for m in can.LogReader(tmp_path / "x.log")
        if (m.arbitration_id, m.is_extended_id) in ids
    ]
    assert list(frames(tmp_path / "x.log", ids)) == theirs
    assert 1000 < len(theirs) < 2000


def test_a_log_read_in_pieces_is_the_log(tmp_path, monkeypatch):
    lines = [f"({k}.000001) can0 {'120' if k % 3 else '121'}#{k % 256:02X}\n" for k in range(500)]
    (tmp_path / "x.log").write_text("".join(lines))
    whole = list(frames(tmp_path / "x.log", [(0x120, False)]))
    for size in (1, 27, 100, 4000):
        monkeypatch.setattr(logs, "_CHUNK_BYTES", size)
        assert list(frames(tmp_path / "x.log", [(0x120, False)])) == whole
        (tmp_path / "y.log").write_text("".join(lines) + "x\n" + lines[0])
        with pytest.raises(ConfigError, match="line 501"):
            list(frames(tmp_path / "y.log", [(0x120, False)]))


def test_a_log_without_any_frame_of_interest_is_one_line(tmp_path, config):
    (tmp_path / "x.log").write_text("(1.0) can0 7FF#11\n")
    with pytest.raises(ConfigError, match="frames of CellTemperatures, CellVoltages, PackMeasurement"):
        canlog.rerun(tmp_path / "x.log", config)


@pytest.mark.parametrize("name", ["frames.log", "frames.asc", "frames.blf", "frames.trc", "frames.mf4"])
def test_what_the_daemon_writes_can_be_replayed(tmp_path, drive, config, name):
    log, encoder = FrameLog(tmp_path / name), SampleEncoder()
    for sample in drive[:20]:
        for number, extended, data in encoder.encode(sample):
            log.received(can.Message(START_S + sample.t_ns * 1e-9, number, extended, data=data))
    log.sent(can.Message(0.0, 0x220, False, data=bytes(8)))
    log.close()
    assert len(list(frames(tmp_path / name, ALL))) == 60
    trace, _ = canlog.rerun(tmp_path / name, config)
    assert len(trace) >= 20


def test_a_full_medium_ends_the_log_and_nothing_else(tmp_path, monkeypatch, caplog):
    log = FrameLog(tmp_path / "x.log")

    def full(_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(log._writer, "on_message_received", full)
    for _ in range(3):
        log.received(can.Message(1.0, 0x120, False, data=b"1"))
    log.close()
    assert [line for line in caplog.messages if "No space left" in line] == caplog.messages[:1]


def test_on_the_command_line(tmp_path, logged, config, monkeypatch, capsys):
    from bms_ukf import cli

    def bms_ukf(*arguments: object) -> int:
        monkeypatch.setattr("sys.argv", ["bms-ukf", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return int(ended.value.code or 0)

    log, out = logged(), tmp_path / "sum.json"
    assert bms_ukf("replay", log, "--config", config, "--json", out, "--report", tmp_path / "r.html") == 0
    assert json.loads(out.read_text())["n"] == 100
    assert (tmp_path / "r.html").stat().st_size > 10_000
    assert bms_ukf("replay", log, "--config", config, "--diff", "lgm50", "--json", out) == 0
    assert json.loads(out.read_text())["diff"]["from_first"]["max_pct"] > 0
    capsys.readouterr()
    for arguments, line in (
        ((log,), "--config: expected the configuration by which"),
        ((log, "--config", config, "--resample", "1"), "--resample is 1.0; expected no such option for CAN logs"),
        ((tmp_path / "x.csv",), "--cell: expected a cell file"),
        ((tmp_path / "x.csv", "--cell", "lgm50"), "--current-positive: expected charge or discharge"),
    ):
        assert bms_ukf("replay", *arguments) == 2
        assert line in capsys.readouterr().err
