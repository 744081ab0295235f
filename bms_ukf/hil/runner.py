"""Runs a scenario against the daemon.

    plant -> sensors -> sensor faults -> frames -> bus faults -> daemon -> frames -> receiver -> record -> verdict

In lockstep all frames of a step are delivered and answered before the next, and everything that is random is seeded:
the same file gives the same trace, bit for bit, over each transport in this process.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from itertools import count
from pathlib import Path

from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.expectations.base import Verdict
from bms_ukf.expectations.record import Record
from bms_ukf.faults.can import Wire
from bms_ukf.hil.bench import IN_PROCESS, open_unit
from bms_ukf.hil.process import Process
from bms_ukf.hil.receiver import Receiver
from bms_ukf.hil.result import Result
from bms_ukf.hil.source import Source
from bms_ukf.hil.timeline import Timeline
from bms_ukf.hil.unit import Unit
from bms_ukf.node import SampleEncoder
from bms_ukf.scenario import Scenario

Watch = Callable[[int, int], None]  # steps done, and steps in all


def run(
    scenario: Scenario, path: Path, interface: str | None = None, channel: str | None = None, watch: Watch | None = None
) -> Result:
    """Run a scenario (found at `path`) over an interface, of the scenario if None, and judge it.

    Raises ConfigError for what the scenario names and is not usable.
    """
    interface = interface or scenario.bus.interface
    result = Result(scenario.name, path, interface, scenario.sensors.seed)
    if interface not in IN_PROCESS and (why := Process.obstacle(scenario.fault, interface)) is not None:
        result.reason = why
        return result
    with tempfile.TemporaryDirectory(prefix="bms-ukf-hil-") as folder:
        unit = open_unit(scenario, path, Path(folder), interface, channel)
        _run(scenario, path, unit, result, watch)
    return result


def _run(scenario: Scenario, path: Path, unit: Unit, result: Result, watch: Watch | None) -> None:
    step_ns = round(scenario.step_s * 1e9)
    wire = Wire(scenario.fault, scenario.sensors.seed)
    encoder = SampleEncoder(scenario.cells, scenario.daemon.temperature_sensors)
    receiver = Receiver(scenario.cells)
    with ExitStack() as stack:
        source = stack.enter_context(Source(scenario, path))
        record = result.record = Record(scenario.fault)
        stack.enter_context(unit)
        timeline = Timeline(scenario.fault, unit)
        started = time.perf_counter()
        try:
            for k in count(1):
                t_ns = k * step_ns
                if (stepped := source.step(t_ns)) is None:
                    break
                true, sample = stepped
                result.overruns += not unit.advance(t_ns)
                timeline.reach(t_ns)
                wire.put(encoder.encode(sample), t_ns, step_ns)
                for due_ns, frame in wire.due(t_ns + step_ns):
                    unit.advance(due_ns)
                    unit.send(frame)
                    result.frames_in += 1
                answer = receiver.read(unit.answers(t_ns + step_ns), t_ns)
                record.append(sample, answer, true, receiver.cells.take() if receiver.cells is not None else None)
                if watch is not None:
                    watch(k, source.steps_at_most)
        except PlantError as error:
            result.reason = str(error)
        if not len(record.trace) and source.failure is None:
            raise ConfigError(path, key="load", expected="at least one step before its limits are reached")
        result.wall_s = time.perf_counter() - started
        result.frames_out, record.stored, record.plant_failure = receiver.frames, receiver.stored, source.failure
    result.matrix = record.matrix()
    result.verdicts = [expectation.verdict(record) for expectation in scenario.expect] + _went_on(scenario, result)


def _went_on(scenario: Scenario, result: Result) -> list[Verdict]:
    """A plant that fails fails the scenario, unless the scenario expects that."""
    failure = result.record.plant_failure if result.record is not None else None
    if any(expectation.kind == "plant_failure" for expectation in scenario.expect):
        return []
    return [Verdict("the plant runs to the end", result.reason or failure or "it does", failure is None)]
