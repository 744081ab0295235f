"""The child process that runs one FMU, seen from here: it answers in time and within its memory, or is ended.

Whatever a library does (hang, crash, leak, print, wait for a licence), it comes out as a PlantError. The child has no
display and no terminal input, so that whoever asks there for a licence fails rather than waits. It is killed with the
thread that started it.
"""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from bms_ukf.errors import ConfigError, PlantError, PlantFailure
from bms_ukf.fmi import wire
from bms_ukf.records import NAN

START_DEADLINE_S = 30.0  # at least: a tool may take long to load
_LOOK_S = 0.1  # how often the clock and the child's memory are looked at
_END_S = 2.0  # what an FMU gets to end by itself
_START = "import sys; sys.path.insert(0, sys.argv.pop(1)); from bms_ukf.fmi.child import main; main()"
_ROOT = str(Path(__file__).resolve().parents[2])
_PAGE = os.sysconf("SC_PAGE_SIZE")


class NotLoadedError(ConfigError):
    """The FMU's library cannot be loaded, or gives no instance."""


class FmuProcess:
    """One FMU in a process of its own.

    `label` is what errors call the FMU. Raises ConfigError for a library or start value that cannot be used, and
    PlantError if the FMU hangs or crashes on the way, or takes more than `memory_limit_MB` of memory.
    """

    def __init__(self, label: str, plan: wire.Plan, folder: Path, *, deadline_s: float, memory_limit_MB: float) -> None:
        self._label, self._deadline_s, self._limit_MB = label, deadline_s, memory_limit_MB
        self._call = "the start"
        self._t = NAN
        self._looked = 0.0
        self._output: deque[bytes] = deque(maxlen=16)
        inputs, outputs = (sum(variable["size"] for variable in plan[key]) for key in ("inputs", "outputs"))
        self._request = struct.Struct(f"={3 + inputs}d")
        self._answer = struct.Struct(f"={1 + outputs}d")
        self._link, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        data = json.dumps(plan).encode()
        self._link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2 * max(len(data), wire.PACKET))
        timeout = struct.pack("@ll", 0, int(_LOOK_S * 1e6))
        # By the socket rather than by Python: one system call instead of two for each answer.
        self._link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeout)
        with theirs:
            self._child = subprocess.Popen(
                [sys.executable, "-P", "-c", _START, _ROOT, str(theirs.fileno()), str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=[theirs.fileno()],
                cwd=folder,
                env=_environment(Path(plan["library"]).parent),
                start_new_session=True,  # a group of its own, to be ended with all it started
            )
        self._reader = threading.Thread(target=self._drain, name=f"output of {label}", daemon=True)
        self._reader.start()
        try:
            self._send(data)
            self.start = self._started(time.monotonic() + max(START_DEADLINE_S, deadline_s))
        except BaseException:
            self.close()
            raise
        self._call = "fmi2DoStep" if plan["fmi"] == 2 else "fmi3DoStep"

    @property
    def pid(self) -> int:
        return self._child.pid

    @property
    def said(self) -> str:
        """The end of what the FMU printed."""
        return b"".join(self._output).decode(errors="replace")

    def request(self, t: float, step: float, parts: int, inputs: list[float]) -> None:
        """Sends the child a step; `answer` takes what comes of it."""
        self._t = t
        self._send(self._request.pack(t, step, parts, *inputs))

    def answer(self) -> list[float]:
        """The outputs after a step. Raises PlantError; the child then lives on only if the kind is "refused"."""
        data = self._receive(time.monotonic() + self._deadline_s)
        if data[:1] == wire.OUTPUTS:
            return list(self._answer.unpack_from(data, 1)[1:])
        if data[:1] == wire.FATAL:
            self.close()
        raise self._error("refused", data[1:].decode(errors="replace"))

    def kill(self) -> None:
        """Ends the child at once, as a crash would: the next step fails."""
        self._signal(signal.SIGKILL)

    def pause(self) -> None:
        """Stops the child, as a hang would: the next step fails once its deadline has passed."""
        self._signal(signal.SIGSTOP)

    def close(self) -> None:
        """Ends the child, by force if it does not end by itself, and what it has started. May be called again."""
        with suppress(OSError):
            self._link.shutdown(socket.SHUT_WR)
        self._wait(_END_S)
        self._finish()
        self._link.close()
        self._reader.join(_END_S)  # unless a process it started holds the pipe open

    def _started(self, deadline: float) -> list[float]:
        while True:
            data = self._receive(deadline)
            kind, text = data[:1], data[1:].decode(errors="replace") if data[:1] != wire.OUTPUTS else ""
            match kind:
                case wire.OUTPUTS:
                    return list(self._answer.unpack_from(data, 1)[1:])
                case wire.CALL:
                    self._call = text
                case wire.UNUSABLE:
                    raise NotLoadedError(
                        self._label, expected=f"an FMU that can be loaded here ({text}{self._last_words()})"
                    )
                case wire.PARAMETER:
                    name, reason = text.split("\t", 1)
                    raise ConfigError(
                        self._label, key=f"parameters.{name}", expected=f"a value the FMU takes ({reason})"
                    )
                case _:
                    raise ConfigError(self._label, expected=f"start values the FMU takes ({text})")

    def _send(self, data: bytes) -> None:
        try:
            self._link.send(data)
        except OSError:
            self._ended()

    def _receive(self, deadline: float) -> bytes:
        while True:
            try:
                data = self._link.recv(wire.PACKET)
            except BlockingIOError:
                data = None
            except OSError:
                data = b""
            now = time.monotonic()
            if now - self._looked > _LOOK_S:
                self._looked = now
                self._look_at_memory()
            if data:
                return data
            if data is not None or self._wait(0):
                self._ended()
            if now > deadline:
                self._signal(signal.SIGKILL)
                waits = "" if self._call.endswith("DoStep") else " (does it wait for a licence, or for its tool?)"
                limit = max(START_DEADLINE_S, self._deadline_s) if waits else self._deadline_s
                raise self._error("hang", f"no answer within {limit:g} s in {self._call}{waits}")

    def _look_at_memory(self) -> None:
        with suppress(OSError, IndexError):
            pages = int(Path(f"/proc/{self.pid}/statm").read_text().split()[1])
            used_MB = pages * _PAGE / 1e6
            if used_MB > self._limit_MB:
                self._signal(signal.SIGKILL)
                raise self._error("memory", f"{used_MB:.0f} MB in use, memory_limit_MB = {self._limit_MB:g}")

    def _ended(self) -> NoReturn:
        """Raises for a child that is gone."""
        self._wait(_END_S)  # it may have closed the socket and live on
        code = self._finish()
        how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        raise self._error("crash", f"its process was {how} in {self._call}{self._last_words()}")

    def _wait(self, limit_s: float) -> bool:
        """Whether the child has ended, within a time; its process id stays taken until `_finish`."""
        until = time.monotonic() + limit_s
        while self._child.returncode is None:
            if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
                return True
            if time.monotonic() >= until:
                return False
            time.sleep(0.002)
        return True

    def _finish(self) -> int:
        """Ends the child and all in its group, if it lives; its exit code."""
        self._signal(signal.SIGKILL)
        return self._child.wait()

    def _last_words(self) -> str:
        """What it printed last, after a comma; nothing if it printed nothing."""
        self._reader.join(0.2)
        lines = [line for line in self.said.splitlines() if line.strip()]
        return f", saying {lines[-1].strip()[:200]!r}" if lines else ""

    def _error(self, kind: PlantFailure, text: str) -> PlantError:
        at = "" if math.isnan(self._t) else f"at t = {self._t:g} s: "
        return PlantError(f"{self._label}: {at}{text}", kind)

    def _signal(self, number: signal.Signals) -> None:
        if self._child.returncode is None:  # else the process id may be another's by now
            with suppress(ProcessLookupError):
                os.killpg(self._child.pid, number)

    def _drain(self) -> None:
        assert self._child.stdout is not None
        with self._child.stdout as pipe:
            while data := os.read(pipe.fileno(), 4096):
                self._output.append(data)


def _environment(libraries: Path) -> dict[str, str]:
    """No display; and what an FMU's library needs may lie beside it."""
    kept = {name: value for name, value in os.environ.items() if name not in {"DISPLAY", "WAYLAND_DISPLAY"}}
    paths = [str(libraries), *filter(None, [kept.get("LD_LIBRARY_PATH")])]
    return kept | {"LD_LIBRARY_PATH": os.pathsep.join(paths)}
