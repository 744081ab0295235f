"""Recordings of real cells as traces: absent ones are named, and what is there keeps its charge, sign and reference."""

from __future__ import annotations

import gzip
import os

import numpy as np
import pytest

from bms_ukf.campaign import recorded
from bms_ukf.errors import ConfigError
from bms_ukf.manifest import DATA_FOLDER

REFERENCE_ERROR = 0.025  # SoC: a cycler's count with its charge efficiency, against the charge alone


@pytest.fixture
def made_up(tmp_path, monkeypatch):
    """Every recording, as half an hour of soak at 60 s, 500 s of a load at 10 Hz, and a rest."""
    soak_s = np.arange(0.0, 1800.0, 60.0)
    time_s = np.concatenate([soak_s, 1800 + np.arange(0.0, 560.0, 0.1)])
    loaded = (time_s > 1800) & (time_s <= 2300)
    charge_A = np.where(loaded, -1.0 + 0.5 * np.sin(time_s), 0.0)
    ah = np.concatenate([[0.0], np.cumsum(charge_A[1:] * np.diff(time_s)) / 3600])
    voltage_V = 4.0 + 0.1 * ah + 0.05 * charge_A
    columns = np.column_stack([time_s, charge_A, voltage_V, np.full_like(time_s, 25.0), ah, 1 + ah / 2.05])
    text = "time_s,current_A,voltage_V,temperature_C,ah,soc_ref\n"
    text += "\n".join(",".join(f"{value:.6f}" for value in row) for row in columns)
    for each in recorded.RECORDED.values():
        (tmp_path / each.cell).mkdir(exist_ok=True)
        (tmp_path / each.cell / f"{each.file}.csv.gz").write_bytes(gzip.compress(text.encode(), 1))
    monkeypatch.setenv(DATA_FOLDER, str(tmp_path))
    return tmp_path


def test_without_a_data_folder_its_absence_is_named(monkeypatch):
    monkeypatch.delenv(DATA_FOLDER, raising=False)
    assert DATA_FOLDER in recorded.missing()
    with pytest.raises(ConfigError, match=DATA_FOLDER):
        recorded.load("a123_lfp/DYN_P25")


def test_a_recording_that_is_not_in_the_folder_is_named(made_up):
    assert recorded.missing() is None
    (made_up / "a123_lfp" / "DYN_P25.csv.gz").unlink()
    assert "a123_lfp/DYN_P25" in recorded.missing()


def test_a_name_that_is_no_recording_is_refused(made_up):
    with pytest.raises(ConfigError, match="a123_lfp/DYN_P25"):
        recorded.load("a123_lfp/DYN_P26")


@pytest.mark.parametrize("name", ["a123_lfp/DYN_N15", "panasonic_ncr18650pf/n10degC_US06"])
def test_a_recording_has_its_charge_its_sign_and_its_reference(made_up, name):
    trace = recorded.load(name)
    assert trace.soc_ref_sigma == recorded.RECORDED[name].soc_ref_sigma
    assert trace.ambient_degC < -5
    assert trace.rows == 2360
    assert np.isfinite(trace.voltage_V).all()  # the soak, too
    drawn_Ah = np.cumsum(trace.current_A) / 3600
    assert trace.current_A[1900:2200].mean() == pytest.approx(1.0, abs=0.01)
    np.testing.assert_allclose(trace.soc[:, 0], 1 - drawn_Ah / 2.05, atol=1e-4)


def test_only_the_panasonic_voltage_is_moved_by_its_lag(made_up):
    moved, kept = (recorded.load(name) for name in ("panasonic_ncr18650pf/25degC_US06", "a123_lfp/DYN_P25"))
    slopes_V = np.gradient(kept.voltage_V[1850:2250, 0])
    lead_s = slopes_V @ (moved.voltage_V - kept.voltage_V)[1850:2250, 0] / (slopes_V @ slopes_V)
    assert lead_s == pytest.approx(0.1, abs=0.02)


@pytest.mark.skipif(recorded.missing() is not None, reason=str(recorded.missing()))
@pytest.mark.parametrize("name", recorded.RECORDED)
def test_the_reference_soc_of_a_recording_follows_its_current(name):
    assert os.environ[DATA_FOLDER]
    trace = recorded.load(name)
    drawn_Ah = np.cumsum(trace.current_A) / 3600
    counted = trace.soc[0, 0] - (drawn_Ah - drawn_Ah[0]) / trace.capacity_Ah[0]
    assert np.abs(trace.soc[:, 0] - counted).max() < REFERENCE_ERROR
    assert trace.rows > 3000
    assert np.isfinite(trace.voltage_V).all()
