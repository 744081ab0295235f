"""Faults of the bus between the vehicle and the daemon: frames are lost, late, repeated or wrong; others are added."""

from __future__ import annotations

import functools
import heapq
from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from itertools import count
from typing import Annotated, Literal

from numpy.random import Generator
from pydantic import Field

from bms_ukf.dbc import own_matrix, protection
from bms_ukf.e2e import Profile11A
from bms_ukf.faults.base import Injection, NonNegative, Positive, Share, generators
from bms_ukf.frames import Frame

Due = tuple[int, Frame]  # when a frame reaches the daemon, in ns, and the frame
Effect = Callable[[int, Frame], Iterable[Due]]

_BITS = 111  # of a frame with 8 bytes and its gap to the next, without stuff bits


class CanFault(Injection):
    """Something on the bus."""


class FrameFault(CanFault):
    """Acts on the frames of one message of the vehicle; None: of all."""

    message: Literal["PackMeasurement", "CellVoltages", "CellTemperatures"] | None = None

    @abstractmethod
    def effect(self, dice: Generator) -> Effect:
        """What becomes of a frame that reaches the daemon at a time."""

    def id(self) -> int | None:
        return None if self.message is None else int(own_matrix().message(self.message).frame_id)


class Loss(FrameFault):
    """Each frame is lost with this probability."""

    kind: Literal["loss"]
    share: Share = 1.0

    def effect(self, dice: Generator) -> Effect:
        return lambda t_ns, frame: () if dice.random() < self.share else ((t_ns, frame),)


class BurstLoss(FrameFault):
    """For `burst_s` in every `every_s` all frames are lost."""

    kind: Literal["burst_loss"]
    burst_s: Positive
    every_s: Positive

    def effect(self, dice: Generator) -> Effect:
        start_ns, burst_ns, every_ns = (round(1e9 * value) for value in (self.at_s, self.burst_s, self.every_s))
        return lambda t_ns, frame: () if (t_ns - start_ns) % every_ns < burst_ns else ((t_ns, frame),)


class Delay(FrameFault):
    """Late by `delay_s` and up to `jitter_s` more; frames may overtake each other."""

    kind: Literal["delay"]
    delay_s: NonNegative
    jitter_s: NonNegative = 0.0

    def effect(self, dice: Generator) -> Effect:
        return lambda t_ns, frame: ((t_ns + round(1e9 * (self.delay_s + self.jitter_s * dice.random())), frame),)


class Duplication(FrameFault):
    """Each frame comes twice with this probability."""

    kind: Literal["duplication"]
    share: Share = 1.0

    def effect(self, dice: Generator) -> Effect:
        return lambda t_ns, frame: ((t_ns, frame),) * (2 if dice.random() < self.share else 1)


class Reordering(FrameFault):
    """A frame waits, with this probability, until the next one of its message has overtaken it."""

    kind: Literal["reordering"]
    share: Share = 1.0

    def effect(self, dice: Generator) -> Effect:
        waiting: dict[int, Frame] = {}

        def swap(t_ns: int, frame: Frame) -> Iterable[Due]:
            if frame[0] in waiting:
                return (t_ns, frame), (t_ns, waiting.pop(frame[0]))
            if dice.random() < self.share:
                waiting[frame[0]] = frame
                return ()
            return ((t_ns, frame),)

        return swap


class WrongDlc(FrameFault):
    """Cut off after `length` bytes."""

    kind: Literal["wrong_dlc"]
    length: Annotated[int, Field(ge=0, le=7)] = 7

    def effect(self, dice: Generator) -> Effect:
        return lambda t_ns, frame: ((t_ns, (frame[0], frame[1], frame[2][: self.length])),)


class WrongCrc(FrameFault):
    """A bit of the payload is flipped with this probability, and the CRC is as it was."""

    kind: Literal["wrong_crc"]
    share: Share = 1.0

    def effect(self, dice: Generator) -> Effect:
        def flip(t_ns: int, frame: Frame) -> Iterable[Due]:
            if dice.random() >= self.share:
                return ((t_ns, frame),)
            identifier, extended, data = frame
            bit = int(dice.integers(8, 8 * len(data)))
            wrong = (int.from_bytes(data, "little") ^ 1 << bit).to_bytes(len(data), "little")
            return ((t_ns, (identifier, extended, wrong)),)

        return flip


class StuckCounter(FrameFault):
    """New values under an alive counter that stands still; the CRC is right."""

    kind: Literal["stuck_counter"]

    def effect(self, dice: Generator) -> Effect:
        held: dict[int, int] = {}
        return lambda t_ns, frame: ((t_ns, _recounted(frame, held.setdefault(frame[0], frame[2][1] & 0x0F))),)


class RewoundCounter(FrameFault):
    """An alive counter `by` behind the one that is due, as of a sender that has started anew; the CRC is right."""

    kind: Literal["rewound_counter"]
    by: Annotated[int, Field(ge=1, le=14)] = 5

    def effect(self, dice: Generator) -> Effect:
        modulo = Profile11A.modulo
        return lambda t_ns, frame: ((t_ns, _recounted(frame, ((frame[2][1] & 0x0F) - self.by) % modulo)),)


class Source(CanFault):
    """Frames that are not the vehicle's."""

    @abstractmethod
    def frames_per_s(self) -> float:
        """How many there are."""

    @abstractmethod
    def frame(self, dice: Generator) -> Frame:
        """The next one."""


class BabblingId(Source):
    """Another node sends random payloads under `id`."""

    kind: Literal["babbling_id"]
    id: Annotated[int, Field(ge=0, le=0x7FF)]
    rate_hz: Annotated[float, Field(gt=0, le=10_000)] = 100.0

    def frames_per_s(self) -> float:
        return self.rate_hz

    def frame(self, dice: Generator) -> Frame:
        return self.id, False, dice.bytes(8)


class BusLoad(Source):
    """Frames that are not the daemon's business take this share of a bus of `bitrate`."""

    kind: Literal["bus_load"]
    share: Share
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 500_000

    def frames_per_s(self) -> float:
        return self.share * self.bitrate / _BITS

    def frame(self, dice: Generator) -> Frame:
        return int(dice.integers(0x300, 0x700)), False, bytes(8)


class InterfaceDown(CanFault):
    """The daemon's interface is taken down and, after `for_s`, up again."""

    kind: Literal["interface_down"]


AnyFault = (
    Loss
    | BurstLoss
    | Delay
    | Duplication
    | Reordering
    | WrongDlc
    | WrongCrc
    | StuckCounter
    | RewoundCounter
    | BabblingId
    | BusLoad
    | InterfaceDown
)


class Wire:
    """Carries frames from the vehicle to the daemon, through all CAN faults of a scenario in the order of its file."""

    def __init__(self, faults: Sequence[Injection], seed: int) -> None:
        """Of `faults` those of the bus are taken."""
        acting = [fault for fault in faults if isinstance(fault, FrameFault)]
        self._effects = [
            (fault, fault.id(), fault.effect(dice))
            for fault, dice in zip(acting, generators(seed, acting), strict=True)
        ]
        adding = [fault for fault in faults if isinstance(fault, Source)]
        self._sources = list(zip(adding, generators(seed, adding), strict=True))
        self._underway: list[tuple[int, int, Frame]] = []
        self._number = count()  # frames due at the same time come in the order in which they were sent

    def put(self, frames: Iterable[Frame], t_ns: int, step_ns: int) -> None:
        """Take the frames the vehicle sends at `t_ns`, and what others send in the step that begins there."""
        travelling: list[Due] = [(t_ns, frame) for frame in frames]
        for fault, identifier, effect in self._effects:
            if fault.active(t_ns):
                travelling = [
                    arrived
                    for due_ns, frame in travelling
                    for arrived in (effect(due_ns, frame) if identifier in {None, frame[0]} else [(due_ns, frame)])
                ]
        for source, dice in self._sources:
            if source.active(t_ns):
                number = round(source.frames_per_s() * step_ns * 1e-9)
                travelling += [(t_ns + k * step_ns // number, source.frame(dice)) for k in range(number)]
        for due_ns, frame in travelling:
            heapq.heappush(self._underway, (due_ns, next(self._number), frame))

    def due(self, before_ns: int) -> Iterable[Due]:
        """What arrives before this time, in order."""
        while self._underway and self._underway[0][0] < before_ns:
            due_ns, _, frame = heapq.heappop(self._underway)
            yield due_ns, frame


def _recounted(frame: Frame, counter: int) -> Frame:
    identifier, extended, data = frame
    return identifier, extended, _profiles()[identifier].recounted(data, counter)


@functools.cache
def _profiles() -> dict[int, Profile11A]:
    matrix = own_matrix()
    return {
        message.frame_id: profile
        for message in map(matrix.message, ("PackMeasurement", "CellVoltages", "CellTemperatures"))
        if (profile := protection(message)) is not None
    }
