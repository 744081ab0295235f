"""Writes cell.c, cell.h and fmu.toml of the shipped pack. Needs the `plant` extra.

python models/pack_96s/regenerate.py
"""

from __future__ import annotations

from pathlib import Path

from bms_ukf.plantmaker import folder, models


def main() -> None:
    folder.write(
        models.load("SPMe", "Chen2020", var_pts=models.points(4, 1, 8)),
        Path(__file__).parent,
        name="pack_96s",
        description="96 LG M50 cells in series that differ: single-particle models with electrolyte, lumped thermal",
        reference="PyBaMM SPMe, parameter set Chen2020, coarse mesh; see documentation/README.md",
        series=96,
        spread=folder.Spread(capacity=0.01, resistance=0.05, soc=0.005, seed=1, gradient_K=8.0, weak=61),
        soc_initial=0.8,
    )


if __name__ == "__main__":
    main()
