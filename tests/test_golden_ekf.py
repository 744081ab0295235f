"""The baseline of the EKF is whole, and a listing against it pairs the right groups. It is run by hand: minutes."""

from __future__ import annotations

import math

import golden_ekf
import pytest

from bms_ukf.manifest import Manifest
from bms_ukf.score.cases import LEVELS, OFFSETS_A


@pytest.mark.parametrize("name", golden_ekf.SETS)
def test_the_baseline_has_every_group_of_its_set(name: str) -> None:
    kept = golden_ekf.load()["sets"][name]
    assert len(kept["cell_sha256"]) == 64
    tests = Manifest.load(golden_ekf.ROOT / "models" / "cells" / "manifests" / f"{name}.toml").test
    degrees = {test.temperature_degC for test in tests if test.role == "drive" and test.use == "validate"}
    whole_drive = {"nominal", *(f"offset {a:+g} A" for a in OFFSETS_A), *(f"startup {soc:g}" for soc in LEVELS)}
    cuts = {f"initial {soc:g}" for soc in LEVELS}
    for degree in degrees:
        cases = {variant["case"] for variant in kept["variants"] if variant["temperature_degC"] == degree}
        assert whole_drive < cases <= whole_drive | cuts
    for variant in kept["variants"]:
        assert variant["temperature_degC"] in degrees
        assert all(math.isfinite(variant[key]) for key in golden_ekf.KEPT if key != "case")
        assert 0 <= variant["coverage95"] <= 1
        assert 0 < variant["rmse_pct"] <= variant["max_pct"] <= 100


def test_a_listing_pairs_groups_by_temperature_and_case_and_shows_those_of_one_side() -> None:
    def variant(temperature: float, case: str, rmse_pct: float) -> dict:
        more = {"coverage95": 0.9, "half_width_pct": 2.0}
        return {"temperature_degC": temperature, "case": case, "rmse_pct": rmse_pct, **more}

    golden = {"sets": {"a": {"variants": [variant(25, "nominal", 3.0), variant(0, "nominal", 4.0)]}}}
    rows = list(golden_ekf.against("a", golden, [variant(0, "nominal", 1.0), variant(0, "startup 0.3", 2.0)]))
    assert [row[1:5] for row in rows] == [
        (25, "nominal", 3.0, None),
        (0, "nominal", 4.0, 1.0),
        (0, "startup 0.3", None, 2.0),
    ]
