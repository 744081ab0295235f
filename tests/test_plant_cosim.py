"""`bms-ukf cosim` with plants that take power or voltage, have several cells, or fail on the way."""

from __future__ import annotations

import json

import pytest
from c_fmu import CELL_STEP, Var, build

POWERED = (Var("P", "input", "W", "0"), Var("v", "output", "V"), Var("i", "output", "A"), Var("soc", "output", "1"))
POWERED_STEP = "i = P / (3.2 + soc); soc -= i * h / 3600 / 5; v = 3.2 + soc - 0.01 * i; return 0;"
APPLIED = (Var("u", "input", "V", "3.7"), Var("i", "output", "A"), Var("soc", "output", "1"))
APPLIED_STEP = "i = (3.2 + soc - u) / 0.05; soc -= i * h / 3600 / 5; return 0;"


@pytest.fixture
def run(bms_ukf, tmp_path):
    """Runs what inspecting an FMU proposes, with words of it replaced: how it ended, and the summary."""

    def run(fmu, *words):
        text = bms_ukf("cosim", "--inspect", fmu).out
        for word, other in words:
            assert word in text
            text = text.replace(word, other)
        (tmp_path / "s.toml").write_text(text)
        ended = bms_ukf("cosim", tmp_path / "s.toml", "--json", tmp_path / "r.json")
        summary = tmp_path / "r.json"
        return ended, json.loads(summary.read_text()) if summary.exists() else None

    return run


@pytest.mark.parametrize(
    ("variables", "step", "start"),
    [(POWERED, POWERED_STEP, "soc = 0.5; v = 3.7;"), (APPLIED, APPLIED_STEP, "soc = 0.5;")],
    ids=["power", "voltage"],
)
def test_a_plant_is_driven_by_what_it_takes_and_by_a_current_too(run, tmp_path, variables, step, start):
    fmu = build(tmp_path / "p.fmu", variables, step, start)
    ended, summary = run(fmu)
    assert (ended.code, summary["n"]) == (0, 600)
    text = (tmp_path / "s.toml").read_text()
    segments = text[text.index("segments = ") :].partition("\n")[0]
    ended, summary = run(fmu, (segments, "segments = [{ rest_s = 60 }, { current_A = 2.0, duration_s = 540 }]"))
    assert (ended.code, summary["n"]) == (0, 600)


@pytest.mark.parametrize(("on_failure", "rows"), [("end", 101), ("degrade", 600)])
def test_a_run_whose_plant_crashes_ends_or_goes_on_without_measurements(run, tmp_path, on_failure, rows):
    fmu = build(tmp_path / "c.fmu", step="if (t > 100) abort();" + CELL_STEP)
    ended, summary = run(fmu, ("[plant]", f'[plant]\non_failure = "{on_failure}"'))
    assert (ended.code, summary["n"]) == (1, rows)
    assert "SIGABRT" in summary["plant_failure"]
    assert "at t = 101 s: its process was killed by SIGABRT" in ended.err


def test_a_plant_of_several_cells_is_one_line_that_says_what_takes_it(run, tmp_path):
    variables = (Var("i", "input", "A", "0"), *(Var(f"v[{k}]", "output", "V") for k in (1, 2)))
    ended, _ = run(build(tmp_path / "pack.fmu", variables, "return 0;", ""))
    assert "cells is 2; expected 1: bms-ukf hil is for several" in ended.line
