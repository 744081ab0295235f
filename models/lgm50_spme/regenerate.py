"""Writes cell.c, cell.h and fmu.toml of the shipped plant. Needs the `plant` extra.

python models/lgm50_spme/regenerate.py
"""

from __future__ import annotations

from pathlib import Path

from bms_ukf.plantmaker import folder, models


def main() -> None:
    folder.write(
        models.load("SPMe", "Chen2020"),
        Path(__file__).parent,
        name="lgm50_spme",
        description="LG M50 cell (5 Ah): single-particle model with electrolyte, lumped thermal",
        reference="PyBaMM SPMe, parameter set Chen2020; see documentation/README.md",
    )


if __name__ == "__main__":
    main()
