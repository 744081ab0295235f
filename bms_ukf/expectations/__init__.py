"""What a scenario expects of the daemon: the `[[expect]]` tables, each judged by what a run recorded."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bms_ukf.expectations import cells, faults, soc, words

Expectation = Annotated[
    soc.SocError
    | soc.Coverage
    | soc.NeverValidAndWrong
    | cells.CellSocError
    | cells.LowestCell
    | words.StatusSequence
    | words.StoredState
    | words.PlantFailure
    | faults.Detected
    | faults.Recovered
    | faults.Quiet,
    Field(discriminator="kind"),
]
