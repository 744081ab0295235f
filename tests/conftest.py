"""What several test modules need. What they compare with, or are made of, is in `reference/`."""

from __future__ import annotations

import os

import hypothesis
import pytest

from bms_ukf import CellParams

# A busy machine is not a failure. CI tries the same examples every time; whoever works on the code tries others.
hypothesis.settings.register_profile("bms-ukf", deadline=None, derandomize="CI" in os.environ)
hypothesis.settings.load_profile("bms-ukf")


@pytest.fixture(scope="session")
def cell() -> CellParams:
    return CellParams.load("lgm50_chen2020")
