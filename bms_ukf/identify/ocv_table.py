"""Open-circuit voltage somebody else has made: a table of it over SoC, or the electrodes of a BPX file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bms_ukf import bpx, manifest
from bms_ukf.errors import ConfigError
from bms_ukf.identify import ocv
from bms_ukf.manifest import MeasuredTest
from bms_ukf.recordings import Selection, read_columns, require_voltage

REQUIRED = ("soc_ref", "voltage_V")
FEWEST_ROWS = 8
WIDEST_GAP = 0.1  # SoC between rows: more is drawn over, and named
FALLS_V, FALLS_TOO_FAR_V = 2e-3, 0.05  # of a voltage as SoC rises: named, and refused
NEGATIVE_V = 1e-3  # of a hysteresis, which is half of charge branch minus discharge branch


def load(path: Path, test: MeasuredTest) -> tuple[ocv.Curve, list[str]]:
    """The curve of a test of the manifest at `path`, and warnings. Raises ConfigError if it is none.

    Columns: SoC as a fraction (or in percent, if its header says so), voltage, and perhaps half the hysteresis.
    """
    file = manifest.find(path, test.file)
    if file.suffix == ".json":
        found = dict(zip(REQUIRED, bpx.open_circuit(file), strict=True))
    else:
        found = read_columns(file, Selection(test.columns.named(), test.where), REQUIRED)
    soc, voltage_V = (found[key] for key in REQUIRED)
    require_voltage(file.name, voltage_V)
    half_V = found.get("hysteresis_V")
    known = np.isfinite(soc) & np.isfinite(voltage_V) & (True if half_V is None else np.isfinite(half_V))
    warnings = []
    if not known.all():
        warnings.append(f"{file.name}: {np.count_nonzero(~known)} of {known.size} rows without a number left out")
    order = np.flatnonzero(known)[np.argsort(soc[known], kind="stable")]
    soc, voltage_V = soc[order], voltage_V[order]
    if soc.size < FEWEST_ROWS or soc[0] < -0.5 or soc[-1] > 1.5 or np.ptp(soc) < 0.5:
        seen = f"{soc.size} rows from {soc[0]:g} to {soc[-1]:g}" if soc.size else "no rows"
        expected = f"at least {FEWEST_ROWS} rows over most of 0..1 (or percent, with % in the header)"
        raise ConfigError(file, key="soc", value=seen, expected=expected)
    if np.corrcoef(soc, voltage_V)[0, 1] < 0.5:
        raise ConfigError(file, key="voltage_V", expected="an open-circuit voltage that rises with SoC")
    warnings += [f"{file.name}: {text}" for text in (*_about_reach(soc), *_about_falls(file, soc, voltage_V))]
    if half_V is not None:
        warnings += [f"{file.name}: {text}" for text in _about_hysteresis(file, half_V[order])]
    inside = (soc > -0.02) & (soc < 1.02)
    curve_V, sigma_V = ocv.rising(soc[inside], voltage_V[inside])
    half = None if half_V is None else np.maximum(np.interp(ocv.SOC, soc, half_V[order]), 0.0)
    return ocv.Curve(test.temperature_degC, curve_V, sigma_V, half, 0.0, ("table",)), warnings


def _about_reach(soc: ocv.Array) -> list[str]:
    warnings = []
    if soc[0] > 0.05 or soc[-1] < 0.95:
        warnings.append(f"covers SoC {soc[0]:.2f} to {soc[-1]:.2f} only")
    widest = int(np.argmax(np.diff(soc)))
    if soc[widest + 1] - soc[widest] > WIDEST_GAP:
        warnings.append(f"nothing between SoC {soc[widest]:.2f} and {soc[widest + 1]:.2f}")
    return warnings


def _about_falls(file: Path, soc: ocv.Array, voltage_V: ocv.Array) -> list[str]:
    """Where the voltage falls as SoC rises. Raises ConfigError if it falls too far for a measured curve."""
    fall_V = np.maximum.accumulate(voltage_V) - voltage_V
    k = int(np.argmax(fall_V))
    if fall_V[k] < FALLS_V:
        return []
    seen = f"{1e3 * fall_V[k]:.0f} mV lower at SoC {soc[k]:.3g} than at a lower SoC"
    if fall_V[k] > FALLS_TOO_FAR_V:
        raise ConfigError(file, key="voltage_V", value=seen, expected="an open-circuit voltage that rises with SoC")
    return [f"voltage is {seen}: the nearest rising curve is drawn"]


def _about_hysteresis(file: Path, half_V: ocv.Array) -> list[str]:
    """Whether the branches cross. Raises ConfigError if the charge branch is the lower one."""
    if np.median(half_V) < -NEGATIVE_V:
        seen, expected = f"{1e3 * np.median(half_V):.1f} mV", "half of charge branch minus discharge branch, 0 or more"
        raise ConfigError(file, key="hysteresis_V", value=seen, expected=expected)
    crossed = int(np.count_nonzero(half_V < -NEGATIVE_V))
    return [f"hysteresis below 0 in {crossed} of {half_V.size} rows: taken for 0"] if crossed else []
