"""What the daemon says: lines for people or JSON for collectors, and few of those that could come with every frame."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import ValidationError

from bms_ukf import seldom
from bms_ukf.logsetup import JsonLines, Log, to_stderr
from bms_ukf.seldom import Seldom

log = logging.getLogger("bms_ukf.test")


@pytest.fixture
def lines(capsys) -> Iterator[list[str]]:
    """Those written to stderr, once it is done."""
    root = logging.getLogger()
    before = root.handlers[:], root.level
    written: list[str] = []
    yield written
    for handler in set(root.handlers) - set(before[0]):
        root.removeHandler(handler)
    root.handlers[:], root.level = before


def test_a_json_line_tells_the_values_apart_from_what_happened(capsys, lines):
    to_stderr(Log(format="json"))
    log.warning("bus: frame 0x%(id)X not sent: %(error)s", {"id": 0x220, "error": OSError("full")})
    log.debug("not wanted")
    (line,) = capsys.readouterr().err.splitlines()
    told = json.loads(line)
    assert told.pop("ts").endswith("+00:00")
    assert told == {
        "level": "warning",
        "source": "bms_ukf.test",
        "message": "bus: frame 0x220 not sent: full",
        "event": "bus: frame 0x%(id)X not sent: %(error)s",
        "fields": {"id": 0x220, "error": "full"},
        "left_out": 0,
    }


def test_lines_of_libraries_and_of_exceptions_are_json_too(capsys, lines):
    to_stderr(Log(format="json"))
    logging.getLogger("can").error("from %s", "elsewhere", exc_info=ValueError("two\nlines"))
    (line,) = capsys.readouterr().err.splitlines()
    told = json.loads(line)
    assert (told["source"], told["message"], told["fields"]) == ("can", "from elsewhere", {})
    assert "two\nlines" in told["exception"]


def test_text_is_one_plain_line_and_the_level_is_kept(capsys, lines):
    to_stderr(Log(level="error"))
    log.warning("not wanted")
    log.error("current: %(seen)s", {"seen": "wrong"})
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(" ERROR current: wrong")


def test_changing_the_format_does_not_say_everything_twice(capsys, lines):
    for form in ("text", "json", "text"):
        to_stderr(Log(format=form))
    log.info("once")
    assert capsys.readouterr().err.count("once") == 1


def test_a_line_that_comes_with_every_frame_is_written_seldom_and_keeps_its_event(caplog, monkeypatch):
    now_s = 100.0
    monkeypatch.setattr(seldom.time, "monotonic", lambda: now_s)
    told = Seldom(log)
    for k in range(1000):
        now_s = 100.0 + k * 0.015
        told.warning("bus: %(error)s", error=k)
    assert [record.getMessage() for record in caplog.records] == [
        "bus: 0",
        "bus: 667 (666 more since the last such line)",
    ]
    parsed = [json.loads(JsonLines().format(record)) for record in caplog.records]
    assert [(line["event"], line["left_out"]) for line in parsed] == [("bus: %(error)s", 0), ("bus: %(error)s", 666)]


def test_a_few_lines_of_what_is_rare_are_written_at_once_and_no_flood(caplog, monkeypatch):
    now_s = 100.0
    monkeypatch.setattr(seldom.time, "monotonic", lambda: now_s)
    told = Seldom(log, burst=3)
    for k in range(200):
        now_s = 100.0 + k * 0.1
        told.warning("%(k)d", k=k)
    written = [int(line.split()[0]) for line in caplog.messages]
    assert written == [0, 1, 2, 100, 101, 102]
    assert "97 more" in caplog.messages[3]


def test_a_line_without_values_is_written_as_it_is(caplog):
    Seldom(log).warning("100 % open again")
    assert caplog.messages == ["100 % open again"]


@pytest.mark.parametrize("wrong", [{"format": "xml"}, {"level": "loud"}, {"rate": 1}])
def test_a_section_that_says_something_else_is_refused(wrong):
    with pytest.raises(ValidationError):
        Log(**wrong)


def test_the_daemon_speaks_json_from_its_first_line_to_its_last(tmp_path: Path) -> None:
    (tmp_path / "bms.toml").write_text(
        'format = 1\ncell = "lgm50_chen2020"\nlog = { format = "json" }\n'
        'bus = { interface = "socketcan", channel = "can0" }\n'
    )
    code = (
        "import can; from pathlib import Path; from bms_ukf import service;"
        "service.open_bus = lambda *_: can.Bus(interface='virtual', channel='log');"
        f"service.serve(Path({str(tmp_path / 'bms.toml')!r}))"
    )
    told = []
    with subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("{"):  # not what compiling says
                told.append(json.loads(line))
                if told[-1]["event"].startswith("running: "):
                    process.terminate()
    assert process.returncode == 0
    assert [line["event"].partition(":")[0] for line in told] == ["running", "stopped"]
    assert told[-1]["fields"]["received"]["accepted"] == 0
