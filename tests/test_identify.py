"""Identification: known answers on a made-up cell that has more to it than the model, and data that cannot be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bms_ukf import identify, toml
from bms_ukf.cell import CellParams
from bms_ukf.cli import main
from bms_ukf.errors import ConfigError
from bms_ukf.identify import choice, dynamics, ocv, ocv_rests, openloop, samples, uncertainty
from bms_ukf.identify.simulate import R0, R1, Place, between, drop
from bms_ukf.identify.tables import SOC, Structure, Unknowns
from bms_ukf.manifest import Manifest, MeasuredTest
from bms_ukf.recordings import Recording

Array = NDArray[np.float64]

CAPACITY_AH = 3.0


def ocv_V(soc: Array) -> Array:
    """An NMC-like curve from 2.8 to 4.2 V."""
    return 3.4 + 0.75 * soc - 0.6 * np.exp(-25 * soc) + 0.05 * np.tanh((soc - 0.6) / 0.08)


def resistance_ohm(temperature_degC: Array) -> Array:
    return 0.03 * np.exp(2500 * (1 / (temperature_degC + 273.15) - 1 / 298.15))


def plant(current_A: Array, step_s: float, temperature_degC: float, seed: int) -> tuple[Array, Array]:
    """Voltage and surface temperature of a cell with four RC pairs, self-heating and noise; full at the start."""
    rng = np.random.default_rng(seed)
    soc = 1 - np.cumsum(current_A) * step_s / 3600 / CAPACITY_AH
    heat_W = current_A**2 * 0.05
    temperature = temperature_degC + samples_lowpass(heat_W * 3.0, step_s, 900.0)
    r = resistance_ohm(temperature)
    shape = 1 + 0.8 * np.exp(-8 * np.clip(soc, 0, 1))
    voltage = ocv_V(np.clip(soc, 0, 1)) - r * shape * 4.0 * np.arcsinh(current_A / 4.0)
    for share, tau_s in ((0.3, 3.0), (0.4, 25.0), (0.5, 150.0), (0.3, 1500.0)):
        voltage -= samples_lowpass(share * r * shape * current_A, step_s, tau_s)
    noise_V = rng.normal(0, 1e-3, current_A.size)
    return voltage + noise_V, temperature


def samples_lowpass(drive: Array, step_s: float, tau_s: float) -> Array:
    out, y, a = np.empty_like(drive), 0.0, np.exp(-step_s / tau_s)
    for k, value in enumerate(drive):
        y = a * y + (1 - a) * value
        out[k] = y
    return out


def drive_A(seed: int) -> Array:
    """Stretches of a minute or more with a mean and a fast random part, until 5 % of the charge is left."""
    rng = np.random.default_rng(seed)
    parts = []
    while sum(part.sum() for part in parts) < 0.95 * CAPACITY_AH * 3600:
        n = int(rng.integers(60, 400))
        fast = np.repeat(rng.normal(0, 1.5, n // 8 + 1), 8)[:n]
        parts.append(np.clip(rng.uniform(-0.5, 3.5) + fast, -4, 9))
    return np.concatenate(parts)


def save(path: Path, step_s: float, current_A: Array, voltage_V: Array, temperature_degC: Array) -> None:
    time_s = np.arange(current_A.size) * step_s
    table = np.column_stack([time_s, -current_A, voltage_V, temperature_degC])
    np.savetxt(path, table, delimiter=",", header="time_s,current_A,voltage_V,temperature_C", comments="", fmt="%.6f")


MANIFEST = """
format = 1
cell = "made_up"
chemistry = "NMC"
current_positive = "charge"
voltage_limits_V = [2.8, 4.2]
"""


def entry(role: str, file: str, temperature: float, **more: object) -> str:
    lines = [f'role = "{role}"', f'file = "{file}"', f"temperature_degC = {temperature}"]
    lines += [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}" for key, value in more.items()]
    return "\n[[test]]\n" + "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A manifest of a slow discharge and one drive at 25 and at 0 degC, with another of each to validate."""
    folder = tmp_path_factory.mktemp("made_up")
    slow = np.concatenate([np.zeros(10), np.full(int(20 * 60 * 0.998), CAPACITY_AH / 20)])
    save(folder / "slow.csv", 60.0, slow, *plant(slow, 60.0, 25.0, 0))
    text = MANIFEST + f"capacity_Ah = {CAPACITY_AH}\n" + entry("ocv", "slow.csv", 25)
    for temperature in (25, 0):
        for use, seed in (("fit", 1), ("validate", 7)):
            current_A = drive_A(seed + temperature)
            file = f"{use}_{temperature}.csv"
            save(folder / file, 1.0, current_A, *plant(current_A, 1.0, temperature, seed))
            text += entry("drive", file, temperature, use=use)
    (folder / "manifest.toml").write_text(text)
    return folder / "manifest.toml"


@pytest.fixture(scope="module")
def found(made_up: Path) -> identify.Identified:
    return identify.run(made_up)


def test_a_slow_discharge_and_one_drive_per_temperature_make_a_good_cell(found: identify.Identified) -> None:
    errors_mV = [1e3 * prediction.rmse_V() for prediction in found.predictions["validate"]]
    assert len(errors_mV) == 2
    assert max(errors_mV) < 5


def test_the_ohmic_resistance_is_that_of_the_plant(found: identify.Identified) -> None:
    """What drops within a sample: r0 and the pair of 3 s are one to rows of 1 s only in part."""
    for temperature in (0.0, 25.0):
        r0 = found.cell.dynamics_at(0.5, temperature)["r0_ohm"]
        expected = float(resistance_ohm(np.array(temperature)))
        assert 0.85 * expected < float(r0) < 1.5 * expected


def test_the_ocv_is_that_of_the_plant(found: identify.Identified) -> None:
    soc = np.linspace(0.1, 0.95, 50)
    assert np.abs(found.cell.ocv_V(soc, 25.0) - ocv_V(soc)).max() < 0.015


def test_the_cell_file_predicts_what_the_fit_did(found: identify.Identified, made_up: Path) -> None:
    _, chosen, _, _ = identify.load(made_up, Manifest.load(made_up))
    for test, prediction in zip(chosen["fit"], found.predictions["fit"], strict=True):
        inside = (test.soc > 0.05) & (test.soc < 0.95)
        assert np.abs(found.model.simulate(test) - prediction.predicted_V)[inside].max() < 2e-3


def test_the_text_is_the_cell_that_was_judged(found: identify.Identified, tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text(found.text)
    assert CellParams.load(tmp_path / "cell.toml") == found.cell
    assert found.cell.provenance["sha256"].keys() >= {"slow.csv"}


def test_the_noise_covers_the_errors_of_tests_never_fitted(found: identify.Identified) -> None:
    expected_V = np.sqrt(sum(value**2 for key, value in found.cell.noise if key.endswith("_V") and value))
    seen_V = max(prediction.rmse_V() for prediction in found.predictions["validate"])
    assert 0.3 * seen_V < expected_V < 10 * seen_V


def unknowns(pairs: int) -> Unknowns:
    half = np.full(SOC.size, 0.02)
    return Unknowns(
        Structure(pairs, hysteresis=True),
        np.array([0.0, 25.0, 40.0]),
        3.0,
        np.full(SOC.size, 0.7),
        half,
        both_branches=True,
    )


def test_derivatives_are_those_of_the_simulation() -> None:
    layout, rng = unknowns(2), np.random.default_rng(3)
    x = layout.start + 0.1 * rng.normal(size=layout.size)
    n = 300
    place = Place(*between(np.linspace(-3.6, -3.3, n), layout.inverse_K), *between(np.linspace(1, 0.2, n), SOC))
    current_A = np.repeat(rng.normal(0, 4, n // 10), 10)
    arguments = (rng.uniform(0.5, 2, n), current_A, current_A, place)
    tables, rate = layout.tables(x), 1e-2
    out, by_table = np.empty(n), np.empty((n, tables.size + 1))
    drop(*arguments, tables, rate, 1, out, by_table)
    for entry_ in rng.choice(tables.size, 60, replace=False):
        shifted = []
        for step in (1e-5, -1e-5):
            other, moved = np.empty(n), tables.copy()
            moved.ravel()[entry_] += step
            drop(*arguments, moved, rate, 1, other, np.empty((0, tables.size + 1)))
            shifted.append(other)
        np.testing.assert_allclose(by_table[:, entry_], (shifted[0] - shifted[1]) / 2e-5, atol=1e-8)
    above, below = np.empty(n), np.empty(n)
    drop(*arguments, tables, rate * np.exp(1e-5), 1, above, np.empty((0, tables.size + 1)))
    drop(*arguments, tables, rate * np.exp(-1e-5), 1, below, np.empty((0, tables.size + 1)))
    np.testing.assert_allclose(by_table[:, -1], (above - below) / 2e-5, atol=1e-8)


def test_the_simulation_relaxes_exactly_for_any_step() -> None:
    layout = unknowns(1)
    tables = layout.tables(layout.start)
    ends = []
    for n in (1, 500):
        place = Place(*between(np.full(n, -1000 / 298.15), layout.inverse_K), *between(np.full(n, 0.5), SOC))
        out = np.empty(n)
        step_s = np.full(n, 60.0 / n)
        drop(step_s, np.full(n, 2.0), np.zeros(n), place, tables, 0.0, 1, out, np.empty((0, tables.size + 1)))
        ends.append(out[-1])
    r, tau = np.exp([np.interp(-1000 / 298.15, layout.inverse_K, tables[R1 + c, :, 8]) for c in (0, 1)])
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)
    assert ends[0] == pytest.approx(2.0 * r * (1 - np.exp(-60.0 / tau)), rel=1e-6)


def test_a_noisy_plateau_becomes_strictly_rising_without_bending_it() -> None:
    rng = np.random.default_rng(5)
    soc = np.linspace(0, 1, 3000)
    true_V = 3.3 + 0.02 * soc + 0.3 * soc**20 - 0.4 * np.exp(-60 * soc)
    curve, sigma = ocv.rising(soc, true_V + rng.normal(0, 2e-3, soc.size))
    assert np.all(np.diff(curve) > 0)
    inside = (ocv.SOC > 0.1) & (ocv.SOC < 0.9)
    error_V = curve - (3.3 + 0.02 * ocv.SOC + 0.3 * ocv.SOC**20 - 0.4 * np.exp(-60 * ocv.SOC))
    running_V = np.interp(ocv.SOC, soc, np.maximum.accumulate(true_V + rng.normal(0, 2e-3, soc.size)))
    assert np.abs(error_V[inside]).max() < 1e-3
    assert np.abs(running_V - curve)[inside].max() > 3e-3
    assert 1e-5 < np.median(sigma[inside]) < 1e-3


def slow_run(direction: int, offset_V: float, hours: float = 20.0) -> Recording:
    n = 1000
    moved = np.linspace(0, CAPACITY_AH * hours / 20, n)
    soc = 1 - moved / CAPACITY_AH if direction > 0 else moved / CAPACITY_AH
    current_A = np.full(n, direction * CAPACITY_AH / 20)
    voltage_V = ocv_V(soc) - direction * offset_V
    return Recording(
        "slow", moved * 3600 / (CAPACITY_AH / 20), current_A, voltage_V, np.full(n, 25.0), direction * moved
    )


def manifest(**more: object) -> Manifest:
    data = {
        "format": 1,
        "cell": "x",
        "chemistry": "NMC",
        "current_positive": "discharge",
        "voltage_limits_V": [2.8, 4.2],
        "test": [{"role": "ocv", "file": "x", "temperature_degC": 25.0}],
    }
    return toml.validate(data | more, Manifest, "manifest")


def test_ocv_is_the_mean_of_the_branches_and_hysteresis_half_their_width() -> None:
    tests = manifest()
    slow = ocv.analyse(tests, [(tests.test[0], slow_run(1, 0.02)), (tests.test[0], slow_run(-1, 0.02))], "m")
    inside = (ocv.SOC > 0.1) & (ocv.SOC < 0.9)
    assert slow.capacity_Ah == pytest.approx(CAPACITY_AH, rel=1e-3)
    np.testing.assert_allclose(slow.at(25.0)[inside], ocv_V(ocv.SOC)[inside], atol=2e-3)
    assert slow.half_width_V is not None
    np.testing.assert_allclose(slow.half_width_V[inside], 0.02, atol=2e-3)


def test_a_charge_that_does_not_close_the_cycle_is_left_out_and_named() -> None:
    tests = manifest()
    short = slow_run(-1, 0.02, hours=17.0)
    short.voltage_V[-1] = 4.2
    slow = ocv.analyse(tests, [(tests.test[0], slow_run(1, 0.02)), (tests.test[0], short)], "m")
    assert slow.half_width_V is None
    assert any("upper limit after 85 %" in warning for warning in slow.warnings)


def test_a_capacity_off_by_a_factor_is_refused_with_the_measured_one() -> None:
    tests = manifest(capacity_Ah=30.0)
    with pytest.raises(ConfigError, match="about the 3 Ah"):
        ocv.analyse(tests, [(tests.test[0], slow_run(1, 0.0))], "m")


def test_no_slow_test_is_one_line() -> None:
    with pytest.raises(ConfigError, match="role 'ocv'"):
        ocv.analyse(manifest(), [], "m")


def test_rests_between_pulses_stand_in_for_a_slow_test() -> None:
    levels = np.linspace(1, 0.05, 20)
    soc = np.repeat(levels, 40)
    current_A = np.where(np.arange(soc.size) % 40 < 5, 3.0, 0.0)
    voltage_V = ocv_V(soc) - 0.03 * current_A
    time_s = np.arange(soc.size) * 60.0
    columns = (time_s, current_A, voltage_V, np.full(soc.size, 25.0), (1 - soc) * CAPACITY_AH)
    pulses = Recording("pulses", *columns)
    test = MeasuredTest(role="pulse", file="p", temperature_degC=25.0)
    slow = ocv_rests.from_rests(manifest(capacity_Ah=CAPACITY_AH), [(test, pulses, soc)], "m")
    inside = (ocv.SOC > 0.1) & (ocv.SOC < 0.95)
    np.testing.assert_allclose(slow.at(25.0)[inside], ocv_V(ocv.SOC)[inside], atol=5e-3)
    with pytest.raises(ConfigError, match="capacity_Ah"):
        ocv_rests.from_rests(manifest(), [(test, pulses, soc)], "m")


def test_one_temperature_is_enough(made_up: Path, tmp_path: Path) -> None:
    """Tables need two rows to interpolate; the second is an Arrhenius guess."""
    text = made_up.read_text()
    head, *entries = text.split("[[test]]")
    (tmp_path / "m.toml").write_text("[[test]]".join([head, *[e for e in entries if "_0.csv" not in e]]))
    for name in ("slow.csv", "fit_25.csv", "validate_25.csv"):
        (tmp_path / name).write_bytes((made_up.parent / name).read_bytes())
    alone = identify.run(tmp_path / "m.toml")
    assert 1e3 * alone.predictions["validate"][0].rmse_V() < 5


def test_charge_efficiency_comes_from_the_reference() -> None:
    rng = np.random.default_rng(6)
    current_A = rng.normal(0.3, 3, 20000)
    soc = 1 - np.cumsum(np.where(current_A < 0, 0.99, 1.0) * current_A) / 3600 / 10
    drawn = np.cumsum(current_A) / 3600
    columns = (np.full(20000, 3.7), np.full(20000, 25.0), drawn, soc)
    recording = Recording("a", np.arange(20000.0), current_A, *columns)
    test = MeasuredTest(role="drive", file="a", temperature_degC=25.0)
    assert samples.coulombic_efficiency([(test, recording)], 10.0) == pytest.approx(0.99, abs=1e-4)


def test_a_reversed_current_is_refused_from_the_command_line(
    made_up: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = made_up.parent / "wrong.toml"
    wrong.write_text(made_up.read_text().replace('"charge"', '"discharge"'))
    monkeypatch.setattr("sys.argv", ["bms-ukf", "identify", str(wrong), "--out", str(tmp_path / "c.toml")])
    with pytest.raises(SystemExit) as stop:
        main()
    message = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2
    assert "current_positive" in message[-1]
    assert not (tmp_path / "c.toml").exists()


def test_blocks_left_out_and_blocks_fitted_share_no_row(found: identify.Identified, made_up: Path) -> None:
    _, chosen, _, _ = identify.load(made_up, Manifest.load(made_up))
    pairs = zip(choice.alternate(chosen["fit"], 0), choice.alternate(chosen["fit"], 1), strict=True)
    for train, judge in pairs:
        assert not np.any(train.counted & judge.counted)
        assert np.all(train.counted | judge.counted)


def test_the_report_holds_every_test_and_warning(found: identify.Identified, tmp_path: Path) -> None:
    from bms_ukf.report.identify import write_report

    found.warnings.append("a warning to be seen")
    page = write_report(tmp_path / "report", found).read_text()
    assert all(prediction.name in page for group in found.predictions.values() for prediction in group)
    assert "a warning to be seen" in page
    assert {path.name for path in (tmp_path / "report").glob("*.png")} >= {"ocv.png", "tables.png", "voltage.png"}


def test_the_file_and_the_report_say_how_well_each_table_is_known(found: identify.Identified, tmp_path: Path) -> None:
    from bms_ukf.report.identify import parameter_rows, slow_rows, write_report

    stated = found.cell.provenance["rel_sigma"]
    rows = len(found.cell.dynamics.temperature_degC)
    assert {"r0_ohm", "r1_ohm", "tau1_s"} <= set(stated)
    assert all(len(values) == rows and min(values) > 0 for values in stated.values())
    assert len(found.cell.provenance["sigma"]["ocv_mV"]) == rows
    page = write_report(tmp_path / "report.html", found).read_text()
    assert all(cell in page for _, cells in parameter_rows(found) for cell in cells)
    assert slow_rows(found)[0][1] == f"{found.slow.drawn_Ah[25.0]:.3f} Ah"


def test_the_stated_error_of_r0_covers_what_halves_of_the_tests_make_of_it(
    found: identify.Identified, made_up: Path
) -> None:
    """Fits to alternating blocks differ by the errors of both; sigmas of independent rows would be far smaller."""
    _, chosen, _, _ = identify.load(made_up, Manifest.load(made_up))
    fits = [
        dynamics.fit(found.model, choice.alternate(chosen["fit"], phase), evaluations=8, kept=700, uncertain=True)
        for phase in (0, 1)
    ]
    seen = [fit.unknowns.tables(fit.x)[R0][:, uncertainty.MIDDLE] for fit in fits]
    stated = [uncertainty.tables(fit)["r0_ohm"][:, uncertainty.MIDDLE] for fit in fits]
    score = (seen[0] - seen[1]) / np.hypot(*stated)
    assert 0.05 < np.sqrt(np.mean(score**2)) < 3


def test_open_loop_of_a_shipped_cell_rests_at_its_ocv() -> None:
    cell = CellParams.load("lgm50_chen2020")
    n = 10
    test = samples.Samples(
        MeasuredTest(role="drive", file="a", temperature_degC=25.0),
        "rest",
        np.ones(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.full(n, 25.0),
        np.linspace(1, 0, n),
        np.ones(n, dtype=bool),
        np.zeros(n, dtype=bool),
    )
    np.testing.assert_allclose(openloop.predict(cell, test).predicted_V, cell.ocv_V(test.soc, 25.0), atol=1e-12)
