"""`bms-ukf diagnose`: its figures against others' ways to them, what it prints, and what it refuses."""

from __future__ import annotations

import io
import json
import math
import re
import sys

import numpy as np
import pytest
import synthetic_cell
from kernel_record import Record
from rich.console import Console

from bms_ukf import CellParams, Tuning, cli, diagnose, diagnose_view
from bms_ukf.kernel import layout
from bms_ukf.kernel.adapt import FAST_S
from bms_ukf.kernel.params import SLOW_SIGMA_V
from bms_ukf.sensor_spec import SensorSpec

SIZES = [("small", 0.1 / 3), ("medium", 0.1), ("large", 0.2)]


@pytest.fixture(scope="module")
def found(cell: CellParams) -> dict:
    return diagnose.diagnose(cell)


def lasting_V(cell: CellParams) -> list[float]:
    """Sigmas of the voltages that a cell at rest may carry."""
    offset_V = SensorSpec().voltage_offset_sigma_V(float(cell.ocv_V(0.5, 25.0)))
    return [cell.noise.v_rc1_sigma_V, cell.noise.v_rc2_sigma_V, math.hypot(SLOW_SIGMA_V, offset_V)]


def shown(diagnosis: dict) -> str:
    console = Console(file=io.StringIO(), width=80, record=True, _environ={})
    diagnose_view.show(diagnosis, console)
    return console.export_text()


def run(monkeypatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["bms-ukf", "diagnose", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.mark.parametrize("soc", [0.5, 0.6])
def test_the_truth_is_what_a_million_cells_drawn_at_random_show(cell, soc):
    row = diagnose.diagnose(cell, soc, 0.06)["bias"][1]
    rng = np.random.default_rng(5)
    drawn = rng.normal(soc, 0.06, 1_000_000)
    voltage = cell.ocv_V(drawn, 25.0)
    for sigma_V in lasting_V(cell):
        voltage -= rng.normal(0, sigma_V, drawn.size)
    std_mV = 1e3 * voltage.std()
    assert row["true"]["mean_V"] == pytest.approx(voltage.mean(), abs=4e-6 * std_mV)
    assert row["true"]["std_mV"] == pytest.approx(std_mV, rel=0.004)


def test_the_truth_is_the_curves_integral_over_every_one_of_its_pieces(cell, found):
    record = Record(cell)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    for row in found["bias"]:
        edges = np.linspace(-2, 3, 1001)  # the kernel's 200 intervals of 0..1, and as fine beyond
        half = np.diff(edges) / 2
        soc = (edges[:-1] + half)[:, None] + half[:, None] * nodes
        density = np.exp(-(((soc - 0.5) / row["soc_sigma"]) ** 2) / 2) / (row["soc_sigma"] * math.sqrt(2 * math.pi))
        ocv = np.vectorize(record.ocv)(soc, 25.0)
        share = density * half[:, None] * weights
        mean = float((share * ocv).sum())
        variance = float((share * (ocv - mean) ** 2).sum()) + sum(sigma_V**2 for sigma_V in lasting_V(cell))
        assert row["true"]["mean_V"] == pytest.approx(mean, abs=1e-7)
        assert row["true"]["std_mV"] == pytest.approx(1e3 * math.sqrt(variance), rel=1e-5)


@pytest.mark.parametrize("soc", [0.3, 0.5, 0.9])
def test_the_compiled_filter_predicts_the_same_mean_and_variance(cell, soc):
    diagnosis = diagnose.diagnose(cell, soc)
    for row in diagnosis["bias"]:
        record = Record(cell, Tuning(gate_sigmas=1e6, current_bias=False))
        record.tick(0.0, 0.0, 3.7, 25.0)
        r0_sigma = math.sqrt(record.params[layout.P_R0_VAR])
        record.x, record.root = [soc, 0.0, 0.0, 0.0, 0.0], np.diag([row["soc_sigma"], *lasting_V(cell), r0_sigma])
        record["parts"] = 0  # the Gaussian is the belief, not a summary of components
        record["voltage_age"] = FAST_S  # the next voltage is not crowded
        record.tick(0.0, 0.0, 3.7, 25.0)
        r = record.params[layout.P_VAR_VOLTAGE] + record.params[layout.P_FAST_VAR]
        assert record["voltage_pred"] == pytest.approx(row["ukf"]["mean_V"], abs=1e-13)
        measured_V2 = record["innovation_var"] - r
        assert measured_V2 == pytest.approx(1e-6 * row["ukf"]["std_mV"] ** 2, rel=1e-11)
        if row["size"] == "medium":
            sound = diagnosis["positive_definite"]
            assert sound["r_mV2"] == pytest.approx(1e6 * r, rel=1e-12)
            explained = 1e6 * (row["ukf"]["std_mV"] * 1e-3) ** 2  # by the states, the mean shift's share included
            assert sound["least_mV2"] <= 1e6 * record["innovation_var"]
            assert sound["least_mV2"] - sound["r_mV2"] <= explained
            assert sound["guaranteed"]
            assert sound["least_mV2"] > sound["r_mV2"]


def test_the_points_are_the_filters_eleven(found):
    points = found["sigma_points"]
    reach = math.sqrt(5) * 0.1
    assert points["soc"] == pytest.approx([0.5, 0.5 + reach, *[0.5] * 4, 0.5 - reach, *[0.5] * 4])
    assert points["w_mean"] == pytest.approx([0.0, *[1 / 10] * 10])
    assert points["w_cov"] == pytest.approx([2.0, *[1 / 10] * 10])


def test_the_keys_are_those_that_are_documented(found):
    lines = re.findall(r"^    (\w+(?:, \w+)*)  +\S", str(diagnose.diagnose.__doc__), re.MULTILINE)
    assert [key for line in lines for key in line.split(", ")] == list(found)
    assert [(row["size"], row["soc_sigma"]) for row in found["bias"]] == [
        (size, pytest.approx(sigma)) for size, sigma in SIZES
    ]
    for row in found["bias"]:
        assert set(row) == {"size", "update", "soc_sigma", "outside", "true", "tangent_line", "ukf"}
        assert row["true"]["bias_mV"] == 0
    assert [row["update"] for row in found["bias"]] == [
        "sigma points",
        "components",
        "components",
    ]  # sigmas of 3.3, 10 and 20 %
    assert found["step_us"] > 0


def test_the_slope_and_what_it_is_worth(cell, found):
    assert [row["soc"] for row in found["observability"]] == pytest.approx(np.linspace(0, 1, 11))
    for row in found["observability"][1:-1]:
        rise = float(np.diff(cell.ocv_V([row["soc"] - 1e-4, row["soc"] + 1e-4], 25.0))[0])
        assert row["docv_dsoc_mV_per_pct"] == pytest.approx(
            1e3 * rise / 0.02, rel=0.05
        )  # the kernel has knots of its own
        assert row["soc_sigma"] == pytest.approx(found["voltage_error_mV"] / row["docv_dsoc_mV_per_pct"] / 100)


def test_a_straight_curve_needs_no_ukf_and_is_the_same_by_all_three():
    diagnosis = diagnose.diagnose(synthetic_cell.cell_of(synthetic_cell.linear()))
    for row in diagnosis["bias"]:
        assert [abs(row[name]["bias_mV"]) for name in ("tangent_line", "ukf")] == pytest.approx([0, 0], abs=1e-8)
        assert row["ukf"]["std_mV"] == pytest.approx(row["true"]["std_mV"], rel=1e-9)
        assert row["tangent_line"]["std_mV"] == pytest.approx(row["true"]["std_mV"], rel=1e-9)
    assert diagnosis["verdict"]["worth_it"] is False
    assert diagnosis["verdict"]["text"].startswith("No.")


@pytest.mark.parametrize(
    ("soc", "sigma", "worth_it", "judged_at"),
    [
        (0.4, 0.1, True, 0.1),  # the tangent line is 17 mV off in sigma, twice what a voltage is
        (0.5, 0.01, False, 0.01),
        (0.2, 0.2, True, 0.2 / 3),  # 16 % of the belief lie below 0
        (0.0, 0.1, None, None),
    ],
)
def test_the_verdict_follows_from_the_table(cell, soc, sigma, worth_it, judged_at):
    diagnosis = diagnose.diagnose(cell, soc, sigma)
    verdict = diagnosis["verdict"]
    assert verdict["worth_it"] is worth_it
    assert verdict["judged_at"] == (judged_at if judged_at is None else pytest.approx(judged_at))
    if judged_at is not None:
        (row,) = (row for row in diagnosis["bias"] if row["soc_sigma"] == verdict["judged_at"])
        tangent = row["tangent_line"]
        off_mV = max(abs(tangent["bias_mV"]), abs(tangent["std_mV"] - row["true"]["std_mV"]))
        assert (off_mV > diagnosis["voltage_error_mV"]) is worth_it


def test_sigma_points_that_do_no_better_are_not_recommended():
    def row(tangent_mV: float, ukf_mV: float) -> dict:
        biases = {"true": 0.0, "tangent_line": tangent_mV, "ukf": ukf_mV}
        return {"soc_sigma": 0.1, "outside": 0.0} | {k: {"bias_mV": v, "std_mV": 50.0} for k, v in biases.items()}

    assert diagnose._verdict([row(5.0, -6.0)], 3.0)["worth_it"] is False
    assert diagnose._verdict([row(5.0, -6.0)], 3.0)["text"].startswith("Not by sigma points.")
    assert diagnose._verdict([row(5.0, -4.0)], 3.0)["worth_it"] is True
    assert diagnose._verdict([row(2.0, 0.0)], 3.0)["worth_it"] is False


@pytest.mark.parametrize(("soc", "sigma"), [(0.5, 0.1), (0.9, 0.03), (0.0, 0.5)])
def test_the_text_fits_80_columns_and_loses_nothing(cell, soc, sigma):
    diagnosis = diagnose.diagnose(cell, soc, sigma)
    text = shown(diagnosis)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "…" not in text
    for piece in ("small", "medium", "large", "components", "EKF bias", "mV per %", "µs", "covariance weight"):
        assert piece in text, piece
    words = diagnosis["verdict"]["text"].split()
    assert all(word in text for word in words)


def test_the_command_prints_and_writes_the_same(cell, tmp_path, monkeypatch, capsys):
    path = tmp_path / "d.json"
    assert run(monkeypatch, cell.cell.name, "--soc", "0.9", "--sigma", "0.03", "--json", str(path)) == 0
    written = json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert (written["soc"], written["soc_sigma"], written["temperature_degC"]) == (0.9, 0.03, 25.0)
    assert f"{written['voltage_error_mV']:.2f} mV" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "pieces"),
    [
        (["lgm50_chen2020", "--soc", "1.5"], ["--soc", "1.5", "0..1"]),
        (["lgm50_chen2020", "--soc", "nan"], ["--soc", "nan", "0..1"]),
        (["lgm50_chen2020", "--sigma", "0"], ["--sigma", "0.0", "above 0"]),
        (["lgm50_chen2020", "--sigma", "-0.1"], ["--sigma", "-0.1", "above 0"]),
        (["lgm50_chen2020", "--sigma", "inf"], ["--sigma", "inf", "at most 0.5"]),
        (["lgm50_chen2020", "--temperature", "90"], ["--temperature", "90.0", "-10..45 degC"]),
        (["lgm50_chen2020", "--soc", "half"], ["--soc", "half"]),
        (["no_such_cell"], ["no_such_cell", "lgm50_chen2020"]),
        ([], ["CELL"]),
    ],
)
def test_a_mistake_is_one_line_that_names_it(arguments, pieces, monkeypatch, capsys):
    assert run(monkeypatch, *arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("bms-ukf: ")
    assert printed.err.count("\n") == 1
    assert all(piece in printed.err for piece in pieces), printed.err
