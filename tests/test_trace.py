from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf.errors import ConfigError
from bms_ukf.records import Estimate, Fault, Sample, Status
from bms_ukf.trace import Trace

ESTIMATE = Estimate(
    soc=0.5,
    soc_sigma=0.01,
    voltage_pred_V=3.7,
    innovation_V=-0.001,
    nis=0.25,
    status=Status.DEGRADED,
    faults=Fault.VOLTAGE_MISSING | Fault.E2E,
    soc_low=0.48,
    soc_high=0.53,
)
FULL = Sample(2_000_000_000, 1.5, 3.699, 25.5), ESTIMATE, 0.51, Sample(2_000_000_000, 1.4, 3.698, 25.4)
EMPTY = Sample(1_100_000_000), Estimate()


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def trace_of(*rows: tuple) -> Trace:
    trace = Trace(len(rows))
    for row in rows:
        trace.append(*row)
    return trace


def test_every_value_lands_in_the_column_of_its_name() -> None:
    trace = trace_of(FULL)
    expected = {
        "soc": 0.5,
        "soc_sigma": 0.01,
        "voltage_pred_V": 3.7,
        "innovation_V": -0.001,
        "nis": 0.25,
        "soc_ref": 0.51,
        "current_A": 1.5,
        "voltage_V": 3.699,
        "temperature_degC": 25.5,
        "current_true_A": 1.4,
        "voltage_true_V": 3.698,
        "temperature_true_degC": 25.4,
        "soc_low": 0.48,
        "soc_high": 0.53,
    }
    assert {name: trace[name][0] for name in expected} == expected
    assert (trace.t_s[0], trace.status[0], trace.faults[0]) == (2.0, Status.DEGRADED, ESTIMATE.faults)


def test_the_csv_has_the_contracts_columns_first_and_words_for_status(tmp_path: Path) -> None:
    trace_of(EMPTY, FULL).write_csv(tmp_path / "t.csv")
    empty, full = rows_of(tmp_path / "t.csv")
    assert list(full)[:7] == ["time_s", "soc", "soc_sigma", "voltage_pred_V", "innovation_V", "nis", "status"]
    assert (full["time_s"], full["soc"], full["status"], full["faults"]) == (
        "2",
        "0.5",
        "degraded",
        "voltage_missing|e2e",
    )
    assert (empty["time_s"], empty["status"]) == ("1.1", "initialising")


def test_missing_is_an_empty_field_and_not_zero(tmp_path: Path) -> None:
    trace_of(EMPTY, FULL).write_csv(tmp_path / "t.csv")
    empty = rows_of(tmp_path / "t.csv")[0]
    assert {empty[name] for name in empty if name not in {"time_s", "status"}} == {""}


def test_unknown_truth_has_no_columns(tmp_path: Path) -> None:
    trace_of(FULL[:2]).write_csv(tmp_path / "t.csv")
    assert list(rows_of(tmp_path / "t.csv")[0])[8:] == [
        "current_A",
        "voltage_V",
        "temperature_degC",
        "soc_low",
        "soc_high",
    ]


NUMBER = st.floats(-1e6, 1e6) | st.just(math.nan)


@given(
    numbers=st.lists(NUMBER, min_size=12, max_size=12),
    t_ns=st.integers(0, 10**15),
    status=st.sampled_from(Status),
    faults=st.integers(0, sum(Fault)),
)
def test_a_written_trace_reads_back(tmp_path_factory, numbers, t_ns, status, faults) -> None:
    a = numbers
    estimate = Estimate(0, a[0], a[1], a[2], a[3], nis=a[4], status=status, faults=Fault(faults))
    trace = trace_of((Sample(t_ns, *a[6:9]), estimate, a[5], Sample(0, *a[9:])))
    path = tmp_path_factory.mktemp("trace") / "t.csv"
    trace.write_csv(path)
    back = Trace.read_csv(path)
    assert back.t_ns.tolist() == [t_ns]
    assert (back.status[0], back.faults[0]) == (status, faults)
    for name in ("soc", "nis", "soc_ref", "temperature_true_degC"):
        assert back[name] == pytest.approx(trace[name], rel=1e-8, abs=1e-30, nan_ok=True)


def test_columns_show_only_the_rows_appended_and_grow_beyond_the_first_capacity() -> None:
    trace = Trace(2)
    assert trace["soc"].shape == trace.t_s.shape == trace.status.shape == (0,)
    trace.append(*FULL)
    assert trace["soc"].tolist() == [0.5]
    trace.append(*EMPTY)
    trace.append(*FULL)
    assert len(trace) == trace.t_s.size == trace.status.size == 3
    assert trace["soc"].tolist() == pytest.approx([0.5, math.nan, 0.5], nan_ok=True)


def test_a_place_that_cannot_be_written_is_named() -> None:
    with pytest.raises(ConfigError, match=r"^/proc/trace\.csv: expected a file that can be written"):
        Trace(0).write_csv(Path("/proc/trace.csv"))


def test_an_empty_trace_is_a_header(tmp_path: Path) -> None:
    Trace(0).write_csv(tmp_path / "t.csv")
    assert (
        tmp_path / "t.csv"
    ).read_text() == "time_s,soc,soc_sigma,voltage_pred_V,innovation_V,nis,status,faults,soc_low,soc_high\n"
    assert len(Trace.read_csv(tmp_path / "t.csv")) == 0


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("soc_sigma", "sigma", "soc_sigma"),
        ("degraded", "fine", "status, row 1"),
        ("|e2e", "|e3e", "faults, row 1"),
        (",3.699,", ",3.6x,", "voltage_V, row 1"),
    ],
)
def test_a_damaged_file_is_named_with_column_and_row(tmp_path: Path, old: str, new: str, key: str) -> None:
    path = tmp_path / "t.csv"
    trace_of(FULL).write_csv(path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        Trace.read_csv(path)
    assert (caught.value.source, caught.value.key) == (str(path), key)


def test_a_truncated_row_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    trace_of(FULL).write_csv(path)
    path.write_text(path.read_text().split("degraded")[0].rstrip(",") + "\n")
    with pytest.raises(ConfigError, match="status, row 1"):
        Trace.read_csv(path)
