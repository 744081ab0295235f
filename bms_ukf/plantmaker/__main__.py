"""`python -m bms_ukf.plantmaker FMU --model SPMe --parameters Chen2020`"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import sys
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from bms_ukf.errors import BmsError, ConfigError


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bms_ukf.plantmaker",
        description="Makes a plant FMU without Python of a PyBaMM model and parameter set.",
    )
    parser.add_argument("fmu", type=Path, help="to write")
    parser.add_argument("--model", default="SPMe", help="SPM, SPMe or Thevenin (default SPMe)")
    parser.add_argument("--parameters", default="Chen2020", help="a parameter set of PyBaMM (default Chen2020)")
    parser.add_argument("--thermal", choices=("lumped", "isothermal"), default="lumped")
    parser.add_argument(
        "--points",
        type=_at_least_one,
        nargs=3,
        metavar=("E", "S", "P"),
        help="of the mesh: each electrode, separator, each particle (default 10 4 20)",
    )
    parser.add_argument(
        "--hysteresis", type=_volts, default=0.0, metavar="V", help="half the gap between charge and discharge branch"
    )
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="version (default 2)")
    parser.add_argument("--series", type=_at_least_one, metavar="N", help="cells in series, as arrays of N")
    parser.add_argument("--parallel", type=_block, default=1, metavar="N", help="each cell is N equal ones in parallel")
    parser.add_argument("--spread-capacity", type=_sigma, default=0.0, metavar="SIGMA", help="e.g. 0.01")
    parser.add_argument("--spread-resistance", type=_sigma, default=0.0, metavar="SIGMA", help="of its own, e.g. 0.1")
    parser.add_argument("--spread-soc", type=_sigma, default=0.0, metavar="SIGMA", help="e.g. 0.01")
    parser.add_argument("--gradient", type=float, default=0.0, metavar="K", help="of ambient, first to last cell")
    parser.add_argument(
        "--weak", type=_at_least_one, metavar="CELL", help="capacity -10 %%, resistance +30 %%, SoC -0.05"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the spread")
    parser.add_argument("--soc-initial", type=float, default=0.5)
    parser.add_argument("--sources", type=Path, metavar="DIR", help="keep the C sources and the table there")
    given = parser.parse_args(arguments)
    command = f"python -m bms_ukf.plantmaker {shlex.join(arguments if arguments is not None else sys.argv[1:])}"
    try:
        _make(given, command)
    except BmsError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(f"{given.fmu}: {given.fmu.stat().st_size} bytes\n")
    return 0


def _make(given: argparse.Namespace, command: str) -> None:
    if not 0 <= given.soc_initial <= 1:
        raise ConfigError("plantmaker", key="--soc-initial", value=given.soc_initial, expected="0 to 1")
    if given.weak is not None and given.weak > (given.series or 1):
        raise ConfigError("plantmaker", key="--weak", value=given.weak, expected="one of the cells of --series")
    if not -30 <= given.gradient <= 30:
        raise ConfigError("plantmaker", key="--gradient", value=given.gradient, expected="-30 to 30")
    if find_spec("pybamm") is None:
        raise ConfigError("plantmaker", expected="PyBaMM, which is not there: pip install 'bms-ukf[plant]'")
    os.environ.setdefault("PYBAMM_DISABLE_TELEMETRY", "true")
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as scratch:
        warnings.simplefilter("ignore")  # PyBaMM's own, of what it does not use here
        from bms_ukf.fmumaker.build import build
        from bms_ukf.plantmaker import folder, models

        points = models.points(*given.points) if given.points else models.FINE
        cell = models.load(given.model, given.parameters, given.thermal, var_pts=points)
        cell = replace(cell, hysteresis_V=given.hysteresis)
        sources = given.sources or Path(scratch)
        sources.mkdir(parents=True, exist_ok=True)
        cells = f", {given.series} in series" if given.series else ""
        folder.write(
            cell,
            sources,
            name=re.sub(r"\W", "_", given.fmu.stem) if given.fmu.stem[:1].isalpha() else f"plant_{given.model}",
            description=f"{given.model} cell, parameter set {given.parameters}, {given.thermal}{cells}",
            reference="PyBaMM; see documentation/README.md",
            series=given.series,
            spread=folder.Spread(
                capacity=given.spread_capacity,
                resistance=given.spread_resistance,
                soc=given.spread_soc,
                seed=given.seed,
                gradient_K=given.gradient,
                weak=given.weak,
            ),
            parallel=given.parallel,
            soc_initial=given.soc_initial,
        )
        (sources / "README.md").write_text(folder.page(cell, command), encoding="utf-8")
        build(sources, given.fmu, given.fmi)


def _at_least_one(text: str) -> int:
    if (number := int(text)) < 1:
        raise argparse.ArgumentTypeError("at least 1")
    return number


def _block(text: str) -> int:
    if not 1 <= (number := int(text)) <= 15:  # the largest capacity_factor is 20, of a cell that is larger than others
        raise argparse.ArgumentTypeError("1 to 15")
    return number


def _sigma(text: str) -> float:
    if not 0 <= (number := float(text)) <= 0.3:
        raise argparse.ArgumentTypeError("0 to 0.3")
    return number


def _volts(text: str) -> float:
    if not 0 <= (number := float(text)) <= 0.5:
        raise argparse.ArgumentTypeError("0 to 0.5")
    return number


if __name__ == "__main__":
    sys.exit(main())
