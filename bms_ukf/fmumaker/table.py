"""fmu.toml: the one table of an FMU, from which its descriptions and its C header are made.

    [model]
    name = "lgm50_spme"                 # of the library, so a C name
    description = "LG M50 cell"
    reference = "where the model comes from"
    version = "1"
    step_s = 1.0
    stop_s = 3600.0
    sources = ["plant.c", "cell.c"]     # from the folder of this file, or from those that the package shares
    headers = ["state.h", "cell.h"]
    objects = []                        # compiled already: for each machine in a folder called as in FMI 3.0
                                        # (aarch64-linux), with headers of its own; the FMU then carries no sources

    [units]                             # exponents of the SI base units; factor and offset turn the unit into them
    degC = { K = 1, offset = 273.15 }

    [[variable]]
    name = "voltage_V"
    causality = "output"
    unit = "V"
    elements = 3                        # an array; left out: a scalar
    description = "terminal voltage"
    feedthrough = ["current_A"]         # what an output depends on besides the state
    at_start = ["current_A", "soc_initial"]     # what its initial value depends on

Inputs and parameters have `start` (of an array a list), `min` and `max`; `missing = true` lets an input be NaN as well.
An output may be of `type = "integer"`.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bms_ukf import toml

Identifier = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class Model(toml.Section):
    """[model]"""

    name: Identifier
    description: str
    reference: str
    version: str
    step_s: float = Field(gt=0)
    stop_s: float = Field(gt=0)
    sources: list[str] = Field(min_length=1)
    headers: list[str]
    objects: list[str] = Field(default_factory=list)


class Variable(toml.Section):
    """[[variable]]: a Real or an Integer of FMI 2.0, a Float64 or an Int32 of FMI 3.0."""

    name: Identifier
    causality: Literal["input", "output", "parameter"]
    type: Literal["real", "integer"] = "real"
    unit: str
    description: str
    elements: int | None = Field(default=None, ge=1)  # None: a scalar
    start: float | list[float] | None = None
    min: float | None = None
    max: float | None = None
    missing: bool = False  # NaN may be set, which says that there is no value
    feedthrough: list[str] = Field(default_factory=list)
    at_start: list[str] = Field(default_factory=list)

    @property
    def size(self) -> int:
        return self.elements or 1

    @property
    def starts(self) -> list[float]:
        """A value for each element; none for an output."""
        if self.start is None:
            return []
        return self.start if isinstance(self.start, list) else [self.start] * self.size

    @property
    def scalar_names(self) -> list[str]:
        """What the elements are called where there are no arrays."""
        return [self.name] if self.elements is None else [f"{self.name}[{k + 1}]" for k in range(self.elements)]

    @model_validator(mode="after")
    def _start_is_there_if_it_is_set(self) -> Self:
        if (self.causality == "output") != (self.start is None):
            raise ValueError(f"a start value of inputs and parameters, and none of outputs ({self.name})")
        if self.start is not None and len(self.starts) != self.size:
            raise ValueError(f"{self.size} start values of {self.name}")
        if (self.type == "integer" and self.causality != "output") or (self.missing and self.causality != "input"):
            raise ValueError(f"integers among outputs only, and missing values among inputs ({self.name})")
        return self


class Table(toml.Section):
    """The whole of fmu.toml. A variable's place is the sum of the sizes of those before it."""

    model: Model
    units: dict[str, dict[str, float]]
    variable: list[Variable] = Field(min_length=1)

    @model_validator(mode="after")
    def _names_are_those_of_the_table(self) -> Self:
        names = [v.name for v in self.variable]
        for v in self.variable:
            unknown = [name for name in (*v.feedthrough, *v.at_start) if name not in names]
            if unknown or names.count(v.name) > 1 or v.unit not in self.units:
                raise ValueError(f"{v.name}: a name of its own, a unit of [units] and dependencies among the variables")
        return self

    def places(self) -> dict[str, int]:
        """Where each variable begins in `value[]` of the C model; an array takes one place an element."""
        places, at = {}, 0
        for v in self.variable:
            places[v.name] = at
            at += v.size
        return places

    @property
    def size(self) -> int:
        return sum(v.size for v in self.variable)


def header(table: Table, token: str) -> str:
    """variables.h: the enum of places, and the table of start values and limits."""
    names, rows = [], []
    for name, place in table.places().items():
        names.append(f"    {name.upper()} = {place},\n")
    for v in table.variable:
        if v.elements is not None or v.causality == "output":
            names.append(f"    {v.name.upper()}_ELEMENTS = {v.size},\n")
        low = "-HUGE_VAL" if v.min is None else repr(v.min)
        high = "HUGE_VAL" if v.max is None else repr(v.max)
        for k, name in enumerate(v.scalar_names):
            start, elements = (v.starts[k] if v.starts else 0.0), (v.size if k == 0 else 0)
            kind = f"{v.causality.upper()}, {v.type.upper()}, {int(v.missing)}"
            rows.append(f'    {{"{name}", {kind}, {elements}, {start!r}, {low}, {high}}},\n')
    return (
        "/* Generated from fmu.toml: do not edit. */\n#ifndef VARIABLES_H\n#define VARIABLES_H\n\n#include <math.h>\n\n"
        f'#define MODEL_TOKEN "{token}"\n\n'
        f"/* Places in value[]. */\nenum {{\n{''.join(names)}    N_VALUES = {table.size}\n}};\n\n"
        "typedef struct {\n    const char *name;\n    enum { INPUT, OUTPUT, PARAMETER } kind;\n"
        "    enum { REAL, INTEGER } type;\n    int may_be_nan; /* an input: there is no value */\n"
        "    unsigned elements; /* of the variable that begins here; 0 within an array */\n"
        "    double start, min, max;\n} Value;\n\n"
        f"static const Value VALUES[N_VALUES] = {{\n{''.join(rows)}}};\n\n#endif\n"
    )
