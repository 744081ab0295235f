"""A plant: one or several FMUs that play the cell or the cells, advanced step by step.

The inputs set at t act over [t, t + h]; the outputs are those at t + h. Time is counted in whole nanoseconds.
"""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np

from bms_ukf import resources, toml
from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.plant.part import Part
from bms_ukf.plant.roles import wire_up
from bms_ukf.plant.table import PlantTable
from bms_ukf.records import NAN, PerCell

Input = Literal["current_A", "power_W", "voltage_V"]
_INPUTS: dict[str, Input] = {  # by the role of what drives the plant
    "current_A": "current_A",
    "power_W": "power_W",
    "supply_V": "voltage_V",
    "voltage_V": "voltage_V",
}


@dataclass(slots=True)
class PlantState:
    """The plant's outputs at `t_ns`; NaN for those it does not have. A float, or an array of shape (cells,).

    `current_A` is positive on discharge: the one that was asked for or that a part of the plant asked for, the FMU's
    output, or the power over the mean of the pack voltage before and after the step.
    """

    t_ns: int
    voltage_V: PerCell = NAN
    temperature_degC: PerCell = NAN
    soc: PerCell = NAN
    current_A: PerCell = 0.0


class Plant:
    """Running FMUs, each in a process of its own; a context manager. `state` holds the latest outputs, from t = 0 on.

    At the start the current and the power are 0, an applied voltage is the FMU's default, and the connections do not
    act yet. The thread that makes a plant must outlive it. Raises ConfigError for an FMU that cannot be used here and
    for a name or value it does not take, PlantError for one that fails while starting.
    """

    def __init__(self, table: PlantTable, relative_to: Path | None = None) -> None:
        self.table = table
        self._ambient_degC = NAN
        self._exchange_ns = 0 if table.step_s is None or table.fmu else round(table.step_s * 1e9)
        with ExitStack() as undo:
            self._parts = []
            for part in table.parts():
                folder = Path(undo.enter_context(tempfile.TemporaryDirectory(prefix="plant-"))).resolve()
                path = resources.find(part.fmu, "plants", ".fmu", relative_to=relative_to)
                self._parts.append(Part(part, path, folder, validate=table.validate_))
            self._wiring = wire_up(table, self._parts)
            for each in self._parts:
                each.prepare()
            self._settle()
            for each in self._parts:
                undo.callback(each.close)
                each.start(deadline_s=table.deadline_s, memory_limit_MB=table.memory_limit_MB)
            self.state = PlantState(0)
            self.state = self._observe(0, self._wiring.drive.held() if self._wiring.drive is not None else NAN)
            self._undo = undo.pop_all()

    @property
    def input(self) -> Input | None:
        """What `step` takes: "current_A", "power_W" or "voltage_V"; None if a part of the plant drives it."""
        return _INPUTS.get(self._wiring.load or "")

    def step(self, load: float, step_ns: int) -> PlantState:
        """Advances by `step_ns` > 0 with the load held; returns the new `state`.

        The load is a current (A) or a power (W), positive = discharge, or a voltage (V), see `input`. Raises PlantError
        if an FMU fails. After a refused step a plant of one FMU is where it was; else its processes are ended.
        """
        t_ns = self.state.t_ns
        exchange_ns = self._exchange_ns or step_ns
        if step_ns % exchange_ns:
            expected = f"a part of the plant's step, {step_ns * 1e-9:g} s"
            raise ConfigError(self.table.label, key="plant.step_s", value=self.table.step_s, expected=expected)
        if self._wiring.drive is not None:
            self._wiring.drive.write(load)
        for _ in range(step_ns // exchange_ns):
            for source, target in self._wiring.connections:
                target.write(source.read())
            self._advance(exchange_ns)
        self.state = self._observe(t_ns + step_ns, load)
        return self.state

    def set_ambient(self, ambient_degC: float) -> None:
        """Sets the ambient temperature from the next step on: the FMU's input, if it has one."""
        self._ambient_degC = ambient_degC
        if self._wiring.ambient is not None:
            self._wiring.ambient.write(ambient_degC)

    def kill(self) -> None:
        """Ends the FMUs' processes at once, as a crash would: the next step fails so."""
        for part in self._parts:
            part.process.kill()

    def pause(self) -> None:
        """Stops the FMUs' processes, as a hang would: the next step fails once its deadline has passed."""
        for part in self._parts:
            part.process.pause()

    def close(self) -> None:
        """Ends the FMUs and removes their files. May be called again."""
        self._undo.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _settle(self) -> None:
        """Start values of the inputs that have a role."""
        wiring = self._wiring
        for source, target in wiring.connections:
            source.settle(is_input=False)
            target.settle(is_input=True)
        for channel in wiring.outputs.values():
            channel.settle(is_input=False)
        if wiring.drive is not None:
            wiring.drive.settle(is_input=True)
            if self.input != "voltage_V":
                wiring.drive.write(0.0)
        if wiring.ambient is not None:
            wiring.ambient.settle(is_input=True)
            self._ambient_degC = float(wiring.ambient.held())
        if self.table.ambient_degC is not None:
            self.set_ambient(self.table.ambient_degC)

    def _advance(self, step_ns: int) -> None:
        failure: PlantError | None = None
        for part in self._parts:
            part.begin(step_ns)
        for part in self._parts:
            try:
                part.finish()
            except PlantError as error:
                failure = failure or error
        if failure is not None:
            if failure.kind != "refused" or len(self._parts) > 1:
                self.kill()
            raise failure

    def _observe(self, t_ns: int, load: PerCell) -> PlantState:
        outputs = {role: channel.read() for role, channel in self._wiring.outputs.items()}
        voltage_V = outputs.get("voltage_V", load)
        if "current_A" in outputs or self._wiring.load is None:
            current_A = outputs.get("current_A", NAN)
        elif self._wiring.load == "current_A":
            current_A = load
        else:
            before_V = self.state.voltage_V if t_ns else voltage_V
            current_A = load / float((np.sum(before_V) + np.sum(voltage_V)) / 2)
        temperature_degC = outputs.get("temperature_degC", self._ambient_degC)
        return PlantState(t_ns, voltage_V, temperature_degC, outputs.get("soc", NAN), current_A)


def open_plant(given: PlantTable | str | Path, relative_to: Path | None = None, **keys: Any) -> Plant:
    """The plant of a [plant] table, whose files are relative to a folder; or of an FMU and the other keys of the table.

    Raises ConfigError and PlantError as Plant does.
    """
    if not isinstance(given, PlantTable):
        given = toml.validate({"fmu": str(given), **keys}, PlantTable, "plant")
    return Plant(given, relative_to)
