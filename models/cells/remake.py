"""Makes the cell files that come from measured tests again, and prints their open-loop voltage errors.

    BMS_UKF_DATA=<folder of the data> python models/cells/remake.py [NAME...]

Each manifest of manifests/ gives a cell file of its name here, but for those whose name says what they leave out: they
are only scored. The date in [provenance] is the only thing that differs between two runs.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from bms_ukf import identify
from bms_ukf.report.identify import error_rows

HERE = Path(__file__).parent


def main() -> None:
    console = Console(width=110)
    for manifest in sorted((HERE / "manifests").glob("*.toml")):
        if sys.argv[1:] and manifest.stem not in sys.argv[1:]:
            continue
        start = time.perf_counter()
        found = identify.run(manifest)
        table = Table("test", "use", "RMSE", "bias", "temperature")
        table.title = f"{manifest.stem}: {found.model.unknowns.structure}, {time.perf_counter() - start:.0f} s"
        for row in error_rows(found):
            table.add_row(*row)
        console.print(table)
        if "_without_" not in manifest.stem:
            (HERE / f"{manifest.stem}.toml").write_text(found.text, encoding="utf-8")


if __name__ == "__main__":
    main()
