"""[plant] of a SCENARIO file: the FMU or FMUs that are driven, how they start and what their variables are for.

    [plant]                                # one FMU
    fmu = "cell.fmu"                       # a file, or the name of a shipped plant
    parameters = { soc_initial = 0.8 }     # start values by FMU name; a list for an array
    ambient_degC = 25.0
    current_positive = "discharge"         # sign of its current and power
    step_s = 0.1                           # the FMU's own step; left out: what the FMU asks for, or the scenario's
    deadline_s = 10.0                      # longest a step may take by the clock on the wall
    memory_limit_MB = 2048
    on_failure = "end"                     # or "degrade": the run goes on without measurements
    validate = true                        # false: use the FMU although its model description breaks the standard

    [plant.variables]                      # role = name; left out: the role's own name; "": the FMU has none
    current_A = "I"
    voltage_V = { name = "U", unit = "mV", gain = -1.0 }    # what the FMU does not say itself
    temperature_degC = ["cell[1].T", "cell[2].T"]           # several cells

    [[plant.part]]                         # several FMUs, instead of `fmu`; variables are then "part.variable"
    name = "cell"
    fmu = "cell.fmu"

    [[plant.connect]]                      # to = from, in the units each declares, * gain + offset
    from = "cell.heat"
    to = "housing.Q_in"

Connected parts advance side by side: each sees the outputs that the others had at the beginning of the step, whatever
the order in which they are listed. `step_s` of the plant is then how often they exchange values.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bms_ukf import toml

Text = Annotated[str, Field(min_length=1)]
Seconds = Annotated[float, Field(gt=0)]
Number = bool | int | float
Parameters = dict[str, Number | str | list[Number]]


class VariableTable(toml.Section):
    """A variable for a role: value in the role's unit = FMU value, converted from `unit`, * gain + offset."""

    name: Text | list[Text]
    unit: str | None = None  # None: the one the FMU declares
    gain: float = 1.0
    offset: float = 0.0


class PartTable(toml.Section):
    """[[plant.part]]: one of several connected FMUs."""

    name: Annotated[str, Field(pattern=r"^\w+$")]
    fmu: Text
    parameters: Parameters = Field(default_factory=dict)
    step_s: Seconds | None = None


class ConnectTable(toml.Section):
    """[[plant.connect]]: an output of one part is an input of another."""

    source: Annotated[Text, Field(alias="from")]
    to: Text
    gain: float = 1.0
    offset: float = 0.0


class PlantTable(toml.Section):
    """[plant]: what is driven, how it starts, and what becomes of the run when it fails."""

    fmu: Text | None = None
    parameters: Parameters = Field(default_factory=dict)
    part: list[PartTable] = Field(default_factory=list)
    connect: list[ConnectTable] = Field(default_factory=list)
    variables: dict[str, str | list[Text] | VariableTable] = Field(default_factory=dict)
    ambient_degC: float | None = None  # None: the FMU's own
    current_positive: Literal["charge", "discharge"] = "discharge"
    step_s: Seconds | None = None
    deadline_s: Seconds = 10.0
    memory_limit_MB: Annotated[float, Field(gt=0)] = 2048.0
    on_failure: Literal["end", "degrade"] = "end"
    validate_: Annotated[bool, Field(alias="validate")] = True

    @model_validator(mode="after")
    def _one_or_several(self) -> Self:
        if (self.fmu is None) == (not self.part):
            raise ValueError("either fmu, or [[plant.part]] for several FMUs")
        if self.part and self.parameters:
            raise ValueError("parameters in [[plant.part]], where there are several FMUs")
        names = [part.name for part in self.part]
        if len(set(names)) < len(names):
            raise ValueError(f"a name of its own for each [[plant.part]], not {', '.join(names)}")
        if self.connect and not self.part:
            raise ValueError("[[plant.part]] for [[plant.connect]] to connect")
        return self

    @property
    def label(self) -> str:
        """The FMU, or FMUs, in one string."""
        return self.fmu or " + ".join(part.fmu for part in self.part)

    def parts(self) -> list[PartTable]:
        """The FMUs; a single one has the name "fmu", which no variable name is preceded by."""
        if self.fmu is None:
            return self.part
        return [PartTable(name="fmu", fmu=self.fmu, parameters=self.parameters, step_s=self.step_s)]
