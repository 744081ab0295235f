"""Frames that were damaged, made up, replayed or cut off, between those of a drive: `python -m fuzz 1e6`."""

from __future__ import annotations

import random
import sys
import time
from typing import NamedTuple

import can
from model_cell import ModelCell

from bms_ukf import CellParams, Estimator, Status
from bms_ukf.bus import SafeBus
from bms_ukf.clock import LockstepClock
from bms_ukf.daemon import Daemon
from bms_ukf.decoder import Decoder
from bms_ukf.intake import Intake
from bms_ukf.node import EstimateDecoder, SampleEncoder
from bms_ukf.records import Sample

IDS = (0x120, 0x121, 0x122, 0x220, 0x224)
PER_SCAN = 10  # frames of the fuzzer to each scan of the vehicle, 0.1 s apart


class Found(NamedTuple):
    frames: int  # made by the fuzzer
    refused: int
    undetected: int  # CRC and counter were right by chance: a CRC of 8 bits lets one in 256 pass
    published: int  # sets with a SoC that was said to be valid
    worst: float  # of their errors, beyond three of the sigmas published with them
    frames_per_s: float


class Queue:
    """A bus: what is put into it is heard, what is sent is kept."""

    def __init__(self) -> None:
        self.waiting: list[can.Message] = []
        self.sent: list[can.Message] = []

    def recv(self, _: float) -> can.Message | None:
        return self.waiting.pop(0) if self.waiting else None

    def send(self, message: can.Message) -> None:
        self.sent.append(message)

    def shutdown(self) -> None:
        """Nothing to close."""


def mutated(dice: random.Random, known: list[tuple[int, bool, bytes]]) -> can.Message:
    """A frame that no sender meant."""
    number, extended, data = dice.choice(known)
    kind = dice.randrange(8)
    bits = bytearray(data)
    if kind < 3:  # bits turned over on the way
        for _ in range(dice.choice((1, 2, 3, 8))):
            bits[dice.randrange(len(bits))] ^= 1 << dice.randrange(8)
    elif kind == 3:
        del bits[dice.randrange(len(bits)) :]
    elif kind == 4:
        return can.Message(0.0, dice.choice(IDS), False, data=dice.randbytes(dice.randrange(9)))
    elif kind == 5:
        return can.Message(0.0, dice.randrange(1 << 29), True, data=dice.randbytes(dice.randrange(9)))
    elif kind == 6:
        return can.Message(0.0, number, extended, is_remote_frame=True, dlc=8)
    return can.Message(0.0, number, extended, data=bytes(bits))  # kind 7: the same once more


def run(frames: int, seed: int = 1, cell_name: str = "lgm50_chen2020") -> Found:
    """Drive with `frames` such frames on the bus; any exception is the caller's."""
    cell, dice = CellParams.load(cell_name), random.Random(seed)
    battery, encoder, queue, clock = ModelCell(cell, 0.8), SampleEncoder(), Queue(), LockstepClock()
    decoder, monitor = Decoder(), EstimateDecoder()
    bus = SafeBus(lambda: queue)  # type: ignore[arg-type, return-value]
    daemon = Daemon(bus, Estimator(cell), Intake(decoder), clock=clock)
    published, undetected, worst = 0, 0, 0.0
    recent: list[tuple[int, bool, bytes]] = []
    began_s = time.perf_counter()
    for k in range(frames // PER_SCAN):
        rests = k < 50
        current_A = 0.0 if rests else 4.0 if k // 3000 % 2 else -4.0  # SoC stays between its ends
        voltage_V = battery.step(current_A, 0.1)
        clock.set((k + 1) * 100_000_000)
        valid = encoder.encode(Sample(0, current_A, voltage_V, 25.0))
        recent = [*valid, *recent][:12]
        queue.waiting = [can.Message(0.0, number, wide, data=data) for number, wide, data in valid]
        queue.waiting += [mutated(dice, recent) for _ in range(PER_SCAN)]
        for _ in valid:
            daemon.poll(0.0)
        meant = decoder.counters.accepted
        while daemon.poll(0.0):
            pass
        undetected += decoder.counters.accepted - meant
        for message in queue.sent:
            told = monitor.decode(message.arbitration_id, message.is_extended_id, bytes(message.data), 0)
            if told is not None and told.status in {Status.OK, Status.DEGRADED}:
                published += 1
                worst = max(worst, abs(float(told.soc) - battery.soc) - 3 * float(told.soc_sigma))
        queue.sent.clear()
    took_s = time.perf_counter() - began_s
    return Found(
        frames, decoder.counters.refused, undetected, published, worst, (PER_SCAN + 3) * (frames // PER_SCAN) / took_s
    )


if __name__ == "__main__":
    found = run(int(float(sys.argv[1])))
    print(found)  # noqa: T201
    sys.exit(found.worst > 0.03)
