"""The plants whose traces the campaign runs on: how each FMU comes about, and which cell file stands for it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

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
    maker: tuple[str, ...] = ()  # what plantmaker is told; empty: the FMU is a shipped one
    parallel: int = 1  # a cell that is too small for a car is taken so many times
    hysteresis: bool = False

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


def _pybamm(name: str, *options: str) -> tuple[str, ...]:
    return ("--model", "SPMe", "--parameters", name, *options)


_LFP = _pybamm("Prada2013", "--thermal", "isothermal", "--hysteresis", "0.015")
PLANTS = {
    plant.name: plant
    for plant in (
        CampaignPlant("lgm50_spme", "lgm50_chen2020", "NMC811 / graphite-SiOx", 5.0, 2.5, 4.2, 3.63),
        CampaignPlant("prada2013", "prada2013", "LFP / graphite", 2.3, 2.0, 3.6, 3.2, _LFP, hysteresis=True),
        CampaignPlant("mohtat2020", "mohtat2020", "NMC532 / graphite", 5.0, 2.8, 4.2, 3.7, _pybamm("Mohtat2020")),
        CampaignPlant(
            "marquis2019", "marquis2019", "LCO / graphite", 4.08, 3.105, 4.1, 3.75, _pybamm("Marquis2019"), 6
        ),
        CampaignPlant("oregan2022", "oregan2022", "NMC811 / graphite-SiOx", 5.0, 2.5, 4.4, 3.7, _pybamm("ORegan2022")),
        CampaignPlant("okane2022", "okane2022", "NMC811 / graphite-SiOx", 5.0, 2.5, 4.2, 3.63, _pybamm("OKane2022")),
        CampaignPlant("ecker2015", "ecker2015", "NMC / graphite", 2.34, 2.5, 4.2, 3.65, _pybamm("Ecker2015"), 15),
    )
}
