"""A daemon and a vehicle around it, for whoever measures or makes up the samples himself."""

from __future__ import annotations

from pathlib import Path

from bms_ukf.expectations.record import SILENT_S
from bms_ukf.hil.hosted import Hosted
from bms_ukf.hil.process import Process
from bms_ukf.hil.receiver import Receiver
from bms_ukf.hil.unit import Unit, write_config
from bms_ukf.node import SampleEncoder
from bms_ukf.records import Estimate, Sample
from bms_ukf.scenario import Scenario

IN_PROCESS = ("direct", "virtual")


def open_unit(scenario: Scenario, path: Path, folder: Path, interface: str, channel: str | None = None) -> Unit:
    """The daemon of a scenario (found at `path`), with its files in `folder`: here, or as a process of its own.

    `channel` None: a bus of its own here, that of the scenario elsewhere. Raises ConfigError for what is not usable.
    """
    config = write_config(folder, scenario, path, interface, channel or scenario.bus.channel)
    if interface in IN_PROCESS:
        return Hosted(config, interface, channel, realtime=scenario.pace.mode == "realtime")
    return Process(config, interface, channel or scenario.bus.channel)


class Bench:
    """`unit` runs; `exchange` is a step of the vehicle."""

    def __init__(self, unit: Unit, scenario: Scenario) -> None:
        self.unit = unit
        self._step_ns = round(scenario.step_s * 1e9)
        self._encoder, self._receiver = SampleEncoder(scenario.cells, scenario.daemon.temperature_sensors), Receiver()
        self._last: Estimate | None = None

    def exchange(self, sample: Sample) -> Estimate | None:
        """Send a sample's frames at its time, which only grows from 0 on; the daemon's last answer, None if it is old.

        Against a daemon in a process of its own this waits for that time by the clock on the wall.
        """
        self.unit.advance(sample.t_ns)
        for frame in self._encoder.encode(sample):
            self.unit.send(frame)
        answer = self._receiver.read(self.unit.answers(sample.t_ns + self._step_ns), sample.t_ns)
        if answer is not None:
            self._last = answer
        elif self._last is not None and sample.t_ns - self._last.t_ns > SILENT_S * 1e9:
            self._last = None
        return self._last
