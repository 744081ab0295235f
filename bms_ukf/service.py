"""`bms-ukf run`: a configuration made into a running daemon, until SIGTERM (exit 0) or SIGINT (exit 130).

SIGHUP reads the configuration again. It is refused, and the daemon goes on as it was, if it is wrong, or if the
estimator would have to be another: what it knows of the battery would be lost.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import threading
import time
from dataclasses import asdict
from pathlib import Path
from types import FrameType

from bms_ukf import logsetup, roles, toml
from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.config import Config, PackUse, Setup
from bms_ukf.daemon import Daemon
from bms_ukf.errors import ConfigError
from bms_ukf.exporter import Exporter
from bms_ukf.flight import Recorder
from bms_ukf.framelog import FrameLog
from bms_ukf.notify import Notifier
from bms_ukf.records import Status, Stored
from bms_ukf.state import Keeper, content, resume

log = logging.getLogger(__name__)

STATUS_S = 5.0


def serve(path: Path, log_frames: Path | None = None) -> None:
    """Run the daemon of a CONFIG file. ConfigError if it cannot start; SIGINT raises KeyboardInterrupt at the end.

    `log_frames`: every frame received and sent is written to this file.
    """
    logsetup.to_stderr(toml.load(path, Config).log)
    stop = threading.Event()
    received: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        received.append(number)
        stop.set()

    service = Service(path, log_frames)
    signals = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
    previous = {number: signal.signal(number, on_signal) for number in signals}
    try:
        service.start()
        gc.collect()
        gc.freeze()  # or a collection would look at all that numba has loaded: 0.15 s without an answer
        while True:
            service.daemon.run(stop, service.chores)
            stop.clear()
            if {signal.SIGTERM, signal.SIGINT} & set(received):
                break
            service.reload()
    finally:
        service.close()
        for number, handler in previous.items():
            signal.signal(number, handler)
    if signal.SIGINT in received:
        raise KeyboardInterrupt


class Service:
    """The daemon of one CONFIG file, and what an operating system wants of it."""

    def __init__(self, path: Path, log_frames: Path | None = None) -> None:
        """Opens the bus and compiles. ConfigError if that is not possible."""
        self._path, self._setup = path, _checked(path)
        self._log = None if log_frames is None else FrameLog(log_frames)
        self._notify = Notifier()
        config = self._setup.config
        self._bus = self._opened(self._setup)
        self._estimator = self._setup.estimator()
        self.daemon = Daemon(
            self._bus,
            self._estimator,
            self._setup.intake(),
            pace=self._setup.pace,
            fd=config.bus.fd,
            pack=self._setup.pack_output(self._estimator),
            health=self._setup.health(self._estimator),
        )
        self._keeper = self._keeper_of(self._setup)
        self._exporter = self._exporter_of(self._setup)
        self._store_at_s = self._status_at_s = 0.0

    def start(self) -> None:
        """Take up what was stored, and say that the daemon runs."""
        state = self._setup.config.state
        if state is not None:
            place = _place(state.file, self._path)
            now_ns, health = self.daemon.now_ns(), self.daemon.health
            stored, line = resume(self._estimator, place, time.time_ns(), now_ns, state.max_age_s, health)
            level = logging.INFO if stored <= Stored.USED else logging.WARNING
            log.log(level, "state: %(state)s: %(reason)s", {"state": stored.word, "reason": line})
            self.daemon.resumed(stored)
        self.daemon.witness = self._recorder_of(self._setup)  # begins with what was taken up
        log.info("running: %(setup)s", {"setup": "; ".join(_explanation(self._setup).splitlines())})
        self._notify.ready(self._status())

    def chores(self) -> None:
        """What is to be done now and then; takes microseconds."""
        now_s = time.monotonic()
        self._notify.alive()
        state = self._setup.config.state
        if state is not None and now_s >= self._store_at_s:
            self._store()
            self._store_at_s = now_s + state.period_s
        if now_s >= self._status_at_s:
            self._notify.status(self._status())
            self._status_at_s = now_s + STATUS_S

    def reload(self) -> None:
        """Read the configuration again, and go on by it or, if that is not possible, by the one before."""
        self._notify.reloading()
        try:
            self._adopt(_checked(self._path))
            log.info("reloaded: %(setup)s", {"setup": "; ".join(_explanation(self._setup).splitlines())})
        except ConfigError as error:
            told = {"error": str(error)}
            log.error("not reloaded, and running as before: %(error)s", told)  # noqa: TRY400 - one line, as everywhere
        self._notify.ready(self._status())

    def close(self) -> None:
        """Store, and let go of the bus."""
        self._notify.stopping()
        self._store()
        if self._keeper is not None and not self._keeper.close():
            log.warning("state: %(file)s: not stored in time", {"file": self._keeper.path})
        self._bus.close()
        if self._exporter is not None:
            self._exporter.close()
        if self._log is not None:
            self._log.close()
        told = {
            "answers": self.daemon.published,
            "received": asdict(self._setup.decoder.counters),
            "bus": asdict(self._bus.counters),
        }
        log.info("stopped: %(answers)d answers; received %(received)s; bus %(bus)s", told)

    def _adopt(self, setup: Setup) -> None:
        """ConfigError, with everything as it was, if that cannot be done."""
        old, new = self._setup.config, setup.config
        if _fixed(self._setup) != _fixed(setup):
            expected = "cell, cells, wiring, balancing or not, health, sensors and [estimator] as before: "
            expected += "restart to change them"
            raise ConfigError(self._path, expected=expected)
        witness = self.daemon.witness if old.recorder == new.recorder else self._recorder_of(setup)
        if old.metrics != new.metrics:
            exporter = self._exporter_of(setup)
            if self._exporter is not None:
                self._exporter.close()
            self._exporter = exporter
        if old.log != new.log:
            logsetup.to_stderr(new.log)
        if old.bus != new.bus or sorted(self._setup.decoder.ids()) != sorted(setup.decoder.ids()):
            bus = self._opened(setup)
            self._bus.close()
            self._bus = bus
        if old.state != new.state:
            if self._keeper is not None:
                self._keeper.close()
            self._keeper = self._keeper_of(setup)
        pack = self.daemon.pack if old.pack == new.pack else setup.pack_output(self._estimator)
        self._setup, self.daemon.witness = setup, witness
        self.daemon.reconfigure(self._bus, setup.intake(), pace=setup.pace, fd=new.bus.fd, pack=pack)

    def _opened(self, setup: Setup) -> SafeBus:
        return SafeBus(lambda: open_bus(setup.config.bus, str(self._path), setup.decoder.ids()), self._log)

    def _keeper_of(self, setup: Setup) -> Keeper | None:
        state = setup.config.state
        return None if state is None else Keeper(_place(state.file, self._path))

    def _recorder_of(self, setup: Setup) -> Recorder | None:
        wanted = setup.config.recorder
        if wanted is None:
            return None
        folder = _place(wanted.folder, self._path)
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise ConfigError(self._path, key="recorder.folder", value=str(folder), expected=str(error)) from None
        return Recorder(self._estimator, folder, wanted.span_s, wanted.keep)

    def _exporter_of(self, setup: Setup) -> Exporter | None:
        wanted = setup.config.metrics
        return None if wanted is None else Exporter(self.daemon, wanted.port, str(self._path))

    def _store(self) -> None:
        """Nothing that is worth less than what was stored before takes its place."""
        if self._keeper is not None and self.daemon.estimate.status in {Status.OK, Status.DEGRADED}:
            self._keeper.keep(content(self._estimator, self.daemon.health), time.time_ns())

    def _status(self) -> str:
        estimate, counters = self.daemon.estimate, self._setup.decoder.counters
        return f"{estimate.status.word}; {counters.accepted} frames accepted, {self.daemon.published} answers"


def explain(path: Path) -> str:
    """What a CONFIG file means, in a few lines. Raises ConfigError as `serve` would, short of opening the bus."""
    return _explanation(_checked(path))


def _explanation(setup: Setup) -> str:
    config, limits = setup.config, setup.cell.cell
    signals = config.signals
    scale = "" if config.capacity_scale == 1.0 else f", {config.capacity_scale:g} times the size of the cell file's"
    lines = [
        f"{config.cells} x {limits.name} ({limits.chemistry}, {limits.capacity_Ah:g} Ah{scale}), "
        f"{limits.temperature_limits_degC[0]:g}..{limits.temperature_limits_degC[1]:g} degC",
        f"bus {config.bus.interface}:{config.bus.channel}, "
        + (
            f"a set of frames every {config.period_s:g} s" if config.transmit == "periodic" else "a set after each scan"
        ),
        "signals of the project's own bms.dbc" if signals is None else f"signals of {', '.join(signals.dbc)}",
        *roles.explained(setup.decoder.bound, signals),
    ]
    lines += roles.sensors_explained(setup.tuning, setup.cell)
    lines += _pack_explained(setup)
    if config.health:
        kept = "kept with the state" if config.state is not None else "not kept: there is no [state]"
        lines.append(f"capacity and resistance of each cell told from its use, {kept}")
    if config.state is not None:
        lines.append(f"state stored in {_place(config.state.file, setup.source)} every {config.state.period_s:g} s")
    if config.recorder is not None:
        lines.append(
            f"on a fault the last {config.recorder.span_s:g} s to {_place(config.recorder.folder, setup.source)}"
        )
    lines += [f"warning: {warning}" for warning in setup.warnings]
    return "\n".join(lines)


def _pack_explained(setup: Setup) -> list[str]:
    config, cell = setup.config, setup.cell.cell
    if config.pack is None and config.cells == 1:
        return []
    pack = config.pack or PackUse()
    volts, amperes = pack.voltage_V or cell.voltage_limits_V, pack.current_A or cell.current_limits_A
    wired = "" if pack.sensor_of is None else f"; {max(pack.sensor_of)} temperature sensors by sensor_of"
    wired += f"; {setup.wiring.strings} strings by string_of" if setup.wiring.strings > 1 else ""
    return [
        f"pack: each cell {volts[0]:g}..{volts[1]:g} V, {amperes[0]:g}..{amperes[1]:g} A, empty at "
        f"{pack.discharge_rate:g} C and full at {pack.charge_rate:g} C, pulses of {pack.pulse_s:g} s; every cell's SoC "
        f"once in {pack.cell_soc_period_s:g} s{wired}"
    ]


def _fixed(setup: Setup) -> tuple[object, ...]:
    """What an estimator is made of."""
    config, wired = setup.config, [getattr(setup.wiring, key) for key in setup.wiring.__slots__]
    of = tuple(None if indices is None else tuple(indices) for indices in wired)
    return setup.cell, config.cells, setup.tuning, of, setup.decoder.balancing is not None, config.health


def _place(name: str, source: Path) -> Path:
    """A file or folder of the service: where systemd gives it a folder, there, else beside the configuration."""
    folder = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return (Path(folder) if folder else source.parent) / name


def _checked(path: Path) -> Setup:
    setup = Setup.load(path)
    config = setup.config
    if config.bus.interface == "virtual":
        raise ConfigError(
            path,
            key="bus.interface",
            value="virtual",
            expected="a bus that other processes can reach, such as socketcan (virtual is for demo and cosim)",
        )
    if config.state is not None:
        _require_place(path, "state.file", config.state.file, "a file")
    if config.recorder is not None:
        _require_place(path, "recorder.folder", config.recorder.folder, "a folder")
    return setup


def _require_place(source: Path, key: str, name: str, what: str) -> None:
    place = _place(name, source)
    if not os.access(place.parent, os.W_OK | os.X_OK):
        expected = f"{what} in a folder that exists and can be written ({place})"
        raise ConfigError(source, key=key, value=name, expected=expected)
