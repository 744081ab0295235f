"""What is done to the daemon, its files, its clock and its interface, and when."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from bms_ukf.faults.base import Injection
from bms_ukf.faults.can import InterfaceDown
from bms_ukf.faults.system import ClockStep, ColdRestart, DaemonKilled, StateCorrupted
from bms_ukf.hil.unit import Unit, corrupt


class Timeline:
    """The actions of a scenario's faults, each done once."""

    def __init__(self, faults: Sequence[Injection], unit: Unit) -> None:
        self._unit = unit
        self._actions = sorted((action for fault in faults for action in self._of(fault)), key=lambda action: action[0])

    def reach(self, t_ns: int) -> None:
        """Do all that is due at this time."""
        while self._actions and 1e9 * self._actions[0][0] <= t_ns:
            _, action = self._actions.pop(0)
            action()

    def _of(self, fault: Injection) -> list[tuple[float, Callable[[], object]]]:
        unit = self._unit
        match fault:
            case DaemonKilled():
                return [(fault.at_s, unit.kill), (fault.end_s, unit.start)]
            case ColdRestart():
                forget = partial(unit.state.unlink, missing_ok=True)
                return [(fault.at_s, unit.kill), (fault.at_s, forget), (fault.end_s, unit.start)]
            case StateCorrupted():
                return [(fault.at_s, partial(corrupt, unit.state, fault.how))]
            case ClockStep():
                back = [] if fault.for_s is None else [(fault.end_s, partial(unit.set_clock, 0.0))]
                return [(fault.at_s, partial(unit.set_clock, fault.step_s)), *back]
            case InterfaceDown():
                return [
                    (fault.at_s, partial(unit.interface, up=False)),
                    (fault.end_s, partial(unit.interface, up=True)),
                ]
        return []
