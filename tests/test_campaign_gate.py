"""The quick campaign as a gate: every class meets its goals, or misses them by no more than it did."""

import honesty_gate
import pytest

from bms_ukf.campaign import classes, command


@pytest.fixture(scope="module")
def quick():
    wanted = honesty_gate.quick()
    return command.summary(wanted, command.campaign(wanted))


@pytest.mark.timeout(1800)
def test_no_class_of_the_quick_campaign_is_worse_than_its_gate(quick):
    assert not honesty_gate.broken(quick, honesty_gate.held())


def test_the_gate_names_classes_and_figures_that_exist(quick):
    for name, figures in honesty_gate.held().items():
        assert name in classes.CLASSES
        assert set(figures) <= set(quick["classes"][name]["goals"])


def test_the_gate_breaks_where_a_goal_is_missed_anew_or_by_more():
    goal = {"inside_pct": 93.0, "beyond_pct": 2.0, "ok_pct": 90.0, "half_width_pct": 4.0}
    found = {"quick": True, "classes": {"rests": goal | {"runs": 12}}}
    assert not honesty_gate.broken(found, {})
    found["classes"]["rests"]["inside_pct"] = 60.0
    assert honesty_gate.broken(found, {})
    assert not honesty_gate.broken(found, {"rests": {"inside_pct": 67.0}})
    assert honesty_gate.broken(found, {"rests": {"inside_pct": 69.0}})
    found["classes"]["rests"].update(inside_pct=95.0, half_width_pct=6.0)
    assert honesty_gate.broken(found, {"rests": {"half_width_pct": 4.7}})
    assert not honesty_gate.broken(found, {"rests": {"half_width_pct": 4.9}})
