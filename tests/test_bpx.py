"""The OCV of a BPX file: a known one, what cannot be one, and nothing run that the file says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bms_ukf import bpx
from bms_ukf.errors import ConfigError


def electrodes() -> dict[str, Any]:
    return {
        "Negative electrode": {
            "Minimum stoichiometry": 0.1,
            "Maximum stoichiometry": 0.9,
            "OCP [V]": "0.3 - 0.2 * x + 0.1 * exp(-20 * x) ** 2",
        },
        "Positive electrode": {
            "Minimum stoichiometry": 0.4,
            "Maximum stoichiometry": 1.0,
            "OCP [V]": {"x": [1.0, 0.0], "y": [3.5, 4.5]},
        },
    }


def save(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content))
    return path


def test_the_ocv_is_the_potentials_between_their_stoichiometry_limits(tmp_path: Path) -> None:
    soc, voltage_V = bpx.open_circuit(save(tmp_path / "a.json", {"Parameterisation": electrodes()}))
    p, n = 1.0 - 0.6 * soc, 0.1 + 0.8 * soc
    np.testing.assert_allclose(voltage_V, 4.5 - p - (0.3 - 0.2 * n + 0.1 * np.exp(-40 * n)), atol=1e-12)


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("OCP [V]", "__import__('os').getcwd()", "not allowed"),
        ("OCP [V]", "x.real", "not allowed"),
        ("OCP [V]", "3.4 +", "an expression of x"),
        ("OCP [V]", {"x": [0, 1]}, "a table of x and y"),
        ("OCP [V]", 0, "defined elsewhere"),
        ("OCP [V]", "-10 * x", "rising with SoC"),
        ("Minimum stoichiometry", None, "Minimum stoichiometry"),
    ],
)
def test_what_is_no_potential_is_one_line_that_names_it(tmp_path: Path, key: str, value: Any, named: str) -> None:
    wrong = electrodes()
    wrong["Positive electrode"][key] = value
    if value is None:
        del wrong["Positive electrode"][key]
    with pytest.raises(ConfigError, match=named) as error:
        bpx.open_circuit(save(tmp_path / "a.json", {"Parameterisation": wrong}))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [[], {}, {"Parameterisation": {}}])
def test_json_that_is_no_bpx_is_refused(tmp_path: Path, content: Any) -> None:
    with pytest.raises(ConfigError, match="a BPX file"):
        bpx.open_circuit(save(tmp_path / "a.json", content))


def test_published_files_reach_their_own_voltage_limits(third_party: Path) -> None:
    folder = third_party / "parameters" / "bpx"
    for name in ("lfp_18650_cell_BPX", "nmc_pouch_cell_BPX", "nmc_pouch_cell_BPX_SPM"):
        cell = json.loads((folder / f"{name}.json").read_text())["Parameterisation"]["Cell"]
        _, voltage_V = bpx.open_circuit(folder / f"{name}.json")
        assert voltage_V[0] == pytest.approx(cell["Lower voltage cut-off [V]"], abs=0.01)
        assert voltage_V[-1] == pytest.approx(cell["Upper voltage cut-off [V]"], abs=0.01)
    with pytest.raises(ConfigError, match="blend"):
        bpx.open_circuit(folder / "nmc_pouch_cell_BPX_blended_electrode.json")
