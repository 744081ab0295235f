"""What several test modules need. What they compare with, or are made of, is in `reference/`."""

from __future__ import annotations

import hypothesis
import pytest

from bms_ukf import CellParams

# A machine that is busy is not a failure.
hypothesis.settings.register_profile("bms-ukf", deadline=None)
hypothesis.settings.load_profile("bms-ukf")


@pytest.fixture(scope="session")
def cell() -> CellParams:
    return CellParams.load("lgm50_chen2020")
