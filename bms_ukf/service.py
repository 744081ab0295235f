"""`bms-ukf run`: a configuration made into a running daemon, until SIGTERM (exit 0) or SIGINT (exit 130)."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from pathlib import Path
from types import FrameType

from bms_ukf import roles
from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.config import Setup
from bms_ukf.daemon import Daemon
from bms_ukf.errors import ConfigError
from bms_ukf.estimator import Estimator

log = logging.getLogger(__name__)


def serve(path: Path) -> None:
    """Run the daemon of a CONFIG file. ConfigError if it cannot start; SIGINT raises KeyboardInterrupt at the end."""
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    setup = _checked(path)
    stop = threading.Event()
    received: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        received.append(number)
        stop.set()

    bus = SafeBus(lambda: open_bus(setup.config.bus, str(path), setup.decoder.ids()))
    estimator = Estimator(setup.cell, setup.config.cells, setup.config.estimator)
    config = setup.config
    daemon = Daemon(
        bus,
        estimator,
        setup.intake(),
        silence_s=config.silence_s,
        period_s=config.period_s if config.transmit == "periodic" else None,
        soc_slew_per_s=config.soc_slew_per_s,
        fd=config.bus.fd,
    )
    previous = {number: signal.signal(number, on_signal) for number in (signal.SIGTERM, signal.SIGINT)}
    log.info("running: %s", "; ".join(_explanation(setup).splitlines()))
    try:
        daemon.run(stop)
    finally:
        bus.close()
        for number, handler in previous.items():
            signal.signal(number, handler)
    log.info("stopped: %d answers; received %s; bus %s", daemon.published, setup.decoder.counters, bus.counters)
    if signal.SIGINT in received:
        raise KeyboardInterrupt


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
    lines += [f"warning: {warning}" for warning in setup.warnings]
    return "\n".join(lines)


def _checked(path: Path) -> Setup:
    setup = Setup.load(path)
    if setup.config.bus.interface == "virtual":
        raise ConfigError(
            path,
            key="bus.interface",
            value="virtual",
            expected="a bus that other processes can reach, such as socketcan (virtual is for demo and cosim)",
        )
    return setup
