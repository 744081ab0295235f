"""The daemon of `test_bench_bus`, in a process of its own: reads SocketCAN frames from a socket it inherits."""

from __future__ import annotations

import socket
import sys
import threading
import time

import can

from bms_ukf import CellParams, Estimator
from bms_ukf.bus import SafeBus
from bms_ukf.daemon import Daemon
from bms_ukf.decoder import Decoder
from bms_ukf.intake import Intake
from bms_ukf.pack import Health
from bms_ukf.socketcan import SocketCan


class OverSocket(SocketCan):
    """The daemon's own receive and send, on a socket pair; nothing stamps its frames, so the wall clock does."""

    def __init__(self, descriptor: int) -> None:
        self.socket, self.dropped, self.channel = socket.socket(fileno=descriptor), 0, "pair"

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message = super().recv(timeout)
        if message is not None:
            message.timestamp = time.time()
        return message


def main() -> None:
    cells = int(sys.argv[2])
    bus = SafeBus(lambda: OverSocket(int(sys.argv[1])))
    estimator = Estimator(CellParams.load("lgm50_chen2020"), cells)
    daemon = Daemon(bus, estimator, Intake(Decoder(cells=cells)), health=Health(estimator))
    bus.send((0x7FF, False, b"ready"), 0)
    daemon.run(threading.Event())


if __name__ == "__main__":
    main()
