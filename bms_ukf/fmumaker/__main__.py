"""`python -m bms_ukf.fmumaker FOLDER FMU`"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bms_ukf.errors import BmsError
from bms_ukf.fmumaker.build import build


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bms_ukf.fmumaker", description="Builds the co-simulation FMU of a model's folder."
    )
    parser.add_argument("folder", type=Path, help="with fmu.toml, README.md and C sources")
    parser.add_argument("fmu", type=Path)
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="version (default 2)")
    given = parser.parse_args()
    try:
        build(given.folder, given.fmu, given.fmi)
    except BmsError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(f"{given.fmu}: {given.fmu.stat().st_size} bytes\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
