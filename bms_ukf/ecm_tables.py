"""Published tables of an equivalent circuit, as PyBaMM's Thevenin model reads them, turned into a cell file.

One CSV for each quantity, whose last column it is: `R0 [Ohm]`, `R1 [Ohm]`, `C1 [F]`, .. over `Temperature [degC]`,
`Current [A]` (positive = discharge) and `SoC`; `OCV [V]` over `SoC`; `dUdT [V/K]` over `OCV [V]` and temperature. What
such tables do not hold is asked for or assumed, and the cell file says so.

A cell file has r0 over current as r0 knee asinh(i / knee) / i, and no other current dependence: each r0 and its knee
are fitted to the table's currents, the RC pairs are means over them.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf import ecm_csv, plausible, toml
from bms_ukf.cell import NO_KNEE_A, CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.identify import cellfile

Array = NDArray[np.float64]

REFERENCE_DEGC = 25.0  # of the OCV
MOST_PAIRS = 3
# Assumed: nobody measured how far published tables are from the cell at hand.
VOLTAGE_SIGMA_V, PAIR_SIGMA_V, R0_SIGMA, RC_SIGMA = 0.005, 0.02, 0.2, 0.3


def import_cell(
    sources: Sequence[Path],
    *,
    name: str,
    chemistry: str,
    capacity_Ah: float,
    voltage_limits_V: tuple[float, float] | None = None,
) -> str:
    """The text of a cell file made of tables; folders stand for the CSV files in them.

    Raises ConfigError for what is missing or cannot be a cell.
    """
    files = _files(sources)
    tables: dict[str, Path] = {}
    for path in files:
        title = ecm_csv.header(path)[-1].split(" [")[0]
        if title in tables:
            raise ConfigError(path, key=title, expected=f"each quantity once; {tables[title].name} holds it too")
        tables[title] = path
    pairs = sum(f"R{j}" in tables for j in range(1, MOST_PAIRS + 2))
    needed = ["OCV", "R0", *(f"{letter}{j}" for j in range(1, max(pairs, 1) + 1) for letter in "RC")]
    missing = [title for title in needed if title not in tables]
    if missing or pairs > MOST_PAIRS:
        held = ", ".join(tables) or "none"
        expected = f"a table for each of {', '.join(needed)} (1 to {MOST_PAIRS} RC pairs); found {held}"
        raise ConfigError(sources[0], key=missing[0] if missing else f"R{pairs}", expected=expected)
    soc, ocv_V = _ocv(tables["OCV"])
    dynamics, deviation, currents_A = _dynamics(tables, pairs, capacity_Ah)
    low, high = voltage_limits_V or (float(ocv_V[0]), float(ocv_V[-1]))
    ocv: dict[str, Any] = {"temperature_degC": [REFERENCE_DEGC], "soc": soc, "voltage_V": ocv_V[None].round(5)}
    if "dUdT" in tables:
        ocv["docv_dT_V_per_K"] = _entropic(tables["dUdT"], ocv_V).round(7)
    temperatures = dynamics["temperature_degC"]
    found = {
        "cell": {
            "name": name,
            "chemistry": chemistry,
            "capacity_Ah": capacity_Ah,
            "voltage_limits_V": [low, high],
            "current_limits_A": [
                min(float(currents_A.min()), -capacity_Ah),
                max(float(currents_A.max()), capacity_Ah),
            ],
            "temperature_limits_degC": [temperatures[0] - 5.0, temperatures[-1] + 5.0],
        },
        "ocv": ocv,
        "dynamics": dynamics,
        "noise": {
            "voltage_sigma_V": VOLTAGE_SIGMA_V,
            "r0_rel_sigma": round(max(R0_SIGMA, deviation["r0_ohm"]), 3),
            **{f"v_rc{j}_sigma_V": PAIR_SIGMA_V for j in range(1, pairs + 1)},
            "rc_rel_sigma": round(max([RC_SIGMA, *(deviation[f"r{j}_ohm"] for j in range(1, pairs + 1))]), 3),
        },
        "provenance": {
            "made_by": "bms-ukf import",
            "tool": cellfile.tool(),
            "date": cellfile.today(),
            "noise": "assumed, not measured: no test of the cell stands behind these tables",
            "voltage_limits": "given" if voltage_limits_V else "assumed: the OCV at SoC 0 and 1",
        },
        "provenance.rel_deviation_from_tables": {key: round(value, 4) for key, value in deviation.items()},
        "provenance.sha256": {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in tables.values()},
    }
    text = cellfile.to_toml(found, f"{name}: from published tables; [noise] is an assumption (see [provenance]).")
    toml.validate(tomllib.loads(text), CellParams, f"the cell file from {sources[0]}")
    return text


def _files(sources: Sequence[Path]) -> list[Path]:
    files: list[Path] = []
    for source in sources:
        if source.suffix == ".json":
            _refuse_json(source)
        files += sorted(source.glob("*.csv")) if source.is_dir() else [source]
    if not files or any(path.suffix != ".csv" for path in files):
        raise ConfigError(sources[0], expected="CSV files of ECM tables, or a folder with some")
    return files


def _refuse_json(source: Path) -> None:
    """Raise ConfigError: no JSON is read, and a BPX file is wanted elsewhere."""
    try:
        found = json.loads(source.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        found = None
    expected = "ECM tables as CSV, no JSON"
    if isinstance(found, dict) and "Parameterisation" in found:
        expected = (
            "ECM tables as CSV: a BPX file has no resistances of a circuit. Give it to `bms-ukf identify` as a test"
            " of role 'ocv_table', with pulse or drive tests for the rest"
        )
    raise ConfigError(source, expected=expected)


def _ocv(path: Path) -> tuple[Array, Array]:
    """The OCV between SoC 0 and 1, with both ends."""
    _, numbers = ecm_csv.load(path, ["SoC"])
    soc, voltage_V = numbers[np.argsort(numbers[:, 0])].T
    if soc[0] > 1e-6 or soc[-1] < 1 - 1e-6:
        raise ConfigError(path, key="SoC", value=f"{soc[0]:g} to {soc[-1]:g}", expected="fractions that cover 0..1")
    if np.ptp(voltage_V) == 0:
        raise ConfigError(path, key="OCV [V]", value=float(voltage_V[0]), expected="a voltage that rises with SoC")
    inner = soc[(soc > 1e-6) & (soc < 1 - 1e-6)]
    knots = np.concatenate([[0.0], inner, [1.0]])
    return knots.round(6), np.interp(knots, soc, voltage_V)


def _entropic(path: Path, ocv_V: Array) -> Array:
    """dOCV/dT along the OCV, at its reference temperature."""
    table = ecm_csv.table(path, ("OCV [V]", "Temperature [degC]"))
    at_reference = [np.interp(REFERENCE_DEGC, table.axes[1], row) for row in table.values]
    return np.asarray(np.interp(ocv_V, table.axes[0], at_reference))


def _dynamics(
    tables: dict[str, Path], pairs: int, capacity_Ah: float
) -> tuple[dict[str, Any], dict[str, float], Array]:
    """The [dynamics], how far they are from the tables (relative, rms over currents), and the currents of r0."""
    r0 = ecm_csv.table(tables["R0"])
    temperatures, currents_A, soc = r0.axes
    if not (soc[0] <= 1e-6 and soc[-1] >= 1 - 1e-6):
        raise ConfigError(r0.path, key="SoC", value=f"{soc[0]:g} to {soc[-1]:g}", expected="fractions that cover 0..1")
    of_cell = f" for {capacity_Ah:g} Ah (--capacity)"
    resistances = plausible.DROP_AT_1C_V.times(1 / capacity_Ah)
    ecm_csv.require(r0.path, "R0 [Ohm]", float(np.median(r0.values)), resistances, of_cell)
    largest_A = float(np.abs(currents_A).max())
    if currents_A.size > 1:
        ecm_csv.require(r0.path, "Current [A]", largest_A, plausible.RATE_PER_H.times(capacity_Ah), of_cell)
    discharge, charge, knee_A = _knee(r0)
    sections: dict[str, Any] = {"soc": soc.round(6), "temperature_degC": [float(T) for T in temperatures]}
    sections["r0_ohm"] = cellfile.figures(discharge)
    if not np.allclose(charge, discharge, rtol=1e-3):
        sections["r0_charge_ohm"] = cellfile.figures(charge)
    if (knee_A < NO_KNEE_A).any():
        sections["r0_knee_A"] = cellfile.figures(knee_A, 3)
    shape = _bend(currents_A[None, :, None], knee_A[:, None, :])
    linear = np.where(currents_A[None, :, None] < 0, charge[:, None], discharge[:, None]) * shape
    deviation = {"r0_ohm": _rms(linear / r0.values - 1)}
    found = []
    for j in range(1, pairs + 1):
        r, c = ecm_csv.table(tables[f"R{j}"]), ecm_csv.table(tables[f"C{j}"])
        for table in (r, c):
            if not all(map(np.array_equal, table.axes, r0.axes)):
                expected = f"the same temperatures, currents and SoC as {r0.path.name}"
                raise ConfigError(table.path, key="rows", value=len(table.values.ravel()), expected=expected)
        smaller = resistances._replace(low=resistances.low / 100)
        ecm_csv.require(r.path, f"R{j} [Ohm]", float(np.median(r.values)), smaller, of_cell)
        mean = r.values.mean(axis=1)
        found.append((mean, (r.values * c.values).mean(axis=1), _rms(mean[:, None] / r.values - 1)))
    for j, (mean, tau_s, off) in enumerate(sorted(found, key=lambda pair: float(np.median(pair[1]))), start=1):
        sections |= {f"r{j}_ohm": cellfile.figures(mean), f"tau{j}_s": cellfile.figures(tau_s)}
        deviation[f"r{j}_ohm"] = off
    return sections, deviation, currents_A


def _knee(r0: ecm_csv.Table) -> tuple[Array, Array, Array]:
    """r0 of discharge and of charge, and the knee: least squares over the currents, each shape (temperatures, SoC)."""
    currents_A = r0.axes[1]
    drawn = currents_A > 0 if (currents_A > 0).any() else np.ones(currents_A.size, dtype=bool)
    put = currents_A < 0 if (currents_A < 0).any() else drawn
    size_A = max(float(np.abs(currents_A).max()), 1.0)
    best = np.full(r0.values[:, 0].shape, np.inf)
    discharge, knee_A = np.zeros_like(best), np.full_like(best, NO_KNEE_A)
    for knee in [NO_KNEE_A, *np.geomspace(0.02, 20, 241) * size_A]:
        bend = _bend(currents_A[drawn], np.array(knee))[None, :, None]
        r = (r0.values[:, drawn] * bend).sum(axis=1) / (bend**2).sum()
        misfit = ((r0.values[:, drawn] - r[:, None] * bend) ** 2).sum(axis=1)
        better = misfit < 0.9 * best
        best, discharge, knee_A = (np.where(better, *pair) for pair in ((misfit, best), (r, discharge), (knee, knee_A)))
    bend = _bend(currents_A[put][None, :, None], knee_A[:, None, :])
    charge = (r0.values[:, put] * bend).sum(axis=1) / (bend**2).sum(axis=1)
    return discharge, charge, knee_A


def _bend(current_A: Array, knee_A: Array) -> Array:
    """knee asinh(i / knee) / i: what is left of r0 at a current."""
    x = np.maximum(np.abs(current_A), 1e-9) / knee_A
    return np.asarray(np.arcsinh(x) / x)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
