"""pytest's way to the daemon: fixtures `plant`, `bms` and `can_bus`, and scenarios as tests.

pytest loads this in every environment that has the package, so nothing of it is imported until a test asks for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    import can

    from bms_ukf.hil.bench import Bench
    from bms_ukf.hil.result import Result
    from bms_ukf.plant import Plant
    from bms_ukf.scenario import Scenario

MARK = "hil(scenario): run a scenario of bms-ukf first, found beside the test or shipped; the test fails if it does"
DEFAULT = "demo"
_serial = count()
_RESULT = pytest.StashKey["Result"]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("bms-ukf", "tests of the battery daemon")
    group.addoption("--can-interface", help="of python-can, with the daemon as a process of its own; default: virtual")
    group.addoption("--can-channel", help="of --can-interface")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", MARK)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> None:
    """A scenario that failed fails its test, before the test's own lines."""
    result = item.stash.get(_RESULT, None)
    if result is not None and result.outcome == "failed":
        failed = [f"{each.wanted}; found {each.found}" for each in result.verdicts if not each.passed]
        pytest.fail("\n".join([f"{result.path}:", *failed]), pytrace=False)


@pytest.fixture
def hil_scenario(request: pytest.FixtureRequest) -> tuple[Scenario, Path]:
    """The scenario of the mark, else the shipped demo, and its path; override it for `plant` and `bms` of your own."""
    from bms_ukf import ConfigError, scenario

    mark = request.node.get_closest_marker("hil")
    name = DEFAULT if mark is None else mark.args[0]
    beside = request.path.parent / name
    try:
        return scenario.load(beside if beside.is_file() else name)
    except ConfigError as error:
        told = str(error)
    pytest.fail(told, pytrace=False)


@pytest.fixture
def hil(request: pytest.FixtureRequest, hil_scenario: tuple[Scenario, Path]) -> Result:
    """What came of the scenario, which has run; a test of one that failed does not get as far as its own lines."""
    from bms_ukf.hil import runner

    interface, channel = request.config.getoption("--can-interface"), request.config.getoption("--can-channel")
    result = runner.run(*hil_scenario, interface, channel)
    request.node.user_properties.append(("trace_sha256", result.trace_hash))
    if result.outcome == "not run":
        pytest.skip(f"not run: {result.reason}")
    request.node.stash[_RESULT] = result
    return result


@pytest.fixture(autouse=True)
def _hil_of_the_mark(request: pytest.FixtureRequest) -> None:
    if request.node.get_closest_marker("hil") is not None:
        request.getfixturevalue("hil")


@pytest.fixture
def plant(hil_scenario: tuple[Scenario, Path]) -> Iterator[Plant]:
    """The plant of `hil_scenario`, at t = 0: `plant.step(current_A, step_ns)`."""
    from bms_ukf.plant import open_plant

    found, path = hil_scenario
    with open_plant(found.plant, path.parent) as plant:
        yield plant


@pytest.fixture
def can_place(request: pytest.FixtureRequest) -> tuple[str, str]:
    """Interface and channel of the test's bus; a virtual one is its own."""
    interface = request.config.getoption("--can-interface") or "virtual"
    return interface, request.config.getoption("--can-channel") or f"bms-ukf-test-{next(_serial)}"


@pytest.fixture
def can_bus(can_place: tuple[str, str]) -> Iterator[can.BusABC]:
    """A node of its own on the bus, as python-can has it: what it sends, `bms` hears, and the other way round."""
    from bms_ukf.bus import open_bus
    from bms_ukf.config import Bus

    with open_bus(Bus(interface=can_place[0], channel=can_place[1]), "--can-interface") as bus:
        yield bus


@pytest.fixture
def bms(can_place: tuple[str, str], hil_scenario: tuple[Scenario, Path], tmp_path: Path) -> Iterator[Bench]:
    """The daemon of `hil_scenario`, running: `bms.exchange(sample)` sends a vehicle's frames and returns its answer."""
    from bms_ukf.hil.bench import Bench, open_unit

    found, path = hil_scenario
    with open_unit(found, path, tmp_path, *can_place) as unit:
        yield Bench(unit, found)
