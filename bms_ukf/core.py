"""The daemon without its bus and its clock: received frames in, sets to be published out, in the time of the frames.

    intake.take -> Scan -> Sample -> Estimator.step -> Estimate -> publication.complete -> a set

`daemon.Daemon` has it on a bus, a replay drives it with the frames of a log: what the two say cannot differ.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bms_ukf.commissioning import Commissioning
from bms_ukf.estimator import Estimator
from bms_ukf.failed import Watch
from bms_ukf.intake import Intake
from bms_ukf.pace import Pace
from bms_ukf.pack import Health
from bms_ukf.publication import Publication
from bms_ukf.records import NAN, Detail, Estimate, Fault, PerCell, Sample, Source, Stored, mean_known
from bms_ukf.scan import TOGETHER_NS, Scan
from bms_ukf.strings import CommissioningStrings, StuckStrings
from bms_ukf.stuck import Stuck

FAULT_HOLD_NS = 1_000_000_000
PATIENCE_NS = 100_000_000  # between two looks at what is due: how long a request to stop may wait
Cells = NDArray[np.intp]
_NONE = Fault.NONE  # what an enumeration does, beyond being compared, takes as long as the step of the filter
_IMPLAUSIBLE = int(Fault.CURRENT_IMPLAUSIBLE | Fault.VOLTAGE_IMPLAUSIBLE)


class Witness(Protocol):
    """Who is told of all that happens, as it happens. What it is given is overwritten later."""

    def stepped(self, sample: Sample, estimate: Estimate) -> None: ...

    def coasted(self, t_ns: int, estimate: Estimate) -> None: ...

    def published(self, t_ns: int, estimate: Estimate, detail: Detail) -> None: ...


class Core:
    """One estimator, its way in, and what is to be published of it. Nobody hears that but `witness`."""

    def __init__(self, estimator: Estimator, intake: Intake, pace: Pace, health: Health | None = None) -> None:
        self.estimator, self.health = estimator, health
        self.publication = Publication(estimator.cell.cell.capacity_Ah)
        cell, wiring = estimator.cell, estimator.wiring
        self._strings = several = wiring.members()
        self.commissioning = CommissioningStrings(cell, wiring) if several else Commissioning(cell)
        self.estimate = estimator.coast(0)  # the latest; its arrays and fields are overwritten by every frame
        self.published = 0  # sets of frames
        self.witness: Witness | None = None
        self.stuck = StuckStrings(cell, wiring) if several else Stuck(cell, estimator.cells)
        self.watch = Watch(estimator)
        self._scan = Scan(estimator.cells, self._step, self._end_scan)
        self._published_ns = 0
        self._stepped = False  # since the last set
        self._adopt(intake, pace)

    def resumed(self, stored: Stored) -> None:
        """Tell on the bus what became of a belief that was stored, now that the estimator has it or not."""
        self.publication.detail.stored = stored
        if stored is Stored.USED:
            self.publication.detail.source = Source.STORED

    def hear(self, arbitration_id: int, is_extended_id: bool, data: bytes, t_ns: int, *, classic: bool = True) -> None:
        """Handle a frame received at `t_ns`, as of `Inbox.decode`; a complete scan is answered by publishing."""
        samples = self.intake.take(arbitration_id, is_extended_id, data, t_ns, classic=classic)
        for sample in samples:
            self._scan.take(sample)
        self.idle(t_ns)

    def idle(self, t_ns: int) -> None:
        """Publish every period, or a prediction after too long a silence: it must not look like a steady SoC."""
        if self._scan.held_ns is not None:
            self._scan.due(t_ns - self.intake.behind_ns)
        if self._due_after_ns is None or t_ns - self._published_ns < self._due_after_ns:
            return
        for sample in self.intake.due(t_ns):
            self._scan.take(sample)
        self._scan.flush()
        if not (self._periodic and self._stepped):
            self._coast(t_ns - self.intake.behind_ns)
        self._publish(t_ns)

    def current_bias_A(self) -> float:
        """What the current sensor shows too much, as the latest estimate has it; of several strings, all together."""
        bias_A = self.estimate.current_bias_A
        if isinstance(bias_A, float) or not self._strings:
            return mean_known(bias_A)
        return sum(mean_known(bias_A[members]) for members in self._strings.values())

    def patience_ns(self, now_ns: int) -> int:
        """How long to wait for a frame before `idle` is due."""
        patience_ns = PATIENCE_NS if self._scan.held_ns is None else TOGETHER_NS
        if not self._periodic or self._due_after_ns is None:
            return patience_ns
        left_ns = self._published_ns + self._due_after_ns - now_ns
        return patience_ns if left_ns > patience_ns else left_ns if left_ns > 0 else 0

    def _adopt(self, intake: Intake, pace: Pace) -> None:
        self.intake = intake
        self.publication.slew_per_s = pace.soc_slew_per_s
        self._periodic = pace.period_s is not None
        due_after_s = pace.silence_s if pace.period_s is None else pace.period_s
        self._due_after_ns = round(1e9 * due_after_s) if due_after_s < math.inf else None
        self._refused = _Recent(Fault.E2E, intake.counters.refused)
        self._failed = _Recent(Fault.BUS, self._failures() + intake.counters.lost)

    def _failures(self) -> int:
        """How often the bus has failed."""
        return 0

    def _send(self, t_ns: int, detail: Detail) -> None:
        """Send the set that `estimate` and `detail` are."""

    def _step(self, sample: Sample) -> None:
        estimate, witness, health = self.estimate, self.witness, self.health
        self.stuck.take(sample)
        shown = sample.current_A, sample.string_current_A
        self._watch(sample)
        voltage = sample.voltage_V
        heard = None if isinstance(voltage, float) else (voltage == voltage).nonzero()[0]  # noqa: PLR0124 - not NaN
        if _is_empty(sample, heard):  # its sender lives, and knows nothing: no reason to look alive
            self._coast(sample.t_ns)
            self.publication.follow(sample, estimate, heard)
            return
        self.estimator.step(sample, out=estimate)
        if health is not None and self.commissioning.fault is _NONE and self.watch.fault is _NONE:
            health.follow(sample, estimate)
        if witness is not None:
            witness.stepped(sample, estimate)
        self.publication.follow(sample, estimate, heard)
        faults, stands = estimate.faults, self.stuck.fault
        if (faults is _NONE and stands is _NONE) or not (int(faults) | int(stands)) & _IMPLAUSIBLE:
            self._commission(sample, shown)
        self._stepped = True

    def _watch(self, sample: Sample) -> None:
        """Take the current for missing where its sensor has failed, or was never right."""
        self.watch.take(sample, self.estimate)
        if self.commissioning.fault is not _NONE:
            sample.current_A, sample.string_current_A = NAN, None

    def _commission(self, sample: Sample, shown: tuple[float, NDArray[np.float64] | None]) -> None:
        """Let the sensors be judged by what they have shown, used or not."""
        before = self.commissioning.fault
        sample.current_A, sample.string_current_A = shown
        self.commissioning.see(sample)
        if before is _NONE and self.commissioning.fault is not _NONE and self.watch.fault is _NONE:
            self.watch.distrust(sample.t_ns)

    def _end_scan(self, t_ns: int) -> None:
        if not self._periodic:
            self._publish(t_ns + self.intake.behind_ns)

    def _coast(self, t_ns: int) -> None:
        self.estimator.coast(t_ns, out=self.estimate)
        if self.witness is not None:
            self.witness.coasted(t_ns, self.estimate)

    def _publish(self, t_ns: int) -> None:
        received = self.intake.counters
        shown = self._refused.at(t_ns, received.refused) | self._failed.at(t_ns, self._failures() + received.lost)
        detail = self.publication.complete(
            self.estimate, t_ns, shown | int(self.commissioning.fault | self.stuck.fault | self.watch.shown)
        )
        detail.current_bias_A = self.current_bias_A()
        self._send(t_ns, detail)
        self.published += 1
        if self.witness is not None:
            self.witness.published(t_ns, self.estimate, detail)
        self._stepped = False
        # A period that is late once is made up for, one that is late by more is not.
        on_time = self._periodic and self._due_after_ns and t_ns - self._published_ns < 2 * self._due_after_ns
        self._published_ns = self._published_ns + self._due_after_ns if on_time and self._due_after_ns else t_ns


class _Recent:
    """A fault that is shown for FAULT_HOLD_NS after its counter moved."""

    def __init__(self, fault: Fault, count: int) -> None:
        self._bit, self._count, self._until_ns = int(fault), count, -1

    def at(self, t_ns: int, count: int) -> int:
        """Its bit, or 0."""
        if count != self._count:
            self._count, self._until_ns = count, t_ns + FAULT_HOLD_NS
        return self._bit if t_ns < self._until_ns else 0


def _is_empty(sample: Sample, heard: Cells | None) -> bool:
    """Whether nothing was measured; `heard` are the cells whose voltages were, None for a single one."""
    if sample.current_A == sample.current_A:
        return False
    voltage = _measured(sample.voltage_V) if heard is None else heard.size
    return not (voltage or _measured(sample.temperature_degC) or _measured(sample.currents_A))


def _measured(values: PerCell) -> bool:
    if isinstance(values, float):
        return values == values  # noqa: PLR0124
    return bool((values == values).any())  # noqa: PLR0124
