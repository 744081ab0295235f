"""What the process that runs an FMU and the one that started it say to each other, packet by packet.

The first packet to the child is the plan, as JSON. It answers with any number of CALL packets, then with OUTPUTS or a
refusal. From then on every request is a row of doubles: t, the step, how many parts to make it in, and the inputs; the
answer to it is OUTPUTS, a row of doubles: the time reached and the outputs, or a refusal. A closed socket is the end.
Values are in the FMU's own units, and booleans and integers are doubles, too.
"""

from __future__ import annotations

from typing import Any, TypedDict

OUTPUTS = b"O"  # doubles
CALL = b"C"  # text: the call that is being made, while starting
UNUSABLE = b"U"  # text: the library or the instance cannot be had
PARAMETER = b"P"  # text: name of a parameter that was refused, a tab, the reason
REFUSED = b"R"  # text: the reason
FATAL = b"F"  # text: the reason; the child has ended

PACKET = 1 << 20  # octets, at most


class Variable(TypedDict):
    """A variable of the FMU; `size` is 1 but for the arrays of FMI 3.0."""

    name: str
    type: str  # as in the model description: Real, Float64, Integer, ...
    reference: int
    size: int


class Setting(Variable):
    """A start value; as many `values` as the variable has elements."""

    values: list[Any]


class Plan(TypedDict):
    """All the child needs to know. `inputs` and `outputs` are sorted by type."""

    fmi: int  # 2 or 3
    library: str
    instance: str
    token: str  # the GUID of FMI 2.0
    resources: str | None
    logger_proxy: str | None  # library that expands the C format of FMI 2.0 messages
    event_mode: bool
    variable_step: bool  # steps may be of any length
    discrete_inputs: bool  # some can only be set in event mode, if that is used
    start_time: float
    tolerance: float | None
    structural: list[Setting]
    parameters: list[Setting]
    inputs: list[Variable]
    input_start: list[float]
    outputs: list[Variable]
