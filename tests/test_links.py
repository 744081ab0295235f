"""The two ways from a sample to an estimate."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from can import CanOperationError, Message

from bms_ukf import CellParams, ConfigError, Estimator, Sample, Status, Tuning, links
from bms_ukf.bus import open_bus
from bms_ukf.config import Bus
from bms_ukf.links import BusLink, DirectLink

SECOND_NS = 1_000_000_000

_channels = (f"test-links-{k}" for k in itertools.count())


def sample(k: int, cells: int = 1) -> Sample:
    voltage_V = 3.8 if cells == 1 else [3.8 + 0.01 * cell for cell in range(cells)]
    return Sample(k * SECOND_NS, 1.0, voltage_V, 25.0)  # type: ignore[arg-type]


@pytest.fixture
def settings():
    return Bus(interface="virtual", channel=next(_channels))


def informed(cell: CellParams) -> Estimator:
    """An estimator with an initial SoC: its status shows the link, not the uncertainty of a start."""
    return Estimator(cell, tuning=Tuning(initial_soc=0.6, initial_soc_sigma=0.02))


@pytest.fixture
def link(cell, settings):
    link = BusLink(informed(cell), settings, "test")
    yield link
    link.close()


def test_the_direct_link_is_the_estimator(cell):
    link, alone = DirectLink(Estimator(cell)), Estimator(cell)
    for k in range(1, 10):
        answer, own = link.exchange(sample(k)), alone.step(sample(k))
        np.testing.assert_equal(dataclasses.asdict(answer), dataclasses.asdict(own))
    assert (link.frames_in, link.frames_out) == (0, 0)
    link.close()


def test_over_the_bus_every_sample_is_answered_in_its_own_step(link):
    for k in range(1, 10):
        estimate = link.exchange(sample(k))
        assert (estimate.t_ns, estimate.status) == (k * SECOND_NS, Status.OK)
        assert (link.frames_in, link.frames_out) == (3 * k, 6 * k)


def test_a_sample_that_is_lost_on_the_bus_has_no_estimate_and_the_next_one_has(link, monkeypatch):
    link.exchange(sample(1))
    with monkeypatch.context() as lossy:
        lossy.setattr(link._vehicle, "send", lambda frame, t_ns: False)
        lost = link.exchange(sample(2))
    assert lost.status is Status.INVALID
    assert math.isnan(lost.soc)
    assert link.exchange(sample(3)).status is Status.DEGRADED, "the counters tell the daemon of the loss"
    assert link.exchange(sample(5)).status is Status.OK
    assert link.frames_in == 9


def test_other_traffic_on_the_channel_changes_nothing(link, cell, settings):
    alone = BusLink(informed(cell), Bus(interface="virtual", channel=next(_channels)), "test")
    with open_bus(settings, "test") as other:
        for k in range(1, 20):
            other.send(Message(arbitration_id=0x123, is_extended_id=False, data=bytes(8)))
            other.send(Message(arbitration_id=0x121, is_extended_id=True, data=b"\xff" * 8))
            assert link.exchange(sample(k)) == alone.exchange(sample(k))
    alone.close()


def test_an_interface_that_opens_once_only_is_refused_and_not_left_open(cell, settings, monkeypatch):
    opened = []

    def open_once(*arguments: object) -> object:
        if opened:
            raise ConfigError("test", expected="an interface that is not in use")
        opened.append(open_bus(*arguments))  # type: ignore[arg-type]
        return opened[0]

    monkeypatch.setattr(links, "open_bus", open_once)
    with pytest.raises(ConfigError, match="not in use"):
        BusLink(Estimator(cell), settings, "test")
    with pytest.raises(CanOperationError):
        opened[0].recv(0.0)


def test_an_interface_that_cannot_be_opened_is_the_callers_mistake(cell):
    with pytest.raises(ConfigError, match=r"test: bus\.channel is 'socketcan:nocan7'"):
        BusLink(Estimator(cell), Bus(interface="socketcan", channel="nocan7"), "test")
