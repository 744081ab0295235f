"""What a set of frames says of all the steps since the one before it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf.publication import REST_NS, Publication
from bms_ukf.records import NAN, Estimate, Fault, Sample, Source, Status

SECOND_NS = 1_000_000_000
KNOWN = Estimate(soc=0.5, soc_sigma=0.01, voltage_pred_V=3.7, age_s=0.0, status=Status.OK)
FUSED = {"innovation_V": 0.001, "nis": 0.1, "age_s": 0.0}


def estimate(**values: Any) -> Estimate:
    return replace(KNOWN, **values)


def slewed(publication: Publication, t_s: float, soc: float, **values: Any) -> float:
    return publication.complete(estimate(soc=soc, **values), round(t_s * SECOND_NS)).soc_slewed


def test_a_correction_is_no_step_for_a_display_and_is_followed_in_time() -> None:
    publication = Publication(capacity_Ah=5.0, slew_per_s=0.001)
    assert slewed(publication, 0.0, 0.80) == 0.80
    shown = [slewed(publication, t_s, 0.70) for t_s in np.arange(0.1, 200.0, 0.1)]
    steps = np.diff([0.80, *shown])
    assert np.abs(steps).max() <= 0.1 * 0.001 + 1e-12
    assert shown[-1] == 0.70


def test_charge_that_flows_is_shown_at_once_however_fast() -> None:
    publication = Publication(capacity_Ah=5.0, slew_per_s=1e-6)
    soc = 0.8
    slewed(publication, 0.0, soc)
    for t in range(1, 60):  # 10 C
        publication.follow(Sample(t * SECOND_NS, current_A=50.0), estimate())
        soc -= 50.0 / 3600 / 5.0
        assert slewed(publication, t, soc) == pytest.approx(soc, abs=0.004), "a step late, as the first has no before"


def test_a_soc_that_is_not_available_is_not_shown_and_starts_anew() -> None:
    publication = Publication(capacity_Ah=5.0)
    slewed(publication, 0.0, 0.8)
    assert math.isnan(slewed(publication, 1.0, NAN, status=Status.INVALID))
    assert slewed(publication, 2.0, 0.3) == 0.3


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 10)), min_size=1, max_size=30))
def test_slewed_stays_between_what_it_was_and_the_soc(steps: list[tuple[float, float]]) -> None:
    publication, t_s, shown = Publication(capacity_Ah=5.0), 0.0, NAN
    for soc, wait_s in steps:
        t_s += wait_s
        before, shown = shown, slewed(publication, t_s, soc)
        low, high = sorted([soc, soc if math.isnan(before) else before])
        assert low - 1e-12 <= shown <= high + 1e-12


def test_the_source_goes_from_nothing_to_start_to_voltage_to_rest() -> None:
    publication = Publication(capacity_Ah=5.0)
    seen = []
    for t_ns, current_A, values in (
        (0, NAN, {"status": Status.INITIALISING, "age_s": NAN}),
        (1, 0.0, FUSED),
        (SECOND_NS, 2.0, FUSED),
        (2 * SECOND_NS, 0.0, FUSED),
        (SECOND_NS + REST_NS, 0.01, FUSED),
        (SECOND_NS + REST_NS + 1, 2.0, {"age_s": 1.0}),
        (SECOND_NS + REST_NS + 2, 0.0, FUSED),
    ):
        publication.follow(Sample(t_ns, current_A=current_A), estimate(**values))
        seen.append(publication.detail.source)
    assert seen == [
        Source.NONE,
        Source.START,
        Source.VOLTAGE,
        Source.VOLTAGE,
        Source.REST,
        Source.REST,
        Source.VOLTAGE,
    ]


def test_a_current_that_is_missing_is_no_rest() -> None:
    publication = Publication(capacity_Ah=5.0)
    publication.follow(Sample(0, current_A=0.0), estimate(**FUSED))
    missing = estimate(faults=Fault.CURRENT_MISSING, **FUSED)
    publication.follow(Sample(2 * REST_NS, voltage_V=3.7), missing)
    publication.follow(Sample(2 * REST_NS + 1, current_A=0.0), estimate(**FUSED))
    assert publication.detail.source is Source.VOLTAGE


def test_what_was_stored_is_the_source_until_a_voltage_is_used() -> None:
    publication = Publication(capacity_Ah=5.0)
    publication.detail.source = Source.STORED
    publication.follow(Sample(0, current_A=0.0), estimate(age_s=3.0))
    assert publication.detail.source is Source.STORED
    publication.follow(Sample(1, current_A=0.0), estimate(**FUSED))
    assert publication.detail.source is Source.VOLTAGE


def test_a_pack_is_compared_cell_by_cell_over_a_whole_scan_and_not_its_last_page_only() -> None:
    publication = Publication(capacity_Ah=5.0)
    shown = estimate(
        soc=np.full(4, 0.5),
        soc_sigma=np.full(4, 0.01),
        voltage_pred_V=np.full(4, NAN),
        innovation_V=np.full(4, NAN),
        nis=np.full(4, NAN),
        age_s=np.zeros(4),
    )
    for page, innovation in ((slice(0, 2), 0.02), (slice(2, 4), 0.001)):
        for name in ("voltage_pred_V", "innovation_V", "nis"):
            getattr(shown, name)[:] = NAN
        shown.innovation_V[page], shown.nis[page] = innovation, (innovation / 0.005) ** 2
        publication.follow(Sample(0, voltage_V=np.full(4, 3.7)), shown, np.arange(page.start, page.stop))
    publication.complete(shown, 0)
    assert shown.innovation_V.tolist() == [0.02, 0.02, 0.001, 0.001]
    assert int(np.argmax(shown.nis)) == 0, "the worst cell was on the first page"
    shown.innovation_V[:] = NAN
    publication.complete(shown, 1)
    assert np.isnan(shown.innovation_V).all(), "told once"
