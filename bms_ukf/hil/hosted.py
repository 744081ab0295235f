"""The daemon in this process, on a cable: it serves its bus when told to, and its clocks are the scenario's."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Self

from bms_ukf import slots, state
from bms_ukf.clock import StampClock
from bms_ukf.config import Setup
from bms_ukf.daemon import Daemon
from bms_ukf.frames import Frame
from bms_ukf.hil.cable import Cable, LockstepBus
from bms_ukf.hil.unit import STATE
from bms_ukf.records import Status
from bms_ukf.slots import Slot

EPOCH_NS = 1_800_000_000_000_000_000  # the wall clock at the start of every scenario: 2027-01-15T08:00Z
LATE_S = 0.001


class Hosted:
    """A `Unit`. In lockstep nothing depends on how fast this machine is: the same scenario gives the same frames."""

    def __init__(self, config: Path, interface: str, channel: str | None = None, *, realtime: bool = False) -> None:
        """`channel` is as of `Cable`. `realtime`: time passes as on the wall."""
        self._setup = Setup.load(config)
        self._state_period_s = self._setup.config.state.period_s if self._setup.config.state else 0.0
        self.state = config.parent / STATE
        self._realtime = realtime
        self._cable = Cable(interface, channel)
        self._t_ns = self._offset_ns = self._store_at_ns = 0
        self._before: Slot | None = None
        self._daemon: Daemon | None = None
        self._unserved = False

    def __enter__(self) -> Self:
        self.start()
        self._started_s = time.monotonic()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop()
        self._cable.close()

    def advance(self, t_ns: int) -> bool:
        if self._unserved:
            self._serve()
        self._t_ns = t_ns
        if not self._realtime:
            return True
        left_s = self._started_s + t_ns * 1e-9 - time.monotonic()
        time.sleep(max(left_s, 0.0))
        return left_s > -LATE_S

    def send(self, frame: Frame) -> None:
        self._cable.send(frame, self._wall_ns() * 1e-9)
        self._unserved = True

    def answers(self, until_ns: int) -> list[Frame]:
        self._serve()
        found = []
        while (message := self._cable.vehicle.recv(0.0)) is not None:
            found.append((message.arbitration_id, message.is_extended_id, bytes(message.data)))
        return found

    def interface(self, *, up: bool) -> None:
        self._cable.up = up

    def kill(self) -> None:
        self._stop()

    def start(self) -> None:
        config = self._setup.config
        setup = Setup(config, self._setup.source)  # a decoder that has seen nothing
        estimator = setup.estimator()
        self._bus = LockstepBus(self._cable, lambda: self._t_ns * 1e-9)
        clock = StampClock(lambda: self._t_ns)
        self._daemon = Daemon(
            self._bus,
            estimator,
            setup.intake(),
            clock=clock,
            pace=setup.pace,
            fd=config.bus.fd,
            pack=setup.pack_output(estimator),
            health=setup.health(estimator),
        )
        if config.state is not None:
            age_s = config.state.max_age_s
            now_ns, health = self._daemon.now_ns(), self._daemon.health
            stored, _ = state.resume(estimator, self.state, self._wall_ns(), now_ns, age_s, health)
            self._daemon.resumed(stored)
        self._store_at_ns = self._t_ns + round(1e9 * self._state_period_s)

    def set_clock(self, offset_s: float) -> None:
        self._offset_ns = round(1e9 * offset_s)

    def _serve(self) -> None:
        """Have the daemon take what is on its bus, and publish what is due."""
        self._unserved = False
        if self._daemon is not None:
            self._bus.idle.clear()
            self._daemon.run(self._bus.idle)
            if self._t_ns >= self._store_at_ns:
                self._store(self._daemon)

    def _store(self, daemon: Daemon) -> None:
        """As the service does, but at the scenario's time and before anything else happens."""
        self._store_at_ns = self._t_ns + round(1e9 * self._state_period_s)
        if daemon.estimate.status in {Status.OK, Status.DEGRADED}:
            slot = Slot(self._wall_ns(), state.content(daemon.estimator, daemon.health))
            slots.write(self.state, slot, self._before)
            self._before = slot

    def _stop(self) -> None:
        if self._daemon is not None:
            self._bus.close()
            self._daemon = None

    def _wall_ns(self) -> int:
        return EPOCH_NS + self._t_ns + self._offset_ns
