"""The loop of `bms-ukf monitor`: frames from a bus, a picture a few times a second."""

from __future__ import annotations

import time
from pathlib import Path

from rich.console import Console
from rich.live import Live

from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.config import Bus, Setup
from bms_ukf.errors import ConfigError
from bms_ukf.monitor import view
from bms_ukf.monitor.watch import Watch

REDRAW_NS = 250_000_000
PLAIN_NS = 1_000_000_000


def monitor(config: Path | None, interface: str | None, channel: str | None, seconds: float | None = None) -> None:
    """Show what is published, for `seconds` or until interrupted. ConfigError if the bus cannot be opened."""
    settings, watch, source = _settings(config, interface, channel)
    ids = list(watch.tracks)
    bus = SafeBus(lambda: open_bus(settings, source, ids))
    console = Console()
    title = f"{settings.interface}:{settings.channel}"
    live = console.is_terminal and not console.is_dumb_terminal
    end_ns = None if seconds is None else time.monotonic_ns() + round(1e9 * seconds)
    due_ns = 0
    try:
        with Live(console=console, auto_refresh=False, transient=False) as picture:
            while end_ns is None or time.monotonic_ns() < end_ns:
                message = bus.recv(0.1)
                now_ns = time.monotonic_ns()
                if message is not None and not message.is_error_frame and not message.is_remote_frame:
                    watch.take(message.arbitration_id, message.is_extended_id, bytes(message.data), now_ns)
                if now_ns < due_ns:
                    continue
                if live:
                    picture.update(view.panel(watch, title, now_ns), refresh=True)
                else:
                    print(view.line(watch, now_ns), flush=True)  # noqa: T201 - a pipe or a log
                due_ns = now_ns + (REDRAW_NS if live else PLAIN_NS)
    finally:
        bus.close()


def _settings(config: Path | None, interface: str | None, channel: str | None) -> tuple[Bus, Watch, str]:
    if config is None:
        if interface is None or channel is None:
            raise ConfigError("monitor", expected="a CONFIG, or --interface and --channel")
        settings, watch, source = Bus(interface=interface, channel=channel), Watch(), "--channel"
    else:
        setup = Setup.load(config)
        overruled = {"interface": interface, "channel": channel}
        settings = setup.config.bus.model_copy(update={k: v for k, v in overruled.items() if v is not None})
        watch, source = Watch(setup.decoder), str(config)
    if settings.interface == "virtual":
        expected = "a bus that other processes can reach, such as socketcan (virtual is for demo and cosim)"
        raise ConfigError(source, key="bus.interface", value="virtual", expected=expected)
    return settings, watch, source
