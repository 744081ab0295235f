"""The process that runs one FMU: takes the plan, then steps on request, until the socket closes or its parent ends.

Whatever the library does to its process, it does it to this one.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import socket
import struct
import sys
from contextlib import suppress
from pathlib import Path

from bms_ukf.fmi import wire
from bms_ukf.fmi.fmi2 import Fmi2
from bms_ukf.fmi.fmi3 import Fmi3
from bms_ukf.fmi.instance import FatalError, Instance, ParameterError, RefusedError, UnusableError

_PR_SET_PDEATHSIG = 1


def main() -> None:
    """Arguments: the file descriptor of the socket, and the process id of the parent."""
    descriptor, parent = map(int, sys.argv[1:3])
    _die_with(parent)
    link = socket.socket(fileno=descriptor)
    link.set_inheritable(False)
    plan: wire.Plan = json.loads(link.recv(wire.PACKET))
    instance = _start(plan, link)
    if instance is not None and _serve(instance, plan, link):
        with suppress(RefusedError, FatalError, UnusableError):
            instance.end()
    sys.stdout.flush()
    os._exit(0)  # what a library does when it is unloaded is of no use any more


def _die_with(parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then closes the socket
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it ended before the line above
        os._exit(0)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")  # if memory runs out, this process goes first


def _start(plan: wire.Plan, link: socket.socket) -> Instance | None:
    def announce(call: str) -> None:
        link.send(wire.CALL + call.encode())

    try:
        instance = (Fmi2 if plan["fmi"] == 2 else Fmi3)(plan, announce)
        outputs = instance.start()
    except ParameterError as error:
        link.send(wire.PARAMETER + f"{error.name}\t{error}".encode())
    except (UnusableError, RefusedError, FatalError) as error:
        kind = wire.UNUSABLE if isinstance(error, UnusableError) else wire.REFUSED
        link.send(kind + str(error).encode())
    else:
        instance.announce = lambda call: None
        link.send(wire.OUTPUTS + struct.pack(f"={len(outputs)}d", *outputs))
        return instance
    return None


def _serve(instance: Instance, plan: wire.Plan, link: socket.socket) -> bool:
    """Steps until the socket closes; False if the FMU must not be called any more."""
    count = 3 + sum(variable["size"] for variable in plan["inputs"])
    request = struct.Struct(f"={count}d")
    answer = struct.Struct(f"={1 + sum(variable['size'] for variable in plan['outputs'])}d")
    packet = request.size + 1
    while data := link.recv(packet):
        t, step, parts, *inputs = request.unpack(data)
        try:
            link.send(wire.OUTPUTS + answer.pack(*instance.step(t, step, int(parts), inputs)))
        except (RefusedError, UnusableError) as error:
            link.send(wire.REFUSED + str(error).encode())
        except FatalError as error:
            link.send(wire.FATAL + str(error).encode())
            return False
    return True
