"""An identified model as a cell file: tables at the precision they have, units in the keys, and their provenance."""

from __future__ import annotations

import datetime
import hashlib
import json
import re
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf import manifest
from bms_ukf.identify import ocv
from bms_ukf.identify.beyond import Extended
from bms_ukf.identify.dynamics import SPLINES
from bms_ukf.identify.ocv_rows import OcvRows
from bms_ukf.identify.samples import Samples
from bms_ukf.identify.simulate import HYSTERESIS, KNEE, R0, R0_CHARGE, R1
from bms_ukf.identify.tables import SOC
from bms_ukf.manifest import Manifest

Array = NDArray[np.float64]
Sections = dict[str, dict[str, Any]]

EDGE_V = 0.25  # how far an OCV may run beyond the voltage limits; `CellParams` refuses 0.3 V
LIMITS_MARGIN_K = 5.0
BARE_KEY = re.compile("[A-Za-z0-9_-]+")  # any other key needs quotes


def sections(
    tests: Manifest, rows: Extended, slow: ocv.Slow, samples: Sequence[Samples], efficiency: float
) -> Sections:
    """Return the sections of a cell file but for [noise] and [provenance].

    The limits of temperature are those of the tests: in a row beyond, the estimator says that it extrapolates.
    """
    model = rows.model
    unknowns = model.unknowns
    tables = np.exp(rows.tables)
    temperatures = [float(T) for T in rows.temperature_degC]
    coldest, warmest = unknowns.temperature_degC[[0, -1]].tolist()
    current_A = np.concatenate([np.zeros(1), *(test.current_A for test in samples)])
    capacity_Ah = slow.capacity_Ah
    dynamics: dict[str, Any] = {"soc": SOC, "temperature_degC": temperatures, "r0_ohm": figures(tables[R0])}
    if not np.allclose(tables[R0_CHARGE], tables[R0], rtol=1e-3):
        dynamics["r0_charge_ohm"] = figures(tables[R0_CHARGE])
    if unknowns.structure.knee:
        dynamics["r0_knee_A"] = figures(tables[KNEE], 3)
    for j in range(unknowns.structure.pairs):
        dynamics[f"r{j + 1}_ohm"] = figures(tables[R1 + 2 * j])
        dynamics[f"tau{j + 1}_s"] = figures(tables[R1 + 2 * j + 1], 3)
    found: Sections = {
        "cell": {
            "name": tests.cell,
            "chemistry": tests.chemistry,
            "capacity_Ah": round(float(capacity_Ah), 4),
            "coulombic_efficiency": round(efficiency, 5),
            "voltage_limits_V": tests.voltage_limits_V,
            "current_limits_A": [
                round(min(float(current_A.min()), -0.5 * capacity_Ah), 1),
                round(max(float(current_A.max()), capacity_Ah), 1),
            ],
            "temperature_limits_degC": [coldest - LIMITS_MARGIN_K, warmest + LIMITS_MARGIN_K],
        },
        "ocv": {"temperature_degC": temperatures, "soc": ocv.SOC, "voltage_V": ocv_rows(rows, slow, tests).round(5)},
        "dynamics": dynamics,
    }
    if unknowns.structure.hysteresis:
        found["hysteresis"] = {
            "soc": SOC,
            "temperature_degC": temperatures,
            "max_V": tables[HYSTERESIS].round(5),
            "rate": round(float(np.exp(model.x[unknowns.rate])), 2),
        }
    if model.core is not None:
        found["thermal"] = dict(zip(("core_K_per_W", "core_tau_s"), (round(x, 3) for x in model.core), strict=True))
    return found


def ocv_rows(extended: Extended, slow: ocv.Slow, tests: Manifest) -> Array:
    """Return the OCV at every temperature row over `ocv.SOC`: the slow test's, its correction, strictly rising again.

    Beyond the tests of the dynamics the slow tests may go on; their correction is that of the nearest row.
    """
    model = extended.model
    correction_V, scales = model.unknowns.correction_V(model.x), np.exp(model.x[model.unknowns.scale])
    slow_V = OcvRows([slow.at(T) for T in extended.temperature_degC.tolist()])
    low, high = tests.voltage_limits_V
    rows = []
    for row, source in enumerate(extended.source):
        voltage_V, _ = slow_V(np.full(ocv.SOC.size, row), 1 - (1 - ocv.SOC) * scales[source])
        voltage_V = voltage_V + SPLINES(ocv.SOC) @ correction_V[source]
        curve, _ = ocv.rising(ocv.SOC, voltage_V, smoothing=ocv.SMOOTHING / 100)
        lifted = np.maximum(curve, low - EDGE_V + ocv.LEAST_SLOPE_V * ocv.SOC)
        rows.append(np.minimum(lifted, high + EDGE_V - ocv.LEAST_SLOPE_V * (1 - ocv.SOC)))
    return np.array(rows)


def provenance(
    path: Path, tests: Manifest, held_out_mV: dict[str, float], rmse_mV: dict[str, dict[str, float]]
) -> Sections:
    """Who made the file, when, of what, and how well it does."""
    files = {test.file: _sha256(manifest.find(path, test.file)) for test in tests.test}
    return {
        "provenance": {
            "made_by": f"bms-ukf identify {path.name}",
            "tool": tool(),
            "date": today(),
            "manifest_sha256": _sha256(path),
        },
        "provenance.held_out_rmse_mV": {name: round(value, 2) for name, value in held_out_mV.items()},
        **{f"provenance.{use}_rmse_mV": values for use, values in rmse_mV.items() if values},
        "provenance.sha256": files,
    }


def tool() -> str:
    """This package and its version."""
    try:
        return f"bms-ukf {version('bms-ukf')}"
    except PackageNotFoundError:
        return "bms-ukf (not installed as a package)"


def today() -> str:
    """The date in UTC, as ISO 8601."""
    return datetime.datetime.now(tz=datetime.UTC).date().isoformat()


def to_toml(found: Sections, title: str) -> str:
    """Return the text of a cell file; of the title, a comment, on one line."""
    printable = "".join(c if c.isprintable() else " " for c in title)
    lines = [f"# {printable}", "format = 1"]
    for section, values in found.items():
        lines.append(f"\n[{section}]")
        lines += [f"{_key(key)} = {_value(value)}" for key, value in values.items()]
    return "\n".join(lines) + "\n"


def figures(table: Array, digits: int = 4) -> Array:
    """Rounded to significant digits: resistances of large cells are small numbers."""
    power = 10.0 ** (digits - 1 - np.floor(np.log10(table)))
    return np.asarray(np.round(table * power) / power)


def _key(key: str) -> str:
    return key if BARE_KEY.fullmatch(key) else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, str):
        # JSON escapes as TOML does, but for U+007F, which it leaves as it is and TOML forbids.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if np.ndim(value) == 0:
        return f"{float(value):.10g}" if float(value) % 1 or abs(float(value)) > 1e9 else f"{float(value):.1f}"
    if np.ndim(value) == 1:
        return f"[{', '.join(map(_value, value))}]"
    return "[\n" + "".join(f"    {_value(row)},\n" for row in value) + "]"


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
