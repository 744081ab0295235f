"""What systemd is told of a service: datagrams to the socket it names, as sd_notify(3) describes them."""

from __future__ import annotations

import os
import socket
import time


class Notifier:
    """Tells the service manager that started this process, or nobody. Never raises: a daemon does not end of it."""

    def __init__(self) -> None:
        """Reads NOTIFY_SOCKET and WATCHDOG_USEC."""
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        limit_us = os.environ.get("WATCHDOG_USEC", "")
        mine = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._beat_s = int(limit_us) * 0.5e-6 if limit_us.isdigit() and mine else None
        self._beat_at_s = 0.0

    def ready(self, status: str) -> None:
        """Started, or configured anew."""
        self._tell(f"READY=1\nSTATUS={status}")

    def status(self, text: str) -> None:
        self._tell(f"STATUS={text}")

    def reloading(self) -> None:
        self._tell(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        self._tell("STOPPING=1")

    def alive(self) -> None:
        """Pat the watchdog, if there is one and half of its time is over."""
        now_s = time.monotonic()
        if self._beat_s is not None and now_s >= self._beat_at_s:
            self._tell("WATCHDOG=1")
            self._beat_at_s = now_s + self._beat_s

    def _tell(self, text: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as any_socket:
            try:
                any_socket.setblocking(False)
                any_socket.sendto(text.encode(), self._address)
            except OSError:
                return
