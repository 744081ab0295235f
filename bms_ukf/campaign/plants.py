"""The plants whose traces the campaign runs on: how each FMU comes about, and which cell file stands for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from bms_ukf.plantmaker.__main__ import main as make_plant

SPREAD = ("--spread-capacity", "0.01", "--spread-resistance", "0.1", "--spread-soc", "0.015", "--seed", "4")


class CampaignPlant(NamedTuple):
    """A plant of one cell. Capacity and voltages are those of a data sheet: they scale loads and end tests."""

    name: str
    cell: str  # the cell file that was identified from tests on it
    chemistry: str
    nominal_Ah: float
    low_V: float
    high_V: float
    nominal_V: float
    maker: tuple[str, ...] = ()  # arguments of plantmaker; empty: the FMU is a shipped one
    parallel: int = 1  # a cell that is too small for a car is taken so many times
    hysteresis: bool = False
    empty_full: tuple[float, float] = (0.0, 1.0)  # in the FMU's SoC, by the slow test: what the project calls 0 and 1

    def fmu(self, folder: Path, cells: int = 1) -> Path | str:
        """The plant FMU of so many cells in series, made in `folder` if it is not a shipped one."""
        if not self.maker and cells in (1, 96):
            return self.name if cells == 1 else "pack_96s"
        path = folder / f"{self.name}_{cells}.fmu"
        series = ("--series", str(cells), "--fmi", "3", *SPREAD) if cells > 1 else ()
        maker = self.maker or ("--parameters", "Chen2020")
        if not path.exists() and make_plant([str(path), *maker, "--parallel", str(self.parallel), *series]):
            raise SystemExit(2)
        return path


def _plant(
    parameters: str,
    chemistry: str,
    nominal_Ah: float,
    low_V: float,
    high_V: float,
    nominal_V: float,
    options: tuple[str, ...] = (),
    parallel: int = 1,
    **more: Any,
) -> CampaignPlant:
    """A parameter set of PyBaMM's under its name in small letters; capacity and maker are those of one cell."""
    maker = ("--model", "SPMe", "--parameters", parameters, *options)
    name, Ah = parameters.lower(), round(nominal_Ah * parallel, 3)
    return CampaignPlant(name, name, chemistry, Ah, low_V, high_V, nominal_V, maker, parallel, **more)


_LFP = ("--thermal", "isothermal", "--hysteresis", "0.015")
PLANTS = {
    plant.name: plant
    for plant in (
        CampaignPlant("lgm50_spme", "lgm50_chen2020", "NMC811 / graphite-SiOx", 5.0, 2.5, 4.2, 3.63),
        _plant("Prada2013", "LFP / graphite", 2.3, 2.0, 3.6, 3.2, _LFP, hysteresis=True, empty_full=(0.0087, 0.9992)),
        _plant("Mohtat2020", "NMC532 / graphite", 5.0, 2.8, 4.2, 3.7, empty_full=(0.0016, 0.9982)),
        _plant("Marquis2019", "LCO / graphite", 0.68, 3.105, 4.1, 3.75, parallel=6, empty_full=(0.0013, 0.9969)),
        _plant("ORegan2022", "NMC811 / graphite-SiOx", 5.0, 2.5, 4.2, 3.63, empty_full=(0.0075, 0.9820)),
        _plant("Ecker2015", "NMC / graphite", 0.156, 2.5, 4.2, 3.65, parallel=15, empty_full=(0.0004, 0.9990)),
    )
}
