"""The pytest plugin as its users have it: ten lines of theirs, in a pytest of its own."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

# A pytest in this process forgets, at its end, what it imported: what it uses is imported before.
import bms_ukf.hil.runner
import bms_ukf.scenario  # noqa: F401

pytest_plugins = ["pytester"]

PLUGIN = "bms_ukf.pytest_plugin"
HEAVY = ("numpy", "numba", "scipy", "can", "cantools", "fmpy", "pydantic", "rich", "matplotlib", "click")
SCENARIO = """
format = 1
name = "mine"
plant = { fmu = "lgm50_spme", parameters = { soc_initial = 0.8 } }
load = { segments = [{ rest_s = 5 }, { current_A = 5.0, duration_s = 15 }] }
estimator = { cell = "lgm50_chen2020" }
[[expect]]
kind = "soc_error"
below = 0.05
"""
README = Path(__file__).resolve().parents[1] / "README.md"


@pytest.fixture
def mine(pytester):
    pytester.makefile(".toml", mine=SCENARIO, wrong=SCENARIO.replace("below = 0.05", "below = 1e-6"))
    return pytester


def run(pytester, *arguments: str):
    return pytester.runpytest_inprocess("-p", PLUGIN, "-p", "no:cacheprovider", *arguments)


def test_the_readmes_ten_lines_pass(mine):
    section = README.read_text("utf-8").partition("**Your own tests.**")[2]
    example = section.partition("```python\n")[2].partition("```")[0]
    wire = '[[fault]]\nkind = "open_wire"\nsignal = "voltage_V"\nat_s = 8\n'
    mine.makefile(".toml", open_wire=SCENARIO + wire)
    mine.makepyfile(example)
    run(mine).assert_outcomes(passed=2)


def test_a_marked_test_runs_its_scenario_and_fails_by_the_expectation(mine):
    mine.makepyfile(
        """
        import pytest

        @pytest.mark.hil("mine.toml")
        def test_it_passes(hil):
            assert hil.soc_error_max < 0.05

        @pytest.mark.hil("wrong.toml")
        def test_it_fails():
            pass

        @pytest.mark.hil("no_such.toml")
        def test_it_is_not_there():
            pass
        """
    )
    result = run(mine, "--junitxml=junit.xml", "--strict-markers")
    result.assert_outcomes(passed=1, failed=1, errors=1)
    result.stdout.fnmatch_lines(["*soc_error: at most 0.00 % from 0 s to the end; found *"])
    result.stdout.fnmatch_lines(["no_such.toml: expected a file, or one of the shipped scenarios: *"])
    assert 'name="trace_sha256"' in (mine.path / "junit.xml").read_text()


def test_what_an_interface_cannot_do_is_skipped_with_the_reason(mine):
    (mine.path / "mine.toml").write_text(SCENARIO + '[[fault]]\nkind = "clock_step"\nstep_s = 60.0\nat_s = 3\n')
    mine.makepyfile("import pytest\n\n@pytest.mark.hil('mine.toml')\ndef test_it():\n    pass\n")
    result = run(mine, "--can-interface=socketcan", "--can-channel=vcan0", "-rs")
    result.assert_outcomes(skipped=1)
    result.stdout.fnmatch_lines(["*not run: clock_step: *"])


def test_what_the_daemon_sends_is_heard_by_another_node_on_its_bus(mine):
    mine.makepyfile(
        """
        from bms_ukf import Sample

        def test_it(can_bus, bms):
            bms.exchange(Sample(1_000_000_000, 1.0, 3.9, 25.0))
            ids = set()
            while (message := can_bus.recv(0.0)) is not None:
                ids.add(message.arbitration_id)
            assert {0x120, 0x220} <= ids
        """
    )
    run(mine).assert_outcomes(passed=1)


def test_loading_it_imports_nothing_heavy():
    code = f"import sys, {PLUGIN}; print(*(name for name in {HEAVY} if name in sys.modules))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not ended.stdout.split()


def test_pytest_finds_it_where_the_package_is_installed():
    names = [entry.value for entry in entry_points(group="pytest11") if entry.value == PLUGIN]
    if not names:
        pytest.skip("the package is not installed here")
    assert names == [PLUGIN]
