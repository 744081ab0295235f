"""The OCV of a BPX file: a known one, what cannot be one, and nothing run that the file says."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

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


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["x", "y", "OCP [V]"]), inner),
    max_leaves=6,
)
TERM = st.sampled_from(
    ["x", "1", "0", "1e300", "-x", "(x)", "x ** 99", "exp(x)", "log(x - 2)", "sqrt(0 - x)", "y", "@", "("]
)
EXPRESSION = st.lists(st.tuples(TERM, st.sampled_from(["+", "-", "*", "/", "**", " "])), min_size=1, max_size=5).map(
    lambda parts: "".join(term + operator for term, operator in parts) + "x"
)
DEEP = st.sampled_from(["-" * 5000 + "x", "(" * 300 + "x" + ")" * 300, "x+" * 5000 + "x", "9 ** 9 ** 9 ** 9", "1 / 0"])
PLACES = st.sampled_from(
    [
        (),
        ("Parameterisation",),
        *(("Parameterisation", electrode) for electrode in bpx.ELECTRODES),
        *(
            ("Parameterisation", electrode, key)
            for electrode in bpx.ELECTRODES
            for key in ("OCP [V]", "Minimum stoichiometry", "Maximum stoichiometry")
        ),
    ]
)


@given(place=PLACES, value=JSON | EXPRESSION | DEEP)
@example(place=("Parameterisation",), value=None)
def test_any_json_is_an_ocv_or_one_line(place: tuple[str, ...], value: Any) -> None:
    content: Any = {"Parameterisation": electrodes()}
    inner = content
    for key in place[:-1]:
        inner = inner[key]
    if place:
        inner[place[-1]] = value
    else:
        content = value
    with tempfile.TemporaryDirectory() as folder:
        try:
            soc, voltage_V = bpx.open_circuit(save(Path(folder) / "a.json", content))
        except ConfigError as error:
            line = str(error)
            assert "\n" not in line
            assert len(line) < 500
        else:
            assert soc.shape == voltage_V.shape
            assert np.isfinite(voltage_V).all()


def test_potentials_in_millivolts_are_named(tmp_path: Path) -> None:
    wrong = electrodes()
    wrong["Positive electrode"]["OCP [V]"] = "4500 - 1000 * x"
    wrong["Negative electrode"]["OCP [V]"] = "300 - 200 * x"
    with pytest.raises(ConfigError, match="is it in mV"):
        bpx.open_circuit(save(tmp_path / "a.json", {"Parameterisation": wrong}))


def test_published_files_reach_their_own_voltage_limits(third_party: Path) -> None:
    folder = third_party / "parameters" / "bpx"
    for name in ("lfp_18650_cell_BPX", "nmc_pouch_cell_BPX", "nmc_pouch_cell_BPX_SPM"):
        cell = json.loads((folder / f"{name}.json").read_text())["Parameterisation"]["Cell"]
        _, voltage_V = bpx.open_circuit(folder / f"{name}.json")
        assert voltage_V[0] == pytest.approx(cell["Lower voltage cut-off [V]"], abs=0.01)
        assert voltage_V[-1] == pytest.approx(cell["Upper voltage cut-off [V]"], abs=0.01)
    with pytest.raises(ConfigError, match="blend"):
        bpx.open_circuit(folder / "nmc_pouch_cell_BPX_blended_electrode.json")
