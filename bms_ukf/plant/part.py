"""One FMU of a plant: its variables that are used, its process, and its own step beside the plant's."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import fmpy

from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.fmi import wire
from bms_ukf.plant import archive
from bms_ukf.plant.description import FLOATS, number, settings, start_of, structural_values, wired
from bms_ukf.plant.process import FmuProcess
from bms_ukf.plant.table import PartTable


class Part:
    """An FMU: described when made, its variables picked by `use_input` and `use_output`, and then opened.

    Once open, `inputs` holds the values for the next step and `outputs` those after the last one, in the FMU's units;
    `input_places` and `output_places` tell where a variable's elements are in them. Raises ConfigError for an FMU that
    cannot be used.
    """

    def __init__(self, table: PartTable, path: Path, folder: Path, *, validate: bool) -> None:
        self.name, self.path, self._table, self._folder = table.name, path, table, folder
        archive.unpack(path, folder)
        self.description = archive.describe(path, folder)
        self._library = archive.library(path, folder, self.description)
        if validate and (found := archive.findings(folder)):
            more = f"; {len(found) - 1} more" if len(found) > 1 else ""
            expected = f"a modelDescription.xml as the FMI standard has it, or validate = false ({found[0]}{more})"
            raise ConfigError(path, key="plant.validate", value=True, expected=expected)
        self.inputs: list[float] = []
        self.outputs: list[float] = []
        self._variables: tuple[dict[str, Any], dict[str, Any]] = ({}, {})  # inputs, outputs
        self._places: tuple[dict[str, range], dict[str, range]] = ({}, {})
        self._t_ns = 0  # where the FMU is
        self._held_ns = 0  # how long inputs have been collected for a step that is longer than the plant's
        self._sums: list[float] = []
        self._sent_ns = 0  # the step whose answer is awaited
        self._process: FmuProcess

    def use_input(self, variable: Any) -> None:
        self._variables[0][variable.name] = variable

    def use_output(self, variable: Any) -> None:
        self._variables[1][variable.name] = variable

    def input_places(self, name: str) -> range:
        return self._places[0][name]

    def output_places(self, name: str) -> range:
        return self._places[1][name]

    def prepare(self) -> None:
        """Settles sizes and places, and the start values of `inputs`, which may then be changed before `start`."""
        structural, parameters = settings(
            self.path, self.description, self._table.parameters, taken=[*self._variables[0]]
        )
        sizes = structural_values(structural)
        rows: list[list[wire.Variable]] = []
        for variables, places in zip(self._variables, self._places, strict=True):
            row = sorted((wired(self.description, v, sizes) for v in variables.values()), key=lambda v: v["type"])
            first = 0
            for variable in row:
                places[variable["name"]] = range(first, first + variable["size"])
                first += variable["size"]
            rows.append(row)
        inputs, outputs = rows
        self._averaged = [variable["type"] in FLOATS for variable in inputs for _ in range(variable["size"])]
        self.inputs = [
            start_of(self._variables[0][variable["name"]]) or 0.0
            for variable in inputs
            for _ in range(variable["size"])
        ]
        co_simulation, experiment = self.description.coSimulation, self.description.defaultExperiment
        is_fmi2 = self.description.fmiVersion.startswith("2.")
        self._start_time = number(experiment and experiment.startTime) or 0.0
        self._plan: wire.Plan = {
            "fmi": 2 if is_fmi2 else 3,
            "library": str(self._library),
            "instance": self.name,
            "token": self.description.guid or "",
            "resources": self._resources(is_fmi2=is_fmi2),
            "logger_proxy": _logger_proxy() if is_fmi2 else None,
            "event_mode": co_simulation.hasEventMode,
            "variable_step": co_simulation.canHandleVariableCommunicationStepSize,
            "discrete_inputs": any(variable.variability == "discrete" for variable in self._variables[0].values()),
            "start_time": self._start_time,
            "tolerance": number(experiment and experiment.tolerance),
            "structural": structural,
            "parameters": parameters,
            "inputs": inputs,
            "input_start": self.inputs,
            "outputs": outputs,
        }

    def start(self, *, deadline_s: float, memory_limit_MB: float) -> None:
        """Starts the FMU at t = 0 with the `inputs` as they are. ConfigError, PlantError: see FmuProcess."""
        limits = {"deadline_s": deadline_s, "memory_limit_MB": memory_limit_MB}
        self._process = FmuProcess(str(self.path), self._plan, self._folder, **limits)
        self._fixed_ns = self._internal_step_ns()
        self._take(self._process.start)

    @property
    def process(self) -> FmuProcess:
        return self._process

    def begin(self, step_ns: int) -> None:
        """Sends the FMU off over the plant's next step.

        An FMU with a longer step of its own waits until that has passed, and is then given the mean of its inputs, so
        that the charge is the same; an FMU with a shorter one makes several steps.
        """
        own_ns = self._own_step_ns(step_ns)
        if step_ns % own_ns == 0 and not self._held_ns:
            self._send(step_ns, step_ns // own_ns, self.inputs)
            return
        self._held_ns += step_ns
        if own_ns % step_ns or self._held_ns > own_ns:
            raise ConfigError(
                self.path,
                key="step_s",
                value=own_ns / 1e9,
                expected=f"a part or a multiple of the plant's step, {step_ns * 1e-9:g} s",
            )
        weighted = (value * step_ns for value in self.inputs)
        self._sums = [a + b for a, b in zip(self._sums, weighted, strict=True)] if self._sums else [*weighted]
        if self._held_ns == own_ns:
            means = [
                total / own_ns if averaged else value
                for total, averaged, value in zip(self._sums, self._averaged, self.inputs, strict=True)
            ]
            self._held_ns, self._sums = 0, []
            self._send(own_ns, 1, means)

    def finish(self) -> None:
        """Waits for what `begin` sent off. Raises PlantError; only a "refused" step leaves the FMU where it was."""
        if self._sent_ns:
            sent_ns, self._sent_ns = self._sent_ns, 0
            try:
                outputs = self._process.answer()
            except PlantError as error:
                if error.kind == "refused" and not self._t_ns:  # it may be the length of the step
                    raise PlantError(
                        f"{error} (a step of {sent_ns * 1e-9:g} s; step_s sets another)", "refused"
                    ) from None
                raise
            self._t_ns += sent_ns
            self._take(outputs)

    def close(self) -> None:
        """Ends the FMU, if it was started."""
        if hasattr(self, "_process"):
            self._process.close()

    def _send(self, step_ns: int, parts: int, inputs: list[float]) -> None:
        self._sent_ns = step_ns
        self._process.request(self._start_time + self._t_ns * 1e-9, step_ns * 1e-9, parts, inputs)

    def _take(self, outputs: list[float]) -> None:
        if not math.isfinite(sum(outputs)):
            wrong = [
                f"{name} = {outputs[place]}"
                for name, places in self._places[1].items()
                for place in places
                if not math.isfinite(outputs[place])
            ]
            if wrong:
                at = f"outputs at t = {self._t_ns * 1e-9:g} s"
                raise PlantError(f"{self.path}: {at}: {', '.join(wrong[:3])}", "nan")
        self.outputs = outputs

    def _own_step_ns(self, step_ns: int) -> int:
        """The step that the user asks for, or the FMU; else the plant's."""
        if self._table.step_s is not None:
            return round(self._table.step_s * 1e9)
        if not self._fixed_ns or step_ns % self._fixed_ns == 0:
            return step_ns  # a communication step may be several internal ones
        if self._fixed_ns % step_ns and self._plan["fmi"] == 2:
            return step_ns  # the step size of FMI 2.0 is only what the FMU suggests
        return self._fixed_ns

    def _internal_step_ns(self) -> int:
        """The FMU's internal step, if it is fixed; else 0."""
        co_simulation, experiment = self.description.coSimulation, self.description.defaultExperiment
        fixed_s = co_simulation.fixedInternalStepSize
        if fixed_s is None and not co_simulation.canHandleVariableCommunicationStepSize and experiment is not None:
            fixed_s = experiment.stepSize
        return round((number(fixed_s) or 0.0) * 1e9)

    def _resources(self, *, is_fmi2: bool) -> str | None:
        """FMI 2.0 has a URI, FMI 3.0 a path that ends with a separator, and nothing if there is no such folder."""
        folder = (self._folder / "resources").resolve()
        if is_fmi2:
            return folder.as_uri()
        return f"{folder}/" if folder.is_dir() else None


def _logger_proxy() -> str | None:
    """fmpy's library that expands the C format of FMI 2.0 messages, for the platforms it has it for."""
    proxy = Path(fmpy.__file__).parent / "logging" / fmpy.platform / f"logging{fmpy.sharedLibraryExtension}"
    return str(proxy) if proxy.is_file() and fmpy.architecture == "x86_64" else None
