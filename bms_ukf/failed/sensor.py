"""One current sensor, judged by its cells' voltages: whether it has failed, since when, and when it is right again.

    Sample -> blocks -> response -> steps -> changed, unseen -> fault

The voltage's own changes tell: nothing else knows the current. While a sensor is failed its readings are looked at all
the same, and once they explain the voltage again, with no load unseen for as long as it takes, the fault is over. What
fails again waits twice as long, and what fails now and then waits for twice the time that it was right in between.

Where the limit lies: a sensor that fails at rest, or under a load that does not change, by reading what it should read
is right until the load changes. A gain error below 1.5 and an offset are not found here, they are in the interval; nor
is a gain of 2 told below 15 % SoC, where the resistance of a cell doubles by itself. A current clipped at zero or at
its range is found where the voltage moves while it is clipped.
"""

from __future__ import annotations

import logging
import math

from bms_ukf.cell import CellParams
from bms_ukf.failed.blocks import Block, Blocks
from bms_ukf.failed.changed import Changed, agreement
from bms_ukf.failed.response import Response
from bms_ukf.failed.steps import Step, Steps
from bms_ukf.failed.unseen import Unseen, is_unseen
from bms_ukf.records import Fault, PerCell, Sample, mean_known

log = logging.getLogger(__name__)

AGREED = 12.0  # log likelihood ratio of the sensor being right
HOLD_NS, HOLD_MAX_NS = 20_000_000_000, 3_600_000_000_000  # without a load unseen, at first and at most
PROBATION_NS = 3_600_000_000_000  # in which one load unseen names what failed before
STILL_HOURS, SMALL_HOURS = 200.0, 20.0  # capacity over them: a current that has not moved, one that may be none
STANDS_NS = 300_000_000_000
SPELLS = 2  # times the longest time without a load unseen that another one ended
SOC_UNKNOWN = 0.5

_TOLD = {
    Fault.CURRENT_FAILED: "the voltage shows loads that it does not: dead, stuck or clipped",
    Fault.CURRENT_SIGN: "the voltage has come to rise where it rises: its sign has turned",
    Fault.CURRENT_SCALE: "the voltage has come to move twice as far: it shows half of what flows",
}


class CurrentSensor:
    """Looks at every sample of one string. `fault`: CURRENT_FAILED, CURRENT_SIGN, CURRENT_SCALE or nothing."""

    def __init__(
        self,
        cell: CellParams,
        cells: int,
        current_max_A: float = math.inf,
        voltages_V: tuple[float, float] = (-math.inf, math.inf),
        *,
        string: int | None = None,
    ) -> None:
        """What is beyond `current_max_A` or outside `voltages_V` is not plausible, and no reading.

        `string` is the number by which the sensor is named, if there are several.
        """
        self.fault = Fault.NONE
        self.suspected = Fault.NONE  # what may be wrong, by evidence that does not name it yet
        self.since_ns = 0  # when it began to be wrong
        self._of = "" if string is None else f" of string {string}"
        self._blocks = Blocks(cells, current_max_A, voltages_V)
        self._response, self._double = Response(cell), Response(cell)
        self._steps, self._changed, self._unseen = Steps(), Changed(), Unseen()
        self._capacity_Ah = cell.cell.capacity_Ah
        self._still_A, self._still_ns = math.nan, 0  # what the current has shown since
        self._voltage_V = math.nan
        self._agreed, self._hold_ns, self._event_ns = 0.0, HOLD_NS, 0
        self._spell_ns = 0  # the longest between two loads unseen, since it was named

    def see(self, sample: Sample, charged: PerCell = math.nan) -> bool:
        """Take note of what was measured; whether `fault` has changed. `charged`: the cells' SoC, about."""
        block = self._blocks.take(sample)
        if block is None:
            return False
        if not abs(block.current_A - self._still_A) <= self._capacity_Ah / STILL_HOURS:
            self._still_A, self._still_ns = block.current_A, block.t_ns
        soc = mean_known(charged)
        if math.isnan(soc):
            soc = SOC_UNKNOWN
        step = self._step(block, soc)
        if step is None:
            return False
        return self._find(step, soc) if self.fault is Fault.NONE else self._forgive(step)

    @property
    def doubted(self) -> bool:
        """Whether anything speaks against the sensor, if too little to suspect it."""
        return self.fault is Fault.NONE and (self._changed.doubted or self._unseen.seen)

    def shows_rest_ns(self, t_ns: int) -> int | None:
        """Since when the sensor has shown a current that may be none and does not move; None: not for long."""
        is_small = abs(self._still_A) <= self._capacity_Ah / SMALL_HOURS
        return self._still_ns if is_small and t_ns - self._still_ns >= STANDS_NS else None

    def accuse(self, since_ns: int, t_ns: int) -> None:
        """Name a sensor by what else is known: it has been wrong since `since_ns`."""
        suspected = self._changed.suspected & (Fault.CURRENT_SIGN | Fault.CURRENT_SCALE)
        kind = suspected if suspected in _TOLD else Fault.CURRENT_FAILED
        self._name(kind, since_ns, t_ns)
        self.suspected = Fault.NONE

    def _step(self, block: Block, soc: float) -> Step | None:
        voltage_V, self._voltage_V = self._voltage_V, block.voltage_V
        if math.isnan(block.dt_s):
            self._response.begin(block.current_A)
            self._double.begin(2.0 * block.current_A)
            u_V = double_V = ohmic_V = math.nan
        else:
            at = block.dt_s, soc, block.temperature_degC
            u_V, ohmic_V = self._response.fall_V(block.current_A, *at)
            double_V, _ = self._double.fall_V(2.0 * block.current_A, *at)
        y_V = block.voltage_V - voltage_V
        if math.isnan(u_V + y_V):
            self._steps.interrupt()
            self._unseen.interrupt()
            return None
        return self._steps.take(block, y_V, u_V, double_V, ohmic_V)

    def _find(self, step: Step, soc: float) -> bool:
        self._changed.take(step, self._steps.informed, soc)
        self._unseen.take(step)
        if self._unseen.since_ns is not None and self._changed.suspected is Fault.NONE:
            self._name(Fault.CURRENT_FAILED, self._unseen.since_ns, step.t_ns)
        elif self._changed.fault is not Fault.NONE:
            self._name(self._changed.fault, self._changed.since_ns, step.t_ns)
        elif self._changed.doubted:
            self._steps.doubt()
        else:
            self._steps.learn(step)
        self.suspected = self._changed.suspected | (Fault.CURRENT_FAILED if self._unseen.pending else Fault.NONE)
        if self.fault is Fault.NONE:
            return False
        self.suspected = Fault.NONE
        return True

    def _name(self, fault: Fault, since_ns: int, t_ns: int) -> None:
        self.fault, self.since_ns = fault, since_ns
        self._spell_ns = t_ns - self._event_ns if self._unseen.is_on_probation(t_ns) else 0
        self._agreed, self._event_ns = 0.0, t_ns
        told = {"of": self._of, "told": _TOLD[fault], "ago": (t_ns - since_ns) * 1e-9}
        log.error("current%(of)s: %(told)s, for %(ago).0f s; taken as missing until it is right again", told)

    def _forgive(self, step: Step) -> bool:
        right_ns = step.t_ns - self._event_ns
        if is_unseen(step):
            self._spell_ns = max(self._spell_ns, right_ns)
            self._event_ns, self._agreed = step.t_ns, 0.0
            return False
        self._agreed = max(0.0, self._agreed + agreement(step))
        if self._agreed < AGREED or right_ns < max(self._hold_ns, SPELLS * self._spell_ns):
            return False
        self.fault = Fault.NONE
        self._hold_ns = min(2 * self._hold_ns, HOLD_MAX_NS)
        self._changed.reset()
        self._unseen.reset()
        self._unseen.probation_ns = step.t_ns + PROBATION_NS
        log.info("current%(of)s: explains the voltage again, and is used again", {"of": self._of})
        return True
