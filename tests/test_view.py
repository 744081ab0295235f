"""The terminal view: what it says, that it fits, that it is cheap, and that a log gets plain lines."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path

import pytest
from rich.console import Console

from bms_ukf import metrics
from bms_ukf.cosim import Progress
from bms_ukf.plant import PlantState
from bms_ukf.records import Estimate, Fault, Sample, Status
from bms_ukf.view import LiveView, verdict

STEPS = 1000


def terminal() -> Console:
    return Console(
        file=io.StringIO(), width=80, height=24, force_terminal=True, color_system="truecolor", record=True, _environ={}
    )


def log() -> Console:
    return Console(file=io.StringIO(), width=80, force_terminal=False, _environ={})


def progress(step: int = 500, soc: float = 0.51, sigma: float = 0.01, **changes: object) -> Progress:
    state = {
        "status": Status.OK,
        "faults": Fault.NONE,
        "sample": Sample(step * 10**9, 1.234, 3.7004, 25.26),
        "frames": 3 * step,
    } | changes
    estimate = Estimate(0, soc, sigma, 3.6991, status=state["status"], faults=state["faults"])
    estimate.soc_low, estimate.soc_high = soc - 1.96 * sigma, soc + 1.96 * sigma
    true = PlantState(step * 10**9, 3.7, 25.0, 0.5)
    return Progress(step, STEPS, 2.5, state["sample"], estimate, true, state["frames"], state["frames"])


def shown(view: LiveView, *states: Progress) -> str:
    console = terminal()
    for state in states:
        view.update(state)
    console.print(view.panel(states[-1]))
    return console.export_text()


def scored(error: float = 0.005, sigma: float = 0.01) -> dict:
    rows = 1200
    interval = [0.5 + error - 1.96 * sigma] * rows, [0.5 + error + 1.96 * sigma] * rows
    score = metrics.score(range(rows), [0.5 + error] * rows, interval, [0.5] * rows)
    return score | {"duration_s": 3600.0, "wall_s": 2.0, "realtime_factor": 1800.0}


def test_the_panel_names_every_figure_with_its_unit() -> None:
    text = shown(LiveView("demo", terminal()), progress())
    for piece in (
        "demo", "50%", "0:08:20", "200 × real time", "51.00 %", "49.04–52.96 %", "50.00 %", "+1.00 %",
        "3.7004 V", "3.6991 V", "1.23 A", "25.3 °C", "1500 / 1500", "ok",
    ):  # fmt: skip
        assert piece in text, piece


@pytest.mark.parametrize("faults", [Fault.NONE, Fault.VOLTAGE_MISSING | Fault.E2E])
def test_the_panel_fits_80_by_24_and_keeps_its_height_when_faults_come(faults: Fault) -> None:
    text = shown(LiveView("a scenario with a rather long name, as some have", terminal()), progress(faults=faults))
    lines = text.rstrip("\n").split("\n")
    assert len(lines) == 14
    assert max(map(len, lines)) <= 80
    assert ("voltage missing, e2e" in text) == bool(faults)


def test_missing_values_are_dashes_and_not_zeros_or_nan() -> None:
    state = progress(soc=math.nan, sigma=math.nan, sample=Sample(0), status=Status.INITIALISING, frames=0)
    text = shown(LiveView("demo", terminal()), state)
    assert "nan" not in text
    assert text.count("–") >= 5
    assert "initialising" in text
    assert "no bus" in text


def test_the_history_shows_the_worst_error_of_each_stretch() -> None:
    view = LiveView("demo", terminal())
    for step in range(1, 501):
        view.update(progress(step, soc=0.5 + (0.3 if step == 1 else 0.0005)))
    line = next(line for line in shown(view, progress(500, soc=0.5005)).split("\n") if "|SoC error|" in line)
    assert line.count("█") == 1
    assert line.count("▁") == 25  # half of 52 columns, less the first


def test_an_error_outside_its_band_is_red_and_one_inside_is_green() -> None:
    for soc, red_or_green in ((0.51, 32), (0.6, 31)):
        console = terminal()
        console.print(LiveView("demo", console).panel(progress(soc=soc)))
        assert re.search(rf"\x1b\[{red_or_green}m *\{100 * soc - 50:+.2f} %", console.export_text(styles=True))


def test_it_redraws_at_most_ten_times_a_second_and_always_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr("bms_ukf.view.monotonic", lambda: now[0])
    drawn = []
    view = LiveView("demo", terminal())
    monkeypatch.setattr(view, "panel", lambda state: drawn.append(state.step) or "")
    with view:
        for step in range(1, STEPS + 1):
            now[0] += 0.001
            view.update(progress(step))
    assert drawn[-1] == STEPS
    assert 10 <= len(drawn) <= 12


def test_a_log_gets_ten_plain_lines_without_control_characters() -> None:
    console = log()
    with LiveView("demo", console) as view:
        for step in range(1, STEPS + 1):
            view.update(progress(step))
    lines = console.file.getvalue().strip("\n").split("\n")
    assert len(lines) == 10
    assert "\x1b" not in "".join(lines)
    assert lines[4] == "demo:  50%  0:08:20  SoC 51.00 % (49.04–52.96 %)  true 50.00 %  error +1.00 %  ok"


def test_a_run_of_few_steps_still_gets_its_last_line() -> None:
    console = log()
    LiveView("demo", console).update(progress(STEPS))
    assert "100%" in console.file.getvalue()


@pytest.mark.parametrize(
    ("error", "sigma", "title", "words"),
    [(0.005, 0.01, "PASSED", ["pass", "pass"]), (0.03, 0.01, "FAILED", ["FAIL", "FAIL"])],
)
def test_the_verdict_says_pass_or_fail_per_goal(error: float, sigma: float, title: str, words: list[str]) -> None:
    console = log()
    verdict(scored(error, sigma), Path("out/report.html"), console)
    text = console.file.getvalue()
    assert title in text
    assert [word for word in text.split() if word in {"pass", "FAIL"}] == words
    assert f"{100 * error:.2f} %" in text
    assert "1800 × real time" in text
    assert text.rstrip().endswith("Report: out/report.html")


def test_the_verdict_says_never_when_the_error_did_not_settle() -> None:
    console = log()
    verdict(scored(error=0.03), None, console)
    assert "never" in console.file.getvalue()


def test_the_verdict_counts_rows_without_an_estimate() -> None:
    console = log()
    verdict(scored() | {"n_unavailable": 12}, None, console)
    assert "Rows without an estimate" in console.file.getvalue()


def test_a_run_without_a_reference_is_told_and_not_judged() -> None:
    console = log()
    verdict(metrics.score([0.0], [0.5], ([0.4], [0.6]), [math.nan]), None, console)
    assert console.file.getvalue() == "No reference SoC: nothing is scored.\n"


def test_a_run_without_an_estimate_is_not_taken_for_one_without_a_reference() -> None:
    console = log()
    verdict(metrics.score([0.0], [math.nan], ([math.nan], [math.nan]), [0.5]), None, console)
    assert "No estimate" in console.file.getvalue()
